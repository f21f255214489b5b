"""Flights of the target from the filters' belief, compiled (host): ``imm_flights.filter_flights``."""

import functools
import math
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxplan.prediction.imm_motions import FADING, STRAIGHT, TURN, MotionConfig
from jaxplan.prediction.kernels.beliefs import (
    begin_belief,
    copy_belief,
    empty_belief,
    log_foreseen,
    log_sum,
    predict_belief,
    update_belief,
)
from jaxplan.prediction.kernels.compiled import entry_point, inner, source_digest
from jaxplan.prediction.kernels.motions import (
    expected_acceleration,
    expected_fading,
    motion_of,
    turn_motion,
    turn_rate,
)

COSINES = 3
"""Whose weights are the noise of a flight, for each axis."""
GRID = 40
"""Intervals in which it is summed up."""
LARGEST = 1.5
"""Times ``max_acceleration`` that a particle accelerates at most."""
LARGEST_EXPONENT = 600.0
"""Keeps a sum finite where a flight is predicted for more than a minute; it errs by millimetres there."""
_TINY = 1e-12


class Filtered(NamedTuple):
    """What the filters say."""

    believed: Float[np.ndarray, "3"]
    """Where the target is [m, world]."""
    flights: Float[np.ndarray, "p s 3"]
    """Particles [m, world]."""
    log_levels: Float[np.ndarray, "l"]
    """Log-likelihoods of the levels of noise."""
    foreseen: Float[np.ndarray, "h"]
    """Log-densities [log 1/m^3] given to the newest positions before they were seen."""


def filtered(
    motion: MotionConfig,
    noise: tuple[Float[np.ndarray, "l"], Float[np.ndarray, "l"]],
    window: tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 3"], int],
    held: int,
    blur: float,
    offsets: Float[np.ndarray, "s"],
    randoms: tuple[Float[np.ndarray, "p"], Float[np.ndarray, "p r"]],
) -> Filtered:
    """Show the filters a window, ask them some positions earlier for the rest of it, and draw flights.

    Args:
        motion: what a plausible target is.
        noise: levels [m], and the logarithms of their shares.
        window: gaps [s], positions [m, world], and how many there are, the newest ones.
        held: how many of the newest ones are asked for.
        blur: deviation [m] that these may have beyond their noise.
        offsets: times [s] of the flights' positions, even.
        randoms: numbers in [0, 1) that choose level and mode, and at least 18 standard normal ones each.
    """
    gaps, positions, count = window
    levels, particles, steps = len(noise[0]), len(randoms[0]), len(offsets)
    found = Filtered(np.zeros(3), np.zeros((particles, steps, 3)), np.zeros(levels), np.zeros(held))
    beliefs = tuple(empty_belief(levels) for _ in range(3))
    responses = np.zeros((3, steps, COSINES)), np.zeros((GRID, COSINES)), np.zeros((steps, COSINES))
    scratch = np.zeros(3), np.zeros(3 * levels), np.zeros((3 * levels, 3, 3)), np.zeros((3, 3))
    uniform, normal = (np.ascontiguousarray(numbers, float) for numbers in randoms)
    times, spaces, there = (np.array(part, float, order="C") for part in (offsets, gaps, positions))
    numbers, room = (count, held), (*beliefs, responses, scratch)
    tolerances = np.hypot(blur, noise[0])
    _compiled()(
        tuple(motion_of(motion)), noise, tolerances, spaces, there, numbers, times, uniform, normal, room, tuple(found)
    )
    return found


@runtime_checkable
class _Filtered(Protocol):
    def __call__(
        self,
        motion: tuple,
        noise: tuple,
        tolerances: Float[np.ndarray, "l"],
        gaps: Float[np.ndarray, "n"],
        positions: Float[np.ndarray, "n 3"],
        numbers: tuple[int, int],
        offsets: Float[np.ndarray, "s"],
        uniform: Float[np.ndarray, "p"],
        normal: Float[np.ndarray, "p r"],
        room: tuple,
        found: tuple,
    ) -> None:
        """Write ``found``; ``room`` is overwritten."""


