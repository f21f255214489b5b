"""What a planner is made of, and its stations for any number of candidates (host).

Every station is compiled for one width and called as often as there are candidates for (decision 0014).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt32

from jaxplan.arrays import AnyArray
from jaxplan.batching import at_fixed_width, pick
from jaxplan.planner.capture import Prospect, straight_capture_times
from jaxplan.planner.descent import Descend
from jaxplan.planner.kernels.goals import reasons_against
from jaxplan.planner.kernels.pieces import Body
from jaxplan.planner.placed import MatchPlaced
from jaxplan.planner.records import PlannerConfig
from jaxplan.planner.rollouts import Flyer
from jaxplan.planner.stations import Match, Routes, Stations, Trajectories
from jaxplan.planner.validator import Keep, Room
from jaxplan.policy.placing import Place
from jaxplan.prediction.candidates import Candidates
from jaxplan.records import replace
from jaxplan.search.kernels.flights import Cut, flights_keep_clear
from jaxplan.search.lattice import Lattices, Paths
from jaxplan.search.meeting_point import beginning_at, ending_before
from jaxplan.search.routes import find_routes
from jaxplan.search.stops import stop_points
from jaxplan.spline import FlatState
from jaxplan.status import Reason
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.reach import reach
from jaxplan.world.obstacles import World

GOALS_AT_ONCE = 512
"""Candidates that are looked at before the search in one call: little work each (arbitrary)."""
LEADS = (0.2, 0.1)
"""Seconds from a start in fast flight to where its routes begin: the longest of which the way is clear (arbitrary)."""


FINER = 4
"""Into how many a piece is cut again that only the looseness of its bound rejects (arbitrary)."""
Members = Int[np.ndarray, "n"]
"""Numbers of candidates. It has a name, as those below, because what annotates a function within another one is made
anew in each call, and what jaxtyping makes lies in a cycle until it is collected."""
_Reasons = UInt32[AnyArray, "n"]
_Times = Float[AnyArray, "m n"]


class Placing(NamedTuple):
    """The placing policy, compiled, and what it must know of the vehicle."""

    place: Place
    """For the starts of a refinement."""
    numbers: Float[np.ndarray, "6"]
    match: MatchPlaced
    """For all candidates."""


class Allocation(NamedTuple):
    """Who allots times, and what is asked of trajectories with them."""

    match: Match
    least_probability: float
    """Of being tracked, where a classifier decides."""
    placing: Placing | None = None
    """Who places the waypoints, too: then ``match`` is not asked."""


class Parts(NamedTuple):
    """Configuration, compiled stations, and a world with its lattices."""

    config: PlannerConfig
    stations: Stations
    lattices: Lattices
    world: World
    room: Room
    """The same world, but the boxes that stand for what moves, for checks and the last look at a plan."""
    vehicle: Vehicle
    body: Body
    """Its numbers, for the last look."""
    descend: Descend | None = None
    """The compiled part of a refinement, where chosen plans are refined."""
    placing: Placing | None = None
    """The policy that a refinement begins with; without one it begins with the chosen plan."""
    flyer: Flyer | None = None
    """The model in which plans are flown, where they are."""
    moving: frozenset[int] = frozenset()
    """Numbers of the boxes that stand for what moves: searches alone keep out of them."""

    @property
    def radius(self) -> float:
        """The vehicle's [m]."""
        return float(self.vehicle.radius)

    @property
    def keep(self) -> Keep:
        """The distance that every trajectory keeps: the vehicle's radius and the tracking margin."""
        checks = self.config.checks
        least, most = self.radius + checks.tracking_margin, self.radius + checks.most_margin
        return Keep(least, checks.slow, checks.margin_per_speed, most)

    def reject(self, state: FlatState, candidates: Candidates) -> UInt32[np.ndarray, "k"]:
        """Early reasons against each candidate; of a target that is lost nothing else is said: it has no place."""
        goals, times = np.asarray(candidates.goals), np.asarray(candidates.arrival_times)
        likelihood, reasons = np.asarray(candidates.likelihood), np.asarray(candidates.reasons)
        target = np.asarray(candidates.target)
        if len(goals) == 0:
            return reasons.copy()
        if self.lattices.roadmap is not None:
            start, distances = np.asarray(state.pos), (float(self.world.keep_in), self.config.padding)
            far = np.asarray(reach(self.vehicle, float(np.linalg.norm(np.asarray(state.vel))), times))
            solids = self.lattices.roadmap.field.solids
            found = reasons | reasons_against(solids, self.room.bounds, distances, start, goals, times, far)
            return np.where(_is_lost(reasons), reasons, found)

        def mark(members: Members) -> _Reasons:
            some = Candidates(
                goals=goals[members],
                arrival_times=times[members],
                likelihood=likelihood[members],
                reasons=reasons[members],
                target=target,
            )
            return self.stations.reject(self.world, some, state).reasons

        return np.where(_is_lost(reasons), reasons, at_fixed_width(mark, np.arange(len(goals)), GOALS_AT_ONCE))

    def score(self, state: FlatState, candidates: Candidates, prospect: Prospect | None) -> Float[np.ndarray, "k"]:
        """What is maximised [s]: the paper's eq. 9, or what flights straight to the goals promise to capture."""
        goals, times = np.asarray(candidates.goals), np.asarray(candidates.arrival_times)
        if prospect is None or not len(times):
            return self.config.likelihood_weight * np.asarray(candidates.likelihood) - times

        return -straight_capture_times(prospect.thinned(), state, goals, times)

    def search(
        self, state: FlatState, goals: Float[np.ndarray, "k 3"], target: Float[np.ndarray, "3"], alternatives: int = 1
    ) -> Paths:
        """Taut paths from the state to where the goals are met; the distance to the target [m] chooses the lattice.

        Row ``k + i K`` is the route i to goal k of K.
        """
        start = np.asarray(state.pos)
        distance = float(np.linalg.norm(target - start))
        lead, capacity = self._lead(state), self.config.path_capacity
        if lead is None:
            paths = find_routes(self.lattices, self.world, start, goals, distance, capacity, alternatives)
        else:
            paths = find_routes(self.lattices, self.world, lead, goals, distance, capacity - 1, alternatives)
            paths = beginning_at(paths, start)
        return ending_before(paths, self.config.meet_radius)

    def _lead(self, state: FlatState) -> Float[np.ndarray, "3"] | None:
        """Where the vehicle will be soon whatever it does, where a profile of speeds plans; None where it is slow.

        A profile takes what is not along the first leg for lost, and a route that turns at once is not followed.
        """
        position, velocity, acceleration = (np.asarray(getattr(state, name)) for name in ("pos", "vel", "acc"))
        if not self.config.is_fast(state):
            return None
        for time in LEADS:
            shares = np.linspace(0.0, time, 5)[1:, None]
            way = position + shares * velocity + 0.5 * shares**2 * acceleration
            if (self.room.free_distance(way) >= self.keep.least).all():
                return np.asarray(way[-1])
        return None

    def route(
        self,
        paths: Paths,
        member: Int[np.ndarray, "k"],
        passing: Bool[np.ndarray, "k"],
        velocities: Float[np.ndarray, "p 3"] | None = None,
    ) -> Routes:
        """Waypoints along the paths ``member``, where ``passing`` on to their stop points.

        The goals of all paths may have ``velocities`` [m/s] at which they are passed: stop points are ahead then.
        """
        stops = paths.points[member, -1]
        if passing.any():
            behind = stop_points(self.lattices, self.world, paths, velocities)
            stops = np.where(passing[:, None], behind[member], stops)

        def place(some: Members) -> Routes:
            return self.stations.route(paths.points[member[some]], stops[some])

        routes = at_fixed_width(place, np.arange(len(member)), self.config.width)
        return routes if velocities is None else routes._replace(velocity=velocities[member].T)

    def allocations(self, state: FlatState) -> tuple[Allocation, ...]:
        """Who allots the times of plans from this state: those that are asked in turn."""
        asked = self.config.allocate
        profile = Allocation(self.stations.match_profile, self.config.profile_probability)
        policy = Allocation(self.stations.match_policy, self.config.checks.least_probability)
        if asked == "both":
            return (profile,) if self.config.is_fast(state) else (profile, policy)
        return (profile,) if asked == "profile" else (policy,)

    def tried(self, state: FlatState) -> tuple[Allocation, ...]:
        """The same before whom stands who places waypoints, where that is asked for all candidates."""
        asked = self.allocations(state)
        if self.placing is None or self.config.place != "all":
            return asked
        return (asked[0]._replace(placing=self.placing), *asked)

    def durations_at(
        self, allocation: Allocation, state: FlatState, routes: Routes, alpha: Float[np.ndarray, "k"]
    ) -> Float[np.ndarray, "m k"]:
        """Durations [s] by one of them at given scale factors."""
        if allocation.match is self.stations.match_profile:  # for any number
            return np.asarray(allocation.match(state, routes, np.zeros(len(alpha)), alpha).least_durations)
        at_once = np.zeros(self.config.width)

        def ask(some: Members) -> _Times:
            return allocation.match(state, pick(routes, some), at_once, alpha[some]).least_durations

        return at_fixed_width(ask, np.arange(len(routes.count)), self.config.width)

    def check(
        self,
        allocation: Allocation,
        state: FlatState,
        routes: Routes,
        durations: Float[AnyArray, "m k"],
        target: Float[np.ndarray, "3"],
        count: int,
    ) -> Trajectories:
        """Solved and checked trajectories, as many as the stations take, of which the first ``count`` are wanted."""
        solved = self.stations.solve(state, routes, durations, target, allocation.least_probability)
        if allocation.placing is not None:  # its waypoints are where no path leads
            reasons = np.asarray(solved.margins.reasons) & ~np.uint32(Reason.DEVIATION)
            solved = Trajectories(solved.splines, replace(solved.margins, reasons=reasons))
        return self.clear(solved, np.flatnonzero(np.asarray(solved.margins.reasons)[:count] == 0))

    def check_all(
        self,
        allocation: Allocation,
        state: FlatState,
        routes: Routes,
        durations: Float[np.ndarray, "m k"],
        target: Float[np.ndarray, "3"],
    ) -> Trajectories:
        """Solved and checked trajectories, any number of them."""
        solved = self.solve(state, routes, durations, target, allocation.least_probability)
        return self.clear(solved, np.flatnonzero(np.asarray(solved.margins.reasons) == 0))

    def solve(
        self,
        state: FlatState,
        routes: Routes,
        durations: Float[np.ndarray, "m k"],
        target: Float[np.ndarray, "3"],
        least_probability: float,
    ) -> Trajectories:
        """Trajectories, any number of them, with all their checks but the one for obstacles."""

        def some_of(some: Members) -> Trajectories:
            return self.stations.solve(state, pick(routes, some), durations[:, some], target, least_probability)

        return at_fixed_width(some_of, np.arange(len(routes.count)), self.config.width)

    def clear(self, trajectories: Trajectories, looked_at: Members) -> Trajectories:
        """The same with the clearance of some of them: a check that is worth it where nothing else is against one."""
        splines, margins = trajectories
        clearance, reasons = np.full(len(margins.reasons), np.nan), np.array(margins.reasons)
        durations, position = np.asarray(splines.durations)[:, looked_at], np.asarray(splines.position)[..., looked_at]
        keep, cut = self.keep, Cut(self.config.checks.samples_per_segment, FINER)
        kept = (keep.least, keep.slow, keep.per_speed, keep.most)
        keeps, clearance[looked_at] = flights_keep_clear(
            self.room.solids, self.room.bounds, durations.T, np.moveaxis(position, -1, 0), kept, cut
        )
        reasons[looked_at[~keeps]] |= np.uint32(Reason.CLEARANCE)
        return Trajectories(splines, replace(margins, clearance=clearance, reasons=reasons))


def _is_lost(reasons: UInt32[np.ndarray, "k"]) -> Bool[np.ndarray, "k"]:
    """Whether candidates are of a target that is lost."""
    return np.asarray(reasons & np.uint32(Reason.TARGET_LOST) != 0)
