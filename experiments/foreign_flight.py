"""A trajectory of ours flown in other people's simulators, by rotorpy's controller (extra ``peers``).

rotorpy 3 (Folk, Paulos, Kumar, arXiv 2306.04485) has a vehicle and ``SE3Control``, the geometric controller of Lee,
Leok and McClamroch (CDC 2010) without the reference's body rates. drone-models has ``first_principles.dynamics``, a
derivative without an integrator: here it is integrated by Runge and Kutta's fourth order, the attitude by the
exponential of the body rates, as its documentation asks. Both get the numbers of our vehicle, neither gets noise.

The feed-forward is differential flatness with drag, after Faessler, Franchi and Scaramuzza (RA-L 2018) with our
isotropic quadratic drag in place of their linear rotor drag: the drag is added to the acceleration, and the moment
gets the body rates and angular acceleration that follow. It is added to what ``SE3Control`` answers, from outside.
"""

import dataclasses
import os
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxplan.precision import in_float64
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.vehicle.flatness import FlatOutputs, against_drag, differential_flatness
from jaxplan.vehicle.params import Vehicle

PLANTS = ("rotorpy", "drone-models")
CONTROLS = ("own gains", "our gains", "feed-forward")
"""``SE3Control`` as rotorpy ships it; with the gains of the vehicle's [se3]; those with the feed-forward."""
SUBSTEPS = 2
"""Steps of Runge and Kutta within one control step (arbitrary; rotorpy's adaptive steps agree to 1 mm)."""
SWITCH = "SCIPY_ARRAY_API"
"""Of SciPy."""
RPM = 60.0 / (2.0 * np.pi)
"""Revolutions a minute of 1 rad/s."""
State = dict[str, np.ndarray]
"""rotorpy's: x, v [m, m/s, world], q [xyzw], w [rad/s, body], wind [m/s], rotor_speeds [rad/s]."""


@runtime_checkable
class Step(Protocol):
    """A plant."""

    def __call__(self, state: State, speeds: Float[np.ndarray, "4"], /) -> State:
        """The state one control step later, under held commands [rad/s]."""
        ...


class Reference(NamedTuple):
    """A trajectory at the controller's instants, and what it demands."""

    state: FlatState
    calm: FlatOutputs
    """Without drag."""
    against: FlatOutputs
    """Against drag."""
    acceleration: Float[np.ndarray, "n 3"]
    """m/s^2, with what is spent against drag."""


class Flown(NamedTuple):
    """One flight, a row for each control step, at its end."""

    position_error: Float[np.ndarray, "n"]
    """m."""
    heading_error: Float[np.ndarray, "n"]
    """rad, of the heading of body x, as the paper has it; says nothing near 90 degrees of tilt."""
    twist_error: Float[np.ndarray, "n"]
    """rad about body z, from the attitude that the reference demands."""
    saturated: Float[np.ndarray, "n"]
    """1 where a command was beyond a rotor's limit."""


@in_float64
def reference_of(vehicle: Vehicle, spline: PiecewisePolynomial, duration: float) -> Reference:
    """The references of the first ``duration`` seconds."""
    times = np.arange(int(duration * CONTROL_RATE + 1e-6) + 1) / CONTROL_RATE
    state = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), spline.state(times))
    calm, against, acceleration = (jax.tree.map(np.asarray, found) for found in _demands(vehicle, state))
    return Reference(state, calm, against, acceleration)


