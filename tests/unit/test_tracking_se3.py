"""The geometric controller: signs at hover, flights beside the default controller, gains from a vehicle file."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.errors import FileError, InputError
from jaxplan.records import replace
from jaxplan.spline import FlatState
from jaxplan.tracking.filters import FilterState
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.rollout import build_plant
from jaxplan.tracking.se3 import se3
from jaxplan.tracking.sensing import Sensed
from jaxplan.vehicle import params
from jaxplan.vehicle.gains import IndiGains, Se3Gains
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.mixing import allocation_matrix
from oracles import plant_references
from tolerances import tolerance


@pytest.mark.usefixtures("x64")
def test_errors_of_a_hovering_vehicle_are_answered_as_the_formula_says() -> None:
    vehicle = load_vehicle().astype(jnp.float64)
    speed = jnp.sqrt(vehicle.mass * vehicle.gravity / (4 * vehicle.thrust_coefficient))
    blank = FilterState(value=jnp.zeros((4, 3)), rate=jnp.zeros((4, 3)))
    sensed = Sensed(
        pos=jnp.zeros(3), vel=jnp.zeros(3), rotation=jnp.eye(3), rotor_speeds=jnp.full(4, speed), signals=blank
    )

    def wrench(pos: list[float], yaw: float = 0.0) -> np.ndarray:
        derivatives = jnp.zeros((5, 3)).at[0].set(jnp.array(pos))
        commands, _ = se3(vehicle, sensed, FlatState(derivatives=derivatives, yaw=jnp.array([yaw, 0.0, 0.0])))
        made = np.array(allocation_matrix(vehicle) @ commands**2)
        reaction = vehicle.rotor_inertia / vehicle.motor_time_constant
        made[2] += reaction * np.sum(vehicle.rotor_spin * (commands - speed))
        return made

    weight = float(vehicle.mass * vehicle.gravity)
    np.testing.assert_allclose(wrench([0.0, 0.0, 0.0]), [0.0, 0.0, 0.0, weight], **tolerance("formula"))
    rise = vehicle.se3.position[2] * 0.1
    np.testing.assert_allclose(wrench([0.0, 0.0, 0.1])[3], weight + float(vehicle.mass) * rise)
    turn = float(vehicle.inertia[2]) * vehicle.se3.attitude[2] * np.sin(0.2)  # e_R of a rotation by 0.2 about z
    np.testing.assert_allclose(wrench([0.0, 0.0, 0.0], yaw=0.2)[:3], [0.0, 0.0, turn], **tolerance("solve"))
    assert wrench([0.1, 0.0, 0.0])[1] > 0.0  # nose down: positive pitch about y (left)
    assert wrench([0.0, 0.1, 0.0])[0] < 0.0  # to the left: negative roll about x


def test_flies_a_figure_eight_and_lags_behind_indi_in_drag() -> None:
    times = np.arange(4 * CONTROL_RATE + 1) / CONTROL_RATE
    references = plant_references.figure_eight(times, 3.0, along_heading=True)
    errors = {}
    for controller in ("indi", "se3"):
        plant = build_plant(load_vehicle(), noise=False, controller=controller)
        state = plant.reset(jax.tree.map(lambda rows: rows[0], references), jax.random.key(0))
        log = plant.fly(state, references)[1]
        errors[controller] = float(np.max(log.position_error))
        assert np.max(log.yaw_error) < np.radians(5.0)
    assert errors["indi"] < errors["se3"] < 0.15


def test_an_unknown_controller_is_refused() -> None:
    with pytest.raises(InputError, match="indi, se3"):
        build_plant(load_vehicle(), controller="pid")  # type: ignore[arg-type]


def test_gains_come_from_the_vehicle_file(tmp_path: Path) -> None:
    presets = Path(params.__file__).parent / "presets"
    text = (presets / "mfrl.toml").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("[90.0, 90.0, 16.41]", "[80.0, 70.0, 15.0]"), encoding="utf-8")
    assert load_vehicle(path).indi == IndiGains(attitude=(80.0, 70.0, 15.0))
    path.write_text(text[: text.index("[indi]")], encoding="utf-8")
    assert load_vehicle(path).se3 == Se3Gains()
    for old, new, said in (
        ("attitude = [90.0", "altitude = [90.0", "altitude"),
        ("[90.0, 90.0, 16.41]", "[90.0, -90.0, 16.41]", "attitude"),
        ("[90.0, 90.0, 16.41]", "[90.0, 90.0]", "attitude"),
        ("[90.0, 90.0, 16.41]", '"high"', "attitude"),
    ):
        path.write_text(text.replace(old, new), encoding="utf-8")
        with pytest.raises(FileError, match=said):
            load_vehicle(path)
    assert replace(load_vehicle(), se3=Se3Gains(rates=(1.0, 1.0, 1.0))).se3.rates[0] == 1.0
