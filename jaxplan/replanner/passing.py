"""Boxes that move, at the instants at which they will be where: what a plan keeps from them.

The map holds still what will be swept soon, as far as that leaves room for plans to begin. Whether a plan, or what is
left of the committed one, is hit is a question of instants, and answered here: a vehicle that stands in the way of a
box has to leave, although nothing touches it yet.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxplan.errors import InputError
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.planner import Rollouts, sampled
from jaxplan.planner.rollouts import LOOKED_AT
from jaxplan.replanner.committed import CommittedPlans
from jaxplan.spline import PiecewisePolynomial
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.validation import as_shaped

LESS = 0.1
"""m; how much nearer a committed plan may come before it is given up: ways that are foreseen anew in each cycle are
never quite the same (arbitrary). So much nearer may the model come, too, which strays from its plan, and a plan that
begins where the vehicle is nearer already than it is to keep."""


class Ways(NamedTuple):
    """Where boxes along the room's axes are expected. Beyond the last instant nothing is known of them.

    Nothing at all is known of a box whose corners are NaN.
    """

    times: Float[np.ndarray, "n"]
    """Ascending [s], on the clock of the cycles; 0.05 s apart or less."""
    lower: Float[np.ndarray, "b n 3"]
    """Lower corners [m, world]."""
    upper: Float[np.ndarray, "b n 3"]
    """Upper corners [m, world]."""
    keep: float
    """What plans keep from them [m]: the vehicle's radius, and what it strays."""


def usual_ways(ways: Ways) -> Ways:
    """Arrays of float64, of the boxes that are known of.

    Raises ``InputError`` for shapes that do not fit, and for numbers that are not finite.
    """
    times = np.atleast_1d(np.asarray(ways.times, dtype=float))
    count = np.shape(ways.lower)[0] if np.ndim(ways.lower) else 0
    lower, upper = (as_shaped("ways: corner", part, (count, len(times), 3)) for part in ways[1:3])
    known = ~(np.isnan(lower).all(axis=(1, 2)) & np.isnan(upper).all(axis=(1, 2)))
    lower, upper = lower[known], upper[known]
    finite = all(np.isfinite(part).all() for part in (times, lower, upper, ways.keep))
    if not finite or not (np.diff(times) > 0.0).all() or not (lower <= upper).all() or not ways.keep >= 0.0:
        raise InputError("ways: want ascending finite times, lower <= upper at each of them, and keep of at least 0 m")
    return Ways(times, lower, upper, float(ways.keep))


class Passing:
    """How near plans come to what moves."""

    def __init__(self, ways: Ways, committed: CommittedPlans, now: float) -> None:
        later = ways.times >= now
        self._ways = Ways(ways.times[later], ways.lower[:, later], ways.upper[:, later], ways.keep)
        self._now, self._kept = now, np.asarray(committed.reference(self._ways.times).pos)
        self.keep, self.least = ways.keep, ways.keep - LESS
        """What plans keep, and what is kept at least, by what is committed and by the model of the vehicle [m]."""
        self.nearest = float(self._apart(self._kept[None])[0])
        """Least distance [m] of what is committed already."""

    @property
    def is_kept(self) -> bool:
        """Whether what is committed is clear enough to be kept."""
        return self.nearest >= self.least

    def wanted(self, takeover: float) -> float:
        """What a plan is to keep [m] that takes over at ``takeover`` [s]: less where the vehicle is nearer by then."""
        before = self._ways.times <= takeover
        return self.keep if self._apart(self._kept[None, before], before)[0] >= self.keep else self.least

    def along(self, splines: SplineBatch | PiecewisePolynomial, takeover: float) -> Float[np.ndarray, "k"]:
        """The same for plans that take over at ``takeover`` [s]; until then what is committed is flown."""
        positions = np.asarray(sampled(splines, self._ways.times - takeover).pos)
        return self._apart(np.where((self._ways.times < takeover)[:, None], self._kept, positions))

    def flown(self, rollouts: Rollouts) -> Float[np.ndarray, "k"]:
        """The same for where the model of the vehicle comes along plans, as long as it flies them."""
        at = (self._ways.times - self._now) * CONTROL_RATE / LOOKED_AT - 1.0
        inside = (at >= 0.0) & (at <= rollouts.positions.shape[1] - 1)
        before, after = np.floor(at[inside]).astype(int), np.ceil(at[inside]).astype(int)
        share = (at[inside] - before)[:, None]
        positions = (1.0 - share) * rollouts.positions[:, before] + share * rollouts.positions[:, after]
        return self._apart(positions, inside)

    def _apart(
        self, positions: Float[np.ndarray, "k n 3"], instants: Bool[np.ndarray, "m"] | slice = slice(None)
    ) -> Float[np.ndarray, "k"]:
        """Least distance [m] from all boxes at these instants; inf where there is nothing, -inf for what is NaN.

        Within a box, which may be larger than what is seen, it is negative: less is deeper, and one can leave it.
        """
        least = np.full(len(positions), np.inf)
        for lower, upper in zip(self._ways.lower[:, instants], self._ways.upper[:, instants], strict=True):
            beyond = np.maximum(lower - positions, positions - upper)
            outside = np.sqrt((np.maximum(beyond, 0.0) ** 2).sum(axis=2))
            apart = outside + np.minimum(beyond.max(axis=2), 0.0)
            least = np.minimum(least, apart.min(axis=1, initial=np.inf))
        return np.asarray(np.where(np.isnan(least), -np.inf, least))
