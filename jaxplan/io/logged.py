"""What the readers of flight logs hand over, whatever the log's format."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError


class Logged(NamedTuple):
    """A recorded flight out of a log with many topics."""

    times: Float[np.ndarray, "n"]
    """Seconds, strictly increasing."""
    positions: Float[np.ndarray, "n 3"]
    """Metres, in the log's own axes."""
    frame: str
    """Those axes: ``enu`` or ``ned``."""
    chosen: str
    """Which topic it is, and what was left out of it."""


def tidied(
    times: Float[np.ndarray, "n"], positions: Float[np.ndarray, "n 3"], topic: str, frame: str, notes: list[str]
) -> Logged:
    """Samples without those that are no numbers and those that repeat a time, both of which are counted and said.

    Raises:
        InputError: less than two are left, or a time goes backwards.
    """
    known = np.isfinite(positions).all(axis=1) & np.isfinite(times)
    times, positions, lost = times[known], positions[known], int((~known).sum())
    if lost:
        notes = [*notes, f"{lost} of {len(known)} samples without a position left out"]
    repeated = np.concatenate([[False], np.diff(times) == 0.0]) if len(times) else np.zeros(0, bool)
    if repeated.any():
        notes = [*notes, f"{int(repeated.sum())} samples that repeat a time left out"]
    times, positions = times[~repeated], positions[~repeated]
    if len(times) < 2:
        raise InputError(f"{topic}: have {len(times)} samples with a position, want at least 2; choose another topic")
    backwards = np.flatnonzero(np.diff(times) < 0.0)
    if len(backwards):
        i = int(backwards[0])
        raise InputError(
            f"{topic}: the time goes backwards, have {times[i + 1]:.9g} s after {times[i]:.9g} s (sample {i + 2}); "
            "choose another topic or time"
        )
    axes = "north, east, down" if frame == "ned" else "z up"
    return Logged(times, positions, frame, "; ".join([f"{topic} as {axes}", *notes]))
