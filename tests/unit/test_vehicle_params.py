"""Vehicle presets: the published numbers, the turn from FRD to FLU, and what a bad file is told."""

import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.errors import FileError, InputError
from jaxplan.records import replace
from jaxplan.vehicle import params
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.mixing import allocation_matrix, inverse_allocation_matrix, signed_sqrt
from jaxplan.vehicle.params import Vehicle, hover_speeds
from jaxplan.vehicle.toml import list_presets
from oracles.layouts import LAYOUTS
from tolerances import tolerance

PRESETS = Path(params.__file__).parent / "presets"


@pytest.mark.parametrize(("name", "hover", "ratio"), [("mfrl", 1080.0, 4.15), ("flightgoggles", 1133.0, 3.77)])
def test_presets_reproduce_the_published_hover_speed_and_thrust_ratio(name: str, hover: float, ratio: float) -> None:
    vehicle = load_vehicle(name)
    weight = vehicle.mass * vehicle.gravity
    assert math.sqrt(weight / (4 * vehicle.thrust_coefficient)) == pytest.approx(hover, abs=1.0)
    assert 4 * vehicle.thrust_coefficient * vehicle.rotor_speed_max**2 / weight == pytest.approx(ratio, abs=0.005)


def test_default_is_mfrl_and_values_stay_on_the_host() -> None:
    vehicle = load_vehicle()
    assert vehicle.name == "mfrl"
    assert isinstance(vehicle.mass, float)
    assert vehicle.rotor_positions.dtype == np.float64
    assert vehicle.astype(jnp.float32).rotor_positions.dtype == jnp.float32
    assert list_presets() == ["cf21", "flightgoggles", "mfrl", "racer5", "x500"]


@pytest.mark.parametrize("name", ["mfrl", "flightgoggles"])
def test_allocation_is_the_published_frd_mixer_seen_in_flu(name: str) -> None:
    vehicle = load_vehicle(name)
    lift, drag = vehicle.thrust_coefficient, vehicle.torque_coefficient
    frd = np.array(
        [
            0.08 * lift * np.array([1, -1, -1, 1]),
            0.08 * lift * np.array([1, 1, -1, -1]),
            drag * np.array([-1, 1, -1, 1]),
            -lift * np.array([1, 1, 1, 1]),
        ]
    )
    with jax.enable_x64(True):
        cast = vehicle.astype(jnp.float64)
        flu, inverse = np.asarray(allocation_matrix(cast)), np.asarray(inverse_allocation_matrix(cast))
    np.testing.assert_allclose(flu, np.diag([1, -1, -1, -1]) @ frd, **tolerance("exact"))
    np.testing.assert_allclose(inverse, np.linalg.inv(flu), rtol=1e-9, atol=1e-3)  # entries are 1e5 to 1e7


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts_without_symmetry_are_inverted(name: str) -> None:
    positions, spin = (np.array(part) for part in LAYOUTS[name])
    vehicle = replace(load_vehicle(), rotor_positions=positions, rotor_spin=spin)
    with jax.enable_x64(True):
        cast = vehicle.astype(jnp.float64)
        matrix, inverse = np.asarray(allocation_matrix(cast)), np.asarray(inverse_allocation_matrix(cast))
    np.testing.assert_allclose(inverse @ matrix, np.eye(4), **tolerance("exact"))
    single = np.asarray(inverse_allocation_matrix(vehicle.astype(jnp.float32)))
    np.testing.assert_allclose(single @ matrix, np.eye(4), **tolerance("exact", np.float32))
    speeds = hover_speeds(vehicle)
    assert (np.ptp(speeds) > 10.0) == (name != "spins by sides")
    weight = vehicle.mass * vehicle.gravity
    np.testing.assert_allclose(matrix @ speeds**2, [0.0, 0.0, 0.0, weight], atol=1e-12 * weight)


def test_a_mixer_without_full_rank_is_refused_with_its_rank() -> None:
    vehicle = load_vehicle()
    row = np.array([[0.1, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.2, 0.0, 0.0], [-0.2, 0.0, 0.0]])
    for positions, spin, rank in (
        (row, [1.0, -1.0, 1.0, -1.0], 3),
        (row, [1.0, 1.0, 1.0, 1.0], 2),
        (np.zeros((4, 3)), [1.0, -1.0, 1.0, -1.0], 2),
        (vehicle.rotor_positions, [1.0, 1.0, -1.0, -1.0], 3),
    ):
        with pytest.raises(InputError, match=f"rank {rank} .*want 4"):
            replace(vehicle, rotor_positions=positions, rotor_spin=np.array(spin))


def test_signed_sqrt_keeps_sign_and_nan() -> None:
    np.testing.assert_allclose(signed_sqrt(jnp.array([4.0, 0.0, -9.0])), [2.0, 0.0, -3.0])
    assert np.isnan(signed_sqrt(jnp.array(jnp.nan)))
    assert jax.grad(signed_sqrt)(0.0) == 0.0


def test_unknown_name_lists_the_presets() -> None:
    with pytest.raises(InputError, match="flightgoggles, mfrl"):
        load_vehicle("crazyflie")


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="none.toml"):
        load_vehicle(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("mass = 0.771", "", "lacks 'mass'"),
        ("mass = 0.771", "mass = 0.771\ncolour = 3", "unknown 'colour'"),
        ("mass = 0.771", 'mass = "heavy"', "'mass'"),
        ("mass = 0.771", "mass = true", "'mass'"),
        ("mass = 0.771", "mass = -1.0", "mass"),
        ("mass = 0.771", "mass = nan", "mass"),
        ("mass = 0.771", "mass = ", "not TOML"),
        ("inertia = [0.004, 0.004, 0.006]", "inertia = [0.004, 0.004]", "'inertia'"),
        ("inertia = [0.004, 0.004, 0.006]", "inertia = [[0.004], [0.004, 1.0]]", "'inertia'"),
        ("rotor_spin = [1.0, -1.0, 1.0, -1.0]", "rotor_spin = [1.0, 1.0, -1.0, -1.0]", "rank 3"),
        ("[-0.08, 0.08, 0.0],", "[0.08, 0.08, 0.0],", "centre of mass must lie between"),
        ("rotor_speed_min = 0.0", "rotor_speed_min = 1100.0", "above rotor_speed_min, 1100"),
        ("rotor_speed_min = 0.0", "rotor_speed_min = 3000.0", "rotor_speed_max"),
        ("rotor_speed_max = 2200.0", "rotor_speed_max = 1000.0", "hovering takes 1080 rad/s"),
        ("inertia = [0.004, 0.004, 0.006]", "inertia = [0.004, -0.004, 0.006]", "inertia"),
    ],
)
def test_bad_files_name_the_key(tmp_path: Path, old: str, new: str, said: str) -> None:
    text = (PRESETS / "mfrl.toml").read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(FileError, match=said):
        load_vehicle(path)


def test_a_copy_is_checked_and_a_file_loads_by_path(tmp_path: Path) -> None:
    vehicle = load_vehicle()
    with pytest.raises(InputError, match="mass"):
        replace(vehicle, mass=0.0)
    assert isinstance(jax.tree.map(lambda leaf: leaf, vehicle), Vehicle)
    source = PRESETS / "mfrl.toml"
    path = tmp_path / "mine.toml"
    path.write_bytes(source.read_bytes())
    assert load_vehicle(str(path)).mass == vehicle.mass
