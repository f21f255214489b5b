"""The candidates of a replan as one table, and the stations that fill it: reject, search, knots, bound, match, check.

Each station takes the table and the rows that it is to look at, and returns the table with what it has found out. None
keeps time, none decides who comes next: ``plan_batch`` does.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt32

from jaxplan.arrival import Arrival, time_to
from jaxplan.batching import fill, join, pick
from jaxplan.planner.capture import Prospect, capture_times
from jaxplan.planner.parts import Allocation, Parts
from jaxplan.planner.placed import courses_along, meet_radii
from jaxplan.planner.records import Plans
from jaxplan.planner.stations import Routes, Trajectories, lengthened, no_trajectories, shortened
from jaxplan.prediction.candidates import Candidates, target_velocities
from jaxplan.search.lattice import Paths
from jaxplan.spline import FlatState
from jaxplan.status import Reason

Rows = Int[np.ndarray, "n"]


SLOWEST_MEETING = 0.3
"""m/s; a target that is slower counts as one at rest: it can be met without a stop point behind it (arbitrary)."""


PLACED_SOONER = 0.6
"""No plan whose waypoints are placed takes less than this share of the first allocation's least time (arbitrary)."""


TAKEN = Reason.GOAL_OCCUPIED | Reason.GOAL_OUTSIDE
"""Against goals whose place is not free: a target may be met on the way there."""


class Matched(NamedTuple):
    """Rows that have durations, but no trajectories yet; filled up to the width of the stations."""

    allocation: Allocation
    rows: Rows
    routes: Routes
    arrival: Arrival


class Checked(NamedTuple):
    """Rows with their trajectories, and what is against those."""

    rows: Rows
    alpha: Float[np.ndarray, "n"]
    reasons: UInt32[np.ndarray, "n"]
    trajectories: Trajectories
    """As many as the stations take; the first n count."""


class Table(NamedTuple):
    """One row for each of k candidates, in the order given. Rows without a route or trajectory have -1 there."""

    candidates: Candidates
    score: Float[np.ndarray, "k"]
    """What the selection maximises [s]."""
    reasons: UInt32[np.ndarray, "k"]
    """Against a row whatever its times."""
    faults: UInt32[np.ndarray, "k"]
    """Of the trajectory that a row has: the last one that was tried."""
    alpha: Float[np.ndarray, "k"]
    """Scale factor of the time allocation; NaN where none was computed."""
    route: Int[np.ndarray, "k"]
    """Column of ``routes``."""
    path: Int[np.ndarray, "k"]
    """Row of ``paths``, that of the shortest one; -1 where those do not lead."""
    trajectory: Int[np.ndarray, "k"]
    """Column of all ``trajectories``, one after the other."""
    paths: Paths | None = None
    """To the goals of the rows that were searched last: the shortest ones, then further ones in the same order."""
    routes: Routes | None = None
    """Along those paths of which waypoints were wanted so far."""
    trajectories: tuple[tuple[Trajectories, int], ...] = ()
    """What each round gave, and how many of its columns count."""

    @property
    def every_row(self) -> Rows:
        """All rows."""
        return np.arange(len(self.reasons))

    def usable(self) -> Rows:
        """Rows with no reason against them so far."""
        return np.flatnonzero(self.reasons == 0)

    def promise(self) -> float:
        """The best score of what can be reached in time, as far as is known [s]; its goal need not be free."""
        possible = ((self.reasons & ~np.uint32(TAKEN)) == 0) & np.isfinite(self.score)
        return float(self.score[possible].max(initial=-np.inf))

    def best_first(self) -> Rows:
        """The usable rows, the best score first, equal ones in the order given."""
        rows = np.flatnonzero((self.reasons == 0) & np.isfinite(self.score))
        return rows[np.argsort(-self.score[rows], kind="stable")]

    def against(self, rows: Rows, reasons: UInt32[np.ndarray, "n"]) -> "Table":
        """The table with more reasons against some rows."""
        merged = self.reasons.copy()
        merged[rows] |= reasons
        return self._replace(reasons=merged)

    def arrival_times(self, rows: Rows) -> Float[np.ndarray, "n"]:
        """When the targets of some rows are at their goals [s from the start state]."""
        return np.asarray(self.candidates.arrival_times)[rows]

    def goals(self, rows: Rows) -> Float[np.ndarray, "n 3"]:
        """Where the targets of some rows are met [m, world]."""
        return np.asarray(self.candidates.goals)[rows]

    def plans(self, promise: float) -> Plans:
        """The table as it is returned, with its first ``promise``."""
        splines, margins = _joined(self.trajectories) if self.trajectories else no_trajectories()
        return Plans(
            goals=self.goals(self.every_row),
            arrival_times=self.arrival_times(self.every_row),
            reasons=self.reasons | self.faults,
            score=self.score,
            promise=promise,
            alpha=self.alpha,
            trajectory=self.trajectory,
            splines=splines,
            margins=margins,
        )


