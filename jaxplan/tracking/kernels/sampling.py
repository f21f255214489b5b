"""References along splines, compiled (host): ``PiecewisePolynomial.state`` for many splines at many instants."""

import functools
from typing import Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxplan.spline import FlatState
from jaxplan.tracking.kernels.compiled import entry_point, inner, source_digest


def references(
    durations: Float[np.ndarray, "k m"],
    position: Float[np.ndarray, "k m n 3"],
    yaw: Float[np.ndarray, "k m q"],
    times: Float[np.ndarray, "t"],
) -> FlatState:
    """Flat states (k, t) of k splines at ``times`` [s of their own]; their ends before and behind."""
    derivatives, turns = np.empty((len(durations), len(times), 5, 3)), np.empty((len(durations), len(times), 3))
    durations, position, yaw, times = (np.ascontiguousarray(leaf, float) for leaf in (durations, position, yaw, times))
    _compiled_sample()(durations, position, yaw, times, derivatives, turns)
    return FlatState(derivatives=derivatives, yaw=turns)


@runtime_checkable
class _Sample(Protocol):
    def __call__(
        self,
        durations: np.ndarray,
        position: np.ndarray,
        yaw: np.ndarray,
        times: np.ndarray,
        derivatives: np.ndarray,
        turns: np.ndarray,
    ) -> None:
        """Writes the states."""


@functools.cache
def _compiled_sample() -> _Sample:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(durations, position, yaw, times, derivatives, turns):
        _ = version
        for k in range(len(durations)):
            for i in range(len(times)):
                segment, share, duration = _locate(durations[k], times[i])
                _write(position[k, segment], share, duration, derivatives[k, i])
                _write(yaw[k, segment].reshape(-1, 1), share, duration, turns[k, i].reshape(-1, 1))

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _locate(durations, time):
    """The segment at a time, the share of it that is over, and its duration; padding is never entered."""
    last = len(durations) - 1
    while last > 0 and durations[last] <= 0.0:
        last -= 1
    segment, end = 0, durations[0]
    while segment < last and time >= end:
        segment += 1
        end += durations[segment]
    local = time - (end - durations[segment])
    duration = durations[segment] if durations[segment] > 0.0 else 1.0
    return segment, min(max(local / duration, 0.0), 1.0), duration


@inner
@no_type_check
def _write(coefficients, share, duration, rows):
    """A polynomial's value and derivatives, as many as there are rows, by Horner's rule for all of them at once."""
    orders, axes = rows.shape
    for axis in range(axes):
        for order in range(orders):
            rows[order, axis] = 0.0
        for power in range(len(coefficients) - 1, -1, -1):
            for order in range(orders - 1, 0, -1):
                rows[order, axis] = rows[order, axis] * share + rows[order - 1, axis]
            rows[0, axis] = rows[0, axis] * share + coefficients[power, axis]
        scale = 1.0
        for order in range(1, orders):
            scale *= order / duration
            rows[order, axis] *= scale
