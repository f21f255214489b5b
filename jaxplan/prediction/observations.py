"""What the defender has seen of the target so far."""

import numpy as np
from jaxtyping import Float

from jaxplan.records import record


@record
class Observations:
    """The newest target positions, oldest first, at least one."""

    times: Float[np.ndarray, "n"]
    """Seconds, increasing."""
    positions: Float[np.ndarray, "n 3"]
    """Metres, world."""

    def add(self, time: float, position: Float[np.ndarray, "3"], keep: int) -> "Observations":
        """These observations and one newer, of which the last ``keep`` are kept."""
        return Observations(
            times=np.append(self.times, time)[-keep:],
            positions=np.concatenate([self.positions, np.asarray(position)[None]])[-keep:],
        )


def first_observation(time: float, position: Float[np.ndarray, "3"]) -> Observations:
    return Observations(times=np.array([float(time)]), positions=np.asarray(position, dtype=float)[None])