def _demands(vehicle: Vehicle, states: FlatState) -> tuple[FlatOutputs, FlatOutputs, Float[Any, "n 3"]]:
    """Without drag and against it, padded to whole seconds so that few lengths compile."""
    count = len(states.derivatives)
    rows = np.minimum(np.arange(-(-count // CONTROL_RATE) * CONTROL_RATE), count - 1)
    calm, against, acceleration = _all_demands(
        vehicle.astype(np.float64), jax.tree.map(lambda leaf: leaf[rows], states)
    )
    return jax.tree.map(lambda leaf: leaf[:count], (calm, against, acceleration))


@jax.jit
def _all_demands(vehicle: Vehicle, states: FlatState) -> tuple[FlatOutputs, FlatOutputs, Float[Any, "n 3"]]:
    pushed = jax.vmap(against_drag, in_axes=(None, 0))(vehicle, states)
    demands = jax.vmap(differential_flatness, in_axes=(None, 0))
    return demands(vehicle, states), demands(vehicle, pushed), pushed.acc


def fly(
    vehicle: Vehicle,
    spline: PiecewisePolynomial,
    duration: float,
    plant: str = "rotorpy",
    control: str = "feed-forward",
) -> Flown:
    """The first ``duration`` seconds of a trajectory, from a state on it.

    Args:
        plant: one of ``PLANTS``.
        control: one of ``CONTROLS``.
    """
    reference = reference_of(vehicle, spline, duration)
    step = rotorpy_step(vehicle) if plant == "rotorpy" else drone_models_step(vehicle)
    controller = _controller(vehicle, control)
    state = _start(vehicle, reference)
    rows, least, most = [], float(vehicle.rotor_speed_min), float(vehicle.rotor_speed_max)
    for now in range(len(reference.acceleration) - 1):
        speeds = _command(controller, state, reference, now, control == "feed-forward")
        state = step(state, np.clip(speeds, least, most))
        rows.append((*_errors(state, reference, now + 1), float(((speeds < least) | (speeds > most)).any())))
        if not rows[-1][0] < 10.0:  # lost: what follows says nothing
            break
    return Flown(*np.array(rows).T)


def _controller(vehicle: Vehicle, control: str) -> Any:
    from rotorpy.controllers.quadrotor_control import SE3Control

    values, gains = parameters(vehicle), vehicle.se3
    if control == "own gains":
        return SE3Control(values)
    values |= {"kp_att": np.array(gains.attitude), "kd_att": np.array(gains.rates)}
    found = SE3Control(values)
    found.kp_pos, found.kd_pos = np.array(gains.position), np.array(gains.velocity)
    return found


def _command(controller: Any, state: State, reference: Reference, now: int, forward: bool) -> Float[np.ndarray, "4"]:
    """Rotor speeds [rad/s] before their limits; below 0 where a rotor should pull down."""
    flat, demanded = reference.state, reference.against if forward else reference.calm
    wanted = {"x": flat.pos[now], "x_dot": flat.vel[now], "yaw": their_yaw(demanded.rotation[now])}
    wanted |= {"x_ddot": reference.acceleration[now] if forward else flat.acc[now]}
    wanted |= {"x_dddot": flat.jerk[now], "x_ddddot": flat.snap[now]}
    answer = controller.update(0.0, state, wanted | {"yaw_dot": flat.yaw[now, 1]})
    if not forward:
        return answer["cmd_motor_speeds"]
    turn = Rotation.from_quat(state["q"]).as_matrix().T @ demanded.rotation[now]
    rates = turn @ demanded.body_rates[now] - np.array([0.0, 0.0, flat.yaw[now, 1]])
    more = controller.kd_att * rates + turn @ demanded.angular_acceleration[now]
    moment = answer["cmd_moment"] + controller.inertia @ more
    thrusts = controller.TM_to_f @ np.array([answer["cmd_thrust"], *moment])
    return np.sign(thrusts) * np.sqrt(np.abs(thrusts) / controller.k_eta)


def their_yaw(rotation: Float[np.ndarray, "3 3"]) -> float:
    """The yaw [rad] from which rotorpy makes this attitude: its b_x is the heading less its part along b_z."""
    b_x, b_z = rotation[:, 0], rotation[:, 2]
    heading = (b_z[2] * b_x - b_x[2] * b_z) * (1.0 if b_z[2] >= 0.0 else -1.0)
    return float(np.arctan2(heading[1], heading[0]))


def _start(vehicle: Vehicle, reference: Reference) -> State:
    """As if the reference had always been flown."""
    first = jax.tree.map(lambda leaf: leaf[0], reference.against)
    return {
        "x": reference.state.pos[0],
        "v": reference.state.vel[0],
        "q": Rotation.from_matrix(first.rotation).as_quat(),
        "w": first.body_rates,
        "wind": np.zeros(3),
        "rotor_speeds": np.clip(first.rotor_speeds, float(vehicle.rotor_speed_min), float(vehicle.rotor_speed_max)),
    }


def _errors(state: State, reference: Reference, now: int) -> tuple[float, float, float]:
    rotation = Rotation.from_quat(state["q"]).as_matrix()
    heading = np.arctan2(rotation[1, 0], rotation[0, 0]) - reference.state.yaw[now, 0]
    between = reference.against.rotation[now].T @ rotation
    twist = np.arctan2(between[1, 0] - between[0, 1], between[0, 0] + between[1, 1])
    wrapped = [abs(float(np.arctan2(np.sin(angle), np.cos(angle)))) for angle in (heading, twist)]
    return float(np.linalg.norm(state["x"] - reference.state.pos[now])), wrapped[0], wrapped[1]


def parameters(vehicle: Vehicle) -> dict[str, Any]:
    """rotorpy's dictionary for a vehicle of ours; its own gains where none are given."""
    positions = {f"r{i + 1}": np.asarray(position) for i, position in enumerate(np.asarray(vehicle.rotor_positions))}
    zeros = dict.fromkeys(("Ixy", "Iyz", "Ixz", "k_d", "k_z", "k_h", "k_flap", "motor_noise_std"), 0.0)
    return {
        "mass": float(vehicle.mass),
        "num_rotors": 4,
        "rotor_pos": positions,
        "rotor_directions": np.asarray(vehicle.rotor_spin),
        "k_eta": float(vehicle.thrust_coefficient),
        "k_m": float(vehicle.torque_coefficient),
        "tau_m": float(vehicle.motor_time_constant),
        "rotor_speed_min": float(vehicle.rotor_speed_min),
        "rotor_speed_max": float(vehicle.rotor_speed_max),
        **dict(zip(("Ixx", "Iyy", "Izz"), np.asarray(vehicle.inertia), strict=True)),
        **dict.fromkeys(("c_Dx", "c_Dy", "c_Dz"), float(vehicle.drag_coefficient)),
        **zeros,
    }


def rotorpy_step(vehicle: Vehicle) -> Step:
    """rotorpy's vehicle; without rotor inertia and aerodynamic moment, which it does not know."""
    from rotorpy.vehicles.multirotor import Multirotor

    plant = Multirotor(parameters(vehicle))
    return lambda state, speeds: plant.step(state, {"cmd_motor_speeds": speeds}, 1.0 / CONTROL_RATE)


def drone_models_step(vehicle: Vehicle) -> Step:
    """drone-models' first principles; its drag is linear, so ours goes in as its disturbing force, moments likewise."""
    dynamics, values, dt = _their_dynamics(), their_numbers(vehicle), 1.0 / CONTROL_RATE / SUBSTEPS
    drag, damping = float(vehicle.drag_coefficient), float(vehicle.aero_moment_coefficient)

    def derivative(rows: tuple[Any, ...], turn: Any, commands: Any) -> tuple[Any, ...]:
        pos, vel, rates, rotors = rows
        quat = turn.as_quat()
        force, moment = -drag * np.linalg.norm(vel) * vel, -damping * np.linalg.norm(rates) * rates
        found = dynamics(pos, quat, vel, rates, commands, rotors, force, turn.apply(moment), **values)
        return found[0], found[2], found[3], found[4]

    def small(rows: tuple[Any, ...], turn: Any, commands: Any) -> tuple[tuple[Any, ...], Any]:
        slopes, at, orientation = [], rows, turn
        for share in (0.5, 0.5, 1.0, 0.0):
            slopes.append((derivative(at, orientation, commands), at[2]))
            at = tuple(row + share * dt * slope for row, slope in zip(rows, slopes[-1][0], strict=True))
            orientation = turn * Rotation.from_rotvec(share * dt * slopes[-1][1])
        weights = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0
        mean = [sum(w * slope[0][i] for w, slope in zip(weights, slopes, strict=True)) for i in range(4)]
        rates = sum(w * slope[1] for w, slope in zip(weights, slopes, strict=True))
        ends = tuple(row + dt * slope for row, slope in zip(rows, mean, strict=True))
        return ends, turn * Rotation.from_rotvec(dt * rates)

    def step(state: State, speeds: Float[np.ndarray, "4"]) -> State:
        rows, turn = (state["x"], state["v"], state["w"], RPM * state["rotor_speeds"]), Rotation.from_quat(state["q"])
        for _ in range(SUBSTEPS):
            rows, turn = small(rows, turn, RPM * speeds)
        new = {"x": rows[0], "v": rows[1], "w": rows[2], "rotor_speeds": rows[3] / RPM}
        return {**new, "q": turn.as_quat(), "wind": state["wind"]}

    return step


def _their_dynamics() -> Any:
    """The function of drone-models, whose package wants SciPy's array switch to be set where SciPy is there already.

    Only while it is imported: with NumPy's arrays, which are all it gets here, SciPy answers the same without.
    """
    before = os.environ.get(SWITCH)
    os.environ[SWITCH] = "1"
    try:
        from drone_models.first_principles import dynamics
    finally:
        if before is None:
            del os.environ[SWITCH]
        else:
            os.environ[SWITCH] = before
    return dynamics


def their_numbers(vehicle: Vehicle) -> dict[str, Any]:
    """The arguments of drone-models' dynamics for a vehicle of ours: rotors turn in revolutions a minute there."""
    positions, inertia = np.asarray(vehicle.rotor_positions, float), np.diag(np.asarray(vehicle.inertia, float))
    arm = float(np.abs(positions[:, :2]).max())
    return {
        "mass": float(vehicle.mass),
        "L": arm,
        "prop_inertia": float(vehicle.rotor_inertia),
        "gravity_vec": np.array([0.0, 0.0, -float(vehicle.gravity)]),
        "J": inertia,
        "J_inv": np.linalg.inv(inertia),
        "rpm2thrust": np.array([0.0, 0.0, float(vehicle.thrust_coefficient) / RPM**2]),
        "rpm2torque": np.array([0.0, 0.0, float(vehicle.torque_coefficient) / RPM**2]),
        "mixing_matrix": np.stack([positions[:, 1] / arm, -positions[:, 0] / arm, np.asarray(vehicle.rotor_spin)]),
        "drag_matrix": np.zeros((3, 3)),
        "rotor_dyn_coef": np.array([1.0, 0.0, 1.0, 0.0]) / float(vehicle.motor_time_constant),
    }


def without(vehicle: Vehicle, *bounds: str) -> Vehicle:
    """The vehicle without some of its bounds: what it then flies it could not fly for them.

    Args:
        bounds: some of ``rotor limits`` (rotors turn ten times as fast) and ``motor lag`` (a twentieth).
    """
    fastest, lag = float(vehicle.rotor_speed_max), float(vehicle.motor_time_constant)
    changed: dict[str, float] = {}
    if "rotor limits" in bounds:
        changed |= {"rotor_speed_max": 10.0 * fastest}
    if "motor lag" in bounds:
        changed |= {"motor_time_constant": 0.05 * lag}
    return dataclasses.replace(vehicle, **changed)
