"""What a cycle can fly beside plans that meet candidates: corrections, approaches and stops, and which is taken."""

from typing import SupportsIndex

import numpy as np
from jaxtyping import Float, UInt32

from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.planner.rollouts import Rollouts
from jaxplan.records import record
from jaxplan.selection import Margins
from jaxplan.selection import select as select_best
from jaxplan.spline import PiecewisePolynomial
from jaxplan.status import Reason


class _Solved:
    """What all of them can tell of one of theirs."""

    splines: SplineBatch
    margins: Margins

    def spline(self, index: SupportsIndex) -> PiecewisePolynomial:
        """One of the trajectories (host, NumPy)."""
        return self.splines.spline(index)

    def probability(self, index: SupportsIndex) -> float:
        """Of trajectory ``index`` being tracked, by the classifier; NaN where the rotor limits decided."""
        return float(np.asarray(self.margins.probability)[index])


@record
class Approaches(_Solved):
    """Trajectories towards goals that cannot be met in time, each a goal, a part of its path and a pace."""

    goals: Float[np.ndarray, "n 3"]
    """Positions [m, world] that the paths lead to."""
    arrival_times: Float[np.ndarray, "n"]
    """When each target is at its goal [s from the start state]."""
    alpha: Float[np.ndarray, "n"]
    """Scale factor of the time allocation."""
    lateness: Float[np.ndarray, "n"]
    """How much later than the target [s] the vehicle would be at the goal at this pace."""
    reasons: UInt32[np.ndarray, "n"]
    """0 means usable."""
    splines: SplineBatch
    margins: Margins


@record
class Corrections(_Solved):
    """Short trajectories straight towards where the target is expected, for a vehicle in flight."""

    goals: Float[np.ndarray, "n 3"]
    """Positions [m, world] that are passed."""
    arrival_times: Float[np.ndarray, "n"]
    """When [s from the start state]."""
    reasons: UInt32[np.ndarray, "n"]
    """0 means usable."""
    splines: SplineBatch
    margins: Margins


@record
class Stops(_Solved):
    """Trajectories that come to rest as soon as may be, each in a direction and at a deceleration of its own."""

    goals: Float[np.ndarray, "n 3"]
    """Where they end [m, world]."""
    arrival_times: Float[np.ndarray, "n"]
    """How long they take [s]."""
    reasons: UInt32[np.ndarray, "n"]
    """0 means usable."""
    splines: SplineBatch
    margins: Margins
    impact: Float[np.ndarray, "n"]
    """How fast each is [m/s] where it first touches something; 0 where nowhere."""
    thrust: Float[np.ndarray, "n"]
    """The most that each asks for [m/s^2, per mass], without drag."""


NEARLY = 0.1
"""m; stops that go astray by no more than this beyond the best are taken for as good (arbitrary)."""
HITS = Reason.CLEARANCE | Reason.NONFINITE
"""What no stop may have that is taken for a safe one."""


def select_approach(approaches: Approaches) -> int:
    """Index of the approach that is least late; -1 when none is usable."""
    return select_best(-approaches.lateness, approaches.reasons)


def select_stop(stops: Stops, flown: Rollouts | None = None) -> int:
    """Index of the gentlest stop; where none passes, of one that only turns fast, then the clear one of least thrust.

    Where none is clear, of the one that hits least hard; -1 when none is finite. Stops that were ``flown`` in the model
    must be followed and clear there: see ``_select_flown``.
    """
    turning = ~np.uint32(Reason.BODY_RATE)
    if flown is not None:
        return _select_flown(stops, flown)
    for score, reasons in (
        (stops.arrival_times, stops.reasons),
        (stops.arrival_times, stops.reasons & turning),
        (-stops.thrust, stops.reasons & np.uint32(HITS)),
    ):
        best = select_best(score, reasons)
        if best >= 0:
            return best
    return select_best(-stops.impact, stops.reasons & np.uint32(Reason.NONFINITE))


def _select_flown(stops: Stops, flown: Rollouts) -> int:
    """The gentlest stop that passes and is followed; then one that only turns fast, then any that is clear.

    Where none is followed, of those that stay clear; then what stays farthest away. Who is followed much worse than
    another of its kind is not taken: the next stop has to begin from there.
    """
    hits, nothing = np.uint32(HITS), np.uint32(0)
    turning, solid = stops.reasons & ~np.uint32(Reason.BODY_RATE), stops.reasons & hits
    unclear = np.where(flown.clear, nothing, hits)
    unfollowed = np.where(flown.followed, unclear, hits)
    for reasons in (stops.reasons | unfollowed, turning | unfollowed, solid | unfollowed, solid | unclear):
        astray = np.where(reasons == 0, flown.astray, np.inf)
        worse = np.where(astray <= astray.min() + NEARLY, nothing, hits)
        best = select_best(stops.arrival_times, reasons | worse)
        if best >= 0:
            return best
    touching = np.where(stops.impact > 0.0, hits, nothing) | (stops.reasons & np.uint32(Reason.NONFINITE))
    best = select_best(flown.clearance, touching)
    return best if best >= 0 else select_best(-stops.impact, stops.reasons & np.uint32(Reason.NONFINITE))