@functools.cache
def _compiled() -> _Filtered:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(motion, noise, tolerances, gaps, positions, numbers, offsets, uniform, normal, room, found):
        _ = version
        belief, there, then, responses, scratch = room
        believed, flights, log_levels, foreseen = found
        _track(motion, noise, gaps, positions, numbers, belief, there, then, scratch[0])
        since = 0.0
        for h in range(numbers[1]):
            at = len(gaps) - numbers[1] + h
            since += gaps[at]
            foreseen[h] = log_foreseen(motion, then, since, positions[at], tolerances, there)
        _believed(belief, scratch[1], believed)
        for level in range(len(log_levels)):
            log_levels[level] = belief[0][level]
        _respond(offsets, responses)
        _factors(belief[3], scratch[2])
        for n in range(len(flights)):
            _fly(motion, belief, offsets, uniform[n], normal[n], responses, scratch, flights[n])

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _track(motion, noise, gaps, positions, numbers, belief, there, then, gain):
    """Write the beliefs after all positions, and after all but those that are held back."""
    count, held = numbers
    last = len(gaps) - 1
    first = last + 1 - count
    way, time = 0.0, 0.0
    for axis in range(3):
        way += (positions[last, axis] - positions[first, axis]) * (positions[last, axis] - positions[first, axis])
    for i in range(first + 1, last + 1):
        time += gaps[i]
    begin_belief(belief, motion, noise, positions[first], math.sqrt(way) / max(time, 1e-3))
    if first >= last - held:
        copy_belief(then, belief)
    for i in range(first + 1, last + 1):
        predict_belief(motion, belief, gaps[i], there)
        update_belief(noise[0], there, positions[i], gain)
        copy_belief(belief, there)
        if i == last - held:
            copy_belief(then, belief)


@inner
@no_type_check
def _believed(belief, shares, believed):
    """Write the probability of each level and mode, and the mean position [m, world]."""
    whole = log_sum(belief[0])
    believed[0], believed[1], believed[2] = 0.0, 0.0, 0.0
    for level in range(len(belief[0])):
        for m in range(3):
            share = math.exp(belief[0][level] - whole + belief[1][level, m])
            shares[3 * level + m] = share
            for axis in range(3):
                believed[axis] += share * belief[2][level, m, 0, axis]
    for i in range(1, len(shares)):
        shares[i] += shares[i - 1]


@inner
@no_type_check
def _respond(offsets, responses):
    """Write what a unit of each cosine in white noise has moved and sped up a target by each offset, without fading."""
    tables, waves, whole = responses
    horizon = offsets[len(offsets) - 1]
    for g in range(GRID):
        for c in range(COSINES):
            wave = math.cos(math.pi * ((g + 0.5) / GRID) * c) * (1.0 if c == 0 else math.sqrt(2.0))
            waves[g, c] = wave * math.sqrt(horizon) / GRID
    for s in range(len(offsets)):
        for c in range(COSINES):
            straight, total, turning = 0.0, 0.0, 0.0
            for g in range(GRID):
                lag = offsets[s] - horizon * ((g + 0.5) / GRID)
                if lag > 0.0:
                    straight += lag * waves[g, c]
                    total += waves[g, c]
                    turning += lag * lag * waves[g, c]
            tables[STRAIGHT, s, c], tables[TURN, s, c], whole[s, c] = straight, 0.5 * turning, total


