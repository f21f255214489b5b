"""Times by a profile of speeds that arrive when they should, one sequence after another, compiled (host).

The profile is that of ``jaxplan.policy.speed_profile``, the search for the scale factor that of ``jaxplan.arrival``.
"""

import functools
import math
from typing import Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float, Int, Int32

from jaxplan.arrival import PATIENCE, SLOPES, Arrival, ArrivalConfig, first_slope
from jaxplan.planner.kernels.compiled import entry_point, inner, source_digest
from jaxplan.policy.speed_profile import LEAST_SPEED, SHORTEST_SEGMENT
from jaxplan.status import Reason

_BEND, _TURNED = 1e-9, 1e-6
"""Least of what the halved turn at a bend is told by, as of ``speed_profile``."""
_EARLY, _ASTRAY = int(Reason.ALPHA_LT_1), int(Reason.ALPHA_NOT_CONVERGED)
_MOST_STRETCHED = 10
LEAST_SLOPE, MOST_SLOPE = SLOPES


def profile_arrival(
    waypoints: Float[np.ndarray, "n 3 k"],
    count: Int[np.ndarray, "k"],
    meet: Int[np.ndarray, "k"],
    velocity: Float[np.ndarray, "3"],
    arrival_times: Float[np.ndarray, "k"],
    least_alpha: Float[np.ndarray, "k"],
    acceleration: float,
    config: ArrivalConfig,
) -> Arrival:
    """Durations by a profile of speeds, slowed until each sequence is at its goal in time.

    Args:
        waypoints: of each sequence [m, world].
        count: how many there are of each.
        meet: numbers of the waypoints at the goals.
        velocity: at the start [m/s].
        arrival_times: when goals are to be reached [s]; for 0 s there are durations at the least scale factors only.
        least_alpha: smallest scale factor of each that is looked at.
        acceleration: of the profile [m/s^2].
        config: when to stop.
    """
    segments, width = len(waypoints) - 1, len(count)
    arrival = Arrival(
        durations=np.zeros((segments, width)),
        alpha=np.zeros(width),
        least_durations=np.zeros((segments, width)),
        reasons=np.zeros(width, np.uint32),
        calls=np.zeros(width, np.int32),
    )
    points, begin = np.array(waypoints, float, order="C"), np.array(velocity, float)
    used, until = (np.array(numbers, np.int32) for numbers in (count, meet))
    wanted, least = (np.array(numbers, float) for numbers in (arrival_times, least_alpha))
    scratch = np.zeros(segments), np.zeros(segments + 1), np.zeros(segments)
    slope = first_slope(np.square(begin).sum())
    settings = float(acceleration), float(slope), float(config.tolerance), int(config.max_calls)
    _compiled()(points, used, until, begin, wanted, least, settings, scratch, tuple(arrival))
    return arrival


@runtime_checkable
class _Arrive(Protocol):
    def __call__(
        self,
        waypoints: Float[np.ndarray, "n 3 k"],
        count: Int32[np.ndarray, "k"],
        meet: Int32[np.ndarray, "k"],
        velocity: Float[np.ndarray, "3"],
        arrival_times: Float[np.ndarray, "k"],
        least_alpha: Float[np.ndarray, "k"],
        settings: tuple[float, float, float, int],
        scratch: tuple,
        arrival: tuple,
    ) -> None:
        """Write ``arrival``; ``scratch`` is overwritten."""


@functools.cache
def _compiled() -> _Arrive:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(waypoints, count, meet, velocity, arrival_times, least_alpha, settings, scratch, arrival):
        _ = version
        lengths, limits, durations = scratch
        acceleration, slope, tolerance, most = settings
        slowed, alpha, least, reasons, calls = arrival
        for k in range(len(count)):
            along = _course(waypoints, k, count[k] - 1, velocity, lengths, limits)
            sequence = (lengths, limits, durations, along, count[k] - 1, meet[k], acceleration)
            first, wanted = math.log(least_alpha[k]), math.log(arrival_times[k])
            early = _miss(sequence, first, wanted)
            for j in range(count[k] - 1):
                least[j, k] = durations[j] * math.exp(first)
            x, f, calls[k] = _matched(sequence, first, early, wanted, slope, tolerance, most)
            met = abs(f) <= tolerance
            exact = math.exp(x) * math.exp(-f) if met else 1.0
            for j in range(count[k] - 1):
                slowed[j, k] = durations[j] * exact
            if early <= tolerance:
                alpha[k] = math.exp(x)
                reasons[k] = 0 if met else _ASTRAY
            else:
                alpha[k], reasons[k] = math.exp(first - early), _EARLY

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _matched(sequence, first, early, wanted, slope, tolerance, most):
    """The logarithm of the scale factor, what is missed then, and calls; the durations of that are written."""
    x, f, calls = first, early, 1
    below, f_below, above, f_above = first, early, math.nan, math.nan
    while calls < most and f_below <= tolerance and f - f == 0.0 and abs(f) > tolerance:
        before, missed = x, f
        x = _proposed(x, f, slope, below, f_below, above, f_above, calls)
        f = _miss(sequence, x, wanted)
        if x != before:
            rise = (f - missed) / (x - before)
            if rise > LEAST_SLOPE / 10.0 and rise - rise == 0.0:
                slope = min(max(rise, LEAST_SLOPE), MOST_SLOPE)
        if f < 0.0:
            below, f_below = x, f
        else:
            above, f_above = x, f
        calls += 1
    return x, f, calls


@inner
@no_type_check
def _proposed(x, f, slope, below, f_below, above, f_above, calls):
    """The step along the slope; where that leads out of the bracket its secant, and its middle now and then."""
    if above - above != 0.0:  # there is no bracket yet
        stretch = 1.0 if calls <= PATIENCE else 2.0 ** min(calls - PATIENCE, _MOST_STRETCHED)
        return x - f / slope * stretch
    if calls > PATIENCE and calls % 3 == 2:
        return 0.5 * (below + above)
    step = x - f / slope
    if below < step < above:
        return step
    secant = below - f_below / ((f_above - f_below) / (above - below))
    return secant if below < secant < above else 0.5 * (below + above)


@inner
@no_type_check
def _miss(sequence, x, wanted):
    """By how much, in the logarithm, a sequence is late at its goal; writes its durations before it is slowed."""
    lengths, limits, durations, along, segments, meet, acceleration = sequence
    speed = max(math.exp(x) * along, LEAST_SPEED)
    total, before, unit = 0.0, speed * speed / (2.0 * acceleration), math.sqrt(2.0 / acceleration)
    for j in range(segments):
        after = max(min(limits[j + 1], before + lengths[j]), 0.0)
        durations[j] = unit * _time(lengths[j], before, after)
        if j < meet:
            total += durations[j]
        before = after
    return x + math.log(total) - wanted


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
