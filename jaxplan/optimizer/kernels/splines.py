"""The minimum-snap spline of a problem's variables and its derivatives by them: ``optimizer.problem``, compiled.

The unknown knot derivatives solve a system of bandwidth 7, the same for all axes (``minsnap.quadratic_program``). With
q_k = T^(k - 7/2) a segment's energy is made of terms K_kd q_k q_d x_k x_d, whose derivatives by log T are k + d - 7
times as much; so the derivatives of the knots are more right-hand sides of the same system. A waypoint acts on its own
axis only, and on all axes alike: one column for each, where a duration has three.
"""

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float

from jaxplan.optimizer.kernels.compiled import inner, summing, within

LINE = 64
"""Bytes of a line of memory."""


class Spline(NamedTuple):
    """Room for a spline of m segments."""

    durations: Float[np.ndarray, "m"]
    """[s]"""
    weights: Float[np.ndarray, "m 5"]
    """T^(k - 7/2)."""
    knots: Float[np.ndarray, "n 5 3"]
    """Position to snap at the n = m + 1 waypoints [SI, world]."""
    band: Float[np.ndarray, "u 8"]
    """Cholesky factor of the u = 4 (m - 1) unknown derivatives; the diagonal comes last."""
    force: Float[np.ndarray, "u 3"]
    """Right-hand sides, then the unknowns."""
    coefficients: Float[np.ndarray, "m 10 3"]
    """Ascending, in normalised time [m]."""


class Tangents(NamedTuple):
    """Room for the derivatives of a spline.

    Columns: the log of each duration, for each axis; then what moves points, of any axis: the inner waypoints, the
    offset of the meeting, the stop; then the value itself, for each axis.
    """

    force: Float[np.ndarray, "u w"]
    """Right-hand sides, then the derivatives of the unknowns."""
    ends: Float[np.ndarray, "10 w"]
    """Of a segment's end values in normalised time; the step in the place of the second position."""
    coefficients: Float[np.ndarray, "m 10 w"]


