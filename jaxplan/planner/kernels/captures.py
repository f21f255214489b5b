"""When futures are captured from ways, compiled (host): each is followed until then, and no farther."""

import functools
import math
from typing import Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxplan.batching import side_by_side
from jaxplan.planner.kernels.compiled import entry_point, inner, source_digest

SHARED = 1000
"""Goals from which on two cores share them (measured: of 400 asking the other one takes what it saves)."""


def spline_times(
    times: Float[np.ndarray, "u"],
    motions: Float[np.ndarray, "u n 3"],
    weights: Float[np.ndarray, "n"],
    reach: Float[np.ndarray, "u"],
    durations: Float[np.ndarray, "k m"],
    position: Float[np.ndarray, "k m q 3"],
    since: float,
    return_speed: float,
) -> Float[np.ndarray, "k"]:
    """Expected seconds until capture along each of k trajectories, at rest where they end.

    Args:
        times: even instants [s].
        motions: of n futures [m, world].
        weights: of the futures; those without are not looked at.
        reach: how far from a way [m] a future is captured at each instant; not negative.
        durations: of the trajectories' segments [s]; 0 behind the last one.
        position: ascending coefficients in normalised time [m, world].
        since: when the trajectories begin to count [s of their own time].
        return_speed: at which what is missed at the end is counted [m/s].
    """
    some = np.flatnonzero(weights)
    futures = np.ascontiguousarray(np.moveaxis(np.asarray(motions, float)[:, some], 1, 0))
    expected, way = np.zeros(len(durations)), np.zeros((len(times), 3))
    shares = np.ascontiguousarray(weights[some], float)
    at, far, parts, terms = (np.array(numbers, float, order="C") for numbers in (times, reach, durations, position))
    _compiled()(at, futures, shares, far, parts, terms, (float(since), float(return_speed)), way, expected)
    return expected


def straight_times(
    times: Float[np.ndarray, "u"],
    motions: Float[np.ndarray, "u n 3"],
    weights: Float[np.ndarray, "n"],
    reach: Float[np.ndarray, "u"],
    start: Float[np.ndarray, "2 3"],
    goals: Float[np.ndarray, "k 3"],
    arrival: Float[np.ndarray, "k"],
    behind: float,
    return_speed: float,
) -> Float[np.ndarray, "k"]:
    """The same along flights straight to goals, at a constant acceleration each.

    Args:
        times, motions, weights, reach, return_speed: as of ``spline_times``.
        start: position [m, world] and velocity [m/s].
        goals: [m, world].
        arrival: when each is reached [s]; positive.
        behind: how long flights go on behind their goals [s].
    """
    some = np.flatnonzero(weights)
    futures = np.ascontiguousarray(np.moveaxis(np.asarray(motions, float)[:, some], 2, 1))
    expected, shares = np.zeros(len(goals)), np.ascontiguousarray(weights[some], float)
    at, far, begin, ends, when = (np.array(part, float, order="C") for part in (times, reach, start, goals, arrival))
    settings, compiled = (behind, float(return_speed)), _compiled_straight()

    def write(few: slice) -> None:
        scratch = np.zeros((len(times), 3)), np.zeros(len(some), np.int64), np.zeros((len(times), len(some)))
        compiled(at, futures, shares, far, begin, ends[few], when[few], settings, scratch, expected[few])

    if len(goals) < SHARED:
        write(slice(None))
    else:
        half = len(goals) // 2
        side_by_side(write, (slice(half), slice(half, None)))
    return expected


@runtime_checkable
class _Expected(Protocol):
    def __call__(
        self,
        times: np.ndarray,
        futures: np.ndarray,
        weights: np.ndarray,
        reach: np.ndarray,
        durations: np.ndarray,
        position: np.ndarray,
        settings: tuple[float, float],
        way: np.ndarray,
        expected: np.ndarray,
    ) -> None:
        """Adds to the expected times, which are zeros; ``way`` is overwritten."""


