"""The simulated vehicle: MJX rigid body, rotors with lag and inertia, drag, process noise, and the sensors' filters.

One physics step of dt = 1/400 s (model of mit-aera/multicopterDynamicsSim; MuJoCo's semi-implicit Euler):

    rotor    w+ = w_c + (w - w_c) exp(-dt / tau)                            exact for a held command
    body     m a = R e_z sum k_T w^2 - m g e_z - c |v - u| (v - u) + noise              u: wind
             J dW + W x J W = sum (r x k_T w^2 e_z) + e_z sum s (k_Q w^2 + J_r dw)
                              + W x e_z sum s J_r w - c_a |W| W + noise

The rotors' angular momentum is -sum s J_r w e_z: it gives the reaction to dw and the gyroscopic term. Speeds within a
step are the mean of its two ends. A rotor's thrust loss scales its k_T and k_Q.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int, PRNGKeyArray, UInt32

from jaxplan.arrays import AnyArray, Scalar
from jaxplan.records import record
from jaxplan.spline import FlatState
from jaxplan.tracking.disturbance import Disturbance, air_velocity
from jaxplan.tracking.filters import FilterState, filter_step
from jaxplan.tracking.model import Body, Motion
from jaxplan.tracking.rates import PHYSICS_RATE
from jaxplan.tracking.sensing import Sensed
from jaxplan.vehicle.flatness import against_drag, differential_flatness
from jaxplan.vehicle.mixing import allocation_matrix
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.rotations import rotation_from_quat
from jaxplan.vehicle.vectors import length

DT = 1.0 / PHYSICS_RATE
"""s, one physics step."""


@record
class PlantState:
    """Everything that the next step of the simulated flight depends on. float32, world z up, body FLU."""

    pos: Float[AnyArray, "*batch 3"]
    """m, world."""
    vel: Float[AnyArray, "*batch 3"]
    """m/s, world."""
    quat_wxyz: Float[AnyArray, "*batch 4"]
    """Body to world, unit."""
    body_rates: Float[AnyArray, "*batch 3"]
    """rad/s, body."""
    rotor_speeds: Float[AnyArray, "*batch 4"]
    """rad/s."""
    signals: FilterState
    """Filtered measurements, (*batch 4 3); rows named in ``sensing``."""
    key: PRNGKeyArray | UInt32[AnyArray, "*batch 2"]
    """Stream of the noise; step i uses ``fold_in(key, i)``, so how a flight is cut into calls does not matter."""
    step: Int[AnyArray, "*batch"]
    """Control steps flown since the reset."""


class Noise(NamedTuple):
    """Standard normal draws of one physics step."""

    force: Float[AnyArray, "3"]
    moment: Float[AnyArray, "3"]
    accelerometer: Float[AnyArray, "3"]
    gyroscope: Float[AnyArray, "3"]


def state_on_reference(vehicle: Vehicle, reference: FlatState, key: PRNGKeyArray) -> PlantState:
    """The plant as if it had always flown ``reference``: attitude, rates, rotors (within limits), settled filters."""
    flat = differential_flatness(vehicle, against_drag(vehicle, reference))
    force = reference.acc + vehicle.gravity * jnp.array([0.0, 0.0, 1.0], reference.acc.dtype)
    thrust = flat.specific_thrust * flat.rotation[:, 2]
    value = jnp.stack([force, thrust, flat.body_rates, flat.moment])
    rate = jnp.stack([reference.jerk, reference.jerk, flat.angular_acceleration, jnp.zeros_like(force)])
    return PlantState(
        pos=reference.pos,
        vel=reference.vel,
        quat_wxyz=flat.quat_wxyz,
        body_rates=flat.body_rates,
        rotor_speeds=jnp.clip(flat.rotor_speeds, vehicle.rotor_speed_min, vehicle.rotor_speed_max),
        signals=FilterState(value=value, rate=rate),
        key=key,
        step=jnp.zeros((), jnp.int32),
    )


def sense(state: PlantState) -> Sensed:
    """What the controller reads at this instant."""
    rotation = rotation_from_quat(state.quat_wxyz)
    return Sensed(
        pos=state.pos, vel=state.vel, rotation=rotation, rotor_speeds=state.rotor_speeds, signals=state.signals
    )


def physics_step(
    vehicle: Vehicle,
    body: Body,
    state: PlantState,
    commands: Float[AnyArray, "4"],
    noise: Noise,
    disturbance: Disturbance | None = None,
    time: Scalar = 0.0,
) -> PlantState:
    """The plant 1/400 s later, under held rotor ``commands`` [rad/s, within limits]. ``vehicle`` is cast already.

    ``time`` [s since the reset] places the gust of the ``disturbance``; None is calm.
    """
    speeds = commands + (state.rotor_speeds - commands) * jnp.exp(-DT / vehicle.motor_time_constant)
    mean_speeds = 0.5 * (state.rotor_speeds + speeds)
    reaction = vehicle.rotor_inertia * jnp.sum(vehicle.rotor_spin * (speeds - state.rotor_speeds)) / DT
    wrench = allocation_matrix(vehicle) @ mean_speeds**2
    thrusts, airspeed = vehicle.thrust_coefficient * mean_speeds**2, state.vel
    if disturbance is not None:
        thrusts = thrusts * (1.0 - jnp.asarray(disturbance.thrust_loss))
        airspeed = state.vel - air_velocity(disturbance, jnp.asarray(time))
    motion = body(
        Motion(pos=state.pos, quat_wxyz=state.quat_wxyz, vel=state.vel, body_rates=state.body_rates),
        thrusts=thrusts,
        force=_body_force(vehicle, airspeed, noise),
        moment=_body_moment(vehicle, state, mean_speeds, reaction, noise),
    )
    signals = _measured(vehicle, state, motion, wrench, reaction, noise)
    return PlantState(
        **motion._asdict(),
        rotor_speeds=speeds,
        signals=filter_step(state.signals, signals, DT),
        key=state.key,
        step=state.step,
    )


def _measured(
    vehicle: Vehicle,
    before: PlantState,
    after: Motion,
    wrench: Float[AnyArray, "4"],
    reaction: Float[AnyArray, ""],
    noise: Noise,
) -> Float[AnyArray, "4 3"]:
    """What goes into the filters at the end of a step, in the rows of ``sensing``."""
    up = jnp.array([0.0, 0.0, 1.0], after.vel.dtype)
    # Isotropic noise is the same in body and world axes, so the turn into the body and back is left out.
    accelerometer = jnp.sqrt(vehicle.accelerometer_variance) * noise.accelerometer
    return jnp.stack(
        [
            (after.vel - before.vel) / DT + vehicle.gravity * up + accelerometer,
            rotation_from_quat(before.quat_wxyz)[:, 2] * (wrench[3] / vehicle.mass),
            after.body_rates + jnp.sqrt(vehicle.gyroscope_variance) * noise.gyroscope,
            wrench[:3] + reaction * up,
        ]
    )


def draw_noise(key: PRNGKeyArray, substeps: int) -> Noise:
    """Standard normal draws for ``substeps`` physics steps, leading axis ``substeps``."""
    draws = jax.random.normal(key, (substeps, 4, 3), jnp.float32)
    return Noise(*(draws[:, row] for row in range(4)))


def no_noise(key: PRNGKeyArray, substeps: int) -> Noise:
    """Zeros instead of draws."""
    del key
    return Noise(*(jnp.zeros((substeps, 3), jnp.float32) for _ in range(4)))


def _body_force(vehicle: Vehicle, airspeed: Float[AnyArray, "3"], noise: Noise) -> Float[AnyArray, "3"]:
    """Drag of the velocity through the air [m/s, world] and process noise [N, world]."""
    drag = -vehicle.drag_coefficient * length(airspeed) * airspeed
    return drag + jnp.sqrt(vehicle.force_noise_psd / DT) * noise.force


def _body_moment(
    vehicle: Vehicle, state: PlantState, speeds: Float[AnyArray, "4"], reaction: Float[AnyArray, ""], noise: Noise
) -> Float[AnyArray, "3"]:
    """Rotor reaction and gyroscopic moment, aerodynamic damping and process noise [N m, body]."""
    rate_x, rate_y, _ = state.body_rates
    momentum = vehicle.rotor_inertia * jnp.sum(vehicle.rotor_spin * speeds)  # along -z
    inertial = jnp.stack([momentum * rate_y, -momentum * rate_x, reaction])
    damping = -vehicle.aero_moment_coefficient * length(state.body_rates) * state.body_rates
    return inertial + damping + jnp.sqrt(vehicle.moment_noise_psd / DT) * noise.moment
