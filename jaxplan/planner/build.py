"""``build_planner``: every decision that depends on configuration is taken here, once.

Only what can win is matched, solved and checked: a candidate's score does not depend on alpha, so the reachable ones
are taken in order of score, some at a time, until one passes. The winner is that of an exhaustive evaluation.
Every station is compiled for one number of lanes and called as often as there are candidates for (decision 0014).
"""

import functools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int, UInt32

from jaxplan.batching import fill, in_portions, join, pick
from jaxplan.feasibility.classifier import Classifier
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.planner.records import (
    APPROACH_GOALS,
    APPROACH_SHARES,
    APPROACH_STRETCHES,
    Planner,
    PlannerConfig,
    Plans,
    Timer,
)
from jaxplan.planner.stations import Routes, Stations, compile_stations, no_trajectories, shortened
from jaxplan.planner.warmup import compile_all
from jaxplan.policy.protocol import Policy
from jaxplan.precision import in_float64
from jaxplan.prediction.candidates import Candidates, candidates_from
from jaxplan.records import replace
from jaxplan.search.lattice import Lattices, Paths, SearchConfig, build_lattices
from jaxplan.search.routes import find_routes
from jaxplan.search.routes import warmup as warm_up_search
from jaxplan.selection import Margins
from jaxplan.spline import FlatState
from jaxplan.status import Reason
from jaxplan.vehicle.params import Vehicle
from jaxplan.world.obstacles import World

GOALS_AT_ONCE = 512
"""Candidates that are looked at before the search in one call: little work each (arbitrary)."""


class Parts(NamedTuple):
    """What a planner is made of."""

    config: PlannerConfig
    stations: Stations
    lattices: Lattices
    world: World

    def search(self, state: FlatState, goals: Float[np.ndarray, "k 3"], target: Float[np.ndarray, "3"]) -> Paths:
        """Taut paths from the state to the goals; the distance to the target chooses the lattice."""
        start = np.asarray(state.pos)
        distance = float(np.linalg.norm(target - start))
        return find_routes(self.lattices, self.world, start, goals, distance, capacity=self.config.path_capacity)

    def route(self, paths: Paths, member: Int[np.ndarray, "k"], shares: Float[np.ndarray, "k"]) -> Routes:
        """Waypoints along the first ``shares`` of the paths ``member``, in arrays no longer than needed."""
        return shortened(self._each(len(member), lambda k: self.stations.route(paths.points[member[k]], shares[k])))

    def allocate(self, state: FlatState, routes: Routes) -> Float[np.ndarray, "m k"]:
        """The policy's least durations [s]."""
        at_once = np.zeros(self.config.lanes)
        return self._each(
            len(routes.count), lambda k: self.stations.match(state, pick(routes, k), at_once).least_durations
        )

    def trace(self, state: FlatState, routes: Routes, durations: Float[Array, "m k"]) -> tuple[SplineBatch, Margins]:
        """Solved and checked trajectories of as many lanes as the stations take."""
        splines, margins = self.stations.trace(state, routes, durations)
        return splines, self.stations.clear(self.world, splines, margins)

    def trace_all(
        self, state: FlatState, routes: Routes, durations: Float[np.ndarray, "m k"]
    ) -> tuple[SplineBatch, Margins]:
        """Solved and checked trajectories of any number of lanes."""
        return self._each(len(routes.count), lambda k: self.trace(state, pick(routes, k), durations[:, k]))

    def _each(self, count: int, program: Callable[[Int[np.ndarray, "n"]], Any]) -> Any:
        return in_portions(program, np.arange(count), self.config.lanes)


class Evaluated(NamedTuple):
    """What became of some lanes of the routes in one round."""

    lanes: Int[np.ndarray, "n"]
    alpha: Float[np.ndarray, "n"]
    reasons: UInt32[np.ndarray, "n"]
    traced: tuple[SplineBatch, Margins]
    """At least n lanes."""


