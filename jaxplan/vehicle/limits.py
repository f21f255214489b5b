"""Is a trajectory within the rotors' reach? The low-fidelity feasibility test of MFRL (no drag, no rotor lag)."""

import enum
import functools
from collections.abc import Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplan.arrays import AnyArray, Scalar
from jaxplan.numerics import safe_divide
from jaxplan.precision import in_float64
from jaxplan.spline import FlatState, FlatStateBatch, PiecewisePolynomial
from jaxplan.vehicle.flatness import demand_of
from jaxplan.vehicle.mixing import inverse_allocation_matrix, signed_sqrt, squared_rotor_speeds
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.vectors import Entry, Vector, cross, dot, length


class Feasibility(enum.IntEnum):
    """What is known about a trajectory and the rotors' limits."""

    INFEASIBLE = -1
    """At some instant a rotor would have to leave its range."""
    UNDECIDED = 0
    """All samples are inside, but the bound between them is not tight enough to vouch for the rest."""
    FEASIBLE = 1
    """No instant of the trajectory asks more than the rotors give."""


class Effort(NamedTuple):
    """What a motion asks of the body as a whole."""

    thrust: Entry
    """Per mass [m/s^2]."""
    tilting: Entry
    """How fast the thrust turns [rad/s]: the body rate across it."""


def rotor_limit_margin(vehicle: Vehicle, state: FlatState | FlatStateBatch) -> Float[Array, "*b"]:
    """Distance [rad/s] of the worst rotor from its nearest limit: positive inside, -inf for a state not finite.

    Args:
        state: one state, or a batch with its axes last.
    """
    vehicle, squared = _squared_speeds(vehicle, state)
    worst = _worst(map(signed_sqrt, squared), vehicle.rotor_speed_min, vehicle.rotor_speed_max)
    finite = jnp.all(jnp.isfinite(state.derivatives), axis=(0, 1)) & jnp.all(jnp.isfinite(state.yaw), axis=0)
    finite &= jnp.isfinite(worst)
    return jnp.where(finite, worst, -jnp.inf)


def thrust_limit_margin(vehicle: Vehicle, state: FlatState | FlatStateBatch) -> Float[Array, "*b"]:
    """Distance of the worst rotor's thrust from its nearest limit, as a share of the range between its limits.

    Of the same sign as ``rotor_limit_margin``, for states as there, and smooth where a rotor stands still; NaN for a
    state not finite.
    """
    vehicle, squared = _squared_speeds(vehicle, state)
    least, most = vehicle.rotor_speed_min**2, vehicle.rotor_speed_max**2
    return _worst(squared, least, most) / (most - least)


def effort_of(vehicle: Vehicle, vel: Vector, acc: Vector, jerk: Vector) -> Effort:
    """What a motion asks of the body as a whole, against gravity and the drag of still air [SI, world]."""
    vehicle = vehicle.astype(jnp.asarray(acc[0]).dtype)
    share, speed = vehicle.drag_coefficient / vehicle.mass, length(vel)
    along = safe_divide(dot(vel, acc), speed)
    force = [acc[axis] + share * speed * vel[axis] for axis in range(3)]
    force[2] = force[2] + vehicle.gravity
    force_rate = [jerk[axis] + share * (speed * acc[axis] + along * vel[axis]) for axis in range(3)]
    thrust = length(force)
    return Effort(thrust, safe_divide(length(cross(force, force_rate)), thrust * thrust))


def most_thrust(vehicle: Vehicle) -> Scalar:
    """Of all rotors together, per mass [m/s^2]."""
    return 4.0 * vehicle.thrust_coefficient * vehicle.rotor_speed_max**2 / vehicle.mass


def least_rotor_margin(vehicle: Vehicle, states: FlatStateBatch) -> Float[Array, "k"]:
    """The least ``rotor_limit_margin`` [rad/s] of k flights over their s sampled states; batch axes (s, k)."""
    return jnp.min(rotor_limit_margin(vehicle, states), axis=0)


@in_float64
def rotor_feasibility(vehicle: Vehicle, spline: PiecewisePolynomial, pieces: int = 64) -> Feasibility:
    """Whether the rotors can fly ``spline``, between samples too (host; each segment is cut into ``pieces``)."""
    return Feasibility(int(_decided(vehicle.astype(jnp.float64), jax.tree.map(jnp.asarray, spline), pieces)))


