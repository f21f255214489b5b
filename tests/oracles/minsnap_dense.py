"""Minimum snap by brute force: monomials in normalised time, every constraint a row, one KKT system.

Shares nothing with the library: no Hermite basis, no block structure, no scaling. High precision by mpmath.
"""

import functools

import mpmath as mp
import numpy as np


def minimum_derivative(waypoints, durations, initial, terminal, order=4, digits=60, passage=None):
    """Coefficients (m, 2r+2, d) in normalised time and the cost, for prescribed end derivatives.

    ``initial`` and ``terminal`` are (r, d) derivatives 1..r, with NaN rows left free; ``passage`` is the number of an
    inner waypoint and the velocity there.
    """
    with mp.workdps(digits):
        coefficients, cost = _exact(waypoints, durations, initial, terminal, order, passage)
        return np.array(coefficients, dtype=float), float(cost)


def cost_gradient(waypoints, durations, initial, terminal, order=4, digits=60):
    """The cost's derivatives by the durations (m,) and by the waypoints (m+1, d): central differences of 1e-20."""
    with mp.workdps(digits):
        step = mp.mpf(10) ** -20

        def slope(values, index, problem):
            costs = []
            for sign in (1, -1):
                moved = np.array([[mp.mpf(float(v)) for v in np.ravel(row)] for row in values], dtype=object)
                moved[index] += sign * step
                costs.append(_exact(*problem(moved))[1])
            return float((costs[0] - costs[1]) / (2 * step))

        def by_time(moved):
            return waypoints, moved[:, 0], initial, terminal, order

        def by_point(moved):
            return moved, durations, initial, terminal, order

        times = [slope(np.asarray(durations)[:, None], (i, 0), by_time) for i in range(len(durations))]
        points = [[slope(waypoints, (i, k), by_point) for k in range(3)] for i in range(len(waypoints))]
        return np.array(times), np.array(points)


def _exact(waypoints, durations, initial, terminal, order, passage=None):
    points = np.array([[mp.mpf(v) for v in row] for row in waypoints], dtype=object)
    ends = (np.asarray(initial, dtype=float), np.asarray(terminal, dtype=float))
    return _solve(points, [mp.mpf(t) for t in durations], *ends, order, passage)


def _solve(waypoints, durations, initial, terminal, order, passage):
    m, n, d = len(durations), 2 * order + 2, waypoints.shape[1]
    times = [mp.mpf(t) for t in durations]
    rows, right = [], []

    def add(entries, values):
        rows.append(entries)
        right.append(values)

    for i in range(m):
        add({(i, k): v for k, v in _row(n, 0, 0)}, waypoints[i])
        add({(i, k): v for k, v in _row(n, 0, 1)}, waypoints[i + 1])
        for derivative in range(1, order + 1):
            if i + 1 < m:
                left = {(i, k): v / times[i] ** derivative for k, v in _row(n, derivative, 1)}
                left |= {(i + 1, k): -v / times[i + 1] ** derivative for k, v in _row(n, derivative, 0)}
                add(left, np.zeros(d))
    for derivative in range(1, order + 1):
        for segment, side, values in ((0, 0, initial), (m - 1, 1, terminal)):
            if not np.isnan(values[derivative - 1]).any():
                add(
                    {(segment, k): v / times[segment] ** derivative for k, v in _row(n, derivative, side)},
                    values[derivative - 1],
                )
    if passage is not None:
        segment, velocity = passage
        add({(segment, k): v / times[segment] for k, v in _row(n, 1, 0)}, velocity)
    return _kkt(rows, right, times, order, m, n, d)


def _kkt(rows, right, times, order, m, n, d):
    size = m * n
    system = mp.zeros(size + len(rows), size + len(rows))
    vector = mp.zeros(size + len(rows), d)
    gram = [[mp.mpf(0)] * n for _ in range(n)]
    for a in range(order, n):
        for b in range(order, n):
            gram[a][b] = mp.ff(a, order) * mp.ff(b, order) / (a + b - 2 * order + 1)
    for i in range(m):
        weight = times[i] ** (1 - 2 * order)
        for a in range(n):
            for b in range(n):
                system[i * n + a, i * n + b] = 2 * gram[a][b] * weight
    for row, (entries, values) in enumerate(zip(rows, right, strict=True)):
        for (i, k), value in entries.items():
            system[size + row, i * n + k] = value
            system[i * n + k, size + row] = value
        for axis in range(d):
            vector[size + row, axis] = mp.mpf(values[axis])
    solution = _columns(system, vector, d)
    coefficients = [[[solution[i * n + k, axis] for axis in range(d)] for k in range(n)] for i in range(m)]
    cost = mp.mpf(0)
    for i in range(m):
        for axis in range(d):
            for a in range(n):
                for b in range(n):
                    cost += (
                        gram[a][b] * times[i] ** (1 - 2 * order) * coefficients[i][a][axis] * coefficients[i][b][axis]
                    )
    return coefficients, cost


def _columns(system, vector, d):
    """Solve for several right-hand sides with one factorisation."""
    factor, pivots = _factors(tuple(system), system.rows, mp.mp.prec)
    out = mp.zeros(vector.rows, d)
    for axis in range(d):
        column = mp.mp.U_solve(factor, mp.mp.L_solve(factor, vector[:, axis], pivots))
        for row in range(vector.rows):
            out[row, axis] = column[row]
    return out


@functools.lru_cache(maxsize=1)
def _factors(entries, size, precision):
    """Triangular factors of a square system, kept for the next right-hand side."""
    system = mp.matrix(size, size)
    for k, entry in enumerate(entries):
        system[k // size, k % size] = entry
    return mp.mp.LU_decomp(system)


def _row(n, derivative, s):
    """Non-zero entries of the row that evaluates a derivative in normalised time at s = 0 or 1."""
    if s == 0:
        return [(derivative, mp.factorial(derivative))]
    return [(k, mp.ff(k, derivative)) for k in range(derivative, n)]
