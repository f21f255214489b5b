"""What a radio's pilot does, here from true state: collective thrust and body rates that follow a reference.

    f   = a_ref + drag(v_ref) / m + g e_z + k_x e_x + k_v e_v                  specific thrust vector [m/s^2, world]
    w_c = R^T R_ref (w_ref + tau dw_ref) + (k_R / k_W) theta(R^T R_f)          body rates [rad/s, body]

theta is the rotation vector to the attitude R_f that has f along b_z and the reference's yaw; w_ref and dw_ref follow
from the reference against drag by differential flatness (``vehicle.flatness``; Faessler, Franchi and Scaramuzza, RA-L
2018, with our quadratic drag). The rotors are late by their time constant tau, so thrust and rates are asked for as
they are needed then. The gains are the vehicle's [se3], of whose attitude loop the rate loop here is the firmware's.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxplan.arrays import AnyArray
from jaxplan.spline import FlatState
from jaxplan.tracking.plant import PlantState
from jaxplan.vehicle.flatness import FlatOutputs, against_drag, attitude_from, differential_flatness
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.rotations import rotation_from_quat, rotation_vector

from .link import HIGH, MIDDLE, Sticks
from .settings import MOST_RATE

IDLE = 0.055
"""Share of full motor output with the throttle low: the firmware's motor_idle as it is shipped."""
LOWEST_THROTTLE = 1050
"""Microseconds, from where the throttle counts: the firmware's min_check as it is shipped."""


def demands(vehicle: Vehicle, references: FlatState) -> FlatOutputs:
    """What each of n references demands against drag, leading axis n."""
    pushed = jax.vmap(against_drag, in_axes=(None, 0))(vehicle, references)
    return jax.vmap(differential_flatness, in_axes=(None, 0))(vehicle, pushed)


def commands(vehicle: Vehicle, state: PlantState, reference: FlatState, demand: FlatOutputs) -> Float[AnyArray, "4"]:
    """Motor output [0 to 1] and body rates [rad/s]; ``vehicle`` is cast already."""
    rotation, gains, dtype = rotation_from_quat(state.quat_wxyz), vehicle.se3, state.pos.dtype
    lag, pushed = vehicle.motor_time_constant, against_drag(vehicle, reference)
    force = (
        pushed.acc
        + vehicle.gravity * jnp.array([0.0, 0.0, 1.0], dtype)
        + jnp.array(gains.position, dtype) * (reference.pos - state.pos)
        + jnp.array(gains.velocity, dtype) * (reference.vel - state.vel)
    )
    soon = force + lag * pushed.jerk
    thrust = vehicle.mass * jnp.maximum(jnp.dot(soon, rotation[:, 2]), 0.0)
    output = jnp.sqrt(0.25 * thrust / vehicle.thrust_coefficient) / vehicle.rotor_speed_max
    ahead = rotation.T @ (demand.rotation @ (demand.body_rates + lag * demand.angular_acceleration))
    error = rotation_vector(rotation.T @ attitude_from(force, reference.yaw[0]))
    stiffness = jnp.array(gains.attitude, dtype) / jnp.array(gains.rates, dtype)
    return jnp.concatenate([output[None], ahead + stiffness * error])


def sticks(output: float, rates: Float[np.ndarray, "3"]) -> Sticks:
    """The radio's pulse widths for a motor output and body rates FLU [rad/s]: yaw is the other way round there."""
    p, q, r = MIDDLE + (HIGH - MIDDLE) * np.degrees(rates) / MOST_RATE
    throttle = LOWEST_THROTTLE + (HIGH - LOWEST_THROTTLE) * (float(output) - IDLE) / (1.0 - IDLE)
    return Sticks(roll=p, pitch=q, throttle=throttle, yaw=2 * MIDDLE - r, armed=True)
