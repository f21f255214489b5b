"""The way towards a target that cannot be met in time (host).

An approach tries a few of the latest goals, each along several shares of its path and at several multiples of its least
time: all of them are feasible, only late, and come to rest.
"""

import numpy as np
from jaxtyping import Int

from jaxplan.planner.parts import Parts
from jaxplan.planner.records import Approaches
from jaxplan.planner.stations import no_trajectories
from jaxplan.planner.table import Table, reject, table_of
from jaxplan.prediction.candidates import Candidates
from jaxplan.spline import FlatState
from jaxplan.status import Reason

GOALS = 4
SHARES = (1.0, 0.6, 0.3)
STRETCHES = (1.0, 1.4, 2.0)
"""An approach tries this many goals, each along these shares of its path, at these multiples of its least time
(arbitrary)."""


def approach(parts: Parts, state: FlatState, candidates: Candidates) -> Approaches:
    """Trajectories towards the latest candidates, for when none can be met."""
    table = reject(parts, state, table_of(candidates, parts.config.likelihood_weight))
    rows = _latest_goals(table)
    axes = np.meshgrid(np.arange(len(rows)), SHARES, STRETCHES, indexing="ij")
    member, share, stretch = (axis.ravel() for axis in axes)
    goals, times = table.goals(rows)[member], table.arrival_times(rows)[member]
    whole_time, reasons, found = np.zeros(len(member)), np.zeros(len(member), np.uint32), no_trajectories()
    if len(rows):
        paths = parts.search(state, table.goals(rows), np.asarray(candidates.target))
        routes = parts.route(paths, member, share)
        durations = parts.least_durations(state, routes) * stretch
        found = parts.check_all(state, routes, durations)
        whole_time = durations.sum(axis=0) / share
        reasons = found.margins.reasons | (paths.reasons & ~np.uint32(Reason.PREFIX_ONLY))[member]
    return Approaches(
        goals=goals,
        arrival_times=times,
        share=share,
        stretch=stretch,
        lateness=whole_time - times,
        reasons=reasons,
        splines=found.splines,
        margins=found.margins,
    )


def _latest_goals(table: Table) -> Int[np.ndarray, "n"]:
    """The few rows of the longest arrival time that a vehicle may fly to, each goal once."""
    possible = np.flatnonzero((table.reasons & ~np.uint32(Reason.OUT_OF_REACH)) == 0)
    latest = possible[np.argsort(-table.arrival_times(possible), kind="stable")]
    _, first = np.unique(table.goals(latest), axis=0, return_index=True)
    return latest[np.sort(first)][:GOALS]
