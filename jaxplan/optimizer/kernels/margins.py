"""What a trajectory keeps, and the Newton system of one step: ``optimizer.margins`` and ``interior_point``, compiled.

The Gauss-Newton matrix sums w J J^T over some 1,500 numbers along a trajectory (a rotor's two limits share one). Each
segment's J sqrt(w) are written in rows of one variable each, with two more rows: what couples the numbers with the
slack, and what they pull at the gradient. All products of two of these rows are the segment's part of the system.
"""

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float

from jaxplan.optimizer.kernels.body import NUMBERS, demand, demand_slopes
from jaxplan.optimizer.kernels.case import Tables
from jaxplan.optimizer.kernels.compiled import inner, summing
from jaxplan.optimizer.kernels.splines import Spline, Tangents, differentiate, make_spline, make_tangents, shape
from jaxplan.optimizer.margins import FARTHEST_STOP, LONGEST, PER_METRE, SHORTEST
from jaxplan.search.kernels.slopes import clearance_slope
from jaxplan.search.kernels.solids import clearance_at

WIDTH = 16
"""Columns that the numbers of one look at the body get: a whole number of vectors."""
_LOW, _HIGH, _FAR = math.log(SHORTEST), math.log(LONGEST), FARTHEST_STOP**2


class Work(NamedTuple):
    """Room for one descent."""

    spline: Spline
    tangents: Tangents
    state: Float[np.ndarray, "5 3"]
    """Position to snap at one instant."""
    numbers: Float[np.ndarray, "16"]
    """Of the body."""
    moved: Float[np.ndarray, "5 w"]
    """``Tangents`` of one instant's state."""
    body: Float[np.ndarray, "4 3 16"]
    place: Float[np.ndarray, "2 3 4"]
    """Derivatives of what is looked at by the state."""
    rows: Float[np.ndarray, "v+2 r"]
    """One segment's part: a row a variable, then what couples with the slack, then the pull."""
    sums: Float[np.ndarray, "v+2 v+2"]
    """Products of the rows, of all segments."""
    system: Float[np.ndarray, "v+1 v+1"]
    """Newton's matrix in the variables and the slack, then its factor."""
    direction: Float[np.ndarray, "v+1"]


