"""Flights and densities of a conditional mixture, compiled (host): ``jaxplan.prediction.mixture``.

What a mixture is conditioned on is one product of a matrix and a vector, in NumPy.
"""

import functools
import math
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxplan.prediction.kernels.beliefs import LOG_TWO_PI, log_sum
from jaxplan.prediction.kernels.compiled import entry_point, inner, source_digest
from jaxplan.prediction.mixture import ConditionalMixture


class Conditioned(NamedTuple):
    """A mixture given what is observed."""

    log_weights: Float[np.ndarray, "k"]
    """Normalised."""
    means: Float[np.ndarray, "f k"]
    """Future coordinates [m]."""
    distance: float
    """Least squared Mahalanobis distance of what is observed from a component."""


def conditioned(model: ConditionalMixture, observed: Float[np.ndarray, "q"]) -> Conditioned:
    """``jaxplan.prediction.mixture.condition`` in NumPy, of a model in NumPy."""
    size, (rows, components) = len(observed), np.shape(model.constants)
    affine = np.asarray(model.rows).reshape(rows * components, size) @ observed
    affine = affine.reshape(rows, components) + model.constants
    squared = (affine[:size] ** 2).sum(axis=0)
    exponents = model.log_weights - 0.5 * squared
    most = exponents.max()
    log_weights = exponents - (most + np.log(np.exp(exponents - most).sum()))
    return Conditioned(log_weights, affine[size:], float(squared.min()))


def flights_of(
    model: ConditionalMixture,
    given: Conditioned,
    newest: Float[np.ndarray, "3"],
    uniform: Float[np.ndarray, "n"],
    normal: Float[np.ndarray, "n r"],
) -> Float[np.ndarray, "n s 3"]:
    """Particles [m, world].

    Args:
        model: in NumPy.
        given: the same, given what was seen.
        newest: position that was seen [m, world].
        uniform, normal: numbers in [0, 1) that choose the components, and standard normal ones.
    """
    shares = np.cumsum(np.exp(given.log_weights))
    component = (uniform[:, None] * shares[-1] >= shares[None, :-1]).sum(axis=1)
    flights = np.ascontiguousarray(given.means.T)[component]
    flights += np.tile(newest, flights.shape[1] // 3)
    _compiled_flights()(np.asarray(model.modes), component, normal, flights)
    return flights.reshape(len(flights), -1, 3)


def log_densities(
    model: ConditionalMixture,
    given: Conditioned,
    newest: Float[np.ndarray, "3"],
    positions: Float[np.ndarray, "h 3"],
    tolerance: float,
) -> Float[np.ndarray, "h"]:
    """Log-density [log 1/m^3] that a mixture gives to each of the next positions [m, world], to ``tolerance`` [m].

    ``newest`` is the position [m, world] before them.
    """
    found, exponents = np.zeros(len(positions)), np.zeros(len(given.log_weights))
    off, factors = np.ascontiguousarray(positions - newest), np.asarray(model.factors)
    _compiled_densities()(factors, given.log_weights, given.means, off, float(tolerance), exponents, found)
    return found


@runtime_checkable
class _Flights(Protocol):
    def __call__(
        self,
        modes: Float[np.ndarray, "k r f"],
        component: np.ndarray,
        normal: Float[np.ndarray, "n r"],
        flights: Float[np.ndarray, "n f"],
    ) -> None:
        """Add to the ``flights`` what is apart from the means."""


@functools.cache
def _compiled_flights() -> _Flights:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(modes, component, normal, flights):
        _ = version
        for n in range(len(flights)):
            for r in range(modes.shape[1]):
                _move(normal[n, r], modes[component[n], r], flights[n])

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _move(share, mode, flight):
    """Add a share of a mode to a flight."""
    for f in range(len(flight)):
        flight[f] += share * mode[f]


@runtime_checkable
class _Densities(Protocol):
    def __call__(
        self,
        factors: Float[np.ndarray, "s 3 3 k"],
        log_weights: Float[np.ndarray, "k"],
        means: Float[np.ndarray, "f k"],
        off: Float[np.ndarray, "h 3"],
        tolerance: float,
        exponents: Float[np.ndarray, "k"],
        found: Float[np.ndarray, "h"],
    ) -> None:
        """Write ``found``; ``exponents`` is overwritten."""


@functools.cache
def _compiled_densities() -> _Densities:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(factors, log_weights, means, off, tolerance, exponents, found):
        _ = version
        for h in range(len(off)):
            for k in range(len(log_weights)):
                x = off[h, 0] - means[3 * h, k]
                y = off[h, 1] - means[3 * h + 1, k]
                z = off[h, 2] - means[3 * h + 2, k]
                exponents[k] = log_weights[k] + _exponent(factors[h], k, tolerance * tolerance, x, y, z)
            found[h] = log_sum(exponents) - 1.5 * LOG_TWO_PI

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _exponent(factors, k, variance, x, y, z):
    """Log-density, but for a constant, of a normal distribution with one component's factor and some more variance."""
    a, b, c = factors[0, 0, k], factors[1, 0, k], factors[1, 1, k]
    d, e, f = factors[2, 0, k], factors[2, 1, k], factors[2, 2, k]
    u = math.sqrt(a * a + variance)
    v, p = a * b / u, a * d / u
    w = math.sqrt(b * b + c * c + variance - v * v)
    q = (b * d + c * e - v * p) / w
    r = math.sqrt(d * d + e * e + f * f + variance - p * p - q * q)
    x = x / u
    y = (y - v * x) / w
    z = (z - p * x - q * y) / r
    return -math.log(u) - math.log(w) - math.log(r) - 0.5 * (x * x + y * y + z * z)
