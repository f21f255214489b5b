"""Least times by a profile of speeds along waypoints, compiled (host): ``jaxplan.policy.speed_profile``."""

import functools
import math
from typing import Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float, Int, Int32

from jaxplan.planner.kernels.compiled import entry_point, inner, source_digest
from jaxplan.policy.speed_profile import LEAST_SPEED, SHORTEST_SEGMENT

_BEND, _TURNED = 1e-9, 1e-6
"""Least of what the halved turn at a bend is told by, as of ``speed_profile``."""


def least_times(
    waypoints: Float[np.ndarray, "n 3 k"],
    count: Int[np.ndarray, "k"],
    meet: Int[np.ndarray, "k"],
    velocity: Float[np.ndarray, "3"],
    alpha: float,
    acceleration: float,
) -> Float[np.ndarray, "k"]:
    """Seconds until the waypoints ``meet`` by a profile of speeds, slowed by ``alpha``.

    Args:
        waypoints: of each sequence [m, world].
        count: how many there are of each.
        meet: numbers of the waypoints whose times are asked for.
        velocity: at the start [m/s].
        alpha: the profile is one of the acceleration over its square.
        acceleration: of the profile [m/s^2].
    """
    found = np.zeros(waypoints.shape[-1])
    points, begin = np.array(waypoints, float, order="C"), alpha * np.asarray(velocity, float)
    limits = np.zeros(len(points)), np.zeros(len(points))
    used, until = (np.array(numbers, np.int32) for numbers in (count, meet))
    _compiled()(points, used, until, begin, acceleration, limits, found)
    found *= alpha
    return found


@runtime_checkable
class _Times(Protocol):
    def __call__(
        self,
        waypoints: Float[np.ndarray, "n 3 k"],
        count: Int32[np.ndarray, "k"],
        meet: Int32[np.ndarray, "k"],
        velocity: Float[np.ndarray, "3"],
        acceleration: float,
        scratch: tuple,
        found: Float[np.ndarray, "k"],
    ) -> None:
        """Write ``found``; ``scratch`` is overwritten."""


@functools.cache
def _compiled() -> _Times:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(waypoints, count, meet, velocity, acceleration, scratch, found):
        _ = version
        lengths, limits = scratch
        for k in range(len(found)):
            along = _course(waypoints, k, count[k] - 1, velocity, lengths, limits)
            along = max(along, LEAST_SPEED)
            total, before = 0.0, along * along / (2.0 * acceleration)
            for j in range(meet[k]):
                after = max(min(limits[j + 1], before + lengths[j]), 0.0)
                total += _time(lengths[j], before, after)
                before = after
            found[k] = math.sqrt(2.0 / acceleration) * total

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _course(waypoints, k, segments, velocity, lengths, limits):
    """Write lengths and largest stopping distances [m] of a sequence; the speed [m/s] along its first segment."""
    along, u, v, w = 0.0, 0.0, 0.0, 0.0
    for j in range(segments):
        x = waypoints[j + 1, 0, k] - waypoints[j, 0, k]
        y = waypoints[j + 1, 1, k] - waypoints[j, 1, k]
        z = waypoints[j + 1, 2, k] - waypoints[j, 2, k]
        length = max(math.sqrt(x * x + y * y + z * z), SHORTEST_SEGMENT)
        x, y, z, lengths[j] = x / length, y / length, z / length, length
        if j == 0:
            along = velocity[0] * x + velocity[1] * y + velocity[2] * z
        else:
            cosine = min(max(x * u + y * v + z * w, -1.0), 1.0)
            half = math.sqrt((1.0 - cosine) / max(1.0 + cosine, _BEND))
            limits[j] = 0.25 * min(length, lengths[j - 1]) / max(half, _TURNED)
        u, v, w = x, y, z
    limits[segments] = 0.0
    for j in range(segments - 1, 0, -1):
        limits[j] = max(min(limits[j], limits[j + 1] + lengths[j]), 0.0)
    return along


@inner
@no_type_check
def _time(length, before, after):
    """Of a segment between two stopping distances [m], in units of the root of half its acceleration."""
    peak, ends = 0.5 * (length + before + after), math.sqrt(before) + math.sqrt(after)
    if peak >= max(before, after):
        return 2.0 * math.sqrt(peak) - ends
    return length / ends
