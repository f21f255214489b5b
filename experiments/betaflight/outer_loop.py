"""What a radio's pilot does, here from true state: collective thrust and body rates that follow a reference.

    f   = a_ref + drag(v_ref) / m + g e_z + k_x e_x + k_v e_v                  specific thrust vector [m/s^2, world]
    w_c = R^T R_ref (w_ref + lead dw_ref) + k_R theta(R^T R_f)                 body rates [rad/s, body]

theta is the rotation vector to the attitude R_f that has f along b_z and the reference's yaw; w_ref and dw_ref follow
from the reference against drag by differential flatness (``vehicle.flatness``; Faessler, Franchi and Scaramuzza, RA-L
2018, with our quadratic drag). The rate loop, its mixer and the motors are not ours. They follow late, so thrust
and rates are asked for as they will be needed ``lead`` seconds later.
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

POSITION, VELOCITY = 10.0, 5.0
"""k_x [1/s^2] and k_v [1/s]."""
ATTITUDE = (10.0, 10.0, 5.0)
"""k_R [1/s], about body x, y, z."""
LEAD = 0.02
"""s."""
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
    rotation = rotation_from_quat(state.quat_wxyz)
    force = (
        against_drag(vehicle, reference).acc
        + vehicle.gravity * jnp.array([0.0, 0.0, 1.0], state.pos.dtype)
        + POSITION * (reference.pos - state.pos)
        + VELOCITY * (reference.vel - state.vel)
    )
    soon = force + LEAD * against_drag(vehicle, reference).jerk
    thrust = vehicle.mass * jnp.maximum(jnp.dot(soon, rotation[:, 2]), 0.0)
    output = jnp.sqrt(0.25 * thrust / vehicle.thrust_coefficient) / vehicle.rotor_speed_max
    ahead = rotation.T @ (demand.rotation @ (demand.body_rates + LEAD * demand.angular_acceleration))
    error = rotation_vector(rotation.T @ attitude_from(force, reference.yaw[0]))
    rates = ahead + jnp.array(ATTITUDE, error.dtype) * error
    return jnp.concatenate([output[None], rates])


def sticks(output: float, rates: Float[np.ndarray, "3"]) -> Sticks:
    """The radio's pulse widths for a motor output and body rates FLU [rad/s]: yaw is the other way round there."""
    p, q, r = MIDDLE + (HIGH - MIDDLE) * np.degrees(rates) / MOST_RATE
    throttle = LOWEST_THROTTLE + (HIGH - LOWEST_THROTTLE) * (float(output) - IDLE) / (1.0 - IDLE)
    return Sticks(roll=p, pitch=q, throttle=throttle, yaw=2 * MIDDLE - r, armed=True)
