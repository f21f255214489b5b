"""Times from a speed profile: as fast along the waypoints as one acceleration allows, from the speed that there is.

At a bend the speed is what the acceleration holds on the arc that fits between the middles of the two segments; at the
end it is 0. In terms of the stopping distance s = v^2 / (2 a) both limits are linear in the way, s_j <= s_i + |j - i|,
so that the forward and the backward pass of path-velocity decomposition (Bobrow, Dubowsky and Gibson 1985) are two
cumulative minima.

Scaled by alpha as any policy, it is the profile of the acceleration a / alpha^2: the start keeps its own speed.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxplan.arrays import AnyArray
from jaxplan.errors import InputError
from jaxplan.numerics import safe_divide, safe_norm
from jaxplan.policy.protocol import Policy
from jaxplan.spline import FlatStateBatch

SHORTEST_SEGMENT = 1e-3
"""Length [m] that coincident waypoints count as, so that no duration is 0 (arbitrary)."""
LEAST_SPEED = 0.2
"""Speed [m/s] along the first segment that a start at rest, or away from it, counts as (arbitrary)."""


class _Course(NamedTuple):
    """What the waypoints fix."""

    lengths: Float[Array, "m k"]
    """Of the segments [m]; 0 behind the last one."""
    first: Float[Array, "3 k"]
    """Direction of the first segment."""
    limits: Float[Array, "n k"]
    """Largest stopping distance [m] at each waypoint: that of its bend, and what is left of the way."""


def speed_profile_policy(acceleration: float = 10.0) -> Policy:
    """Allocate the least times at which no waypoint asks for more than ``acceleration`` [m/s^2], for any vehicle.

    The default is about gravity, of which a quadrotor with twice the thrust of its weight has as much to spare. Raises
    InputError for an acceleration that is not positive.
    """
    if not (acceleration > 0.0 and acceleration < float("inf")):
        raise InputError(f"policy: the acceleration is {acceleration} m/s^2, want a positive number")

    def encode(waypoints: Float[AnyArray, "n 3 k"], count: Int[AnyArray, "k"]) -> _Course:
        steps = jnp.diff(jnp.asarray(waypoints), axis=0)
        segments = jnp.asarray(count) - 1
        real = jnp.arange(len(steps), dtype=segments.dtype)[:, None] < segments[None]
        lengths = jnp.where(real, jnp.maximum(safe_norm(steps, axis=1), SHORTEST_SEGMENT), 0.0)
        directions = safe_divide(steps, lengths[:, None])
        end = jnp.zeros_like(lengths[:1])
        bends = jnp.where(real[1:], 0.5 * _radii(lengths, directions), 0.0)
        limits = jnp.concatenate([end + jnp.inf, bends, end])
        return _Course(lengths, directions[0], _ahead(limits[::-1], lengths[::-1])[::-1])

    def decode(course: _Course, initial: FlatStateBatch) -> Float[Array, "m k"]:
        along = jnp.maximum(jnp.sum(initial.vel * course.first, axis=0), LEAST_SPEED)
        start = along**2 / (2.0 * acceleration)
        stopping = _ahead(jnp.concatenate([start[None], course.limits[1:]]), course.lengths)
        before, after = stopping[:-1], stopping[1:]
        peak = 0.5 * (course.lengths + before + after)
        ends = jnp.sqrt(before) + jnp.sqrt(after)
        # on a first segment too short to brake: evenly from the speed before it to the one behind it
        brakes = peak >= jnp.maximum(before, after)
        times = jnp.where(brakes, 2.0 * jnp.sqrt(peak) - ends, safe_divide(course.lengths, ends))
        return jnp.sqrt(2.0 / acceleration) * times

    return Policy("profile", encode, decode)


def _radii(lengths: Float[Array, "m k"], directions: Float[Array, "m 3 k"]) -> Float[Array, "m-1 k"]:
    """Radius [m] of the arc at each bend that touches both segments, the shorter one in its middle."""
    cosine = jnp.clip(jnp.sum(directions[1:] * directions[:-1], axis=1), -1.0, 1.0)
    tangent_of_half = jnp.sqrt((1.0 - cosine) / jnp.maximum(1.0 + cosine, 1e-9))
    return 0.5 * jnp.minimum(lengths[1:], lengths[:-1]) / jnp.maximum(tangent_of_half, 1e-6)


def _ahead(limits: Float[Array, "n k"], lengths: Float[Array, "m k"]) -> Float[Array, "n k"]:
    """The largest numbers within ``limits`` that grow by no more than the lengths between them."""
    way = jnp.concatenate([jnp.zeros_like(lengths[:1]), jnp.cumsum(lengths, axis=0)])
    return jnp.maximum(way + jax.lax.cummin(limits - way, axis=0), 0.0)
