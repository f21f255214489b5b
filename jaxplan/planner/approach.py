"""The way towards a target that cannot be met in time (host).

An approach tries a few of the latest goals, each at several paces. Like any other plan it flies through its goal and
comes to rest behind it, or, as a second choice, at the goal.
"""

import numpy as np
from jaxtyping import Float, Int

from jaxplan.arrival import time_to
from jaxplan.planner.border import usual_candidates, usual_state
from jaxplan.planner.fallbacks import Approaches
from jaxplan.planner.parts import Parts
from jaxplan.planner.stations import Routes, no_trajectories, shortened
from jaxplan.planner.table import Table, reject, table_of
from jaxplan.prediction.candidates import Candidates
from jaxplan.spline import FlatState
from jaxplan.status import Reason

GOALS = 4
PACES = (0.75, 0.82, 0.9, 1.0, 1.15, 1.4, 2.0, 3.0)
"""An approach tries this many goals at these scale factors of the time allocation (arbitrary)."""


def approach(parts: Parts, state: FlatState, candidates: Candidates) -> Approaches:
    """Trajectories towards the latest candidates, for when none can be met; by the first allocation that has any."""
    state, candidates = usual_state(state), usual_candidates(candidates)
    table = reject(parts, state, table_of(candidates, np.zeros(len(candidates.goals))))
    rows = _latest_goals(table)
    meetings = (True, False) if parts.config.meet != "rest" else (False,)
    axes = np.meshgrid(np.arange(len(rows)), meetings, PACES, indexing="ij")
    member, passing, alpha = (axis.ravel() for axis in axes)
    goals, times = table.goals(rows)[member], table.arrival_times(rows)[member]
    arrival, reasons, found = np.zeros(len(member)), np.zeros(len(member), np.uint32), no_trajectories()
    if len(rows):
        paths = parts.search(state, table.goals(rows), np.asarray(candidates.target))
        routes = shortened(parts.route(paths, member, passing))
        missing = (paths.reasons & ~np.uint32(Reason.PREFIX_ONLY))[member]
        for allocation in parts.allocations(state):
            durations = parts.durations_at(allocation, state, routes, alpha)
            found = parts.check_all(allocation, state, routes, durations, np.asarray(candidates.target))
            reasons = np.asarray(found.margins.reasons) | missing
            if (reasons == 0).any():
                break
        durations = np.asarray(found.splines.durations)
        arrival = np.asarray(time_to(durations, np.asarray(routes.meet))) * _left_out(routes, paths.length[member])
    return Approaches(
        goals=goals,
        arrival_times=times,
        alpha=alpha,
        lateness=arrival - times,
        reasons=reasons,
        splines=found.splines,
        margins=found.margins,
    )


def _left_out(routes: Routes, lengths: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """By what the flight of only a beginning of a path is longer when it goes on to its end; 1 for whole ones."""
    covered = np.linalg.norm(np.diff(np.asarray(routes.samples), axis=0), axis=1).sum(axis=0)
    prefix = (np.asarray(routes.reasons) & np.uint32(Reason.PREFIX_ONLY)) != 0
    return np.where(prefix, np.maximum(lengths / np.maximum(covered, 1e-9), 1.0), 1.0)


def _latest_goals(table: Table) -> Int[np.ndarray, "n"]:
    """The few rows of the longest arrival time that a vehicle may fly to, each goal once."""
    possible = np.flatnonzero((table.reasons & ~np.uint32(Reason.OUT_OF_REACH)) == 0)
    latest = possible[np.argsort(-table.arrival_times(possible), kind="stable")]
    _, first = np.unique(table.goals(latest), axis=0, return_index=True)
    return latest[np.sort(first)][:GOALS]
