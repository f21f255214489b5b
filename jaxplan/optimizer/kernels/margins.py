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
from jaxplan.optimizer.kernels.compiled import inner, summing, within
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
    """Of the body, or of a place: the weights of its distances, then the sign of each axis."""
    moved: Float[np.ndarray, "5 w"]
    """``Tangents`` of one instant's state."""
    body: Float[np.ndarray, "4 3 16"]
    """Derivatives of the numbers by velocity to snap."""
    rows: Float[np.ndarray, "v+2 r"]
    """One segment's part: a row a variable, then what couples with the slack, then the pull."""
    sums: Float[np.ndarray, "v+2 v+2"]
    """Products of the rows, of all segments."""
    system: Float[np.ndarray, "v+1 v+1"]
    """Newton's matrix in the variables and the slack, then its factor."""
    direction: Float[np.ndarray, "v+1"]
    tried: Float[np.ndarray, "v"]
    """The variables at the end of a step."""


def make_work(m: int, tables: Tables) -> Work:
    """For m segments (host)."""
    tangents, looks = make_tangents(m), WIDTH * len(tables.body) + 4 * len(tables.places)
    shapes = (5, 3), (WIDTH,), (5, tangents.ends.shape[1]), (4, 3, WIDTH), (4 * m + 2, -(-looks // 32) * 32)
    sizes = (4 * m + 2, 4 * m + 2), (4 * m + 1, 4 * m + 1), (4 * m + 1,), (4 * m,)
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
    """Write Newton's system around ``x`` and its right-hand side: minus the gradient. All margins are above -slack."""
    v, m = len(x), len(work.spline.durations)
    time = shape(case, x, work.spline)
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
            system[a, b] += weight * slope * (slope if count == 1 else -2.0 * x[b] / size)


@within
@no_type_check
def _body_rows(case, i, s, slack, barrier, work):
    """The rows' columns of one look at the body; the sums of weights and pulls."""
    m, rows = len(work.spline.durations), work.rows
    _move(case.tables.body[s], work, i, case.dilation, 1, 5)
    demand_slopes(case, work.state, work.numbers, work.body)
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
    _enter(work.body, work.moved, m, begin, rows)
    return total, pulled


@within
@no_type_check
def _place_rows(case, i, s, slack, barrier, work):
    """The same of one look at obstacles and faces."""
    m, rows, state, scales = len(work.spline.durations), work.rows, work.state, work.numbers
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
        scales[number] = PER_METRE * root
        if number > 0:
            axis = number - 1
            scales[4 + axis] = -1.0 if p[axis] > 0.5 * (case.corners[axis] + case.corners[3 + axis]) else 1.0
    growth = more * state[1, 0], more * state[1, 1], more * state[1, 2]
    _enter_place(away, growth, scales, work.moved, m, begin, rows)
    return total, pulled


@inner
@no_type_check
def _enter_place(away, growth, scales, moved, m, begin, rows):
    """The four columns of one place: away from the obstacle and from the nearer faces, less what speed asks for."""
    u, v, w = scales[4], scales[5], scales[6]
    for k in range(m):
        row, x, y, z = rows[k], moved[0, k], moved[0, m + k], moved[0, 2 * m + k]
        keep = growth[0] * moved[1, k] + growth[1] * moved[1, m + k] + growth[2] * moved[1, 2 * m + k]
        row[begin] = scales[0] * (away[0] * x + away[1] * y + away[2] * z - keep)
        row[begin + 1] = scales[1] * (u * x - keep)
        row[begin + 2] = scales[2] * (v * y - keep)
        row[begin + 3] = scales[3] * (w * z - keep)
    for j in range(m):
        place, speed = moved[0, 3 * m + j], moved[1, 3 * m + j]
        for axis in range(3):
            row, keep = rows[m + 3 * j + axis], growth[axis] * speed
            row[begin] = scales[0] * (away[axis] * place - keep)
            for other in range(3):
                row[begin + 1 + other] = -scales[1 + other] * keep
            row[begin + 1 + axis] += scales[1 + axis] * scales[4 + axis] * place


@summing
@no_type_check
def _move(table, work, i, dilation, first, beyond):
    """One instant's state and its ``Tangents``; the segment's own duration also stretches time."""
    m, moved, sources = len(work.spline.durations), work.moved, work.tangents.coefficients[i]
    rate = dilation / work.spline.durations[i]
    scale = rate if first else 1.0
    for order in range(first, beyond):
        row = moved[order]
        row[:] = 0.0
        for power in range(0, 10, 5):
            a, b, c, d, e = (
                sources[power],
                sources[power + 1],
                sources[power + 2],
                sources[power + 3],
                sources[power + 4],
            )
            f, g, h = scale * table[order, power], scale * table[order, power + 1], scale * table[order, power + 2]
            p, q = scale * table[order, power + 3], scale * table[order, power + 4]
            for column in range(len(row)):
                row[column] += f * a[column] + g * b[column] + h * c[column] + p * d[column] + q * e[column]
        for axis in range(3):
            value = row[4 * m + axis]
            work.state[order, axis] = value
            row[axis * m + i] -= order * value
        scale *= rate


@summing
@no_type_check
def _enter(slopes, moved, m, begin, rows):
    """From derivatives by the state to derivatives by the variables: the columns of one look at the body."""
    for k in range(4 * m):
        row = rows[k, begin : begin + WIDTH]
        row[:] = 0.0
        for axis in range(3):
            if k >= m and (k - m) % 3 != axis:
                continue
            column = axis * m + k if k < m else 3 * m + (k - m) // 3
            f, g, h, p = moved[1, column], moved[2, column], moved[3, column], moved[4, column]
            a, b, c, d = slopes[0, axis], slopes[1, axis], slopes[2, axis], slopes[3, axis]
            for number in range(WIDTH):
                row[number] += f * a[number] + g * b[number] + h * c[number] + p * d[number]


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
