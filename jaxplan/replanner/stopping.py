"""Which stop is committed, where the committed plan may not be flown any more and there is no other."""

import numpy as np

from jaxplan.planner import HITS, NEARLY, Fault, Planner, Rollouts, Stops, select_stop
from jaxplan.records import replace
from jaxplan.replanner.choice import Known, Outcome, chosen_from
from jaxplan.replanner.passing import Passing
from jaxplan.selection import select
from jaxplan.spline import FlatState
from jaxplan.status import PlanStatus, Reason

STOPPING = (PlanStatus.BRAKE, PlanStatus.RECOVER, PlanStatus.BLOCKED)
"""Committed plans that are stops."""
FARTHER = 0.02
"""m; how much farther from obstacles the model must stay along a stop than along a committed plan that is clear itself
(arbitrary)."""
TUMBLE = 0.8
"""m; a stop that the model is so far ``astray`` of is none: the vehicle would be lost (docs/decisions/0060)."""

_Held = tuple[Stops, Rollouts | None]
"""Stops and their flights in the model, marked where they are too near to something."""
_Found = tuple[Stops, Rollouts | None, int]
"""And which of them is taken."""


def stop_for(planner: Planner, known: Known, status: PlanStatus) -> Outcome:
    """What ``select_stop`` takes; where none is clear, only if the committed plan hits harder, or goes nearer.

    Where the model follows none of them, and stays clear, stops are tried from where the vehicle will be. From what
    moves stops keep what plans keep or, where none that is followed does, what is kept at least. Where none
    does that either, the one of those that are followed is taken that stays farthest away: who is off its reference
    avoids nothing.
    """
    start, committed, ahead, passing = known.start, known.committed, known.ahead, known.passing
    stops, flown, held = _tried(planner, known, start.state)
    found = _clear(held)
    if ahead is not None and not _is_followed(found):
        again = _clear(_tried(planner, known, ahead.at(start.takeover))[2])
        if again is not None and _is_followed(again):
            return status, chosen_from(again[0], again[2], np.nan)._replace(anew=True)
    if found is not None:
        stops, flown, best = found
        kept = flown is not None and _stops_as_well(planner, known, float(flown.astray[best]))
        return status, None if kept else chosen_from(stops, best, np.nan)
    (stops, nearest), best = held[-1], _farthest(stops, flown, *held[-1])
    hit = planner.impact(committed.spline, known.since)
    softer = best >= 0 and (stops.impact[best] < hit or (start.measured and stops.impact[best] == 0.0))
    if ahead is not None and nearest is not None and hit == 0.0:
        farther = float(ahead.committed.clearance[0])
        if passing is not None:
            farther = min(farther, passing.nearest, float(passing.flown(ahead.committed)[0]))
        softer = best >= 0 and bool(nearest.clearance[best] > farther + FARTHER)
        softer = softer and bool(nearest.astray[best] <= max(TUMBLE, float(ahead.committed.astray[0])))
    return PlanStatus.BLOCKED, chosen_from(stops, best, np.nan) if softer else None


def _tried(planner: Planner, known: Known, state: FlatState) -> tuple[Stops, Rollouts | None, list[_Held]]:
    """Stops from a state at the takeover, their flights in the model, and both as ``_kept`` marks them."""
    ahead, passing, takeover = known.ahead, known.passing, known.start.takeover
    stops = planner.brake(state, known.committed.spline, known.since, aside=True)
    flown = None if ahead is None else ahead.along(stops.splines, takeover)
    return stops, flown, [(stops, flown)] if passing is None else _kept(stops, flown, passing, takeover)


def _clear(held: list[_Held]) -> _Found | None:
    """The first that is clear, and followed hardly worse than another; where none is followed, but no tumble."""
    found = [(stops, flown, select_stop(stops, flown)) for stops, flown in held]
    found = [one for one in found if one[2] >= 0 and not one[0].reasons[one[2]] & np.uint32(HITS)]
    clear = [one for one in found if one[1] is None or one[1].clear[one[2]]]
    followed = [one for one in clear if _is_followed(one)]
    best = min(map(_astray, followed), default=np.inf)
    well = [one for one in followed if _astray(one) <= best + NEARLY]
    return next(iter(well + [one for one in clear if _astray(one) <= TUMBLE]), None)


def _astray(found: _Found) -> float:
    """How badly the model, where there is one, follows it [m]."""
    return 0.0 if found[1] is None else float(found[1].astray[found[2]])


def _is_followed(found: _Found | None) -> bool:
    """Whether the model, where there is one, follows it."""
    return found is not None and (found[1] is None or bool(found[1].followed[found[2]]))


def _farthest(stops: Stops, flown: Rollouts | None, held: Stops, nearest: Rollouts | None) -> int:
    """Where all are hit: what ``select_stop`` takes; if only what moves hits, what is followed, or else no tumble."""
    if flown is not None and nearest is not None and nearest is not flown:
        for safe in (flown.clear & flown.followed, flown.clear & (flown.astray <= TUMBLE)):
            unsafe = np.where(safe, np.uint32(0), np.uint32(HITS))
            best = select(nearest.clearance, (stops.reasons & np.uint32(HITS)) | unsafe)
            if best >= 0:
                return best
    return select_stop(held, nearest)


def _kept(stops: Stops, flown: Rollouts | None, passing: Passing, takeover: float) -> list[_Held]:
    """Stops, and their flights in the model, not clear where something that moves is too near: first, and then less."""
    apart, nothing, near = passing.along(stops.splines, takeover), np.uint32(0), np.uint32(Reason.CLEARANCE)
    if flown is not None:
        strayed = passing.flown(flown)
        clear, clearance = flown.clear & (strayed >= passing.least), np.minimum(flown.clearance, strayed)
        flown = replace(flown, clear=clear, clearance=np.minimum(clearance, apart))
    wanted = (passing.keep, passing.least)
    marked = [replace(stops, reasons=stops.reasons | np.where(apart >= keep, nothing, near)) for keep in wanted]
    return [(one, flown) for one in marked]


def _stops_as_well(planner: Planner, known: Known, astray: float) -> bool:
    """Whether what is committed is a stop that is clear, and followed hardly worse than another, so far [m].

    Another one would only begin later.
    """
    ahead, passing = known.ahead, known.passing
    if ahead is None or known.start.measured or known.committed.status not in STOPPING:
        return False
    clear = ahead.committed.clear[0] and (passing is None or passing.is_kept) and known.is_passed_by(ahead.committed)
    faults = planner.validate(known.committed.spline, known.since).faults
    return bool(clear and not faults & Fault.CLEARANCE and ahead.committed.astray[0] <= astray + NEARLY)
