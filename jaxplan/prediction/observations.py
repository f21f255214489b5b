"""What a predictor is given of the target."""

from typing import no_type_check

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.records import record
from jaxplan.validation import as_finite, as_number

_SAME_INSTANT = 1e-6
"""Seconds by which a time may differ from that which is asked for."""


@record
class Observations:
    """The newest target positions, oldest first, at least one; from a stream, equally spaced in time."""

    times: Float[np.ndarray, "n"]
    """Seconds, increasing."""
    positions: Float[np.ndarray, "n 3"]
    """Metres, world."""
    age: float = 0.0
    """Seconds from the newest position until now, the instant from which arrival times count."""

    def newest(self, count: int, apart: float) -> "Observations":
        """The newest positions that are so far ``apart`` [s], ``count`` at most; what lies between is left out."""
        wanted = self.times[-1] - apart * np.arange(count)
        place = np.searchsorted(self.times, wanted - _SAME_INSTANT)
        there = np.abs(self.times[place] - wanted) < _SAME_INSTANT
        chosen = place[: count if there.all() else int(there.argmin())][::-1]
        return Observations(times=self.times[chosen], positions=self.positions[chosen], age=self.age)

    def within(self, span: float) -> "Observations":
        """All positions of the last ``span`` seconds, the newest one at least."""
        first = int(np.searchsorted(self.times, self.times[-1] - span - _SAME_INSTANT))
        return Observations(times=self.times[first:], positions=self.positions[first:], age=self.age)


@no_type_check
def usual_observations(observations: Observations) -> Observations:
    """Arrays of float64. Raises ``InputError`` unless there is a position, all are finite and the times ascend."""
    times = as_finite("observations: times", observations.times, (None,))
    positions = as_finite("observations: positions", observations.positions, (len(times), 3))
    age = as_number("observations: age", observations.age)
    if not len(times) or not (np.diff(times) > 0.0).all() or age < 0.0:
        raise InputError("observations: want one position or more, at ascending times, of an age of 0 s or more")
    return Observations(times=times, positions=positions, age=age)


def first_observation(time: float, position: Float[np.ndarray, "3"]) -> Observations:
    """A target that was seen just once, now."""
    return Observations(times=np.array([float(time)]), positions=np.asarray(position, dtype=float)[None])