@inner
@no_type_check
def _factors(covariances, factors):
    """Write lower triangular factors; what rounding has made negative on the diagonal counts as 0."""
    for level in range(len(covariances)):
        for m in range(3):
            a, low = covariances[level, m], factors[3 * level + m]
            low[0, 0] = math.sqrt(max(a[0, 0], _TINY))
            low[1, 0], low[2, 0] = a[1, 0] / low[0, 0], a[2, 0] / low[0, 0]
            low[1, 1] = math.sqrt(max(a[1, 1] - low[1, 0] * low[1, 0], _TINY))
            low[2, 1] = (a[2, 1] - low[1, 0] * low[2, 0]) / low[1, 1]
            low[2, 2] = math.sqrt(max(a[2, 2] - low[2, 0] * low[2, 0] - low[2, 1] * low[2, 1], _TINY))


@inner
@no_type_check
def _fly(motion, belief, offsets, uniform, normal, responses, scratch, flight):
    """Write the flight of one particle."""
    state = scratch[3]
    mode = _drawn(motion, belief, uniform, normal, scratch)
    position, velocity, acceleration = state[0], state[1], state[2]
    speed = _size(velocity)
    fading, rate = expected_fading(motion, speed), turn_rate(motion, velocity, acceleration)
    noise = _noise(motion, mode, speed, fading)
    if mode == FADING:
        _fade(offsets, fading, responses)
    for s in range(len(offsets)):
        onwards, bent = offsets[s], 0.0
        if mode == FADING:
            bent = fading * (onwards + fading * math.expm1(-onwards / fading))
        elif mode == TURN:
            onwards, bent, _, _ = turn_motion(offsets[s], rate)
        for axis in range(3):
            moved = 0.0
            for c in range(COSINES):
                moved += noise * responses[0][mode, s, c] * normal[9 + 3 * c + axis]
            flight[s, axis] = position[axis] + onwards * velocity[axis] + bent * acceleration[axis] + moved


@inner
@no_type_check
def _drawn(motion, belief, uniform, normal, scratch):
    """The mode of a particle; writes the state that it begins with."""
    shares, factors, state = scratch[1], scratch[2], scratch[3]
    chosen = 0
    for i in range(len(shares) - 1):
        chosen += uniform * shares[len(shares) - 1] >= shares[i]
    for i in range(3):
        for axis in range(3):
            state[i, axis] = belief[2][chosen // 3, chosen % 3, i, axis]
            for j in range(i + 1):
                state[i, axis] += factors[chosen, i, j] * normal[3 * j + axis]
    shrunk = min(1.0, LARGEST * motion[3] / max(_size(state[2]), 1e-9))
    for axis in range(3):
        state[2, axis] *= shrunk
    return chosen % 3


@inner
@no_type_check
def _noise(motion, mode, speed, fading):
    """Root of the intensity of a mode's white noise."""
    acceleration = expected_acceleration(motion, speed)
    if mode == STRAIGHT:
        return motion[6] * acceleration * math.sqrt(fading)
    jerk = acceleration * math.sqrt(2.0 / fading)
    return jerk if mode == FADING else motion[7] * jerk


@inner
@no_type_check
def _fade(offsets, fading, responses):
    """Write what a unit of each cosine has moved a target whose acceleration fades, by each offset."""
    tables, waves, whole = responses
    horizon, g = offsets[len(offsets) - 1], 0
    first = second = third = 0.0
    for s in range(len(offsets)):
        while g < GRID and offsets[s] - horizon * ((g + 0.5) / GRID) > 0.0:
            grown = math.exp(min(horizon * ((g + 0.5) / GRID) / fading, LARGEST_EXPONENT))
            first, second, third = (
                first + grown * waves[g, 0],
                second + grown * waves[g, 1],
                third + grown * waves[g, 2],
            )
            g += 1
        shrunk = math.exp(-offsets[s] / fading)
        for c in range(COSINES):
            left = shrunk * (first if c == 0 else second if c == 1 else third)
            tables[FADING, s, c] = fading * (tables[STRAIGHT, s, c] - fading * (whole[s, c] - left))


@inner
@no_type_check
def _size(vector):
    return math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
