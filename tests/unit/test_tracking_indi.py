"""The controller: inversion of the rotors, its order of giving way, attitude error, configuration."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.spline import FlatState
from jaxplan.tracking.filters import FilterState
from jaxplan.tracking.indi import indi
from jaxplan.tracking.rotor_commands import rotor_commands
from jaxplan.tracking.sensing import Sensed
from jaxplan.vehicle.allocation import allocation_matrix
from jaxplan.vehicle.gains import IndiGains
from jaxplan.vehicle.params import Vehicle, load_vehicle

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
    np.testing.assert_allclose(wrench[[0, 1, 3]], [0.1, -0.1, weight], rtol=1e-9)
    assert np.min(commands) < 1e-3  # one rotor is at its limit, so no more yaw was to be had

    commands, saturated = solve(jnp.array([0.5, 0.3, 0.0]), jnp.array(100.0))
    wrench = np.asarray(allocation_matrix(vehicle)) @ np.asarray(commands) ** 2
    assert saturated
    np.testing.assert_allclose(wrench[:2], [0.5, 0.3], rtol=1e-9)
    assert weight < wrench[3] < 100.0
    assert np.max(commands) == pytest.approx(2200.0)

    commands, saturated = solve(jnp.array([50.0, 0.0, 0.0]), jnp.array(weight))
    assert saturated
    np.testing.assert_allclose(np.sort(commands), [0.0, 0.0, 2200.0, 2200.0])


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
        np.testing.assert_allclose(rest[:3], [0.0, 0.0, 0.006 * 16.41 * yaw], rtol=1e-6, atol=1e-9)
    assert np.sign(rest[2]) == np.sign(yaw)
    assert wrench([0.0, 0.0, 0.1])[3] == pytest.approx(float(vehicle.mass) * (float(vehicle.gravity) + 1.35))
    if yaw == 0.0:
        assert wrench([0.1, 0.0, 0.0])[1] > 0.0  # nose down: positive pitch about y (left)
        assert wrench([0.0, 0.1, 0.0])[0] < 0.0  # to the left: negative roll about x


def test_gains_are_checked() -> None:
    with pytest.raises(InputError, match="position"):
        IndiGains(position=(1.0, 2.0))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="rates"):
        IndiGains(rates=(1.0, float("nan"), 1.0))
    with pytest.raises(InputError, match="least_specific_thrust"):
        IndiGains(least_specific_thrust=0.0)
