"""The Newton system of one step: that of ``optimizer.interior_point``, compiled.

The Gauss-Newton matrix sums w J J^T over some 1,500 numbers along a trajectory (a rotor's two limits share one). Their
J sqrt(w) are written in rows of one variable each, with two more rows: what couples the numbers with the slack, and
what they pull at the gradient. All products of two of these rows are a part of the system. The rows hold what one
segment asks of the body, and then what it keeps from obstacles: as much as the fastest memory has room for (32 KB).
"""

import math
from typing import no_type_check

from jaxplan.optimizer.kernels.body import NUMBERS, demand_slopes
from jaxplan.optimizer.kernels.compiled import inner, summing, within
from jaxplan.optimizer.kernels.margins import FAR, WIDTH, body_margins, bound, keep_at, to_face
from jaxplan.optimizer.kernels.splines import differentiate, shape
from jaxplan.optimizer.margins import PER_METRE
from jaxplan.search.kernels.slopes import clearance_slope


@inner
@no_type_check
def set_up(case, x, slack, barrier, penalty, damping, work):
    """Write Newton's system around ``x`` and its right-hand side: minus the gradient. All margins are above -slack."""
    v, m = len(x), len(work.spline.durations)
    time = shape(case, x, work.spline)
    differentiate(case, time, work.spline, work.tangents)
    work.sums[:] = 0.0
    total, pulled, looks = 0.0, 0.0, len(case.tables.body)
    columns = (NUMBERS * (looks - 1) + WIDTH + 7) // 8 * 8  # as ``make_work`` has room for
    for i in range(m):
        for s in range(looks):
            weight, pull = _body_rows(case, i, s, slack, barrier, work)
            total, pulled = total + weight, pulled + pull
        for row in range(v + 2):
            for column in range(NUMBERS * looks, columns):
                work.rows[row, column] = 0.0
        _multiply(work.rows, columns, work.sums)
        weight, pull = _place_rows(case, i, slack, barrier, work)
        total, pulled = total + weight, pulled + pull
        _multiply(work.rows, 4 * case.tables.ways.shape[2], work.sums)
    system, right = work.system, work.direction
    for a in range(v):
        for b in range(a + 1):
            system[a, b] = work.sums[a, b]
        system[v, a], right[a] = work.sums[v, a], work.sums[v + 1, a]
    for margin in range(2 * m + 2):
        pull = barrier / (bound(x, margin) + slack)
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
        first, count, size = (v - 6, 3, 1.0) if margin == v // 2 else (v - 3, 3, FAR)
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
    total, pulled, share, begin = 0.0, 0.0, 1.0 / barrier, NUMBERS * s
    couple, pulls = rows[4 * m, begin : begin + NUMBERS], rows[4 * m + 1, begin : begin + NUMBERS]
    for number in range(NUMBERS):
        one, other = body_margins(case, number, work.numbers[number])
        up, down = barrier / (one + slack), barrier / (other + slack)
        weight = share * (up * up + down * down)
        total, pulled, root = total + weight, pulled + up + down, math.sqrt(weight)
        couple[number], pulls[number] = share * (up * up - down * down) / root, (up - down) / root
        for order in range(4):
            for axis in range(3):
                work.body[order, axis, number] *= root
    _enter(work.body, work.moved, m, begin, rows)
    return total, pulled


@within
@no_type_check
def _place_rows(case, i, slack, barrier, work):
    """The rows' columns of all looks of a segment at obstacles and faces; the sums of weights and pulls."""
    m, length, ways, place = len(work.spline.durations), case.tables.ways.shape[2], work.ways, work.place
    _move_places(case.tables.ways, work.tangents.coefficients[i], work.spline.durations[i], m, i, ways)
    total, pulled, whole = 0.0, 0.0, math.sqrt(barrier)
    share, couple, pulls = 1.0 / whole, work.rows[4 * m], work.rows[4 * m + 1]
    for s in range(len(case.tables.places)):
        x, y, z = ways[0, 4 * m, s], ways[0, 4 * m + 1, s], ways[0, 4 * m + 2, s]
        u, v, w = ways[1, 4 * m, s], ways[1, 4 * m + 1, s], ways[1, 4 * m + 2, s]
        speed = math.sqrt(u * u + v * v + w * w)
        keep = keep_at(case, speed)
        growing = 0.0 < case.kept[2] * (speed - case.kept[1]) < case.kept[3] and speed > 0.0
        more = case.kept[2] / speed if growing else 0.0
        place[6, s], place[7, s], place[8, s] = more * u, more * v, more * w
        free, away = clearance_slope(case.solids, x, y, z)
        for number in range(4):
            at = x if number == 1 else y if number == 2 else z
            apart = free if number == 0 else to_face(case, at, number - 1)
            pull = barrier / (PER_METRE * (apart - keep) + slack)
            root, column = share * pull, number * length + s
            total, pulled = total + root * root, pulled + pull
            couple[column], pulls[column] = root, whole
            scale = PER_METRE * root
            place[9 + number, s] = scale
            if number == 0:
                place[0, s], place[1, s], place[2, s] = scale * away[0], scale * away[1], scale * away[2]
            else:
                middle = 0.5 * (case.corners[number - 1] + case.corners[2 + number])
                place[2 + number, s] = -scale if at > middle else scale
    for s in range(len(case.tables.places), length):
        for number in range(4):
            couple[number * length + s] = pulls[number * length + s] = 0.0
    _enter_places(place, ways, m, work.parts)
    return total, pulled


