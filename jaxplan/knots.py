"""Knot selection: few waypoints that carry the shape of a path (paper, Sec. III-A; Pagani and Scott 2018).

Along a path q_0 .. q_M the parameter k = (k_d + k_c) / 2 adds up arc length k_d [m] and turning k_c [rad]; the
waypoints lie uniformly in k, so corners get more of them. Their number is ceil(max(k_d / k_d,min, k_c / k_c,min)),
at least 2 and at most ``MAX_WAYPOINTS``, start and goal included. A path that wants more is cut to the part that
``MAX_WAYPOINTS`` can carry.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplan.arrays import AnyArray
from jaxplan.numerics import safe_divide, safe_norm
from jaxplan.records import record
from jaxplan.validation import require_positive, require_within

MAX_WAYPOINTS = 14
"""Longest sequence the planner handles (paper, Sec. III-A)."""


@dataclasses.dataclass(frozen=True)
class KnotConfig:
    """How densely waypoints are set."""

    distance_per_knot: float = 2.0
    """k_d,min [m]; the paper gives no value (docs/decisions/0005-knots.md)."""
    turning_per_knot: float = 0.25
    """k_c,min [rad]; the paper gives no value."""
    samples: int = 64
    """Points at uniform arc length that stand for a path, here and in the deviation test."""

    def __post_init__(self) -> None:
        require_positive("knots", self, "distance_per_knot", "turning_per_knot")
        require_within("knots", self, 8, 4096, "samples")


@record
class Knots:
    """Waypoints of paths, padded by repeating the goal."""

    waypoints: Float[Array, "*batch 14 3"]
    """Positions [m, world]."""
    count: Int[Array, "*batch"]
    """Waypoints in use, 2 to 14."""


@record
class SelectedRoutes:
    """k paths, or as much of each as the waypoints can carry."""

    knots: Knots
    """With a leading axis k."""
    samples: Float[Array, "k s 3"]
    """The same parts of the paths at uniform arc length [m, world]."""
    whole: Bool[Array, "k"]
    """False where only a beginning of the path is left."""
    meet: Int[Array, "k"]
    """Number of the waypoint at the goal: the last one but where there is a stop point behind it."""


def select_routes(
    paths: Float[AnyArray, "k l 3"],
    config: KnotConfig,
    shares: Float[AnyArray, "k"] | float = 1.0,
    stops: Float[AnyArray, "k 3"] | None = None,
) -> SelectedRoutes:
    """Waypoints and samples of the first ``shares`` of searched paths [m] whose unused points repeat their last one.

    Args:
        paths: k paths of up to l points.
        config: how densely waypoints are set.
        shares: of each path.
        stops: where each sequence goes on to behind its goal [m]; nowhere where that is the goal. A path of which only
            a beginning is left goes nowhere either.
    """
    sample = jax.vmap(lambda path, share: resample(path, config.samples, share))
    whole = sample(paths, jnp.ones(len(paths), paths.dtype))
    along = jax.vmap(_parameters)(whole)
    most = MAX_WAYPOINTS if stops is None else MAX_WAYPOINTS - 1
    shares = jnp.minimum(most / jax.vmap(lambda one: _wanted(one, config))(along), shares)

    def cut() -> tuple[Knots, Array]:
        samples = sample(paths, shares)
        return jax.vmap(lambda path: _place(path, _parameters(path), config, most))(samples), samples

    def keep() -> tuple[Knots, Array]:
        return jax.vmap(lambda path, along: _place(path, along, config, most))(whole, along), whole

    knots, samples = jax.lax.cond(jnp.any(shares < 1.0), cut, keep)
    meet = knots.count - 1
    if stops is not None:
        passing = (shares >= 1.0) & jnp.any(jnp.asarray(stops) != paths[:, -1], axis=1)
        longer = sample(
            jnp.concatenate([paths, jnp.asarray(stops)[:, None]], axis=1), jnp.ones(len(paths), paths.dtype)
        )
        samples = jnp.where(passing[:, None, None], longer, samples)
        knots = _with_stops(knots, jnp.asarray(stops), passing)
    return SelectedRoutes(knots=knots, samples=samples, whole=shares >= 1.0, meet=meet)


def select_knots(path: Float[AnyArray, "l 3"], config: KnotConfig) -> Knots:
    """At most ``MAX_WAYPOINTS`` waypoints along one whole path [m] whose unused points repeat their last one."""
    return _place(path, _parameters(path), config, MAX_WAYPOINTS)


def resample(
    path: Float[AnyArray, "l 3"], samples: int, share: Float[AnyArray, ""] | float = 1.0
) -> Float[Array, "{samples} 3"]:
    """``samples`` points at uniform arc length along the first ``share`` of one path's length."""
    path = jnp.asarray(path)
    distance = _cumulate(safe_norm(jnp.diff(path, axis=0)))
    return interpolate_along(path, distance, jnp.linspace(0.0, 1.0, samples, dtype=path.dtype) * share * distance[-1])


