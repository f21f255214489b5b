"""The controller: inversion of the rotors, its order of giving way, attitude error, configuration."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linprog

from jaxplan.errors import InputError
from jaxplan.records import replace
from jaxplan.spline import FlatState
from jaxplan.tracking.filters import FilterState
from jaxplan.tracking.indi import indi
from jaxplan.tracking.rotor_commands import rotor_commands
from jaxplan.tracking.sensing import Sensed
from jaxplan.vehicle.gains import IndiGains
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.mixing import allocation_matrix
from jaxplan.vehicle.params import Vehicle
from tolerances import relative, tolerance

pytestmark = pytest.mark.usefixtures("x64")


@pytest.fixture
def vehicle() -> Vehicle:
    return load_vehicle().astype(jnp.float64)


def made(vehicle: Vehicle, commands: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """Moment and thrust at the instant of the command: eq. (33), rotor by rotor."""
    wrench = np.asarray(allocation_matrix(vehicle)) @ commands**2
    for i in range(4):
        gain = (commands[i] - speeds[i]) / float(vehicle.motor_time_constant)
        wrench[2] += float(vehicle.rotor_spin[i]) * float(vehicle.rotor_inertia) * gain
    return wrench


def test_commands_solve_the_inversion_whatever_the_present_speeds(vehicle: Vehicle) -> None:
    rng = np.random.default_rng(0)
    commands, speeds = rng.uniform(200, 2100, (200, 4)), rng.uniform(0, 2200, (200, 4))
    wanted = np.stack([made(vehicle, c, w) for c, w in zip(commands, speeds, strict=True)])
    solve = jax.jit(jax.vmap(lambda m, t, w: rotor_commands(vehicle, m, t, w)))
    found, saturated = solve(jnp.asarray(wanted[:, :3]), jnp.asarray(wanted[:, 3]), jnp.asarray(speeds))
    assert not np.any(saturated)
    np.testing.assert_allclose(found, commands, rtol=1e-5)  # a fixed number of Newton steps


def test_yaw_gives_way_before_thrust_and_thrust_before_roll(vehicle: Vehicle) -> None:
    hover = jnp.full(4, 1080.0)
    weight = float(vehicle.mass * vehicle.gravity)
    solve = jax.jit(lambda moment, thrust: rotor_commands(vehicle, moment, thrust, hover))

    commands, saturated = solve(jnp.array([0.1, -0.1, 5.0]), jnp.array(weight))
    wrench = np.asarray(allocation_matrix(vehicle)) @ np.asarray(commands) ** 2
    assert saturated
    np.testing.assert_allclose(wrench[[0, 1, 3]], [0.1, -0.1, weight], **tolerance("formula"))
    assert np.min(commands) < 1e-3  # one rotor is at its limit, so no more yaw was to be had

    commands, saturated = solve(jnp.array([0.5, 0.3, 0.0]), jnp.array(100.0))
    wrench = np.asarray(allocation_matrix(vehicle)) @ np.asarray(commands) ** 2
    assert saturated
    np.testing.assert_allclose(wrench[:2], [0.5, 0.3], **tolerance("formula"))
    assert weight < wrench[3] < 100.0
    assert np.max(commands) == pytest.approx(2200.0)

    commands, saturated = solve(jnp.array([50.0, 0.0, 0.0]), jnp.array(weight))
    assert saturated
    np.testing.assert_allclose(np.sort(commands), [0.0, 0.0, 2200.0, 2200.0])


KITE = np.array([[0.12, 0.06, 0.0], [0.07, -0.1, 0.01], [-0.09, -0.07, 0.0], [-0.06, 0.11, -0.01]])
MIDDLE = np.array([[0.1, 0.0, 0.0], [-0.05, -0.09, 0.0], [-0.05, 0.09, 0.0], [0.0, 0.0, 0.0]])


@pytest.mark.parametrize("positions", [KITE, MIDDLE, None], ids=["kite", "triangle and centre", "symmetric"])
def test_what_gives_way_is_what_linear_programming_says(vehicle: Vehicle, positions: np.ndarray | None) -> None:
    """Roll and pitch are kept with the nearest thrust that any yaw moment allows."""
    if positions is not None:
        spin = np.array([1.0, 1.0, 1.0, -1.0]) if positions is MIDDLE else np.array([1.0, -1.0, 1.0, -1.0])
        vehicle = replace(load_vehicle(), rotor_positions=positions, rotor_spin=spin).astype(jnp.float64)
    rng = np.random.default_rng(1)
    moments = rng.normal(size=(120, 3)) * np.array([0.5, 0.5, 0.05])
    thrusts = rng.uniform(-5.0, 40.0, 120)
    mixer = np.asarray(allocation_matrix(vehicle))
    solve = jax.jit(jax.vmap(lambda m, t: rotor_commands(vehicle, m, t, jnp.full(4, 1080.0))))
    commands, saturated = solve(jnp.asarray(moments), jnp.asarray(thrusts))
    wrenches = np.asarray(commands) ** 2 @ mixer.T
    most, kept = float(vehicle.rotor_speed_max) ** 2, 0
    for moment, thrust, wrench, flag in zip(moments, thrusts, wrenches, saturated, strict=True):
        # scaled squares of the rotor speeds in [0, 1], and how far the thrust is from the wanted one
        rows = mixer * most
        equal = np.hstack([rows[:2], np.zeros((2, 1))])
        away = np.array([[*rows[3], -1.0], [*-rows[3], -1.0]])
        best = linprog([0, 0, 0, 0, 1], away, [thrust, -thrust], equal, moment[:2], [(0, 1)] * 4 + [(0, None)])
        if best.status != 0:
            assert flag
            continue
        kept += 1
        np.testing.assert_allclose(wrench[:2], moment[:2], **tolerance("solve"))
        assert abs(wrench[3] - thrust) == pytest.approx(best.fun, **relative("solve"))
        assert flag or best.fun < 1e-9
    assert kept > 40


def test_nan_shows_in_commands_and_in_the_flag(vehicle: Vehicle) -> None:
    commands, saturated = rotor_commands(vehicle, jnp.full(3, jnp.nan), jnp.array(7.0), jnp.full(4, 1080.0))
    assert np.all(np.isnan(commands))
    assert saturated


@pytest.mark.parametrize("yaw", [0.0, 0.4, -2.5])
def test_errors_of_a_hovering_vehicle_are_answered_with_the_right_sign(vehicle: Vehicle, yaw: float) -> None:
    up = jnp.array([0.0, 0.0, float(vehicle.gravity)])
    signals = FilterState(value=jnp.stack([up, up, jnp.zeros(3), jnp.zeros(3)]), rate=jnp.zeros((4, 3)))
    speed = jnp.sqrt(vehicle.mass * vehicle.gravity / (4 * vehicle.thrust_coefficient))
    sensed = Sensed(
        pos=jnp.zeros(3), vel=jnp.zeros(3), rotation=jnp.eye(3), rotor_speeds=jnp.full(4, speed), signals=signals
    )

    def wrench(pos: list[float]) -> np.ndarray:
        derivatives = jnp.zeros((5, 3)).at[0].set(jnp.array(pos))
        reference = FlatState(derivatives=derivatives, yaw=jnp.array([yaw, 0.0, 0.0]))
        commands, _ = indi(vehicle, sensed, reference)
        return made(vehicle, np.asarray(commands), np.full(4, float(speed)))

    rest = wrench([0.0, 0.0, 0.0])
    # a pure yaw error is a rotation by yaw about z: J_z K_z yaw, within the yaw authority of the rotors
    if abs(yaw) < 1.0:
        np.testing.assert_allclose(rest[:3], [0.0, 0.0, 0.006 * 16.41 * yaw], **tolerance("solve"))
    assert np.sign(rest[2]) == np.sign(yaw)
    assert wrench([0.0, 0.0, 0.1])[3] == pytest.approx(float(vehicle.mass) * (float(vehicle.gravity) + 1.35))
    if yaw == 0.0:
        assert wrench([0.1, 0.0, 0.0])[1] > 0.0  # nose down: positive pitch about y (left)
        assert wrench([0.0, 0.1, 0.0])[0] < 0.0  # to the left: negative roll about x


def test_gains_are_checked() -> None:
    with pytest.raises(InputError, match="position"):
        IndiGains(position=(1.0, 2.0))
    with pytest.raises(InputError, match="rates"):
        IndiGains(rates=(1.0, float("nan"), 1.0))
    with pytest.raises(InputError, match="least_specific_thrust"):
        IndiGains(least_specific_thrust=0.0)
