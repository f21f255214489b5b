"""Differential flatness: the attitude, rates, moments and rotor speeds that fly a given trajectory.

From Newton's law without drag (as in the MFRL feasibility check, so the real vehicle needs a little more):

    specific_thrust * b_z = acc + g e_z

and b_x in the vertical plane of the yaw angle: the heading of b_x is exactly the yaw while b_z points upwards
(Tal & Karaman, IEEE TCST 29(3), 2021, eq. 12-15; theirs is NED with b_z down, here z is up and the body FLU).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplan.numerics import safe_divide
from jaxplan.records import record
from jaxplan.spline import FlatState
from jaxplan.vehicle.allocation import signed_sqrt, squared_rotor_speeds
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.rotations import length, quat_from_rotation


@record
class FlatOutputs:
    """What one flat state demands of the vehicle. Body frame FLU, world z up."""

    specific_thrust: Float[Array, ""]
    """m/s^2, >= 0."""
    thrust: Float[Array, ""]
    """N, along body +z, >= 0."""
    rotation: Float[Array, "3 3"]
    """Body to world: columns are the body axes in the world."""
    quat_wxyz: Float[Array, "4"]
    """The same attitude as a quaternion, w >= 0."""
    body_rates: Float[Array, "3"]
    """rad/s, body."""
    angular_acceleration: Float[Array, "3"]
    """rad/s^2, body."""
    moment: Float[Array, "3"]
    """N m, body: J dw + w x J w. Rotor inertia is left out."""
    rotor_speeds: Float[Array, "4"]
    """rad/s; negative where the rotor would have to pull downwards."""


def differential_flatness(vehicle: Vehicle, state: FlatState) -> FlatOutputs:
    """Attitude, rates, thrust, moment and rotor speeds along a trajectory, at one instant.

    In exact free fall the attitude is taken level and the rates 0; NaN in acceleration, jerk, snap or yaw stays NaN.
    """
    state = jax.tree.map(jnp.asarray, state)
    vehicle = vehicle.astype(state.derivatives.dtype)
    force = state.acc + vehicle.gravity * jnp.array([0.0, 0.0, 1.0], state.acc.dtype)
    specific_thrust = length(force)
    rotation = attitude_from(force, state.yaw[0])
    rates, angular_acceleration = body_rates_from(
        rotation, specific_thrust, state.jerk, state.snap, state.yaw[1], state.yaw[2]
    )
    moment = vehicle.inertia * angular_acceleration + jnp.cross(rates, vehicle.inertia * rates)
    thrust = vehicle.mass * specific_thrust
    return FlatOutputs(
        specific_thrust=specific_thrust,
        thrust=thrust,
        rotation=rotation,
        quat_wxyz=quat_from_rotation(rotation),
        body_rates=rates,
        angular_acceleration=angular_acceleration,
        moment=moment,
        rotor_speeds=signed_sqrt(squared_rotor_speeds(vehicle, moment, thrust)),
    )


def against_drag(vehicle: Vehicle, reference: FlatState) -> FlatState:
    """The state whose flatness outputs make ``reference`` against the drag of still air: acceleration and jerk hold the
    drag -c |v| v and its rate too. Snap is left as it is.
    """
    vel, acc = reference.vel, reference.acc
    speed = length(vel)
    share = vehicle.drag_coefficient / vehicle.mass
    along = safe_divide(jnp.dot(vel, acc), speed)
    drag_rate = speed * acc + along * vel
    derivatives = reference.derivatives.at[2].add(share * speed * vel).at[3].add(share * drag_rate)
    return FlatState(derivatives=derivatives, yaw=reference.yaw)


def attitude_from(force: Float[Array, "3"], yaw: Float[Array, ""]) -> Float[Array, "3 3"]:
    """The attitude (body to world) with b_z along ``force`` [world] and b_x in the vertical plane of ``yaw`` [rad].

    Level where ``force`` is 0. Where b_z is horizontal and normal to that plane, b_x is the horizontal heading.
    """
    cos, sin, zero = jnp.cos(yaw), jnp.sin(yaw), jnp.zeros_like(yaw)
    up = jnp.stack([zero, zero, zero + 1.0])
    magnitude = length(force)
    b_z = jnp.where(magnitude == 0.0, up, force / jnp.where(magnitude == 0.0, 1.0, magnitude))
    ahead = jnp.cross(jnp.stack([-sin, cos, zero]), b_z)
    span = length(ahead)
    b_x = jnp.where(span == 0.0, jnp.stack([cos, sin, zero]), ahead / jnp.where(span == 0.0, 1.0, span))
    return jnp.stack([b_x, jnp.cross(b_z, b_x), b_z], axis=1)


def body_rates_from(
    rotation: Float[Array, "3 3"],
    specific_thrust: Float[Array, ""],
    jerk: Float[Array, "3"],
    snap: Float[Array, "3"],
    yaw_rate: Float[Array, ""],
    yaw_acceleration: Float[Array, ""],
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Body rates [rad/s] and angular acceleration [rad/s^2] that make ``jerk``, ``snap`` and the yaw motion.

    At the attitude and thrust given, which need not be the reference's. Tal & Karaman 2021 eq. (14), (15), solved by
    hand: with R^T jerk = dc e_z + c (w x e_z) the tilt rates follow from the jerk, then w_z from the yaw rate;
    likewise one derivative higher. 0 where there is no solution (no thrust, or b_z horizontal for w_z).
    """
    b_x3, b_y3, b_z3 = rotation[2]
    jerk_x, jerk_y, thrust_rate = rotation.T @ jerk
    snap_x, snap_y, _ = rotation.T @ snap
    heading = 1.0 - b_x3 * b_x3  # squared length of b_x seen from above
    rate_x = -safe_divide(jerk_y, specific_thrust)
    rate_y = safe_divide(jerk_x, specific_thrust)
    rate_z = safe_divide(heading * yaw_rate - b_y3 * rate_y, b_z3)
    acc_x = -safe_divide(snap_y + 2.0 * thrust_rate * rate_x, specific_thrust) + rate_y * rate_z
    acc_y = safe_divide(snap_x - 2.0 * thrust_rate * rate_y, specific_thrust) - rate_x * rate_z
    heading_rate = -2.0 * b_x3 * (rate_z * b_y3 - rate_y * b_z3)
    drift = rate_x * (rate_y * b_z3 - rate_z * b_y3)
    acc_z = safe_divide(heading * yaw_acceleration + heading_rate * yaw_rate - drift - b_y3 * acc_y, b_z3)
    return jnp.stack([rate_x, rate_y, rate_z]), jnp.stack([acc_x, acc_y, acc_z])