def interpolate_along(
    path: Float[Array, "l 3"], parameter: Float[Array, "l"], at: Float[Array, "n"]
) -> Float[Array, "n 3"]:
    """Points of a polyline where its non-decreasing ``parameter`` takes the values ``at``."""
    right = jnp.clip(jnp.sum(parameter[:, None] < at[None], axis=0, dtype=jnp.int32), 1, len(parameter) - 1)
    low, high = parameter[right - 1], parameter[right]
    weight = jnp.clip(safe_divide(at - low, high - low), 0.0, 1.0)[:, None]
    return path[right - 1] * (1.0 - weight) + path[right] * weight


class _Along(NamedTuple):
    """What has added up at every point of a path."""

    distance: Float[Array, "l"]
    """k_d [m]."""
    turning: Float[Array, "l"]
    """k_c [rad]."""


def _place(path: Float[AnyArray, "l 3"], along: _Along, config: KnotConfig, most: int) -> Knots:
    """The waypoints, uniform in k, at most so many."""
    count = jnp.clip(jnp.ceil(_wanted(along, config)), 2, most)
    parameter = 0.5 * (along.distance + along.turning)
    share = jnp.minimum(jnp.arange(MAX_WAYPOINTS, dtype=count.dtype) / (count - 1.0), 1.0)
    waypoints = interpolate_along(jnp.asarray(path), parameter, share * parameter[-1])
    return Knots(waypoints=waypoints, count=count.astype(jnp.int32))


def _with_stops(knots: Knots, stops: Float[Array, "k 3"], passing: Bool[Array, "k"]) -> Knots:
    """One more waypoint behind the goals of the sequences that pass them."""
    behind = jnp.arange(MAX_WAYPOINTS, dtype=knots.count.dtype)[None] >= knots.count[:, None]
    moved = (behind & passing[:, None])[..., None]
    waypoints = jnp.where(moved, stops[:, None], knots.waypoints)
    return Knots(waypoints=waypoints, count=knots.count + passing.astype(knots.count.dtype))


def _wanted(along: _Along, config: KnotConfig) -> Float[Array, ""]:
    """max(k_d / k_d,min, k_c / k_c,min), before rounding and the upper limit; at least 2."""
    distance, turning = along.distance[-1] / config.distance_per_knot, along.turning[-1] / config.turning_per_knot
    return jnp.maximum(jnp.maximum(distance, turning), 2.0)


def _parameters(path: Float[AnyArray, "l 3"]) -> _Along:
    """k_d and k_c at every point of a path [m]."""
    edges = jnp.diff(path, axis=0)
    lengths = safe_norm(edges)
    turning = _turning(edges, lengths)
    return _Along(_cumulate(lengths), _cumulate(jnp.concatenate([jnp.zeros_like(lengths[:1]), turning])))


def _turning(edges: Float[Array, "e 3"], lengths: Float[Array, "e"]) -> Float[Array, "e-1"]:
    """Curvature of the circle through three consecutive points times half its two edges [rad]; 0 on a line.

    The radius R of that circle obeys 1/R = 2 |u x v| / (|u| |v| |u + v|) for the edges u and v (Menger).
    """
    u, v = edges[:-1], edges[1:]
    doubled_area = safe_norm(jnp.cross(u, v))
    inverse_radius = safe_divide(2.0 * doubled_area, lengths[:-1] * lengths[1:] * safe_norm(u + v))
    return inverse_radius * 0.5 * (lengths[:-1] + lengths[1:])


def _cumulate(values: Float[Array, "n"]) -> Float[Array, "n+1"]:
    """0 and the partial sums, as a product with a triangle of ones: several times as fast as XLA's scans."""
    triangle = jnp.triu(jnp.ones((len(values), len(values) + 1), values.dtype), 1)
    return jnp.dot(values, triangle, precision="highest")
