"""Many splines as arrays of fixed shape, and their references at the controller's instants.

Flights differ in length and in segments; programs do not. Segments are padded to one of a few counts, and references
are sampled block by block in float64, so that a long flight costs no more precision or memory than a short one.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplan.arrays import AnyArray
from jaxplan.errors import InputError
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.precision import in_float64
from jaxplan.records import replace
from jaxplan.spline import FlatState, PiecewisePolynomial

if TYPE_CHECKING:
    Splines = PiecewisePolynomial | Sequence[PiecewisePolynomial] | SplineBatch
else:
    Splines = Any  # ``as_sequence`` looks at what it gets, and has a message of its own
"""One trajectory, a list of them, or the batch that the planner makes."""

_LEAST_SEGMENTS = 4
"""Smallest padded number of segments; larger ones are this times a power of 4 (arbitrary)."""


def as_sequence(splines: Splines) -> Sequence[PiecewisePolynomial] | SplineBatch:
    """A list or a batch, neither empty; ``InputError`` for anything else. Splines without yaw keep the heading 0."""
    found = [splines] if isinstance(splines, PiecewisePolynomial) else splines
    if isinstance(found, SplineBatch):
        return found
    if not isinstance(found, Sequence) or not found or not all(isinstance(s, PiecewisePolynomial) for s in found):
        raise InputError(
            f"splines: have {type(splines).__name__}, want a PiecewisePolynomial, a list of at least one of them, or "
            "the splines of Plans"
        )
    return [_with_yaw(spline) for spline in found]


def _with_yaw(spline: PiecewisePolynomial) -> PiecewisePolynomial:
    if spline.yaw is not None:
        return spline
    return replace(spline, yaw=np.zeros((len(spline.durations), 6)))


def duration_of_each(splines: Sequence[PiecewisePolynomial] | SplineBatch) -> Float[np.ndarray, "k"]:
    """Seconds; NaN where a duration or a coefficient is not finite or a duration is negative."""
    if isinstance(splines, SplineBatch):
        durations = np.asarray(splines.durations, dtype=np.float64)
        good = np.all(durations >= 0.0, axis=0) & np.all(np.isfinite(splines.position), axis=(0, 1, 2))
        good &= np.all(np.isfinite(splines.yaw), axis=(0, 1, 2))
        return np.where(good, durations.sum(axis=0), np.nan)
    values = np.full(len(splines), np.nan)
    for index, spline in enumerate(splines):
        durations = np.asarray(spline.durations, dtype=np.float64)
        finite = np.all(np.isfinite(spline.position)) and np.all(np.isfinite(np.asarray(spline.yaw)))
        if finite and np.all(durations >= 0.0):
            values[index] = durations.sum()
    return values


class PaddedSplines(NamedTuple):
    """The fields of a ``PiecewisePolynomial`` with a leading batch axis and a common number of segments."""

    durations: Float[AnyArray, "b m"]
    position: Float[AnyArray, "b m n 3"]
    yaw: Float[AnyArray, "b m k"]


def padded(splines: Sequence[PiecewisePolynomial] | SplineBatch, chosen: Int[np.ndarray, "b"]) -> PaddedSplines:
    """The ``chosen`` flights, in NumPy float64."""
    if isinstance(splines, SplineBatch):
        last_first = [np.moveaxis(np.asarray(leaf)[..., chosen], -1, 0) for leaf in jax.tree.leaves(splines)]
        durations, position, yaw = (np.asarray(leaf, dtype=np.float64) for leaf in last_first)
        flights = [(durations, position, yaw[..., 0])]
    else:
        flights = [jax.tree.map(lambda leaf: np.asarray(leaf)[None], _leaves(splines[index])) for index in chosen]
    segments = _bucket(max(flight[0].shape[1] for flight in flights))
    widths = [max(flight[i].shape[2] for flight in flights) for i in (1, 2)]
    shapes = [(segments,), (segments, widths[0], 3), (segments, widths[1])]
    grown = [[_grow(leaf, shape) for leaf, shape in zip(flight, shapes, strict=True)] for flight in flights]
    durations, position, yaw = (np.concatenate(parts) for parts in zip(*grown, strict=True))
    return PaddedSplines(durations, position, yaw)


@in_float64
def references_at(splines: PaddedSplines, times: Float[np.ndarray, "n"]) -> FlatState:
    """The references of all flights at ``times`` [s], (b, n), rounded to float32."""
    return _sample(splines, times)


@jax.jit
def _sample(splines: PaddedSplines, times: Float[Array, "n"]) -> FlatState:
    states = jax.vmap(lambda flight: PiecewisePolynomial(**flight._asdict()).state(times))(splines)
    return jax.tree.map(lambda leaf: leaf.astype(jnp.float32), states)


def _leaves(spline: PiecewisePolynomial) -> tuple[np.ndarray, ...]:
    return tuple(np.asarray(leaf, dtype=np.float64) for leaf in (spline.durations, spline.position, spline.yaw))


def _bucket(segments: int) -> int:
    size = _LEAST_SEGMENTS
    while size < segments:
        size *= 4
    return size


def _grow(array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Zeros behind ``array`` along every axis but the first."""
    extra = [(0, want - have) for want, have in zip(shape, array.shape[1:], strict=True)]
    return np.pad(array, [(0, 0), *extra])
