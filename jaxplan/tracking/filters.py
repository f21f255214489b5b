"""Second-order Butterworth low-pass: x'' = w^2 (u - x) - sqrt(2) w x', stepped by implicit Euler.

The same filter runs on every signal that the controller compares, so that all are late by the same time; x' serves as
the derivative. Cutoff as in the MFRL simulator (30 Hz: w^2 = 35530.6, sqrt(2) w = 266.57).
"""

import math

from jaxtyping import Float

from jaxplan.arrays import AnyArray
from jaxplan.records import record

CUTOFF_HZ = 30.0
"""MFRL simulator; Tal & Karaman 2021 use the same (188.5 rad/s)."""

_OMEGA = 2.0 * math.pi * CUTOFF_HZ


@record
class FilterState:
    """A filtered signal of any shape and its derivative."""

    value: Float[AnyArray, "*signal"]
    """Unit of the signal."""
    rate: Float[AnyArray, "*signal"]
    """Unit of the signal per second."""


def filter_step(state: FilterState, signal: Float[AnyArray, "*signal"], dt: float) -> FilterState:
    """The filter after ``dt`` [s] of the input ``signal``."""
    gain = dt * _OMEGA**2
    rate = (state.rate + gain * (signal - state.value)) * (1.0 / (1.0 + dt * (math.sqrt(2.0) * _OMEGA + gain)))
    return FilterState(value=state.value + dt * rate, rate=rate)
