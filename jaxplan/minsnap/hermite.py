"""Two-point Hermite basis on s in [0, 1] and the exact energy of its highest minimised derivative.

A segment of order r is a polynomial of degree 2r+1 fixed by its value and first r derivatives at both
ends: r = 4 gives degree 9 for position (minimum snap), r = 2 degree 5 for yaw (minimum acceleration).
With end values u = [f(0), f'(0) .. f^(r)(0), f(1) .. f^(r)(1)] (derivatives with respect to s)

    coefficients = COEFFICIENTS(r) @ u            ascending powers of s
    int_0^1 (f^(r))^2 ds = u.T @ ENERGY(r) @ u

Both are computed in exact rational arithmetic and rounded once. Source: Hermite interpolation; the use of
end derivatives as unknowns follows Bry et al., "Aggressive flight of fixed-wing and quadrotor aircraft in
dense indoor environments", IJRR 2015.
"""

import functools
import math
from fractions import Fraction

import numpy as np
from jaxtyping import Float

Matrix = list[list[Fraction]]


@functools.cache
def coefficients(order: int) -> Float[np.ndarray, "{2*order+2} {2*order+2}"]:
    """Map from end values to ascending coefficients in normalised time."""
    return _to_float(_coefficients_exact(order))


@functools.cache
def energy(order: int) -> Float[np.ndarray, "{2*order+2} {2*order+2}"]:
    """Symmetric matrix of the integral of the squared ``order``-th derivative over [0, 1]."""
    n = 2 * order + 2
    basis = _coefficients_exact(order)
    gram = [[Fraction(0)] * n for _ in range(n)]
    for a in range(order, n):
        for b in range(order, n):
            factor = math.perm(a, order) * math.perm(b, order)
            gram[a][b] = Fraction(factor, a + b - 2 * order + 1)
    return _to_float(_multiply(_transpose(basis), _multiply(gram, basis)))


@functools.cache
def energy_root(order: int) -> Float[np.ndarray, "{order+2} {2*order+2}"]:
    """Matrix whose Gram matrix is ``energy``: the r-th derivative in orthonormal Legendre polynomials.

    Squaring after the projection instead of before keeps the energy accurate where it is small beside its parts.
    """
    n = 2 * order + 2
    basis = _coefficients_exact(order)
    rows = []
    for degree in range(order + 2):
        weights = [Fraction(0)] * n
        for a in range(order, n):
            for power, factor in enumerate(_legendre(degree)):
                weights[a] += factor * Fraction(math.perm(a, order), a - order + power + 1)
        rows.append(weights)
    return np.sqrt(2.0 * np.arange(order + 2)[:, None] + 1.0) * _to_float(_multiply(rows, basis))


@functools.cache
def _coefficients_exact(order: int) -> Matrix:
    n = 2 * order + 2
    end_values = [[Fraction(0)] * n for _ in range(n)]
    for derivative in range(order + 1):
        end_values[derivative][derivative] = Fraction(math.factorial(derivative))
        for power in range(derivative, n):
            end_values[order + 1 + derivative][power] = Fraction(math.perm(power, derivative))
    return _inverse(end_values)


def _legendre(degree: int) -> list[Fraction]:
    """Ascending coefficients of the shifted Legendre polynomial on [0, 1]."""
    return [
        Fraction((-1) ** (degree + power) * math.comb(degree, power) * math.comb(degree + power, power))
        for power in range(degree + 1)
    ]


def _inverse(matrix: Matrix) -> Matrix:
    """Gauss-Jordan elimination in rational arithmetic."""
    n = len(matrix)
    work = [[*row, *(Fraction(int(i == j)) for j in range(n))] for i, row in enumerate(matrix)]
    for column in range(n):
        pivot = next(row for row in range(column, n) if work[row][column] != 0)
        work[column], work[pivot] = work[pivot], work[column]
        work[column] = [value / work[column][column] for value in work[column]]
        for row in range(n):
            if row != column and work[row][column] != 0:
                factor = work[row][column]
                work[row] = [a - factor * b for a, b in zip(work[row], work[column], strict=True)]
    return [row[n:] for row in work]


def _multiply(a: Matrix, b: Matrix) -> Matrix:
    return [
        [sum((x * y for x, y in zip(row, column, strict=True)), Fraction(0)) for column in _transpose(b)] for row in a
    ]


def _transpose(a: Matrix) -> Matrix:
    return [list(column) for column in zip(*a, strict=True)]


def _to_float(a: Matrix) -> Float[np.ndarray, "m n"]:
    return np.array([[float(value) for value in row] for row in a])
