"""Where plans come to rest behind their goals: the first clear one of ``jaxplan.search.stops``' points, traced."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplan.device.paths import sees
from jaxplan.device.room import Room
from jaxplan.numerics import safe_norm
from jaxplan.search.stops import OPTIONS


def stop_points(room: Room, points: Float[Array, "k l 3"]) -> Float[Array, "k 3"]:
    """Behind each way's goal the best point to stop at that is seen from there, or the goal itself [m, world].

    What is best is in ``jaxplan.search.stops``: as straight on and as far as there is room for.
    """
    goals, before = points[:, -1], _before_the_goal(points)
    along = goals - before
    length = safe_norm(along)
    directions = along / jnp.maximum(length, 1e-9)[:, None]
    distance, turn, rise = (jnp.asarray(column, points.dtype) for column in OPTIONS.T)
    cos, sin, (x, y, z) = jnp.cos(turn), jnp.sin(turn), directions.T
    ahead = jnp.stack(
        [
            x[:, None] * cos[None] - y[:, None] * sin[None],
            x[:, None] * sin[None] + y[:, None] * cos[None],
            z[:, None] * rise[None],
        ],
        axis=-1,
    )
    ahead = ahead * (distance[None] / jnp.maximum(safe_norm(ahead), 1e-3))[..., None]
    options = goals[:, None] + ahead
    from_goal = jnp.broadcast_to(goals[:, None], options.shape)
    clear = sees(room, from_goal.reshape(-1, 3), options.reshape(-1, 3), strictly=True).reshape(options.shape[:2])
    first = jnp.argmax(clear, axis=1)
    usable = jnp.any(clear, axis=1) & (length > 1e-6)
    chosen = jnp.take_along_axis(options, first[:, None, None], axis=1)[:, 0]
    return jnp.where(usable[:, None], chosen, goals)


def _before_the_goal(points: Float[Array, "k l 3"]) -> Float[Array, "k 3"]:
    """The last corner of each way that is not its goal; its start where all are."""
    apart = safe_norm(points - points[:, -1:]) > 1e-6
    corners = jnp.arange(points.shape[1])
    last = jnp.max(jnp.where(apart, corners[None], 0), axis=1)
    return jnp.take_along_axis(points, last[:, None, None], axis=1)[:, 0]