def table_of(candidates: Candidates, score: Float[np.ndarray, "k"]) -> Table:
    """A table of which nothing is known but the score."""
    count = len(candidates.goals)
    none, nowhere = np.zeros(count, np.uint32), np.full(count, -1)
    return Table(candidates, score, none, none, np.full(count, np.nan), nowhere, nowhere, nowhere)


def reject(parts: Parts, state: FlatState, table: Table) -> Table:
    """Mark what cannot be a goal."""
    return table.against(table.every_row, parts.reject(state, table.candidates))


def outrank(table: Table, rows: Rows) -> Table:
    """Mark rows that cannot win, so that no more work is done for them."""
    return table.against(rows, np.full(len(rows), Reason.OUTRANKED, np.uint32))


def search(parts: Parts, state: FlatState, table: Table, rows: Rows) -> Table:
    """Find the paths to each row's goal; the first is the shortest one."""
    target = np.asarray(table.candidates.target)
    paths = parts.search(state, table.goals(rows), target, parts.config.alternatives)
    found = paths.reasons[: len(rows)]
    path = _numbered(np.full_like(table.path, -1), rows, 0)
    return table.against(rows, found)._replace(paths=paths, path=path)


def knots(parts: Parts, table: Table, rows: Rows) -> Table:
    """Place waypoints along the paths of ``rows``."""
    paths = _paths_of(parts, table, rows)
    every = np.arange(len(paths.count))
    expected = target_velocities(table.candidates)[rows] if parts.config.meet == "match" else None
    velocities = None if expected is None else np.tile(expected, (len(every) // len(rows), 1))
    routes = parts.route(paths, every, np.full(len(every), parts.config.meet != "rest"), velocities)
    reasons = np.asarray(routes.reasons)[: len(rows)].copy()
    if expected is not None:
        ends = (np.asarray(routes.meet) == np.asarray(routes.count) - 1)[: len(rows)]
        moving = np.linalg.norm(expected, axis=1) > SLOWEST_MEETING
        reasons[ends & moving] |= np.uint32(Reason.NO_STOP)
    before = 0 if table.routes is None else len(table.routes.count)
    whole = routes if table.routes is None else join([(table.routes, before), (routes, len(every))])
    return table.against(rows, reasons)._replace(routes=whole, route=_numbered(table.route, rows, before))


def bound(parts: Parts, state: FlatState, table: Table, rows: Rows) -> Table:
    """Ask the first time allocation for the least time to the goals of the ``rows`` that had their waypoints last.

    What takes longer than T_goal cannot be met.

    Of several routes to a goal the one of the least time is kept.
    """
    assert table.routes is not None, "waypoints come first"
    paths = _paths_of(parts, table, rows)
    alpha, least, route = table.alpha.copy(), parts.config.arrival.least_alpha, table.route.copy()
    first, *_ = parts.allocations(state)
    begin, count = int(route[rows[0]]), len(paths.count)
    routes = shortened(pick(table.routes, np.arange(begin, begin + count)))
    durations = parts.durations_at(first, state, routes, np.full(count, least))
    times = np.asarray(time_to(durations, np.asarray(routes.meet))).copy()
    times[len(rows) :][paths.reasons[len(rows) :] != 0] = np.inf
    soonest = np.argmin(times.reshape(-1, len(rows)), axis=0) * len(rows) + np.arange(len(rows))
    alpha[rows] = least * table.arrival_times(rows) / times[soonest]
    sooner = PLACED_SOONER if parts.tried(state)[0].placing is not None else 1.0
    late = ~(alpha[rows] >= sooner * least * (1.0 - parts.config.arrival.tolerance))
    route[rows] = begin + soonest
    reasons = np.where(late, Reason.ALPHA_LT_1, 0).astype(np.uint32)
    return table.against(rows, reasons)._replace(alpha=alpha, route=route)


def match(parts: Parts, allocation: Allocation, state: FlatState, table: Table, rows: Rows) -> Matched:
    """Slow at most ``width`` rows down until each arrives at T_goal."""
    padded = fill(rows, parts.config.width)
    routes, times = shortened(pick(table.routes, table.route[padded])), table.arrival_times(padded)
    if allocation.placing is not None:
        radius = meet_radii(table.candidates, times, parts.config.refinement)
        courses, routes = courses_along(routes, parts.room, radius, allocation.placing.numbers)
        arrival, points = allocation.placing.match(state, courses, times)
        return Matched(allocation, rows, routes._replace(waypoints=np.asarray(points)), arrival)
    least = np.full(len(padded), parts.config.arrival.least_alpha)
    return Matched(allocation, rows, routes, allocation.match(state, routes, times, least))


def check(parts: Parts, state: FlatState, table: Table, matched: Matched) -> Checked:
    """Solve and check the trajectories of the rows just matched."""
    allocation, rows, routes, arrival = matched
    found = parts.check(allocation, state, routes, arrival.durations, np.asarray(table.candidates.target), len(rows))
    reasons = np.asarray(arrival.reasons) | np.asarray(found.margins.reasons)
    return Checked(rows, np.asarray(arrival.alpha)[: len(rows)], reasons[: len(rows)], found)


def enter(table: Table, checked: Checked) -> Table:
    """The table with trajectories for some rows, instead of those that they had."""
    rows, alpha, faults = checked.rows, table.alpha.copy(), table.faults.copy()
    alpha[rows], faults[rows] = checked.alpha, checked.reasons
    return table._replace(
        alpha=alpha,
        faults=faults,
        trajectory=_numbered(table.trajectory, rows, sum(count for _, count in table.trajectories)),
        trajectories=(*table.trajectories, (checked.trajectories, len(rows))),
    )


def rescored(table: Table, prospect: Prospect) -> Table:
    """The table with the scores of those that pass by what their trajectories capture (``jaxplan.planner.capture``)."""
    passing = np.flatnonzero(((table.reasons | table.faults) == 0) & (table.trajectory >= 0))
    if not len(passing):
        return table
    score, before = table.score.copy(), 0
    for found, count in table.trajectories:
        column = table.trajectory[passing] - before
        here = (column >= 0) & (column < count)
        score[passing[here]] = -capture_times(prospect, found.splines, column[here])[column[here]]
        before += count
    return table._replace(score=score)


def _paths_of(parts: Parts, table: Table, rows: Rows) -> Paths:
    """The shortest paths to the goals of ``rows``, then the further ones."""
    assert table.paths is not None, "rows are searched first"
    apart = len(table.paths.count) // parts.config.alternatives
    return table.paths.some(np.concatenate([table.path[rows] + i * apart for i in range(parts.config.alternatives)]))


def _joined(rounds: Sequence[tuple[Trajectories, int]]) -> Trajectories:
    """The trajectories of all rounds, one after the other, as long as the longest."""
    segments = max(len(found.splines.durations) for found, _ in rounds)
    return join([(lengthened(found, segments), count) for found, count in rounds])


def _numbered(columns: Int[np.ndarray, "k"], rows: Rows, first: int) -> Int[np.ndarray, "k"]:
    """The columns with those of ``rows`` counted from ``first`` on."""
    numbered = columns.copy()
    numbered[rows] = first + np.arange(len(rows))
    return numbered