def make_work(m: int, tables: Tables) -> Work:
    """For m segments (host)."""
    tangents, looks = make_tangents(m), WIDTH * len(tables.body) + 4 * len(tables.places)
    shapes = (5, 3), (WIDTH,), (5, tangents.ends.shape[1]), (4, 3, WIDTH), (2, 3, 4), (4 * m + 2, -(-looks // 32) * 32)
    sizes = (4 * m + 2, 4 * m + 2), (4 * m + 1, 4 * m + 1), (4 * m + 1,)
    return Work(make_spline(m), tangents, *(np.zeros(size) for size in (*shapes, *sizes)))


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
                one, other = _body_margins(case, number, work.numbers[number])
                least, product, logs = _count(one, slack, least, product, logs)
                least, product, logs = _count(other, slack, least, product, logs)
            if not least + slack > 0.0:
                return time, least, -math.inf
        for s in range(len(case.tables.places)):
            _sample(case.tables.places[s], work.spline, i, 1.0, 0, 2, work.state)
            p, keep = work.state[0], _keep(case, _speed(work.state))
            free = clearance_at(case.solids, p[0], p[1], p[2])
            least, product, logs = _count(PER_METRE * (free - keep), slack, least, product, logs)
            for axis in range(3):
                margin = PER_METRE * (_to_face(case, p[axis], axis) - keep)
                least, product, logs = _count(margin, slack, least, product, logs)
            if not least + slack > 0.0:
                return time, least, -math.inf
    for margin in range(2 * len(work.spline.durations) + 2):
        least, product, logs = _count(_bound(x, margin), slack, least, product, logs)
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
def _body_margins(case, number, value):
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
def _keep(case, speed):
    """The distance that is asked for [m]."""
    least, slow, per_speed, most = case.kept
    return least + min(max(per_speed * (speed - slow), 0.0), most)


@inner
@no_type_check
def _to_face(case, place, axis):
    """Metres to the nearer face of the room along an axis."""
    low, high = case.corners[axis], case.corners[3 + axis]
    return 0.5 * (high - low) - abs(place - 0.5 * (low + high))


@inner
@no_type_check
def _bound(x, margin):
    """Margins of the variables themselves: each duration from both sides, the meeting ball, the stop."""
    v = len(x)
    if margin < v // 2:
        k = margin // 2
        return x[k] - _LOW if margin % 2 == 0 else _HIGH - x[k]
    first, size = (v - 6, 1.0) if margin == v // 2 else (v - 3, _FAR)
    return 1.0 - (x[first] ** 2 + x[first + 1] ** 2 + x[first + 2] ** 2) / size


@inner
@no_type_check
def set_up(case, x, slack, barrier, penalty, damping, work):
    """Write Newton's system around ``x``, whose spline is in ``work``, and its right-hand side: minus the gradient."""
    v, m = len(x), len(work.spline.durations)
    time = 0.0
    for k in range(m - 1):
        time += work.spline.durations[k]
    differentiate(case, time, work.spline, work.tangents)
    work.sums[:] = 0.0
    total, pulled = 0.0, 0.0
    for i in range(m):
        for s in range(len(case.tables.body)):
            weight, pull = _body_rows(case, i, s, slack, barrier, work)
            total, pulled = total + weight, pulled + pull
        for s in range(len(case.tables.places)):
            weight, pull = _place_rows(case, i, s, slack, barrier, work)
            total, pulled = total + weight, pulled + pull
        _multiply(work.rows, work.sums)
    system, right = work.system, work.direction
    for a in range(v):
        for b in range(a + 1):
            system[a, b] = work.sums[a, b]
        system[v, a], right[a] = work.sums[v, a], work.sums[v + 1, a]
    for margin in range(2 * m + 2):
        pull = barrier / (_bound(x, margin) + slack)
        weight = pull * pull / barrier
        total, pulled = total + weight, pulled + pull
        _enter_bound(x, margin, weight, pull, system, right)
    for k in range(m - 1):
        system[k, k] += work.spline.durations[k]
        right[k] -= work.spline.durations[k]
    system[v, v], right[v] = total + barrier / (slack * slack), pulled - penalty + barrier / slack
    for a in range(v + 1):
        system[a, a] += damping * system[a, a] + 1e-9


@inner
@no_type_check
def _enter_bound(x, margin, weight, pull, system, right):
    """A margin of the variables themselves in the system."""
    v = len(x)
    first, count, size = margin // 2, 1, 1.0
    if margin >= v // 2:
        first, count, size = (v - 6, 3, 1.0) if margin == v // 2 else (v - 3, 3, _FAR)
    for a in range(first, first + count):
        slope = (1.0 if margin % 2 == 0 else -1.0) if count == 1 else -2.0 * x[a] / size
        system[v, a] += weight * slope
        right[a] += pull * slope
        for b in range(first, a + 1):
            system[a, b] += weight * slope * ((slope if count == 1 else -2.0 * x[b] / size))


@inner
@no_type_check
def _body_rows(case, i, s, slack, barrier, work):
    """The rows' columns of one look at the body; the sums of weights and pulls."""
    m, rows = len(work.spline.durations), work.rows
    _move(case.tables.body[s], work, i, case.dilation, 1, 5)
    demand(case, work.state, work.numbers)
    demand_slopes(case, work.state, work.body)
    total, pulled, begin = 0.0, 0.0, WIDTH * s
    for number in range(NUMBERS):
        one, other = _body_margins(case, number, work.numbers[number])
        up, down = barrier / (one + slack), barrier / (other + slack)
        weight = (up * up + down * down) / barrier
        total, pulled, root = total + weight, pulled + up + down, math.sqrt(weight)
        rows[4 * m, begin + number] = (up * up - down * down) / (barrier * root)
        rows[4 * m + 1, begin + number] = (up - down) / root
        for order in range(4):
            for axis in range(3):
                work.body[order, axis, number] *= root
    _enter(work.body, work.moved[1:], m, begin, rows)
    return total, pulled


@inner
@no_type_check
def _place_rows(case, i, s, slack, barrier, work):
    """The same of one look at obstacles and faces."""
    m, rows, slopes, state = len(work.spline.durations), work.rows, work.place, work.state
    _move(case.tables.places[s], work, i, 1.0, 0, 2)
    p, speed = state[0], _speed(state)
    keep = _keep(case, speed)
    growing = 0.0 < case.kept[2] * (speed - case.kept[1]) < case.kept[3] and speed > 0.0
    more = case.kept[2] / speed if growing else 0.0
    free, away = clearance_slope(case.solids, p[0], p[1], p[2])
    total, pulled, begin = 0.0, 0.0, WIDTH * len(case.tables.body) + 4 * s
    for number in range(4):
        apart = free if number == 0 else _to_face(case, p[number - 1], number - 1)
        pull = barrier / (PER_METRE * (apart - keep) + slack)
        total, pulled, root = total + pull * pull / barrier, pulled + pull, pull / math.sqrt(barrier)
        rows[4 * m, begin + number], rows[4 * m + 1, begin + number] = root, math.sqrt(barrier)
        scale = PER_METRE * root
        for axis in range(3):
            slope = away[axis] if number == 0 else 0.0
            if number == axis + 1:
                slope = -1.0 if p[axis] > 0.5 * (case.corners[axis] + case.corners[3 + axis]) else 1.0
            slopes[0, axis, number], slopes[1, axis, number] = scale * slope, -scale * more * state[1, axis]
    _enter(slopes, work.moved, m, begin, rows)
    return total, pulled


@inner
@no_type_check
def _move(table, work, i, dilation, first, beyond):
    """One instant's state and its ``Tangents``; the segment's own duration also stretches time."""
    m, moved, sources = len(work.spline.durations), work.moved, work.tangents.coefficients[i]
    rate = dilation / work.spline.durations[i]
    scale = rate if first else 1.0
    for order in range(first, beyond):
        row = moved[order]
        row[:] = 0.0
        for power in range(order, 10):
            factor, source = scale * table[order, power], sources[power]
            for column in range(len(row)):
                row[column] += factor * source[column]
        for axis in range(3):
            value = row[4 * m + axis]
            work.state[order, axis] = value
            row[axis * m + i] -= order * value
        scale *= rate


@inner
@no_type_check
def _enter(slopes, moved, m, begin, rows):
    """From derivatives by the state to derivatives by the variables: some columns of all rows."""
    orders, _, count = slopes.shape
    for k in range(m):
        row = rows[k, begin : begin + count]
        row[:] = 0.0
        for order in range(orders):
            for axis in range(3):
                factor, slope = moved[order, axis * m + k], slopes[order, axis]
                for number in range(count):
                    row[number] += factor * slope[number]
    for j in range(m):
        for axis in range(3):
            row = rows[m + 3 * j + axis, begin : begin + count]
            row[:] = 0.0
            for order in range(orders):
                factor, slope = moved[order, 3 * m + j], slopes[order, axis]
                for number in range(count):
                    row[number] += factor * slope[number]


@summing
@no_type_check
def _multiply(rows, sums):
    """Add the product of each row with each of those before it."""
    for a in range(len(rows)):
        one = rows[a]
        for b in range(a + 1):
            other, total = rows[b], 0.0
            for column in range(rows.shape[1]):
                total += one[column] * other[column]
            sums[a, b] += total
