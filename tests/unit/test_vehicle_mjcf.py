"""A user's own MJCF: what is read from it, that it flies like the same numbers in TOML, and what is refused."""

from pathlib import Path

import jax
import numpy as np
import pytest

import jaxplan
from jaxplan.errors import FileError
from jaxplan.tracking.model import vehicle_mjcf
from jaxplan.vehicle import params
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.mjcf import vehicle_from_mjcf
from tolerances import tolerance

MINE = """<mujoco>
  <option gravity="0 0 -9.8"/>
  <worldbody>
    <body name="drone" pos="0 0 1">
      <freejoint/>
      <geom type="box" size="0.1 0.1 0.02" contype="0" conaffinity="0"/>
      <inertial pos="0 0 0.01" mass="0.9" diaginertia="0.003 0.005 0.004"/>
      <site name="a" pos="0.1 -0.1 0.02"/> <site name="b" pos="-0.1 0.1 0.02"/>
      <site name="c" pos="0.1 0.1 0.02"/> <site name="d" pos="-0.1 -0.1 0.02"/>
    </body>
  </worldbody>
  <actuator>
    <motor site="a" gear="0 0 1 0 0 -0.02" ctrlrange="0 8"/> <motor site="b" gear="0 0 1 0 0 -0.02" ctrlrange="0 8"/>
    <motor site="c" gear="0 0 1 0 0 0.02" ctrlrange="0 8"/> <motor site="d" gear="0 0 1 0 0 0.02" ctrlrange="0 8"/>
  </actuator>
</mujoco>
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.xml"
    path.write_text(text, encoding="utf-8")
    return path


def test_mass_inertia_rotors_and_limits_are_read(tmp_path: Path) -> None:
    vehicle, base = vehicle_from_mjcf(written(tmp_path, MINE)), load_vehicle()
    assert (vehicle.name, vehicle.mass, vehicle.gravity) == ("mine", 0.9, 9.8)
    np.testing.assert_allclose(vehicle.inertia, [0.003, 0.005, 0.004])
    np.testing.assert_allclose(vehicle.rotor_positions[0], [0.1, -0.1, 0.01])
    np.testing.assert_array_equal(vehicle.rotor_spin, [-1.0, -1.0, 1.0, 1.0])
    assert vehicle.torque_coefficient == pytest.approx(0.02 * base.thrust_coefficient)
    assert vehicle.thrust_coefficient * vehicle.rotor_speed_max**2 == pytest.approx(8.0)
    assert vehicle.motor_time_constant == base.motor_time_constant


def test_the_public_loader_takes_presets_toml_and_mjcf(tmp_path: Path) -> None:
    assert jaxplan.load_vehicle is load_vehicle  # there is one
    assert jaxplan.load_vehicle().name == "mfrl"
    preset = Path(params.__file__).parent / "presets" / "flightgoggles.toml"
    assert jaxplan.load_vehicle(preset).mass == jaxplan.load_vehicle("flightgoggles").mass == 1.0
    assert jaxplan.load_vehicle(str(written(tmp_path, MINE))).mass == 0.9


def test_the_generated_model_reads_back_as_the_vehicle_it_came_from(tmp_path: Path) -> None:
    vehicle = load_vehicle("flightgoggles")
    again = vehicle_from_mjcf(written(tmp_path, vehicle_mjcf(vehicle)), base=vehicle)
    for ours, theirs in zip(jax.tree.leaves(vehicle), jax.tree.leaves(again), strict=True):
        np.testing.assert_allclose(ours, theirs, **tolerance("exact"))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('pos="0.1 -0.1 0.02"', 'pos="0.1 0.1 0.02"', "centre of mass must lie between"),
        ('0 0 -0.02"', '0 0 0.02"', "rank 3"),
        ('0 0 0.02"', '0 0 0.03"', "torques per thrust"),
        ('gear="0 0 1', 'gear="1 0 0', "upwards"),
        ("<freejoint/>", "", "free"),
        ('ctrlrange="0 8"', 'ctrlrange="0 1"', "hovering takes"),
        ('mass="0.9"', 'mass="-0.9"', "MuJoCo refuses|mass"),
        ("<worldbody>", '<include file="/etc/passwd"/><worldbody>', "include"),
        ("</mujoco>", "", "MuJoCo"),
    ],
)
def test_what_is_no_quadrotor_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in MINE
    with pytest.raises(FileError, match=said):
        vehicle_from_mjcf(written(tmp_path, MINE.replace(old, new)))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="none.xml"):
        vehicle_from_mjcf(tmp_path / "none.xml")