def build_planner(
    config: PlannerConfig | None = None,
    *,
    world: World,
    vehicle: Vehicle,
    policy: Policy,
    classifier: Classifier | None = None,
) -> Planner:
    """Compose the stations for one world, vehicle and policy.

    Args:
        classifier: decides which trajectories the vehicle can follow; without one the rotor limits do.
    """
    config = config or PlannerConfig()
    return _in_world(config, compile_stations(config, vehicle, policy, classifier), world)


def _in_world(config: PlannerConfig, stations: Stations, world: World) -> Planner:
    """A planner for one world; what is compiled without looking at the world is shared by all."""
    lattices = build_lattices(world, SearchConfig(padding=config.padding))
    unnamed = replace(world, name="", provenance="")  # names are part of what is compiled for
    parts = Parts(config, stations, lattices, in_float64(jax.device_put)(unnamed))
    return Planner(
        plan_batch=functools.partial(in_float64(_plan_batch), parts),
        approach=functools.partial(in_float64(_approach), parts),
        warmup=functools.partial(in_float64(_warmup), parts),
        in_world=functools.partial(_in_world, config, stations),
        config=config,
    )


def _plan_batch(parts: Parts, state: FlatState, candidates: Candidates, timer: Timer | None = None) -> Plans:
    config, timer = parts.config, timer or Timer()
    reasons, goals, times = _rejected(parts, state, candidates)
    score = config.likelihood_weight * np.asarray(candidates.likelihood) - times
    chosen = np.flatnonzero(reasons == 0)
    timer.lap("reject")
    rounds: list[Evaluated] = []
    alpha, lanes = np.full(len(goals), np.nan), np.full(len(goals), -1)
    if len(chosen):
        paths = parts.search(state, goals[chosen], candidates.target)
        timer.lap("search")
        routes = parts.route(paths, np.arange(len(chosen)), np.ones(len(chosen)))
        reasons[chosen] |= paths.reasons | routes.reasons
        timer.lap("knots")
        shares = times[chosen] / parts.allocate(state, routes).sum(axis=0)
        reasons[chosen] |= np.where(shares >= 1.0 - config.arrival.tolerance, 0, Reason.ALPHA_LT_1).astype(np.uint32)
        alpha[chosen] = shares
        timer.lap("policy")
        order = np.arange(len(chosen)) if config.exhaustive else _by_score(score[chosen], reasons[chosen])
        rounds = list(_evaluate(parts, state, routes, times[chosen], order, timer))
        for part in rounds:
            members = chosen[part.lanes]
            lanes[members] = np.arange(len(members)) + lanes.max() + 1
            alpha[members] = part.alpha
            reasons[members] |= part.reasons
        waiting = chosen[order]
        reasons[waiting[lanes[waiting] < 0]] |= np.uint32(Reason.OUTRANKED)
    splines, margins = join([(part.traced, len(part.lanes)) for part in rounds]) if rounds else no_trajectories()
    timer.lap("select")
    return Plans(
        goals=goals,
        arrival_times=times,
        reasons=reasons,
        score=score,
        alpha=alpha,
        lanes=lanes,
        splines=splines,
        margins=margins,
    )


def _approach(parts: Parts, state: FlatState, candidates: Candidates, timer: Timer | None = None) -> Plans:
    timer = timer or Timer()
    reasons, goals, times = _rejected(parts, state, candidates)
    chosen = _latest_goals(reasons, goals, times)
    member, shares, stretches = (axis.ravel() for axis in np.meshgrid(*_approach_axes(len(chosen)), indexing="ij"))
    failed, whole_time = np.zeros(len(member), np.uint32), np.zeros(len(member))
    splines, margins = no_trajectories()
    if len(chosen):
        paths = parts.search(state, goals[chosen], candidates.target)
        routes = parts.route(paths, member, shares)
        durations = parts.allocate(state, routes) * stretches
        splines, margins = parts.trace_all(state, routes, durations)
        whole_time = durations.sum(axis=0) / shares
        failed = margins.reasons | (paths.reasons & ~np.uint32(Reason.PREFIX_ONLY))[member]
    timer.lap("approach")
    return Plans(
        goals=goals[chosen][member],
        arrival_times=times[chosen][member],
        reasons=failed,
        score=times[chosen][member] - whole_time,
        alpha=stretches,
        lanes=np.arange(len(member)),
        splines=splines,
        margins=margins,
    )


