"""What a predictor is given of the target."""

import numpy as np
from jaxtyping import Float

from jaxplan.records import record


@record
class Observations:
    """The newest target positions, oldest first, at least one; from a stream, equally spaced in time."""

    times: Float[np.ndarray, "n"]
    """Seconds, increasing."""
    positions: Float[np.ndarray, "n 3"]
    """Metres, world."""
    age: float = 0.0
    """Seconds from the newest position until now, the instant from which arrival times count."""


def first_observation(time: float, position: Float[np.ndarray, "3"]) -> Observations:
    """A target that was seen just once, now."""
    return Observations(times=np.array([float(time)]), positions=np.asarray(position, dtype=float)[None])
