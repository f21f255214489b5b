"""Waypoints along searched paths, one path after another, compiled (host): ``jaxplan.knots.select_routes``."""

import functools
import math
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int32

from jaxplan.knots import MAX_WAYPOINTS, KnotConfig
from jaxplan.planner.kernels.compiled import entry_point, inner, source_digest


class Placed(NamedTuple):
    """Waypoints and samples of paths, or of as much of each as the waypoints can carry; batch axis last."""

    waypoints: Float[np.ndarray, "14 3 k"]
    """[m, world]; the goal is repeated behind the last one."""
    samples: Float[np.ndarray, "p 3 k"]
    """At equal steps of arc length [m, world]."""
    count: Int32[np.ndarray, "k"]  # type: ignore[assignment]  # of waypoints, not tuple.count
    """Waypoints in use."""
    meet: Int32[np.ndarray, "k"]
    """Number of the waypoint at the goal."""
    whole: Bool[np.ndarray, "k"]
    """False where only a beginning of the path is left."""


def place_waypoints(paths: Float[np.ndarray, "k l 3"], stops: Float[np.ndarray, "k 3"], config: KnotConfig) -> Placed:
    """Waypoints along paths [m], one for the way on to a stop [m] where that is not the path's last point."""
    width, length = paths.shape[:2]
    placed = Placed(
        waypoints=np.zeros((MAX_WAYPOINTS, 3, width)),
        samples=np.zeros((config.samples, 3, width)),
        count=np.zeros(width, np.int32),
        meet=np.zeros(width, np.int32),
        whole=np.zeros(width, bool),
    )
    points, distance = np.zeros((length + 1, 3)), np.zeros(length + 1)
    scratch = points, distance, np.zeros((config.samples, 3)), np.zeros(config.samples)
    settings = config.distance_per_knot, config.turning_per_knot, MAX_WAYPOINTS - 1
    corners, ends = np.array(paths, float, order="C"), np.array(stops, float, order="C")
    _compiled()(corners, ends, settings, scratch, tuple(placed))
    return placed


@runtime_checkable
class _Place(Protocol):
    def __call__(
        self,
        paths: Float[np.ndarray, "k l 3"],
        stops: Float[np.ndarray, "k 3"],
        settings: tuple,
        scratch: tuple,
        placed: tuple,
    ) -> None:
        """Write ``placed``; ``scratch`` is overwritten."""


@functools.cache
def _compiled() -> _Place:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(paths, stops, settings, scratch, placed):
        _ = version
        for k in range(len(paths)):
            _one(paths[k], stops[k], settings, scratch, placed, k)

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _one(path, stop, settings, scratch, placed, k):
    """Write the results of the path k."""
    points, distance, samples, parameter = scratch
    waypoints, sampled, count, meet, whole = placed
    last = len(path) - 1
    for i in range(len(path)):
        points[i, 0], points[i, 1], points[i, 2] = path[i, 0], path[i, 1], path[i, 2]
    _resample(points, distance, last, 1.0, samples)
    wanted = _wanted(samples, parameter, settings)
    share = min(settings[2] / wanted, 1.0)
    if share < 1.0:
        _resample(points, distance, last, share, samples)
        wanted = _wanted(samples, parameter, settings)
    knots = settings[2] if wanted > settings[2] else math.ceil(wanted)
    _waypoints(samples, parameter, knots, waypoints, k)
    passing = share >= 1.0 and (stop[0] != path[last, 0] or stop[1] != path[last, 1] or stop[2] != path[last, 2])
    if passing:
        for axis in range(3):
            points[last + 1, axis] = stop[axis]
            for j in range(knots, len(waypoints)):
                waypoints[j, axis, k] = stop[axis]
        _resample(points, distance, last + 1, 1.0, samples)
    for i in range(len(samples)):
        for axis in range(3):
            sampled[i, axis, k] = samples[i, axis]
    count[k], meet[k], whole[k] = knots + passing, knots - 1, share >= 1.0


@inner
@no_type_check
def _resample(points, distance, last, share, samples):
    """Write points at uniform arc length along a share of the way to the ``last`` of some points."""
    distance[0] = 0.0
    for i in range(last):
        u, v, w = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1], points[i + 1, 2] - points[i, 2]
        distance[i + 1] = distance[i] + math.sqrt(u * u + v * v + w * w)
    whole, right = share * distance[last], 1
    for i in range(len(samples)):
        at = i / (len(samples) - 1.0) * whole
        while right < last and distance[right] < at:
            right += 1
        weight = _weight(distance[right - 1], distance[right], at)
        for axis in range(3):
            samples[i, axis] = points[right - 1, axis] * (1.0 - weight) + points[right, axis] * weight


@inner
@no_type_check
def _weight(low, high, at):
    """Share of the way from one number to the next at which a number lies."""
    return min(max((at - low) / (high - low), 0.0), 1.0) if high != low else 0.0


@inner
@no_type_check
def _wanted(samples, parameter, settings):
    """How many waypoints points want, before rounding, at least 2; writes half of length and turning until each."""
    length, turning, before = 0.0, 0.0, 0.0
    u, v, w = 0.0, 0.0, 0.0
    parameter[0] = 0.0
    for i in range(1, len(samples)):
        x, y, z = (
            samples[i, 0] - samples[i - 1, 0],
            samples[i, 1] - samples[i - 1, 1],
            samples[i, 2] - samples[i - 1, 2],
        )
        own = math.sqrt(x * x + y * y + z * z)
        length += own
        if i > 1:
            turning += _turning(u, v, w, before, x, y, z, own)
        parameter[i] = 0.5 * (length + turning)
        u, v, w, before = x, y, z, own
    return max(max(length / settings[0], turning / settings[1]), 2.0)


@inner
@no_type_check
def _turning(u, v, w, before, x, y, z, own):
    """Curvature of the circle through the ends of two edges times half their lengths [rad] (Menger)."""
    a, b, c = v * z - w * y, w * x - u * z, u * y - v * x
    area = math.sqrt(a * a + b * b + c * c)
    far = math.sqrt((u + x) * (u + x) + (v + y) * (v + y) + (w + z) * (w + z))
    below = before * own * far
    return 2.0 * area / below * 0.5 * (before + own) if below != 0.0 else 0.0


@inner
@no_type_check
def _waypoints(samples, parameter, knots, waypoints, k):
    """Write so many waypoints of the path k, evenly in the parameter, and the last one behind them."""
    last = len(samples) - 1
    right = 1
    for j in range(len(waypoints)):
        at = min(j / (knots - 1.0), 1.0) * parameter[last]
        while right < last and parameter[right] < at:
            right += 1
        weight = _weight(parameter[right - 1], parameter[right], at)
        for axis in range(3):
            waypoints[j, axis, k] = samples[right - 1, axis] * (1.0 - weight) + samples[right, axis] * weight