def _warmup(parts: Parts, state: FlatState) -> None:
    warm_up_search(parts.lattices, parts.world, parts.config.path_capacity)
    compile_all(parts.stations, parts.world, parts.config, state)
    candidates = _around(state, parts.config.lanes)
    _plan_batch(parts, state, candidates)
    _approach(parts, state, candidates)


def _evaluate(
    parts: Parts,
    state: FlatState,
    routes: Routes,
    times: Float[np.ndarray, "k"],
    order: Int[np.ndarray, "n"],
    timer: Timer,
) -> Iterator[Evaluated]:
    """Match, solve and check the lanes of the routes in ``order``, in rounds, until a round has a usable one."""
    stations, config = parts.stations, parts.config
    for begin in range(0, len(order), config.lanes):
        lanes = order[begin : begin + config.lanes]
        padded = fill(lanes, config.lanes)
        some = pick(routes, padded)
        arrival = stations.match(state, some, times[padded])
        timer.lap("policy", arrival)
        traced = parts.trace(state, some, arrival.durations)
        reasons = (np.asarray(arrival.reasons) | np.asarray(traced[1].reasons))[: len(lanes)]
        timer.lap("minsnap")
        yield Evaluated(lanes, np.asarray(arrival.alpha)[: len(lanes)], reasons, traced)
        if not config.exhaustive and (reasons == 0).any():
            return


def _by_score(score: Float[np.ndarray, "k"], reasons: UInt32[np.ndarray, "k"]) -> Int[np.ndarray, "n"]:
    """Candidates without a reason against them, the best first, equal ones in the order given."""
    possible = np.flatnonzero((reasons == 0) & np.isfinite(score))
    return possible[np.argsort(-score[possible], kind="stable")]


def _rejected(
    parts: Parts, state: FlatState, candidates: Candidates
) -> tuple[UInt32[np.ndarray, "k"], Float[np.ndarray, "k 3"], Float[np.ndarray, "k"]]:
    """Early reasons, goals and arrival times of the candidates, on the host."""
    goals, times = np.asarray(candidates.goals), np.asarray(candidates.arrival_times)
    likelihood, reasons = np.asarray(candidates.likelihood), np.asarray(candidates.reasons)
    start, target = np.asarray(state.pos), np.asarray(candidates.target)

    def mark(lanes: Int[np.ndarray, "n"]) -> UInt32[Array, "n"]:
        some = Candidates(
            goals=goals[lanes],
            arrival_times=times[lanes],
            likelihood=likelihood[lanes],
            reasons=reasons[lanes],
            target=target,
        )
        return parts.stations.reject(parts.world, some, start).reasons

    return in_portions(mark, np.arange(len(goals)), GOALS_AT_ONCE) if len(goals) else reasons.copy(), goals, times


def _latest_goals(
    reasons: UInt32[np.ndarray, "k"], goals: Float[np.ndarray, "k 3"], times: Float[np.ndarray, "k"]
) -> Int[np.ndarray, "n"]:
    """The few candidates of the longest arrival time that a vehicle may fly to, each goal once."""
    possible = np.flatnonzero((reasons & ~np.uint32(Reason.OUT_OF_REACH)) == 0)
    latest = possible[np.argsort(-times[possible], kind="stable")]
    _, first = np.unique(goals[latest], axis=0, return_index=True)
    return latest[np.sort(first)][:APPROACH_GOALS]


def _approach_axes(goals: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What an approach combines: goal, share of its path, multiple of its least time."""
    return np.arange(goals), np.array(APPROACH_SHARES), np.array(APPROACH_STRETCHES)


def _around(state: FlatState, count: int) -> Candidates:
    """Harmless candidates near a state, to warm up with."""
    goals = np.asarray(state.pos) + 0.3 * np.random.default_rng(0).standard_normal((count, 3)) * [1.0, 1.0, 0.1]
    return candidates_from(np.asarray(state.pos), goals, np.full(count, 1.0), np.zeros(count))
