"""Knot selection: few waypoints that carry the shape of a path (paper, Sec. III-A; Pagani and Scott 2018).

Along a path q_0 .. q_M the parameter k = (k_d + k_c) / 2 adds up arc length k_d [m] and turning k_c [rad]; the
waypoints lie uniformly in k, so corners get more of them. Their number is ceil(max(k_d / k_d,min, k_c / k_c,min)),
at least 2 and at most ``MAX_WAYPOINTS``, start and goal included.
"""

import dataclasses
import math
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxplan.errors import InputError
from jaxplan.numerics import safe_divide, safe_norm

MAX_WAYPOINTS = 14
"""Longest sequence the planner handles (paper, Sec. III-A)."""


@dataclasses.dataclass(frozen=True)
class KnotConfig:
    """How densely waypoints are set."""

    distance_per_knot: float = 2.0
    """k_d,min [m]; the paper gives no value."""
    turning_per_knot: float = math.pi / 3.0
    """k_c,min [rad]; the paper gives no value."""

    def __post_init__(self) -> None:
        for name in ("distance_per_knot", "turning_per_knot"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"knots: {name} is {getattr(self, name)}, want a positive number")


class Knots(NamedTuple):
    """Waypoints of one path, padded by repeating the goal."""

    waypoints: Float[Array, "14 3"]
    count: Int[Array, ""]
    """Waypoints in use, 2 to 14."""


def select_knots(path: Float[Array, "l 3"], config: KnotConfig) -> Knots:
    """Waypoints along one ``path`` [m] whose unused points repeat its last one."""
    edges = jnp.diff(path, axis=0)
    lengths = safe_norm(edges)
    turning = _turning(edges, lengths)
    distance = _cumulate(lengths)
    curvature = _cumulate(jnp.concatenate([jnp.zeros_like(turning[:1]), turning]))
    wanted = jnp.maximum(distance[-1] / config.distance_per_knot, curvature[-1] / config.turning_per_knot)
    count = jnp.clip(jnp.ceil(wanted), 2, MAX_WAYPOINTS).astype(jnp.int32)
    parameter = 0.5 * (distance + curvature)
    share = jnp.minimum(jnp.arange(MAX_WAYPOINTS) / (count - 1), 1.0)
    return Knots(interpolate_along(path, parameter, share * parameter[-1]), count)


def resample(path: Float[Array, "l 3"], samples: int) -> Float[Array, "s 3"]:
    """``samples`` points at uniform arc length along one path."""
    distance = _cumulate(safe_norm(jnp.diff(path, axis=0)))
    return interpolate_along(path, distance, jnp.linspace(0.0, 1.0, samples) * distance[-1])


def interpolate_along(
    path: Float[Array, "l 3"], parameter: Float[Array, "l"], at: Float[Array, "n"]
) -> Float[Array, "n 3"]:
    """Points of a polyline where its non-decreasing ``parameter`` takes the values ``at``."""
    right = jnp.clip(jnp.sum(at[:, None] > parameter, axis=1), 1, len(parameter) - 1)
    low, high = parameter[right - 1], parameter[right]
    weight = jnp.clip(safe_divide(at - low, high - low), 0.0, 1.0)[:, None]
    return path[right - 1] * (1.0 - weight) + path[right] * weight


def _turning(edges: Float[Array, "e 3"], lengths: Float[Array, "e"]) -> Float[Array, "e-1"]:
    """Curvature of the circle through three consecutive points times half its two edges [rad]; 0 on a line.

    The radius R of that circle obeys 1/R = 2 |u x v| / (|u| |v| |u + v|) for the edges u and v (Menger).
    """
    u, v = edges[:-1], edges[1:]
    doubled_area = safe_norm(jnp.cross(u, v))
    inverse_radius = safe_divide(2.0 * doubled_area, lengths[:-1] * lengths[1:] * safe_norm(u + v))
    return inverse_radius * 0.5 * (lengths[:-1] + lengths[1:])


def _cumulate(values: Float[Array, "n"]) -> Float[Array, "n+1"]:
    return jnp.concatenate([jnp.zeros_like(values[:1]), jnp.cumsum(values)])
