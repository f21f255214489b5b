"""``build_planner``: every decision that depends on configuration is taken here, once.

Only what can win is matched, solved and checked: a candidate's score does not depend on alpha, so the reachable ones
are taken in order of score, some at a time, until one passes. The winner is that of an exhaustive evaluation.
"""

import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int, UInt32

from jaxplan.feasibility.classifier import Classifier
from jaxplan.minsnap.batch import SplineBatch
from jaxplan.numerics import in_float64
from jaxplan.planner.lanes import bucket_for, join_lanes, pad, round_sizes, scatter
from jaxplan.planner.records import (
    APPROACH_GOALS,
    APPROACH_SHARES,
    APPROACH_STRETCHES,
    Planner,
    PlannerConfig,
    Plans,
    Timer,
)
from jaxplan.planner.stations import Routes, Stations, compile_stations, shortened
from jaxplan.planner.warmup import compile_all
from jaxplan.policy.protocol import Policy
from jaxplan.prediction.candidates import Candidates, candidates_from
from jaxplan.search.lattice import Lattices, Paths, SearchConfig, build_lattices
from jaxplan.search.routes import find_routes
from jaxplan.search.routes import warmup as warm_up_search
from jaxplan.selection import Margins
from jaxplan.spline import FlatState
from jaxplan.status import Reason
from jaxplan.vehicle.params import Vehicle
from jaxplan.world.obstacles import World


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
    lattices = build_lattices(world, SearchConfig(padding=config.padding))
    world = in_float64(jax.device_put)(world)
    parts = Parts(config, compile_stations(config, world, vehicle, policy, classifier), lattices, world)
    return Planner(
        plan_batch=functools.partial(in_float64(_plan_batch), parts),
        approach=functools.partial(in_float64(_approach), parts),
        warmup=functools.partial(in_float64(_warmup), parts),
        config=config,
    )


def _plan_batch(parts: Parts, state: FlatState, candidates: Candidates, timer: Timer | None = None) -> Plans:
    config, stations, timer = parts.config, parts.stations, timer or Timer()
    reasons, goals, times = _rejected(stations, state, candidates, config.buckets)
    score = config.likelihood_weight * np.asarray(candidates.likelihood) - times
    chosen = np.flatnonzero(reasons == 0)
    timer.lap("reject")
    paths = parts.search(state, goals[chosen], candidates.target)
    timer.lap("search")
    bucket = bucket_for(len(chosen), config.buckets)
    routes = stations.route(pad(paths.points, bucket, fill=state.pos), np.ones(bucket))
    routes = shortened(routes, int(np.asarray(routes.count).max()))
    reasons[chosen] |= paths.reasons | np.asarray(routes.reasons)[: len(chosen)]
    timer.lap("knots")
    context, least = stations.read(routes, state)
    shares = times[chosen] / np.asarray(least)[: len(chosen)]
    reasons[chosen] |= np.where(shares >= 1.0 - config.arrival.tolerance, 0, Reason.ALPHA_LT_1).astype(np.uint32)
    timer.lap("policy")
    order = np.arange(len(chosen)) if config.exhaustive else _by_score(score[chosen], reasons[chosen])
    rounds = list(_evaluate(parts, state, routes, context, times[chosen], order, timer))
    alpha, lanes = scatter(shares, chosen, len(goals), np.nan), np.full(len(goals), -1)
    for part in rounds:
        members = chosen[part.lanes]
        lanes[members] = np.arange(len(members)) + lanes.max() + 1
        alpha[members] = part.alpha
        reasons[members] |= part.reasons
    waiting = chosen[order]
    reasons[waiting[lanes[waiting] < 0]] |= np.uint32(Reason.OUTRANKED)
    splines, margins = join_lanes([(part.traced, len(part.lanes)) for part in rounds])
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
    config, stations, timer = parts.config, parts.stations, timer or Timer()
    reasons, goals, times = _rejected(stations, state, candidates, config.buckets)
    chosen = _latest_goals(reasons, goals, times)
    paths = parts.search(state, goals[chosen], candidates.target)
    lanes, shares, stretches = (axis.ravel() for axis in np.meshgrid(*_approach_axes(len(chosen)), indexing="ij"))
    bucket = bucket_for(len(lanes), config.buckets)
    routes = stations.route(pad(paths.points[lanes], bucket, state.pos), pad(shares, bucket, 1.0))
    routes = shortened(routes, int(np.asarray(routes.count).max()))
    durations = stations.stretch(routes, state, pad(stretches, bucket, 1.0))
    splines, margins = stations.trace(state, routes, durations)
    whole_time = np.asarray(durations).sum(axis=0)[: len(lanes)] / shares
    failed = np.asarray(margins.reasons)[: len(lanes)] | (paths.reasons & ~np.uint32(Reason.PREFIX_ONLY))[lanes]
    timer.lap("approach")
    return Plans(
        goals=goals[chosen][lanes],
        arrival_times=times[chosen][lanes],
        reasons=failed,
        score=times[chosen][lanes] - whole_time,
        alpha=stretches,
        lanes=np.arange(len(lanes)),
        splines=splines,
        margins=margins,
    )