@inner
@no_type_check
def _move_places(tables, sources, duration, m, i, ways):
    """``_move`` for all places of a segment: position and velocity."""
    _move_order(tables[0], sources, 1.0, 4 * m + 3, ways[0])
    _move_order(tables[1], sources, 1.0 / duration, 4 * m + 3, ways[1])
    for axis in range(3):
        for s in range(ways.shape[2]):
            ways[1, axis * m + i, s] -= ways[1, 4 * m + axis, s]


@summing
@no_type_check
def _move_order(tables, sources, scale, columns, ways):
    """One of them; a sum of ten parts is written out, since ten loops take six times as long."""
    a, b, c, d, e = tables[0], tables[1], tables[2], tables[3], tables[4]
    f, g, h, i, j = tables[5], tables[6], tables[7], tables[8], tables[9]
    for column in range(columns):
        row = ways[column]
        k, n, o, p, q = _five(sources, scale, 0, column)
        r, t, u, v, w = _five(sources, scale, 5, column)
        for s in range(len(row)):
            low = k * a[s] + n * b[s] + o * c[s] + p * d[s] + q * e[s]
            row[s] = low + (r * f[s] + t * g[s] + u * h[s] + v * i[s] + w * j[s])


@inner
@no_type_check
def _five(sources, scale, first, column):
    """Five of a column, scaled."""
    a, b, c = sources[first, column], sources[first + 1, column], sources[first + 2, column]
    return scale * a, scale * b, scale * c, scale * sources[first + 3, column], scale * sources[first + 4, column]


@summing
@no_type_check
def _enter_places(place, ways, m, parts):
    """The four columns of each place: away from the obstacle and from the nearer faces, less what speed asks for."""
    a, b, c, f, g, h, p, q, r = place[0], place[1], place[2], place[3], place[4], place[5], place[6], place[7], place[8]
    of_free, of_x, of_y, of_z = place[9], place[10], place[11], place[12]
    for k in range(m):
        free, by_x, by_y, by_z = parts[k, 0], parts[k, 1], parts[k, 2], parts[k, 3]
        x, y, z = ways[0, k], ways[0, m + k], ways[0, 2 * m + k]
        u, v, w = ways[1, k], ways[1, m + k], ways[1, 2 * m + k]
        for s in range(len(free)):
            keep = p[s] * u[s] + q[s] * v[s] + r[s] * w[s]
            free[s] = a[s] * x[s] + b[s] * y[s] + c[s] * z[s] - of_free[s] * keep
            by_x[s] = f[s] * x[s] - of_x[s] * keep
            by_y[s] = g[s] * y[s] - of_y[s] * keep
            by_z[s] = h[s] * z[s] - of_z[s] * keep
    for j in range(m):
        for axis in range(3):
            for number in range(4):
                slope = place[axis] if number == 0 else place[2 + number]
                moves = 1.0 if number == 0 or number == 1 + axis else 0.0
                part, weight, growth = parts[m + 3 * j + axis, number], place[9 + number], place[6 + axis]
                _enter_point(slope, moves, weight, growth, ways[0, 3 * m + j], ways[1, 3 * m + j], part)


@summing
@no_type_check
def _enter_point(slope, moves, weight, growth, at, speed, part):
    """One margin at all places by one of the points, along an axis."""
    for s in range(len(part)):
        part[s] = moves * slope[s] * at[s] - weight[s] * growth[s] * speed[s]


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
    """From derivatives by the state to derivatives by the variables: the columns of one look at the body.

    A sum is written out in one expression: with a loop for each of its parts it takes twice as long.
    """
    by_x, by_y, by_z = _of_axis(slopes, 0), _of_axis(slopes, 1), _of_axis(slopes, 2)
    for own in range(m):
        row = rows[own, begin : begin + WIDTH]
        a, b, c, d = by_x
        e, f, g, h = by_y
        i, j, k, n = by_z
        p, q, r, s = _of_column(moved, own)
        t, u, v, w = _of_column(moved, m + own)
        x, y, z, o = _of_column(moved, 2 * m + own)
        for number in range(WIDTH):
            row[number] = (
                (p * a[number] + q * b[number] + r * c[number] + s * d[number])
                + (t * e[number] + u * f[number] + v * g[number] + w * h[number])
                + (x * i[number] + y * j[number] + z * k[number] + o * n[number])
            )
    for point in range(m):
        p, q, r, s = _of_column(moved, 3 * m + point)
        for axis in range(3):
            row = rows[m + 3 * point + axis, begin : begin + WIDTH]
            a, b, c, d = _of_axis(slopes, axis)
            for number in range(WIDTH):
                row[number] = p * a[number] + q * b[number] + r * c[number] + s * d[number]


@inner
@no_type_check
def _of_axis(slopes, axis):
    """Derivatives by velocity to snap along one axis."""
    return slopes[0, axis], slopes[1, axis], slopes[2, axis], slopes[3, axis]


@inner
@no_type_check
def _of_column(moved, column):
    """How one variable moves velocity to snap."""
    return moved[1, column], moved[2, column], moved[3, column], moved[4, column]


@summing
@no_type_check
def _multiply(rows, columns, sums):
    """Add the product of each row with each of those before it, two by two: what is read serves two products."""
    for a in range(0, len(rows), 2):
        one, next_one = rows[a], rows[a + 1]
        for b in range(0, a + 1, 2):
            other, next_other = rows[b], rows[b + 1]
            t = u = v = w = 0.0
            for column in range(columns):
                p, q, f, g = one[column], next_one[column], other[column], next_other[column]
                t, u, v, w = t + p * f, u + p * g, v + q * f, w + q * g
            sums[a, b] += t
            sums[a, b + 1] += u
            sums[a + 1, b] += v
            sums[a + 1, b + 1] += w