def feasibility(vehicle: Vehicle, spline: PiecewisePolynomial, pieces: int) -> Int[Array, ""]:
    """The traced core of ``rotor_feasibility``: its value for one spline; ``vmap`` it over more.

    INFEASIBLE comes from the middles of the pieces, where flatness is evaluated exactly, FEASIBLE from
    ``squared_speed_bounds`` of all pieces. A value that is not finite is INFEASIBLE.
    """
    vehicle = vehicle.astype(spline.position.dtype)
    real = spline.durations > 0.0
    states = _middles(spline, pieces)
    margins = jax.vmap(jax.vmap(lambda state: rotor_limit_margin(vehicle, state)))(states)
    inside = jnp.all(jnp.where(real[:, None], margins, 0.0) >= 0.0)
    low, high = squared_speed_bounds(vehicle, spline, pieces)
    within = (low >= vehicle.rotor_speed_min**2) & (high <= vehicle.rotor_speed_max**2)
    certain = jnp.all(within | ~real[:, None, None])
    return jnp.where(inside, jnp.where(certain, 1, 0), -1)


def squared_speed_bounds(
    vehicle: Vehicle, spline: PiecewisePolynomial, pieces: int
) -> tuple[Float[Array, "m p 4"], Float[Array, "m p 4"]]:
    """Bounds [(rad/s)^2] of what each rotor turns at, squared, anywhere on each piece of each segment.

    Hull bounds of jerk j, snap s and yaw rate and acceleration bound the acceleration around the piece's middle,
    hence thrust and tilt from both sides; the body rates and angular accelerations of ``body_rates_from`` follow term
    by term by the triangle inequality, and the moments by Euler's equation. With c the specific thrust, z the vertical
    component of b_z and t = sqrt(1 - z^2) that of b_x and b_y at most:

        |w_xy| <= j / c,   |w_z| <= (|psi'| + t |w_xy|) / z,   |dw_xy| <= (s + 2 j |w_xy|) / c + |w_xy| |w_z|
    """
    vehicle = vehicle.astype(spline.position.dtype)
    half = (0.5 * spline.durations / pieces)[:, None]
    jerk, snap = spline.bounds(3, pieces), spline.bounds(4, pieces)
    turn, turn_rate = spline.yaw_bounds(1, pieces), spline.yaw_bounds(2, pieces)
    force = _middles(spline, pieces).acc + vehicle.gravity * jnp.array([0.0, 0.0, 1.0], half.dtype)[None, None]
    magnitude = jnp.sqrt(jnp.sum(force * force, axis=-1))
    least, most = jnp.maximum(magnitude - jerk * half, 0.0), magnitude + jerk * half
    upright = jnp.clip((force[..., 2] - jerk * half) / most, 0.0, 1.0)
    tilt = jnp.sqrt(1.0 - upright * upright)
    rate = jerk / least
    spin = (turn + tilt * rate) / upright
    acceleration = (snap + 2.0 * jerk * rate) / least + rate * spin
    heading_rate = 2.0 * tilt * (spin * tilt + rate)
    drift = rate * (rate + spin * tilt)
    spin_rate = (turn_rate + heading_rate * turn + drift + tilt * acceleration) / upright
    ix, iy, iz = vehicle.inertia
    moments = jnp.stack(
        [
            ix * acceleration + jnp.abs(iz - iy) * rate * spin,
            iy * acceleration + jnp.abs(iz - ix) * rate * spin,
            iz * spin_rate + jnp.abs(iy - ix) * rate * rate,
        ],
        axis=-1,
    )
    mixer = inverse_allocation_matrix(vehicle)
    tilting = moments @ jnp.abs(mixer[:, :3]).T
    lift = (vehicle.mass * mixer[:, 3])[None, None]
    return least[..., None] * lift - tilting, most[..., None] * lift + tilting


def _squared_speeds(vehicle: Vehicle, state: FlatState | FlatStateBatch) -> tuple[Vehicle, list[Float[AnyArray, "*b"]]]:
    """The vehicle, cast, and the squares of what its rotors turn at [(rad/s)^2], negative where one pulls down."""
    state = jax.tree.map(jnp.asarray, state)
    vehicle = vehicle.astype(state.derivatives.dtype)
    demand = demand_of(vehicle, state)
    return vehicle, squared_rotor_speeds(vehicle, demand.moment, vehicle.mass * demand.specific_thrust)


def _worst(rotors: Iterable[Float[AnyArray, "*b"]], least: Scalar, most: Scalar) -> Float[Array, "*b"]:
    """The least distance of a rotor from its nearest limit."""
    return functools.reduce(jnp.minimum, [jnp.minimum(rotor - least, most - rotor) for rotor in rotors])


def _middles(spline: PiecewisePolynomial, pieces: int) -> FlatState:
    """The flat states in the middles of the pieces (m, p); padding repeats the end."""
    starts = jnp.cumsum(spline.durations) - spline.durations
    shares = jnp.asarray((np.arange(pieces) + 0.5) / pieces, spline.durations.dtype)
    return spline.state(starts[:, None] + spline.durations[:, None] * shares[None])


_decided = jax.jit(feasibility, static_argnums=2)
