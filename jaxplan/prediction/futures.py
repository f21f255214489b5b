"""What may become of the target: whole motions, each with its probability."""

import numpy as np
from jaxtyping import Float

from jaxplan.arrays import AnyArray
from jaxplan.records import record


@record
class Futures:
    """n motions of which one comes true."""

    times: Float[AnyArray, "s"]
    """Seconds from the instant of the prediction, rising; the first one is that of the newest observation."""
    positions: Float[AnyArray, "n s 3"]
    """Where each motion is then [m, world]."""
    weights: Float[AnyArray, "n"]
    """Their probabilities; together 1."""

    def at(self, times: Float[np.ndarray, "t"]) -> Float[np.ndarray, "n t 3"]:
        """Where each motion is [m, world] at ``times`` [s], straight on between its own, at rest beyond them (host)."""
        own, positions = np.asarray(self.times), np.asarray(self.positions)
        if len(own) == 1:
            return np.repeat(positions, len(times), axis=1)
        before = np.clip(np.searchsorted(own, times, side="right") - 1, 0, len(own) - 2)
        share = np.clip((times - own[before]) / (own[before + 1] - own[before]), 0.0, 1.0)[:, None]
        rows = np.swapaxes(positions, 0, 1).reshape(len(own), -1)  # whole rows are gathered at once
        there = rows[before] * (1.0 - share) + rows[before + 1] * share
        return np.asarray(np.swapaxes(there.reshape(len(times), -1, 3), 0, 1))