@functools.cache
def _compiled() -> _Expected:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(times, futures, weights, reach, durations, position, settings, way, expected):
        _ = version
        since, return_speed = settings
        for k in range(len(durations)):
            for u in range(len(times)):
                _write(durations[k], position[k], since + times[u], way[u])
            for n in range(len(futures)):
                expected[k] += weights[n] * _captured(times, futures[n], reach, way, return_speed)

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _write(durations, position, time, place):
    """Write where a trajectory is [m, world] at one of its times [s], at its ends before and behind."""
    begun, segment = 0.0, 0
    while segment + 1 < len(durations) and durations[segment + 1] > 0.0 and time >= begun + durations[segment]:
        begun += durations[segment]
        segment += 1
    duration = durations[segment] if durations[segment] > 0.0 else 1.0
    share = min(max((time - begun) / duration, 0.0), 1.0)
    terms = position[segment]
    for axis in range(3):
        found = terms[len(terms) - 1, axis]
        for power in range(len(terms) - 2, -1, -1):
            found = found * share + terms[power, axis]
        place[axis] = found


@runtime_checkable
class _Straight(Protocol):
    def __call__(
        self,
        times: np.ndarray,
        futures: np.ndarray,
        weights: np.ndarray,
        reach: np.ndarray,
        start: np.ndarray,
        goals: np.ndarray,
        arrival: np.ndarray,
        settings: tuple[float, float],
        scratch: tuple[np.ndarray, np.ndarray, np.ndarray],
        expected: np.ndarray,
    ) -> None:
        """Write the expected times; the futures are (u, 3, n). ``scratch`` is overwritten."""


@functools.cache
def _compiled_straight() -> _Straight:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(times, futures, weights, reach, start, goals, arrival, settings, scratch, expected):
        _ = version
        behind, return_speed = settings
        way, first, apart = scratch
        for k in range(len(goals)):
            for u in range(len(times)):
                since = min(times[u], arrival[k] + behind)
                share = since / arrival[k]
                for axis in range(3):
                    missed = goals[k, axis] - start[0, axis] - start[1, axis] * arrival[k]
                    way[u, axis] = start[0, axis] + since * start[1, axis] + share * share * missed
            for u in range(len(way)):
                _write_squared(futures[u], way[u], apart[u])
            for n in range(len(first)):
                first[n] = len(way)
            for u in range(len(way) - 1, -1, -1):
                _mark_within(apart[u], reach[u] * reach[u], u, first)
            for n in range(len(weights)):
                before, there = apart[max(first[n] - 1, 0), n], apart[min(first[n], len(way) - 1), n]
                expected[k] += weights[n] * _captured_at(times, reach, first[n], before, there, return_speed)

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _write_squared(futures, place, apart):
    """Write how far all futures are from a place, squared [m^2]: many at a time."""
    x, y, z = place[0], place[1], place[2]
    along, across, up = futures[0], futures[1], futures[2]
    for n in range(len(apart)):
        a, b, c = along[n] - x, across[n] - y, up[n] - z
        apart[n] = a * a + b * b + c * c


@inner
@no_type_check
def _mark_within(apart, far, u, first):
    """Write the instant ``u`` for all futures that are no farther then: many at a time."""
    for n in range(len(first)):
        if apart[n] <= far:  # a conditional expression is not made one for many at a time
            first[n] = u


@inner
@no_type_check
def _captured(times, future, reach, way, return_speed):
    """When one future is captured [s]."""
    before = there = 0.0
    for u in range(len(times)):
        there = _squared(future, way, u)
        if there <= reach[u] * reach[u]:
            return _captured_at(times, reach, u, before, there, return_speed)
        before = there
    return _captured_at(times, reach, len(times), before, there, return_speed)


@inner
@no_type_check
def _captured_at(times, reach, first, before, there, return_speed):
    """When one future is captured [s]: between the ``first`` instant within reach and the one before, or behind all.

    It is ``there`` away at the first, squared [m^2], and ``before`` at the one before it.
    """
    last = len(times) - 1
    if first > last:
        return times[last] + (math.sqrt(before) - reach[last]) / return_speed
    if first == 0:
        return max(times[0], 0.0)
    missed, within = math.sqrt(before) - reach[first - 1], math.sqrt(there) - reach[first]
    share = missed / max(missed - within, 1e-9)
    return max(times[first] - (times[1] - times[0]) * (1.0 - share), 0.0)


@inner
@no_type_check
def _squared(future, way, u):
    """Distance at one instant, squared [m^2]."""
    x, y, z = future[u, 0] - way[u, 0], future[u, 1] - way[u, 1], future[u, 2] - way[u, 2]
    return x * x + y * y + z * z
