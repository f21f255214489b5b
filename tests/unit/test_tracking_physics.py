"""The plant in float64 and float32 against closed forms and C MuJoCo, at the precision of the arithmetic."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxplan.records import replace
from jaxplan.tracking.filters import FilterState
from jaxplan.tracking.model import Integrator, complete_body, vehicle_body, vehicle_mjcf
from jaxplan.tracking.plant import DT, Noise, PlantState, physics_step
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle
from oracles import plant_c_mujoco
from tolerances import relative

STEPS = 800
"""2 s; one length, so that a vehicle compiles once for each precision and integrator."""
RELATIVE = {"float64": 1e-6, "float32": 1e-4}
"""Wanted agreement with closed forms."""
SLOW_IN_FLOAT32 = pytest.mark.parametrize("dtype", ["float64", pytest.param("float32", marks=pytest.mark.slow)])


def fly(vehicle: Vehicle, commands: np.ndarray, dtype: str, integrator: Integrator, **initial: object) -> PlantState:
    """The states after each physics step under rotor ``commands``, without noise, lanes in front."""
    wide = dtype == "float64"
    with jax.enable_x64(wide), jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):  # MJX's RK4
        if integrator == "Euler":
            body = vehicle_body(vehicle, float64=wide)
        else:
            body = complete_body(vehicle, integrator=integrator, float64=wide)
        cast = vehicle.astype(dtype)
        state = PlantState(
            **{
                "pos": jnp.zeros(3, dtype),
                "vel": jnp.zeros(3, dtype),
                "quat_wxyz": jnp.array([1.0, 0.0, 0.0, 0.0], dtype),
                "body_rates": jnp.zeros(3, dtype),
                "rotor_speeds": jnp.zeros(4, dtype),
                "signals": FilterState(value=jnp.zeros((4, 3), dtype), rate=jnp.zeros((4, 3), dtype)),
                "key": jax.random.key(0),
                "step": jnp.int32(0),
                **{name: jnp.asarray(value, dtype) for name, value in initial.items()},
            }
        )
        silence = Noise(*(jnp.zeros(3, dtype) for _ in range(4)))

        def step(state: PlantState, command: jax.Array) -> tuple[PlantState, PlantState]:
            state = physics_step(cast, body, state, command, silence)
            return state, state

        states = jax.jit(lambda s, c: jax.lax.scan(step, s, c)[1])(state, jnp.asarray(commands, dtype))
        assert states.pos.dtype == np.dtype(dtype)
        return jax.tree.map(lambda leaf: leaf if leaf is states.key else np.asarray(leaf, dtype=np.float64), states)


def still_air() -> Vehicle:
    """The default vehicle without drag, whose rotors turn without inertia."""
    return replace(load_vehicle(), drag_coefficient=0.0, rotor_inertia=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_free_fall_and_torque_free_rotation(dtype: str) -> None:
    # MuJoCo's RK4 averages body rates of different attitudes: at 400 Hz the momentum drifts by 1.6e-7 |w|^2, with w in
    # rad/s, so 1e-6 holds up to 2.5 rad/s; here |w| = 2.4
    vehicle, rates = still_air(), np.array([1.33, -0.93, 1.77])
    states = fly(vehicle, np.zeros((STEPS, 4)), dtype, "RK4", vel=[1.0, 2.0, 3.0], body_rates=rates)
    t = np.arange(1, STEPS + 1)[:, None] * DT
    fall = np.array([1.0, 2.0, 3.0]) * t + np.array([0.0, 0.0, -0.5 * vehicle.gravity]) * t**2
    tolerance = RELATIVE[dtype]
    np.testing.assert_allclose(states.pos, fall, rtol=tolerance, atol=tolerance * 15.0)  # falls 14 m

    inertia = np.asarray(vehicle.inertia)
    energy = np.sum(inertia * states.body_rates**2, axis=1)
    np.testing.assert_allclose(energy, np.sum(inertia * rates**2), rtol=tolerance)
    rotation = Rotation.from_quat(states.quat_wxyz[:, [1, 2, 3, 0]]).as_matrix()
    momentum = np.einsum("nij,nj->ni", rotation, inertia * states.body_rates)
    size = np.linalg.norm(inertia * rates)
    np.testing.assert_allclose(momentum, np.tile(inertia * rates, (STEPS, 1)), atol=tolerance * size)
    # a symmetric top: the rates across its axis turn at (J_z - J_x) / J_x w_z
    turn = (inertia[2] - inertia[0]) / inertia[0] * rates[2] * t[:, 0]
    across = (rates[0] + 1j * rates[1]) * np.exp(1j * turn)
    spin = states.body_rates[:, 0] + 1j * states.body_rates[:, 1]
    np.testing.assert_allclose(spin, across, atol=tolerance * np.abs(across[0]))


@SLOW_IN_FLOAT32
def test_hover_thrust(dtype: str) -> None:
    vehicle = load_vehicle()
    hover = np.sqrt(vehicle.mass * vehicle.gravity / (4 * vehicle.thrust_coefficient))
    tolerance = RELATIVE[dtype]
    states = fly(vehicle, np.full((STEPS, 4), hover), dtype, "Euler", rotor_speeds=np.full(4, hover))
    # what is left of gravity would move it 2 g m in 2 s
    np.testing.assert_allclose(states.pos, 0.0, atol=tolerance * 0.5 * vehicle.gravity * (STEPS * DT) ** 2)
    lift = vehicle.thrust_coefficient * np.sum(states.rotor_speeds**2, axis=1)
    np.testing.assert_allclose(lift, vehicle.mass * vehicle.gravity, rtol=tolerance)


@SLOW_IN_FLOAT32
def test_rotors_step_as_a_first_order_lag(dtype: str) -> None:
    vehicle = load_vehicle()
    states = fly(vehicle, np.full((STEPS, 4), 1500.0), dtype, "Euler", rotor_speeds=np.full(4, 500.0))
    t = np.arange(1, STEPS + 1) * DT
    speeds = 1500.0 - 1000.0 * np.exp(-t / vehicle.motor_time_constant)
    np.testing.assert_allclose(states.rotor_speeds, np.tile(speeds[:, None], 4), rtol=RELATIVE[dtype])


@pytest.mark.parametrize(
    ("integrator", "dtype", "metres"),
    [
        ("Euler", "float64", 1e-8),
        pytest.param("Euler", "float32", 1e-4, marks=pytest.mark.slow),
        pytest.param("RK4", "float64", 1e-8, marks=pytest.mark.slow),
        pytest.param("RK4", "float32", 1e-4, marks=pytest.mark.slow),
    ],
)
def test_mjx_follows_c_mujoco_for_two_seconds(integrator: Integrator, dtype: str, metres: float) -> None:
    vehicle = load_vehicle("flightgoggles")
    t = np.arange(STEPS)[:, None] * DT
    commands = 1133.0 + 25.0 * np.sin(2 * np.pi * t * np.array([1.1, 1.3, 0.9, 1.2]) + np.array([0.0, 0.3, 1.0, 2.0]))
    vel, rates, speeds = np.array([1.0, -0.5, 0.2]), np.array([0.3, -0.2, 0.5]), np.full(4, 1000.0)
    states = fly(vehicle, commands, dtype, integrator, vel=vel, body_rates=rates, rotor_speeds=speeds)
    qpos, qvel = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.concatenate([vel, rates])
    pos, _ = plant_c_mujoco.fly_open_loop(vehicle, vehicle_mjcf(vehicle, integrator), qpos, qvel, speeds, commands)
    assert np.ptp(pos[:, 0]) > 0.5
    np.testing.assert_allclose(states.pos, pos[:, :3], atol=metres)
    np.testing.assert_allclose(states.quat_wxyz, pos[:, 3:], atol=metres)


def test_the_momentum_drifts_with_the_square_of_the_rate() -> None:
    """The range in which free rotation keeps its momentum to 1e-6: C MuJoCo's RK4 at 400 Hz, as MJX's beside it."""
    vehicle = still_air()
    inertia, axis = np.asarray(vehicle.inertia), np.array([3.0, -2.0, 4.0]) / np.sqrt(29.0)
    still = np.zeros((STEPS, 4))

    def drift(size: float) -> float:
        qpos, qvel = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.concatenate([np.zeros(3), size * axis])
        pos, vel = plant_c_mujoco.fly_open_loop(vehicle, vehicle_mjcf(vehicle, "RK4"), qpos, qvel, still[0], still)
        turned = Rotation.from_quat(pos[:, [4, 5, 6, 3]]).apply(inertia * vel[:, 3:])
        return float(np.max(np.abs(turned - inertia * qvel[3:])) / np.linalg.norm(inertia * qvel[3:]))

    assert drift(2.5) < 1e-6 < drift(3.0)
    assert drift(5.0) == pytest.approx(4.0 * drift(2.5), rel=0.1)


def test_eulers_step_is_of_first_order_in_energy_and_momentum() -> None:
    """What the flights' integrator gives up against RK4: bounded errors of the order of rate times step."""
    vehicle, rates = still_air(), np.array([3.0, -2.0, 4.0])
    states = fly(vehicle, np.zeros((STEPS, 4)), "float64", "Euler", body_rates=rates)
    inertia = np.asarray(vehicle.inertia)
    energy = np.sum(inertia * states.body_rates**2, axis=1)
    drift = np.max(np.abs(energy / np.sum(inertia * rates**2) - 1.0))
    assert 1e-4 < drift < 1e-2
    parabola = -0.5 * vehicle.gravity * (STEPS * DT) ** 2
    assert states.pos[-1, 2] == pytest.approx(parabola * (1.0 + 1.0 / STEPS), **relative("formula"))
