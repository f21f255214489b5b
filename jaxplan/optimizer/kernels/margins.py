"""What a trajectory keeps, ``optimizer.margins`` compiled, and the room that a descent needs."""

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float

from jaxplan.optimizer.kernels.body import NUMBERS, demand
from jaxplan.optimizer.kernels.case import Tables
from jaxplan.optimizer.kernels.compiled import inner
from jaxplan.optimizer.kernels.splines import (
    Spline,
    Tangents,
    aligned,
    make_spline,
    make_tangents,
    shape,
)
from jaxplan.optimizer.margins import FARTHEST_STOP, LONGEST, PER_METRE, SHORTEST
from jaxplan.search.kernels.solids import clearance_at

WIDTH = 16
"""Columns that one look at the body writes, a whole number of vectors; the next one begins behind its numbers."""
_LOW, _HIGH, FAR = math.log(SHORTEST), math.log(LONGEST), FARTHEST_STOP**2


class Work(NamedTuple):
    """Room for one descent."""

    spline: Spline
    tangents: Tangents
    rows: Float[np.ndarray, "v+2 r"]
    """Some numbers' part: a row a variable, then what couples with the slack, then the pull."""
    parts: Float[np.ndarray, "v+2 p l"]
    """The same memory: the columns of places, by margin."""
    state: Float[np.ndarray, "5 3"]
    """Position to snap at one instant."""
    numbers: Float[np.ndarray, "16"]
    """Of the body."""
    moved: Float[np.ndarray, "5 w"]
    """``Tangents`` of one instant's state."""
    body: Float[np.ndarray, "4 3 16"]
    """Derivatives of the numbers by velocity to snap."""
    ways: Float[np.ndarray, "2 w l"]
    """``Tangents`` of position and velocity at all places of a segment, the columns before the places."""
    place: Float[np.ndarray, "13 l"]
    """What its margins follow from at each place: by x, y, z away from the obstacle, towards the farther faces, and how
    what is kept grows with velocity; and the weights of the four."""
    sums: Float[np.ndarray, "v+2 v+2"]
    """Products of the rows, of all numbers; right of the diagonal what is left over."""
    system: Float[np.ndarray, "v+1 v+1"]
    """Newton's matrix in the variables and the slack, then its factor."""
    direction: Float[np.ndarray, "v+1"]
    tried: Float[np.ndarray, "v"]
    """The variables at the end of a step."""


def make_work(m: int, tables: Tables) -> Work:
    """For m segments (host)."""
    tangents, length = make_tangents(m), tables.ways.shape[2]
    width, parts = tangents.ends.shape[1], max(-(-_columns(len(tables.body)) // length), 5)
    rows = aligned((4 * m + 2, parts * length))
    shapes = (5, 3), (WIDTH,), (5, width), (4, 3, WIDTH), (2, width, length), (13, length)
    sizes = (4 * m + 2, 4 * m + 2), (4 * m + 1, 4 * m + 1), (4 * m + 1,), (4 * m,)
    others = [aligned(size) for size in (*shapes, *sizes)]
    return Work(make_spline(m), tangents, rows, rows.reshape(len(rows), parts, length), *others)


def _columns(looks: int) -> int:
    """Of so many looks at the body, in whole vectors of 8."""
    return -(-(NUMBERS * (looks - 1) + WIDTH) // 8) * 8


@inner
@no_type_check
def look(case, x, slack, work):
    """Time to the meeting [s], the least margin, and the sum of the logarithms of all with the slack.

    -inf where a margin is not above -slack; then what follows it is not looked at.
    """
    time = shape(case, x, work.spline)
    least, product, logs = math.inf, 1.0, 0.0
    for i in range(len(work.spline.durations)):
        for s in range(len(case.tables.body)):
            _sample(case.tables.body[s], work.spline, i, case.dilation, 1, 5, work.state)
            demand(case, work.state, work.numbers)
            for number in range(NUMBERS):
                one, other = body_margins(case, number, work.numbers[number])
                least, product, logs = _count(one, slack, least, product, logs)
                least, product, logs = _count(other, slack, least, product, logs)
            if not least + slack > 0.0:
                return time, least, -math.inf
        for s in range(len(case.tables.places)):
            _sample(case.tables.places[s], work.spline, i, 1.0, 0, 2, work.state)
            p, keep = work.state[0], keep_at(case, _speed(work.state))
            free = clearance_at(case.solids, p[0], p[1], p[2])
            least, product, logs = _count(PER_METRE * (free - keep), slack, least, product, logs)
            for axis in range(3):
                margin = PER_METRE * (to_face(case, p[axis], axis) - keep)
                least, product, logs = _count(margin, slack, least, product, logs)
            if not least + slack > 0.0:
                return time, least, -math.inf
    for margin in range(2 * len(work.spline.durations) + 2):
        least, product, logs = _count(bound(x, margin), slack, least, product, logs)
    return time, least, logs + math.log(product) if least + slack > 0.0 else -math.inf


@inner
@no_type_check
def _count(margin, slack, least, product, logs):
    """One more margin; the logarithm of several is taken at once. NaN stays the least; inf does not count."""
    value = margin + slack
    if margin == math.inf:
        return least, product, logs
    if not value > 0.0:
        return (margin if not margin >= least else least), product, logs
    product *= value
    if not 1e-100 < product < 1e100:
        product, logs = 1.0, logs + math.log(product)
    return (margin if margin < least else least), product, logs


@inner
@no_type_check
def _sample(table, spline, i, dilation, first, beyond, state):
    """Derivatives ``first`` to before ``beyond`` at one instant of segment i, flown ``dilation`` times as fast."""
    rate, c = dilation / spline.durations[i], spline.coefficients[i]
    scale = rate if first else 1.0
    for order in range(first, beyond):
        row = table[order]
        u = v = w = 0.0
        for power in range(order, 10):
            u, v, w = u + row[power] * c[power, 0], v + row[power] * c[power, 1], w + row[power] * c[power, 2]
        state[order, 0], state[order, 1], state[order, 2] = scale * u, scale * v, scale * w
        scale *= rate


@inner
@no_type_check
def body_margins(case, number, value):
    """From the lower limit of one of the body's numbers and from its upper one; inf where it has none."""
    turn = number % 6
    if number == 12:
        return math.inf, 1.0 - value
    if turn == 4:
        return value - case.upright, math.inf
    if turn == 5:
        return value - case.ahead, math.inf
    return value - (case.craft.slowest / case.craft.fastest) ** 2, 1.0 - value


@inner
@no_type_check
def _speed(state):
    return math.sqrt(state[1, 0] * state[1, 0] + state[1, 1] * state[1, 1] + state[1, 2] * state[1, 2])


@inner
@no_type_check
def keep_at(case, speed):
    """The distance that is asked for [m]."""
    least, slow, per_speed, most = case.kept
    return least + min(max(per_speed * (speed - slow), 0.0), most)


@inner
@no_type_check
def to_face(case, place, axis):
    """Metres to the nearer face of the room along an axis."""
    low, high = case.corners[axis], case.corners[3 + axis]
    return 0.5 * (high - low) - abs(place - 0.5 * (low + high))


@inner
@no_type_check
def bound(x, margin):
    """Margins of the variables themselves: each duration from both sides, the meeting ball, the stop."""
    v = len(x)
    if margin < v // 2:
        k = margin // 2
        return x[k] - _LOW if margin % 2 == 0 else _HIGH - x[k]
    first, size = (v - 6, 1.0) if margin == v // 2 else (v - 3, FAR)
    return 1.0 - (x[first] ** 2 + x[first + 1] ** 2 + x[first + 2] ** 2) / size