def aligned(shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    """Zeros that begin with a line of memory (host): vectors that begin elsewhere are read in two steps."""
    size = math.prod(shape)
    room = np.zeros(size + LINE // 8)
    first = -room.ctypes.data % LINE // 8
    return room[first : first + size].reshape(shape)


def make_spline(m: int) -> Spline:
    """Room for one spline (host)."""
    shapes = (m,), (m, 5), (m + 1, 5, 3), (4 * (m - 1), 8), (4 * (m - 1), 3), (m, 10, 3)
    return Spline(*(aligned(shape) for shape in shapes))


def make_tangents(m: int) -> Tangents:
    """Room for its derivatives (host); rows end in zeros, so that they are whole vectors."""
    width = -(-(4 * m + 3) // 8) * 8
    return Tangents(*(aligned(shape) for shape in ((4 * (m - 1), width), (10, width), (m, 10, width))))


@inner
@no_type_check
def target_at(case, time, k):
    """Where the target is along axis k [m], and how fast [m/s] (``TargetTable.at``)."""
    last = len(case.position) - 1
    steps = min(max(time / case.interval, 0.0), float(last))
    i = min(int(steps), last - 1)
    s, left = steps - i, case.position[i, k]
    slope, next_slope = case.interval * case.velocity[i, k], case.interval * case.velocity[i + 1, k]
    step = case.position[i + 1, k] - left
    square, cube = 3.0 * step - 2.0 * slope - next_slope, slope + next_slope - 2.0 * step
    moving = 1.0 if 0.0 <= time <= last * case.interval else 0.0
    speed = moving * (slope + s * (2.0 * square + 3.0 * s * cube)) / case.interval
    return left + s * (slope + s * (square + s * cube)), speed


@inner
@no_type_check
def shape(case, x, spline):
    """Write the spline of the variables ``x``; comes back with the time to the meeting [s]."""
    m = len(spline.durations)
    time = 0.0
    for i in range(m):
        duration = math.exp(x[i])
        spline.durations[i] = duration
        time += duration if i < m - 1 else 0.0
        weight = 1.0 / (duration * duration * duration * math.sqrt(duration))
        for k in range(5):
            spline.weights[i, k] = weight
            weight *= duration
    for axis in range(3):
        for k in range(5):
            spline.knots[0, k, axis] = case.start[k, axis]
            spline.knots[m, k, axis] = 0.0
        for j in range(m - 2):
            spline.knots[1 + j, 0, axis] = x[m + 3 * j + axis]
        meet, _ = target_at(case, time, axis)
        meet += case.meet_radius * x[4 * m - 6 + axis]
        spline.knots[m - 1, 0, axis] = meet
        spline.knots[m, 0, axis] = meet + x[4 * m - 3 + axis]
    _factor(case.tables.energy, spline)
    _pull(case.tables.energy, spline)
    _solve(spline.band, spline.force, 3)
    _write(case.tables.basis, spline)
    return time


@inner
@no_type_check
def _factor(energy, spline):
    """The system's matrix, row by row, and its Cholesky factor."""
    q, band = spline.weights, spline.band
    for row in range(len(band)):
        n, k = row // 4, row % 4
        for back in range(7, -1, -1):
            column = row - back
            if column < 0:
                continue
            d = column % 4
            if column // 4 == n:
                total = energy[6 + k, 6 + d] * q[n, k + 1] * q[n, d + 1]
                total += energy[1 + k, 1 + d] * q[n + 1, k + 1] * q[n + 1, d + 1]
            elif column // 4 == n - 1:
                total = energy[6 + k, 1 + d] * q[n, k + 1] * q[n, d + 1]
            else:
                total = 0.0
            for other in range(max(0, row - 7), column):
                total -= band[row, 7 - row + other] * band[column, 7 - column + other]
            band[row, 7 - back] = math.sqrt(total) if back == 0 else total / band[column, 7]


@inner
@no_type_check
def _pull(energy, spline):
    """How waypoints and the start's derivatives pull at the unknown derivatives."""
    q, knots, force = spline.weights, spline.knots, spline.force
    for row in range(len(force)):
        n, k = row // 4, row % 4 + 1
        for axis in range(3):
            before = knots[n + 1, 0, axis] - knots[n, 0, axis]
            behind = knots[n + 2, 0, axis] - knots[n + 1, 0, axis]
            total = energy[5 + k, 5] * q[n, k] * q[n, 0] * before + energy[k, 5] * q[n + 1, k] * q[n + 1, 0] * behind
            if n == 0:
                for d in range(1, 5):
                    total += energy[5 + k, d] * q[0, k] * q[0, d] * knots[0, d, axis]
            force[row, axis] = -total


@summing
@no_type_check
def _solve(band, force, width):
    """Forward and back substitution of all columns, in place."""
    for row in range(len(band)):
        for other in range(max(0, row - 7), row):
            factor = band[row, 7 - row + other]
            for column in range(width):
                force[row, column] -= factor * force[other, column]
        scale = 1.0 / band[row, 7]
        for column in range(width):
            force[row, column] *= scale
    for row in range(len(band) - 1, -1, -1):
        for other in range(row + 1, min(row + 8, len(band))):
            factor = band[other, 7 - other + row]
            for column in range(width):
                force[row, column] -= factor * force[other, column]
        scale = 1.0 / band[row, 7]
        for column in range(width):
            force[row, column] *= scale


@inner
@no_type_check
def _write(basis, spline):
    """Knots and coefficients from the unknowns that were found."""
    knots = spline.knots
    for row in range(len(spline.force)):
        for axis in range(3):
            knots[1 + row // 4, 1 + row % 4, axis] = spline.force[row, axis]
    for i in range(len(spline.durations)):
        duration = spline.durations[i]
        for axis in range(3):
            step = knots[i + 1, 0, axis] - knots[i, 0, axis]
            for c in range(10):
                total, power = basis[c, 5] * step, 1.0
                for d in range(1, 5):
                    power *= duration
                    total += power * (basis[c, d] * knots[i, d, axis] + basis[c, 5 + d] * knots[i + 1, d, axis])
                spline.coefficients[i, c, axis] = total + (knots[i, 0, axis] if c == 0 else 0.0)


@within
@no_type_check
def differentiate(case, time, spline, tangents):
    """Write the derivatives of a spline that was shaped, with its meeting at ``time`` [s]."""
    _push(case.tables.energy, spline, tangents.force)
    _solve(spline.band, tangents.force, 4 * len(spline.durations))
    for i in range(len(spline.durations)):
        _move_ends(spline, i, tangents)
        _move_coefficients(case.tables.basis, spline, i, tangents)
        _follow(case, time, spline, tangents.coefficients[i])


@inner
@no_type_check
def _push(energy, spline, force):
    """How each duration and each of the m waypoints behind the start pushes the unknown derivatives."""
    q, knots, m = spline.weights, spline.knots, len(spline.durations)
    for row in range(len(force)):
        n, k = row // 4, row % 4 + 1
        for column in range(4 * m):
            force[row, column] = 0.0
        for side in range(2):
            i = n + side  # the segment that ends at the row's knot, then the one that begins there
            e = 5 + k if side == 0 else k
            for axis in range(3):
                total = (k - 7.0) * energy[e, 5] * q[i, 0] * (knots[i + 1, 0, axis] - knots[i, 0, axis])
                for d in range(1, 5):
                    pull = energy[e, d] * knots[i, d, axis] + energy[e, 5 + d] * knots[i + 1, d, axis]
                    total += (k + d - 7.0) * q[i, d] * pull
                force[row, axis * m + i] = -q[i, k] * total
            by_step = energy[e, 5] * q[i, k] * q[i, 0]
            force[row, 3 * m + i] -= by_step
            if i > 0:
                force[row, 3 * m + i - 1] += by_step


@inner
@no_type_check
def _move_ends(spline, i, tangents):
    """Derivatives of the end values of segment i."""
    m, duration, ends, force = len(spline.durations), spline.durations[i], tangents.ends, tangents.force
    for column in range(4 * m):
        ends[0, column] = ends[5, column] = 0.0
    ends[5, 3 * m + i] = 1.0
    if i > 0:
        ends[0, 3 * m + i - 1], ends[5, 3 * m + i - 1] = 1.0, -1.0
    power = 1.0
    for d in range(1, 5):
        power *= duration
        left, right = ends[d], ends[5 + d]
        for column in range(4 * m):
            left[column] = power * force[4 * (i - 1) + d - 1, column] if i > 0 else 0.0
            right[column] = power * force[4 * i + d - 1, column] if i < m - 1 else 0.0
        for axis in range(3):
            left[axis * m + i] += d * power * spline.knots[i, d, axis]
            right[axis * m + i] += d * power * spline.knots[i + 1, d, axis]


@summing
@no_type_check
def _move_coefficients(basis, spline, i, tangents):
    """Derivatives of the coefficients of segment i, and the coefficients themselves behind them."""
    m, ends, rows = len(spline.durations), tangents.ends, tangents.coefficients[i]
    for c in range(10):
        row = rows[c]
        for column in range(4 * m):
            row[column] = ends[0, column] if c == 0 else 0.0
        for d in range(1, 10):
            factor, end = basis[c, d], ends[d]
            if factor != 0.0:
                for column in range(4 * m):
                    row[column] += factor * end[column]
        for axis in range(3):
            row[4 * m + axis] = spline.coefficients[i, c, axis]


@inner
@no_type_check
def _follow(case, time, spline, rows):
    """From the last two waypoints to what moves them: the target by the time to it, the meeting's offset, the stop."""
    m = len(spline.durations)
    for c in range(10):
        row = rows[c]
        both = row[4 * m - 2] + row[4 * m - 1]
        row[4 * m - 2] = case.meet_radius * both
        for axis in range(3):
            _, speed = target_at(case, time, axis)
            for k in range(m - 1):
                row[axis * m + k] += spline.durations[k] * speed * both
