"""Differential flatness: the attitude, rates, moments and rotor speeds that fly a given trajectory.

From Newton's law without drag (as in the MFRL feasibility check, so the real vehicle needs a little more):

    specific_thrust * b_z = acc + g e_z

and b_x in the vertical plane of the yaw angle: the heading of b_x is exactly the yaw while b_z points upwards
(Tal & Karaman, IEEE TCST 29(3), 2021, eq. 12-15; theirs is NED with b_z down, here z is up and the body FLU).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from jaxplan.arrays import AnyArray
from jaxplan.numerics import safe_divide
from jaxplan.records import record
from jaxplan.spline import FlatState, FlatStateBatch
from jaxplan.vehicle.mixing import signed_sqrt, squared_rotor_speeds
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.rotations import quat_from_rotation
from jaxplan.vehicle.vectors import Entry, Vector, cross, direction, dot, length


@record
class FlatOutputs:
    """What one flat state demands of the vehicle. Body frame FLU, world z up."""

    specific_thrust: Float[AnyArray, ""]
    """m/s^2, >= 0."""
    thrust: Float[AnyArray, ""]
    """N, along body +z, >= 0."""
    rotation: Float[AnyArray, "3 3"]
    """Body to world: columns are the body axes in the world."""
    quat_wxyz: Float[AnyArray, "4"]
    """The same attitude as a quaternion, w >= 0."""
    body_rates: Float[AnyArray, "3"]
    """rad/s, body."""
    angular_acceleration: Float[AnyArray, "3"]
    """rad/s^2, body."""
    moment: Float[AnyArray, "3"]
    """N m, body: J dw + w x J w. Rotor inertia is left out."""
    rotor_speeds: Float[AnyArray, "4"]
    """rad/s; negative where the rotor would have to pull downwards."""


class Demand(NamedTuple):
    """What one flat state demands of the body, entry by entry; units as in ``FlatOutputs``."""

    specific_thrust: Entry
    axes: tuple[Vector, Vector, Vector]
    """b_x, b_y and b_z in the world: the columns of the rotation."""
    body_rates: Vector
    angular_acceleration: Vector
    moment: Vector


def differential_flatness(vehicle: Vehicle, state: FlatState) -> FlatOutputs:
    """Attitude, rates, thrust, moment and rotor speeds along a trajectory, at one instant.

    In exact free fall the attitude is taken level and the rates 0; NaN in acceleration, jerk, snap or yaw stays NaN.
    """
    state = jax.tree.map(jnp.asarray, state)
    vehicle = vehicle.astype(state.derivatives.dtype)
    demand = demand_of(vehicle, state)
    rotation, thrust = _matrix(demand.axes), vehicle.mass * demand.specific_thrust
    return FlatOutputs(
        specific_thrust=demand.specific_thrust,
        thrust=thrust,
        rotation=rotation,
        quat_wxyz=quat_from_rotation(rotation),
        body_rates=jnp.stack(demand.body_rates),
        angular_acceleration=jnp.stack(demand.angular_acceleration),
        moment=jnp.stack(demand.moment),
        rotor_speeds=signed_sqrt(jnp.stack(squared_rotor_speeds(vehicle, demand.moment, thrust))),
    )


def demand_of(vehicle: Vehicle, state: FlatState | FlatStateBatch) -> Demand:
    """The body's part of ``differential_flatness``; ``vehicle`` is cast already.

    Args:
        state: one state, or a batch with its axes last.
    """
    _, _, acc, jerk, snap = state.derivatives
    inertia = vehicle.inertia
    force = (acc[0], acc[1], acc[2] + vehicle.gravity)
    specific_thrust, axes = length(force), _axes(force, state.yaw[0])
    rates, angular_acceleration = _rates(axes, specific_thrust, jerk, snap, state.yaw[1], state.yaw[2])
    gyroscopic = cross(rates, [inertia[axis] * rates[axis] for axis in range(3)])
    moment = [inertia[axis] * angular_acceleration[axis] + gyroscopic[axis] for axis in range(3)]
    return Demand(specific_thrust, axes, rates, angular_acceleration, moment)


def against_drag(vehicle: Vehicle, reference: FlatState) -> FlatState:
    """The state whose flatness outputs make ``reference`` against the drag of still air.

    Its acceleration and jerk hold the drag -c |v| v and its rate too; snap is left as it is.
    """
    vel, acc = reference.vel, reference.acc
    speed = length(vel)
    share = vehicle.drag_coefficient / vehicle.mass
    along = safe_divide(dot(vel, acc), speed)
    drag_rate = speed * acc + along * vel
    derivatives = jnp.asarray(reference.derivatives).at[2].add(share * speed * vel).at[3].add(share * drag_rate)
    return FlatState(derivatives=derivatives, yaw=reference.yaw)


def attitude_from(force: Float[AnyArray, "3"], yaw: Float[AnyArray, ""]) -> Float[AnyArray, "3 3"]:
    """The attitude (body to world) with b_z along ``force`` [world] and b_x in the vertical plane of ``yaw`` [rad].

    Level where ``force`` is 0. Where b_z is horizontal and normal to that plane, b_x is the horizontal heading.
    """
    return _matrix(_axes(force, yaw))


def body_rates_from(
    rotation: Float[AnyArray, "3 3"],
    specific_thrust: Float[AnyArray, ""],
    jerk: Float[AnyArray, "3"],
    snap: Float[AnyArray, "3"],
    yaw_rate: Float[AnyArray, ""],
    yaw_acceleration: Float[AnyArray, ""],
) -> tuple[Float[AnyArray, "3"], Float[AnyArray, "3"]]:
    """Body rates [rad/s] and angular acceleration [rad/s^2] that make ``jerk``, ``snap`` and the yaw motion.

    At the attitude and thrust given, which need not be the reference's. Tal & Karaman 2021 eq. (14), (15), solved by
    hand: with R^T jerk = dc e_z + c (w x e_z) the tilt rates follow from the jerk, then w_z from the yaw rate;
    likewise one derivative higher. 0 where there is no solution (no thrust, or b_z horizontal for w_z).
    """
    axes = (rotation[:, 0], rotation[:, 1], rotation[:, 2])
    rates, acceleration = _rates(axes, specific_thrust, jerk, snap, yaw_rate, yaw_acceleration)
    return jnp.stack(rates), jnp.stack(acceleration)


def _axes(force: Vector, yaw: Entry) -> tuple[Vector, Vector, Vector]:
    """The columns of ``attitude_from``."""
    cos, sin, zero = jnp.cos(yaw), jnp.sin(yaw), jnp.zeros_like(yaw)
    b_z = direction(force, otherwise=(zero, zero, zero + 1.0))
    b_x = direction(cross((-sin, cos, zero), b_z), otherwise=(cos, sin, zero))
    return b_x, cross(b_z, b_x), b_z


def _matrix(axes: tuple[Vector, Vector, Vector]) -> Float[AnyArray, "3 3"]:
    return jnp.stack([jnp.stack(axis) for axis in axes], axis=1)


def _rates(
    axes: tuple[Vector, Vector, Vector],
    specific_thrust: Entry,
    jerk: Vector,
    snap: Vector,
    yaw_rate: Entry,
    yaw_acceleration: Entry,
) -> tuple[Vector, Vector]:
    """Entries of ``body_rates_from``."""
    b_x3, b_y3, b_z3 = (axis[2] for axis in axes)
    jerk_x, jerk_y, thrust_rate = (dot(axis, jerk) for axis in axes)
    snap_x, snap_y, _ = (dot(axis, snap) for axis in axes)
    heading = 1.0 - b_x3 * b_x3  # squared length of b_x seen from above
    rate_x = -safe_divide(jerk_y, specific_thrust)
    rate_y = safe_divide(jerk_x, specific_thrust)
    rate_z = safe_divide(heading * yaw_rate - b_y3 * rate_y, b_z3)
    acc_x = -safe_divide(snap_y + 2.0 * thrust_rate * rate_x, specific_thrust) + rate_y * rate_z
    acc_y = safe_divide(snap_x - 2.0 * thrust_rate * rate_y, specific_thrust) - rate_x * rate_z
    heading_rate = -2.0 * b_x3 * (rate_z * b_y3 - rate_y * b_z3)
    drift = rate_x * (rate_y * b_z3 - rate_z * b_y3)
    acc_z = safe_divide(heading * yaw_acceleration + heading_rate * yaw_rate - drift - b_y3 * acc_y, b_z3)
    return (rate_x, rate_y, rate_z), (acc_x, acc_y, acc_z)
