"""Flights as few numbers: the principal components of how far a target gets along one axis (host, or JAX).

A flight is ``STEPS`` positions after the newest one, as the target sees it. Each axis has the same six curves, the
strongest that were found in training; what they leave out of held-out flights at up to 10 m/s is below 1.1 cm for half
of the positions and below 7 cm for nine tenths.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.arrays import AnyArray
from jaxplan.prediction.mdn.view import STEPS

CURVES = 6
COEFFICIENTS = 3 * CURVES


class Curves(NamedTuple):
    """The six curves, and how much of each a flight has."""

    shapes: Float[AnyArray, "s m"]
    """Orthonormal columns."""
    spreads: Float[AnyArray, "3 m"]
    """Deviation of their coefficients over all flights, by axis."""


def fitted_curves(flights: Float[np.ndarray, "n s 3"]) -> Curves:
    """The curves of these flights, in units of length of one's own; float32 (host)."""
    sides = np.swapaxes(flights.astype(np.float64), 1, 2).reshape(-1, STEPS)
    _, vectors = np.linalg.eigh(sides.T @ sides)
    shapes = vectors[:, ::-1][:, :CURVES]
    spreads = np.einsum("sm,nsa->nam", shapes, flights).std(axis=0) + 1e-4
    return Curves(shapes.astype(np.float32), spreads.astype(np.float32))


def coefficients_of(curves: Curves, flights: Float[AnyArray, "n s 3"]) -> Any:
    """(n, c): coefficients over their spreads, x first."""
    sides = flights.swapaxes(1, 2) @ curves.shapes
    return (sides / curves.spreads[None]).reshape(len(flights), COEFFICIENTS)


def flights_of(curves: Curves, coefficients: Float[AnyArray, "n c"]) -> Any:
    """(n, s, 3): the flights with these coefficients."""
    sides = coefficients.reshape(len(coefficients), 3, CURVES) * curves.spreads[None]
    return (sides @ curves.shapes.T).swapaxes(1, 2)


def places_at(curves: Curves, steps: int) -> Float[np.ndarray, "h 3 c"]:
    """What coefficients are multiplied by for the positions at the first steps (host)."""
    shares = np.zeros((steps, 3, 3, CURVES))
    for axis in range(3):
        shares[:, axis, axis] = np.asarray(curves.shapes)[:steps] * np.asarray(curves.spreads)[axis]
    return shares.reshape(steps, 3, COEFFICIENTS)