def _warmup(parts: Parts, state: FlatState) -> None:
    warm_up_search(parts.lattices, parts.world, parts.config.path_capacity)
    compile_all(parts.stations, parts.config, state)
    for count in parts.config.buckets:
        candidates = _around(state, count)
        _plan_batch(parts, state, candidates)
        _approach(parts, state, candidates)


def _evaluate(
    parts: Parts,
    state: FlatState,
    routes: Routes,
    context: Any,
    times: Float[np.ndarray, "k"],
    order: Int[np.ndarray, "n"],
    timer: Timer,
) -> Iterator[Evaluated]:
    """Match, solve and check the lanes of the routes in ``order``, in growing rounds, until a round has a usable one.

    At least one round is run, so that there are arrays to return.
    """
    stations, config, begin = parts.stations, parts.config, 0
    for size in _rounds(len(order), config):
        lanes = order[begin : begin + size]
        padded = pad(lanes, size, fill=0)
        some = stations.pick(routes, padded)
        arrival = stations.match(stations.pick(context, padded), state, pad(times[lanes], size, fill=1.0))
        timer.lap("policy", arrival)
        traced = stations.trace(state, some, arrival.durations)
        reasons = (np.asarray(arrival.reasons) | np.asarray(traced[1].reasons))[: len(lanes)]
        timer.lap("minsnap")
        yield Evaluated(lanes, np.asarray(arrival.alpha)[: len(lanes)], reasons, traced)
        begin += size
        if not config.exhaustive and (reasons == 0).any():
            return


def _rounds(count: int, config: PlannerConfig) -> Iterator[int]:
    """Sizes of the rounds: a small one, then larger ones; all at once if exhaustive. At least one."""
    if config.exhaustive:
        yield bucket_for(count, config.buckets)
        return
    small, large = round_sizes(config.buckets)
    yield small
    for _ in range(small, count, large):
        yield large


def _by_score(score: Float[np.ndarray, "k"], reasons: UInt32[np.ndarray, "k"]) -> Int[np.ndarray, "n"]:
    """Candidates without a reason against them, the best first, equal ones in the order given."""
    possible = np.flatnonzero((reasons == 0) & np.isfinite(score))
    return possible[np.argsort(-score[possible], kind="stable")]


def _rejected(
    stations: Stations, state: FlatState, candidates: Candidates, buckets: tuple[int, ...]
) -> tuple[UInt32[np.ndarray, "k"], Float[np.ndarray, "k 3"], Float[np.ndarray, "k"]]:
    """Early reasons, goals and arrival times of the candidates, on the host."""
    goals, times = np.asarray(candidates.goals), np.asarray(candidates.arrival_times)
    bucket = bucket_for(len(goals), buckets)
    padded = Candidates(
        goals=pad(goals, bucket, fill=np.nan),
        arrival_times=pad(times, bucket, fill=np.nan),
        likelihood=pad(np.asarray(candidates.likelihood), bucket, fill=0.0),
        reasons=pad(np.asarray(candidates.reasons), bucket, fill=0),
        target=np.asarray(candidates.target),
    )
    marked = stations.reject(padded, np.asarray(state.pos))
    return np.array(marked.reasons)[: len(goals)], goals, times


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
