"""What the network sees, in a frame of the sequence's own, and what its outputs mean (paper, Sec. II-C).

Positions enter as steps between waypoints, turned about the vertical so that the goal lies ahead (x): a policy then
serves every room, place and heading alike. Speeds and lengths are compressed logarithmically, which never saturates:
the arrival matching speeds the initial state up by alpha and must be seen to do so.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplan.arrays import AnyArray
from jaxplan.numerics import safe_divide, safe_norm
from jaxplan.spline import FlatStateBatch
from jaxplan.vehicle.thrust import LEAST_THRUST, STANDARD_GRAVITY, log_thrust

MEAN_SPEED = 4.0
"""Speed [m/s] that turns a path's length into its nominal time (the predecessors' value)."""
SHORTEST = 0.05
"""Length [m] below which steps count as equally short (arbitrary)."""
UNITS = (2.0, 4.0, 12.0, 50.0)
"""m/s, m/s^2, m/s^3, m/s^4 around which velocity to snap go over from linear to logarithmic (arbitrary)."""
SEGMENT_FEATURES = 10
STATE_FEATURES = 38


class Frame(NamedTuple):
    """Where a sequence lies and how long it is."""

    cos: Float[Array, "k"]
    sin: Float[Array, "k"]
    nominal: Float[Array, "k"]
    """(path length / mean speed) / segments [s]: the unit of the network's durations."""
    first: Float[Array, "3 k"]
    """Unit vector of the first step, in the frame."""
    second: Float[Array, "3 k"]
    """Unit vector of the second step, 0 where there is none."""
    step: Float[Array, "k"]
    """Length of the first step [m]."""
    length: Float[Array, "k"]
    """Length of the path [m]."""


def sequence_frame(waypoints: Float[AnyArray, "n 3 k"], count: Float[AnyArray, "k"]) -> Frame:
    """The frame of waypoints [m, world] of which ``count`` are in use; the goal repeats behind them.

    ``count`` has the dtype of the waypoints, which is that of all features.
    """
    ahead = waypoints[-1] - waypoints[0]
    span = safe_norm(ahead[:2], axis=0)
    cos = jnp.where(span > 0.0, safe_divide(ahead[0], span), 1.0)
    sin = safe_divide(ahead[1], span)
    steps = jnp.diff(waypoints, axis=0)
    lengths = safe_norm(steps, axis=1)
    length = jnp.maximum(jnp.sum(lengths, axis=0), SHORTEST)
    return Frame(
        cos=cos,
        sin=sin,
        nominal=length / MEAN_SPEED / jnp.maximum(count - 1, 1),
        first=safe_divide(turned(steps[0], cos, sin), lengths[:1]),
        second=safe_divide(turned(steps[1], cos, sin), lengths[1:2]) if len(steps) > 1 else jnp.zeros_like(steps[0]),
        step=lengths[0],
        length=length,
    )


def turned(
    vectors: Float[AnyArray, "*a 3 k"], cos: Float[Array, "k"], sin: Float[Array, "k"]
) -> Float[Array, "*a 3 k"]:
    """Vectors of the world in the sequence's frame."""
    x, y, z = (vectors[..., axis, :] for axis in range(3))
    cos, sin = (jnp.expand_dims(part, tuple(range(x.ndim - 1))) for part in (cos, sin))
    return jnp.stack([cos * x + sin * y, cos * y - sin * x, z], axis=-2)


def segment_features(
    waypoints: Float[AnyArray, "n 3 k"], count: Float[AnyArray, "k"], frame: Frame
) -> tuple[Float[Array, "m f k"], Bool[Array, "m k"]]:
    """What the encoder sees of each segment of waypoints [m, world], and which segments are real."""
    steps = turned(jnp.diff(waypoints, axis=0), frame.cos, frame.sin)
    lengths = safe_norm(steps, axis=1)
    directions = safe_divide(steps, lengths[:, None])
    index = jnp.arange(len(steps), dtype=lengths.dtype)[:, None]
    real = index < (count - 1)[None]
    alike = jnp.where(real[1:], jnp.sum(directions[:-1] * directions[1:], axis=1), 1.0)
    edge = jnp.ones_like(alike[:1])
    left = 1.0 - safe_divide(jnp.cumsum(lengths, axis=0), frame.length[None])
    features = [
        *(directions[:, axis] for axis in range(3)),
        jnp.log(lengths + SHORTEST),
        jnp.log(safe_divide(lengths, (MEAN_SPEED * frame.nominal)[None]) + SHORTEST),
        jnp.concatenate([edge, alike]),
        jnp.concatenate([alike, edge]),
        left,
        (index == (count - 2)[None]).astype(lengths.dtype),
        jnp.broadcast_to((0.2 * count)[None], lengths.shape),
    ]
    return jnp.where(real[:, None], jnp.stack(features, axis=1), 0.0), real


def state_features(initial: FlatStateBatch, frame: Frame) -> Float[Array, "f k"]:
    """What the decoder sees of the initial velocity to snap and of the yaw [SI, world].

    Besides the derivatives themselves, what they are along the first two steps, how far the vehicle needs to stop, and
    what thrust and turning they demand: products that a small network would have to learn.
    """
    own = turned(initial.derivatives[1:], frame.cos, frame.sin)
    sizes = safe_norm(own, axis=1)
    units = jnp.asarray(UNITS, own.dtype)[:, None]
    compressed = jnp.arcsinh(sizes / units)
    vectors = safe_divide(own, sizes[:, None]) * compressed[:, None]
    along, beyond = (jnp.sum(own * step[None], axis=1) for step in (frame.first, frame.second))
    cos, sin = jnp.cos(initial.yaw[0]), jnp.sin(initial.yaw[0])
    facing = frame.cos * cos + frame.sin * sin, frame.cos * sin - frame.sin * cos
    scalars = [
        compressed[0],
        compressed[1],
        safe_divide(along[0], sizes[0]),
        jnp.arcsinh(sizes[0] ** 2 / (10.0 * frame.length)),
        jnp.log(frame.length),
        *facing,
        jnp.arcsinh(initial.yaw[1]),
        jnp.arcsinh(0.5 * initial.yaw[2]),
        jnp.arcsinh(sizes[0] ** 2 / (10.0 * frame.step + SHORTEST)),
        jnp.log(frame.step + SHORTEST),
        frame.first[0] * facing[0] + frame.first[1] * facing[1],
        frame.first[0] * facing[1] - frame.first[1] * facing[0],
        *_thrust_features(own),
    ]
    return jnp.concatenate(
        [vectors.reshape(12, -1), jnp.arcsinh(along / units), jnp.arcsinh(beyond / units), jnp.stack(scalars)]
    )


def _thrust_features(own: Float[Array, "4 3 k"]) -> list[Float[Array, "k"]]:
    """Size and tilt of the initial specific thrust, and how fast its size and direction change."""
    force = own[1].at[2].add(STANDARD_GRAVITY)
    thrust = safe_norm(force, axis=0)
    at_least = jnp.maximum(thrust, LEAST_THRUST)
    up = force / at_least[None]
    change, change_of_change = (jnp.sum(vector * up, axis=0) for vector in own[2:])
    turning = safe_norm(own[2] - change[None] * up, axis=0) / at_least
    twisting = safe_norm(own[3] - change_of_change[None] * up, axis=0) / at_least
    return [
        log_thrust(thrust),
        up[2],
        jnp.arcsinh(turning),
        jnp.arcsinh(0.1 * twisting),
        jnp.arcsinh(0.1 * change),
    ]
