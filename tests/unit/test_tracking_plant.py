"""The simulated vehicle against C MuJoCo, against SciPy's integrator, and against closed forms."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxplan.precision import float32_island
from jaxplan.records import replace
from jaxplan.spline import FlatState, hover
from jaxplan.tracking.filters import FilterState
from jaxplan.tracking.model import vehicle_body, vehicle_mjcf
from jaxplan.tracking.plant import (
    DT,
    Noise,
    PlantState,
    draw_noise,
    no_noise,
    physics_step,
    state_on_reference,
)
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle
from oracles import plant_c_mujoco, plant_rigid_body
from tolerances import tolerance

Flight = Callable[[PlantState, np.ndarray], PlantState]


def open_loop(vehicle: Vehicle, noise: Callable[[jax.Array, int], Noise] = no_noise) -> Flight:
    """The states after each physics step under given rotor commands (n, 4)."""
    body = vehicle_body(vehicle)

    def fly(state: PlantState, commands: jax.Array) -> PlantState:
        cast = vehicle.astype(jnp.float32)

        def step(state: PlantState, row: tuple[jax.Array, Noise]) -> tuple[PlantState, PlantState]:
            state = physics_step(cast, body, state, *row)
            return state, state

        return jax.lax.scan(step, state, (commands, noise(state.key, commands.shape[0])))[1]

    return float32_island(fly)


def start(**changes: object) -> PlantState:
    values: dict[str, object] = {
        "pos": np.zeros(3),
        "vel": np.zeros(3),
        "quat_wxyz": np.array([1.0, 0.0, 0.0, 0.0]),
        "body_rates": np.zeros(3),
        "rotor_speeds": np.zeros(4),
        "signals": FilterState(value=np.zeros((4, 3)), rate=np.zeros((4, 3))),
        "key": jax.random.key(0),
        "step": np.zeros((), np.int32),
    }
    return PlantState(**{**values, **changes})  # type: ignore[arg-type]


def gentle_commands(n: int) -> np.ndarray:
    """Rotor commands around hover that roll, pitch and yaw the vehicle without turning it over."""
    t = np.arange(n)[:, None] * DT
    return 1085.0 + 25.0 * np.sin(2 * np.pi * t * np.array([1.1, 1.3, 0.9, 1.2]) + np.array([0.0, 0.3, 1.0, 2.0]))


@pytest.mark.parametrize("name", ["mfrl", "flightgoggles"])
def test_mjx_follows_c_mujoco_for_two_seconds(name: str) -> None:
    vehicle = load_vehicle(name)
    initial = start(
        vel=np.array([1.0, -0.5, 0.2]), body_rates=np.array([0.3, -0.2, 0.5]), rotor_speeds=np.full(4, 1000.0)
    )
    commands = gentle_commands(800)
    states = open_loop(vehicle)(initial, commands)
    qpos = np.concatenate([initial.pos, initial.quat_wxyz])
    qvel = np.concatenate([initial.vel, initial.body_rates])
    pos, vel = plant_c_mujoco.fly_open_loop(vehicle, vehicle_mjcf(vehicle), qpos, qvel, initial.rotor_speeds, commands)
    assert np.ptp(pos[:, 0]) > 0.5
    assert np.max(np.abs(vel[:, 3:])) > 0.3
    # float32 over 800 steps of an unstable body: 1e-4 m, and the same figure relative for the rest
    np.testing.assert_allclose(states.pos, pos[:, :3], atol=1e-4)
    np.testing.assert_allclose(states.quat_wxyz, pos[:, 3:], atol=1e-4)
    np.testing.assert_allclose(states.vel, vel[:, :3], atol=3e-4)


@pytest.mark.parametrize("name", ["mfrl", "flightgoggles"])
def test_forces_and_moments_are_those_of_newton_and_euler(name: str) -> None:
    vehicle = load_vehicle(name)
    command = np.array([1300.0, 1000.0, 1150.0, 1100.0])
    turn = Rotation.from_euler("xyz", [0.2, -0.3, 0.5])
    initial = {
        "pos": np.zeros(3),
        "vel": np.array([3.0, -1.0, 0.5]),
        "rotation": turn.as_matrix(),
        "rates": np.array([1.0, -2.0, 3.0]),
        "speeds": np.array([900.0, 1200.0, 1000.0, 1300.0]),
    }
    n = 40
    end = plant_rigid_body.fly(vehicle, initial, command, n * DT)
    x, y, z, w = turn.as_quat()
    state = start(
        vel=initial["vel"],
        quat_wxyz=np.array([w, x, y, z]),
        body_rates=initial["rates"],
        rotor_speeds=initial["speeds"],
    )
    states = open_loop(vehicle)(state, np.tile(command, (n, 1)))
    change = np.linalg.norm(end["rates"] - initial["rates"])
    assert change > 2.0
    # MuJoCo's Euler step is of first order: errors of about DT / 2 times the change of the slope over 0.1 s
    np.testing.assert_allclose(states.body_rates[-1], end["rates"], atol=0.02 * change)
    np.testing.assert_allclose(states.vel[-1], end["vel"], atol=0.02)
    np.testing.assert_allclose(states.pos[-1], end["pos"], atol=5e-3)
    np.testing.assert_allclose(states.rotor_speeds[-1], end["speeds"], **tolerance("exact", np.float32))


def test_free_fall() -> None:
    vehicle = replace(load_vehicle(), drag_coefficient=0.0)
    states = open_loop(vehicle)(start(), np.zeros((400, 4)))
    k = np.arange(1, 401)
    np.testing.assert_allclose(states.vel[:, 2], -9.81 * k * DT, **tolerance("exact", np.float32))
    np.testing.assert_allclose(
        states.pos[:, 2], -9.81 * DT**2 * k * (k + 1) / 2, rtol=1e-4
    )  # the exact sum of the steps
    assert abs(states.pos[-1, 2] + 9.81 / 2) < 0.02  # and the parabola, to first order in DT
    np.testing.assert_array_equal(states.quat_wxyz[-1], [1.0, 0.0, 0.0, 0.0])


def test_rotors_step_exactly_as_a_first_order_lag() -> None:
    vehicle = load_vehicle()
    states = open_loop(vehicle)(start(rotor_speeds=np.full(4, 500.0)), np.full((40, 4), 1500.0))
    t = np.arange(1, 41) * DT
    expected = 1500.0 - 1000.0 * np.exp(-t / vehicle.motor_time_constant)
    np.testing.assert_allclose(states.rotor_speeds, np.tile(expected[:, None], 4), **tolerance("exact", np.float32))


def test_drag_slows_as_the_closed_form_says() -> None:
    vehicle = replace(load_vehicle(), gravity=1e-9)
    states = open_loop(vehicle)(start(vel=np.array([10.0, 0.0, 0.0])), np.zeros((400, 4)))
    expected = 10.0 / (1.0 + vehicle.drag_coefficient / vehicle.mass * 10.0 * 1.0)
    assert states.vel[-1, 0] == pytest.approx(expected, rel=3e-3)  # first order in DT


def test_gyroscopic_moments_do_no_work() -> None:
    vehicle = replace(load_vehicle(), gravity=1e-9)
    speeds = np.array([1000.0, 0.0, 1000.0, 0.0])  # net angular momentum of the rotors, balanced thrust
    state = start(body_rates=np.array([0.5, 0.2, 0.0]), rotor_speeds=speeds)
    vehicle = replace(vehicle, torque_coefficient=1e-20)
    rates = np.asarray(open_loop(vehicle)(state, np.tile(speeds, (200, 1))).body_rates, dtype=np.float64)
    energy = np.sum(vehicle.inertia * rates**2, axis=1)
    assert np.ptp(np.arctan2(rates[:, 1], rates[:, 0])) > 0.5  # the axis precesses
    np.testing.assert_allclose(energy, energy[0], rtol=0.02)  # explicit steps: precession angle per step squared


def test_noise_has_the_given_spectral_density() -> None:
    vehicle = replace(load_vehicle(), gravity=1e-9, drag_coefficient=0.0, motor_time_constant=1e-3)
    states = open_loop(vehicle, draw_noise)(start(), np.zeros((4000, 4)))
    force = np.diff(np.asarray(states.vel, dtype=np.float64), axis=0) / DT * vehicle.mass
    variance = vehicle.force_noise_psd / DT
    # variance of 12000 draws: relative standard deviation sqrt(2 / 12000) = 1.3 %; five sigma
    assert np.var(force) == pytest.approx(variance, rel=0.065)
    moment = np.diff(np.asarray(states.body_rates[:, 2], dtype=np.float64)) / DT * vehicle.inertia[2]
    assert np.var(moment) == pytest.approx(vehicle.moment_noise_psd / DT, rel=0.12)


def test_state_on_reference_hovers_level() -> None:
    vehicle = load_vehicle()
    settle = float32_island(lambda state, key: state_on_reference(vehicle.astype(jnp.float32), state, key))
    state = settle(hover(np.array([1.0, 2.0, 3.0]), yaw=0.5), jax.random.key(0))
    speed = np.sqrt(vehicle.mass * vehicle.gravity / (4 * vehicle.thrust_coefficient))
    np.testing.assert_allclose(state.rotor_speeds, np.full(4, speed), **tolerance("exact", np.float32))
    np.testing.assert_allclose(
        state.quat_wxyz, [np.cos(0.25), 0.0, 0.0, np.sin(0.25)], **tolerance("exact", np.float32)
    )
    fast = FlatState(derivatives=np.zeros((5, 3)), yaw=np.zeros(3))
    fast.derivatives[2, 2] = 100.0
    assert np.all(settle(fast, jax.random.key(0)).rotor_speeds == np.float32(2200.0))
