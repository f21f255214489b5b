"""Trajectories of degree 9 as ones of degree 7, which is all that small flight computers evaluate (host, NumPy).

A segment becomes several pieces, each with the segment's position, velocity, acceleration and jerk at both ends: the
result is continuous to jerk, and what it is off grows with the eighth power of a piece's length.
"""

import functools
from math import perm
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.polynomials import derivative_table, part_table
from jaxplan.spline import PiecewisePolynomial

SIZE = 8
"""Coefficients of a polynomial of degree 7."""
MOST_PIECES = 64
"""Of one segment."""
_SAMPLES = 33
"""Of a piece, at which the two are compared: they differ by s^4 (1 - s)^4 times a straight line, widest inside."""


class Septic(NamedTuple):
    """A trajectory of degree 7."""

    spline: PiecewisePolynomial
    """Its pieces."""
    error: float
    """Largest distance from the original at any time [m]."""


def as_septic(spline: PiecewisePolynomial, tolerance: float) -> Septic:
    """As few equal pieces of each segment as keep within ``tolerance`` [m]; yaw, of degree 5, stays what it is.

    Raises:
        InputError: a segment would need more than ``MOST_PIECES``.
    """
    durations, positions, yaws, worst = [], [], [], 0.0
    every = zip(np.asarray(spline.durations), np.asarray(spline.position), np.asarray(spline.yaw), strict=True)
    for number, (duration, position, yaw) in enumerate(every):
        count, pieces, error = _fewest(position, tolerance)
        if count == 0:
            raise InputError(
                f"segment {number}: {MOST_PIECES} pieces of degree 7 are {error:.2g} m off, want {tolerance:g} m; "
                "give a larger tolerance"
            )
        turned = np.zeros((count, SIZE))
        turned[:, : len(yaw)] = [_part(yaw, count, k) for k in range(count)]
        durations.append(np.full(count, duration / count))
        positions.append(pieces)
        yaws.append(turned)
        worst = max(worst, error)
    found = PiecewisePolynomial(
        durations=np.concatenate(durations), position=np.concatenate(positions), yaw=np.concatenate(yaws)
    )
    return Septic(found, worst)


def _fewest(position: Float[np.ndarray, "n 3"], tolerance: float) -> tuple[int, Float[np.ndarray, "c 8 3"], float]:
    """How many pieces, their coefficients and error [m]; 0 pieces where too many would be needed."""
    samples = np.linspace(0.0, 1.0, _SAMPLES)
    values, values_again = derivative_table(len(position), samples, 0), derivative_table(SIZE, samples, 0)
    error, pieces = np.inf, np.zeros((0, SIZE, 3))
    for count in range(1, MOST_PIECES + 1):
        parts = np.stack([_part(position, count, k) for k in range(count)])
        pieces = _hermite(len(position)) @ parts
        error = float(np.linalg.norm(values_again @ pieces - values @ parts, axis=-1).max())
        if error <= tolerance:
            return count, pieces, error
    return 0, pieces, error


def _part(coefficients: Float[np.ndarray, "n *d"], count: int, number: int) -> Float[np.ndarray, "n *d"]:
    """One of ``count`` equal parts of a polynomial, in its own time from 0 to 1."""
    return np.asarray(part_table(len(coefficients), number / count, (number + 1) / count) @ coefficients)


@functools.cache
def _hermite(size: int) -> Float[np.ndarray, "8 {size}"]:
    """From coefficients of any degree to those of degree 7 with the same derivatives 0 to 3 at both ends."""

    def ends(count: int) -> Float[np.ndarray, "8 {count}"]:
        rows = np.zeros((8, count))
        for order in range(4):
            rows[order, order] = perm(order, order)
            rows[4 + order, order:] = [perm(power, order) for power in range(order, count)]
        return rows

    return np.linalg.solve(ends(SIZE), ends(size))
