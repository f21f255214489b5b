"""Polynomials on [0, 1] by their ascending coefficients: values, derivatives, control points of their parts.

The tables are NumPy in float64 and are made once, where a function is built; a product with one is a dense operation
that JAX and NumPy both do fast.
"""

import functools
import itertools
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxplan.arrays import AnyArray, namespace


def horner(
    coefficients: Sequence[Float[AnyArray, "*shape"]],
    s: Float[AnyArray, "*#shape"],
    duration: Float[AnyArray, "*#shape"],
    derivative: int,
) -> Float[AnyArray, "*shape"]:
    """Values of the ``derivative``-th time derivative at ``s`` in [0, 1], by Horner's rule.

    There is one array of coefficients for each power, in any layout. ``duration`` [s], which must not be 0, is the time
    that s takes from 0 to 1.
    """
    value = namespace(coefficients[0]).zeros_like(coefficients[0])
    for power in range(len(coefficients) - 1, derivative - 1, -1):
        value = value * s + math.perm(power, derivative) * coefficients[power]
    return value / duration**derivative


def derivative_table(count: int, s: Float[np.ndarray, "p"], derivative: int) -> Float[np.ndarray, "p {count}"]:
    """Map from ``count`` coefficients to the ``derivative``-th derivative in s at many ``s``."""
    table = np.zeros((len(s), count))
    for power in range(derivative, count):
        table[:, power] = math.perm(power, derivative) * s ** (power - derivative)
    return table


def part_table(count: int, start: float, end: float) -> Float[np.ndarray, "{count} {count}"]:
    """Map from ``count`` coefficients to those of the part from ``start`` to ``end``, as a polynomial on [0, 1]."""
    table = np.zeros((count, count))
    for power in range(count):
        for k in range(power + 1):
            table[k, power] = math.comb(power, k) * start ** (power - k) * (end - start) ** k
    return table


@functools.cache
def control_point_table(count: int, derivative: int, pieces: int) -> Float[np.ndarray, "p {count}"]:
    """Map from ``count`` coefficients to the control points of a derivative in s on each of equal ``pieces`` of [0, 1].

    On a piece the derivative lies in the convex hull of its count - derivative control points, the Bernstein
    coefficients (Farouki, CAGD 29(6), 2012). The rows are piece after piece.
    """
    degree = count - 1 - derivative
    slope = np.zeros((degree + 1, count))
    bernstein = np.zeros((degree + 1, degree + 1))
    for power in range(degree + 1):
        slope[power, power + derivative] = math.perm(power + derivative, derivative)
        for point in range(power, degree + 1):
            bernstein[point, power] = math.comb(point, power) / math.comb(degree, power)
    cuts = np.linspace(0.0, 1.0, pieces + 1)
    return np.concatenate([bernstein @ part_table(degree + 1, a, b) @ slope for a, b in itertools.pairwise(cuts)])
