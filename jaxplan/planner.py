"""One replan, from candidates to checked trajectories: the stations of the method in order.

    candidates -> search -> knots -> policy <-> arrival -> minimum snap -> checks -> selection

``build_planner`` takes every decision that depends on configuration and returns a tuple of functions. Search
runs on the host; the other stations are compiled, once for each bucket of candidates.
"""

import dataclasses
import functools
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt32

from jaxplan.arrival import Arrival, ArrivalConfig, match_arrival
from jaxplan.errors import InputError
from jaxplan.minsnap.batch import SplineBatch, fit
from jaxplan.numerics import in_float64
from jaxplan.policy.protocol import Policy
from jaxplan.prediction.candidates import Candidates, candidates_from, reject_early
from jaxplan.records import record
from jaxplan.search.knots import KnotConfig, select_route
from jaxplan.search.lattice import Paths, SearchConfig, build_lattices
from jaxplan.search.routes import find_routes
from jaxplan.search.routes import warmup as warm_up_search
from jaxplan.selection import CheckConfig, Margins, check
from jaxplan.selection import select as select_best
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.status import Reason, bit
from jaxplan.vehicle.params import Vehicle
from jaxplan.world.obstacles import World

APPROACH_GOALS = 4
APPROACH_SHARES = (1.0, 0.6, 0.3)
APPROACH_STRETCHES = (1.0, 1.4, 2.0)
"""An approach tries this many goals, each along these shares of its path, at these multiples of its least time
(arbitrary)."""
APPROACH_LANES = APPROACH_GOALS * len(APPROACH_SHARES) * len(APPROACH_STRETCHES)


@dataclasses.dataclass(frozen=True)
class PlannerConfig:
    """Every setting of the planner, in SI units."""

    padding: float = 0.5
    """Clearance of goals and searched paths from obstacles [m] (paper, Sec. IV)."""
    max_speed: float = 8.0
    """Goals that need more than this average speed [m/s] are dropped at once (arbitrary, above what is ever flown)."""
    max_yaw_rate: float = 3.0
    """Average yaw rate [rad/s] that a segment may ask for (arbitrary)."""
    likelihood_weight: float = 1.0
    """Seconds that a likelihood of 1 is worth in the selection (paper eq. 9 leaves the unit open)."""
    path_capacity: int = 32
    """Corners of the longest taut path; longer ones are planned as prefixes."""
    buckets: tuple[int, ...] = (36, 100, 400)
    """Candidate counts that are compiled; a batch is padded to the next one, larger batches are refused."""
    knots: KnotConfig = KnotConfig()
    arrival: ArrivalConfig = ArrivalConfig()
    checks: CheckConfig = CheckConfig()

    def __post_init__(self) -> None:
        for name in ("max_speed", "max_yaw_rate"):
            if not 0.0 < getattr(self, name) < float("inf"):
                raise InputError(f"planner: {name} is {getattr(self, name)}, want a positive number")
        if not 0.0 <= self.padding < float("inf"):
            raise InputError(f"planner: padding is {self.padding} m, want 0 or more")
        if list(self.buckets) != sorted(set(self.buckets)) or min(self.buckets, default=0) < APPROACH_LANES:
            raise InputError(
                f"planner: buckets are {self.buckets}, want increasing counts of at least {APPROACH_LANES}"
            )


@record
class Plans:
    """What became of every candidate, in the order they were given."""

    goals: Float[np.ndarray, "k 3"]
    arrival_times: Float[np.ndarray, "k"]
    """When each target is there [s from the start state]."""
    reasons: UInt32[np.ndarray, "k"]
    """0 means usable."""
    score: Float[np.ndarray, "k"]
    """What the selection maximises [s]."""
    alpha: Float[np.ndarray, "k"]
    """Scale factor of the time allocation; NaN where none was computed."""
    lanes: Int[np.ndarray, "k"]
    """Lane of each candidate in ``splines`` and ``margins``; -1 for those that were rejected before planning."""
    splines: SplineBatch
    margins: Margins

    def spline(self, index: int) -> PiecewisePolynomial:
        """The trajectory to candidate ``index`` (host, NumPy)."""
        return self.splines.spline(int(self.lanes[index]))


def select(plans: Plans) -> int:
    """Index of the candidate to commit; -1 when nothing is usable, never index 0 by accident."""
    return select_best(plans.score, plans.reasons)


class Planner(NamedTuple):
    """The planner's functions; after ``warmup`` none of them compiles anything."""

    plan_batch: Callable[..., Plans]
    """(state, candidates, timer): trajectories from one state timed to meet each candidate (paper, Sec. III-B)."""
    approach: Callable[..., Plans]
    """(state, candidates, timer): trajectories towards the latest candidates, only late, for when none can be met."""
    warmup: Callable[[FlatState], None]
    """Compile every station for every bucket."""
    config: PlannerConfig


class Timer:
    """Wall time of the stations [ms]; waits for compiled results, so that each station pays for itself."""

    def __init__(self) -> None:
        self.stages: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str, result: Any = None) -> None:
        jax.block_until_ready(result)
        now = time.perf_counter()
        self.stages[stage] = self.stages.get(stage, 0.0) + 1e3 * (now - self._last)
        self._last = now


class Routes(NamedTuple):
    """Searched paths in the form that the compiled stations want, batch axis last."""

    waypoints: Float[Array, "14 3 k"]
    count: Int[Array, "k"]
    samples: Float[Array, "p 3 k"]
    reasons: UInt32[Array, "k"]


class _Stations(NamedTuple):
    """The compiled stations."""

    reject: Callable[..., Candidates]
    route: Callable[..., Routes]
    allocate: Callable[..., Arrival]
    stretch: Callable[..., Float[Array, "m k"]]
    trace: Callable[..., tuple[SplineBatch, Margins]]


def build_planner(
    config: PlannerConfig = PlannerConfig(), *, world: World, vehicle: Vehicle, policy: Policy
) -> Planner:
    """Compose the stations for one world, vehicle and policy."""
    lattices = build_lattices(world, SearchConfig(padding=config.padding))
    world = in_float64(jax.device_put)(world)
    stations = _compile_stations(config, world, vehicle, policy)

    def search(state: FlatState, goals: Float[np.ndarray, "k 3"], target: Float[np.ndarray, "3"]) -> Paths:
        start = np.asarray(state.pos)
        distance = float(np.linalg.norm(target - start))
        return find_routes(lattices, world, start, goals, distance, capacity=config.path_capacity)

    @in_float64
    def plan_batch(state: FlatState, candidates: Candidates, timer: Timer | None = None) -> Plans:
        timer = timer or Timer()
        reasons, goals, times = _rejected(stations, state, candidates, config.buckets)
        chosen = np.flatnonzero(reasons == 0)
        bucket = _bucket(len(chosen), config.buckets)
        timer.lap("reject")
        paths = search(state, goals[chosen], candidates.target)
        timer.lap("search")
        routes = stations.route(_pad(paths.points, bucket, fill=state.pos), np.ones(bucket))
        timer.lap("knots", routes)
        arrival = stations.allocate(routes, state, _pad(times[chosen], bucket, fill=1.0))
        timer.lap("policy", arrival)
        splines, margins = stations.trace(state, routes, arrival.durations)
        timer.lap("minsnap", margins)
        reasons[chosen] |= paths.reasons | np.asarray(routes.reasons | arrival.reasons | margins.reasons)[: len(chosen)]
        return Plans(
            goals=goals,
            arrival_times=times,
            reasons=reasons,
            score=config.likelihood_weight * np.asarray(candidates.likelihood) - times,
            alpha=_scatter(np.asarray(arrival.alpha), chosen, len(goals), np.nan),
            lanes=_scatter(np.arange(bucket), chosen, len(goals), -1),
            splines=splines,
            margins=margins,
        )

    @in_float64
    def approach(state: FlatState, candidates: Candidates, timer: Timer | None = None) -> Plans:
        timer = timer or Timer()
        reasons, goals, times = _rejected(stations, state, candidates, config.buckets)
        chosen = _latest_goals(reasons, goals, times)
        paths = search(state, goals[chosen], candidates.target)
        lanes, shares, stretches = (axis.ravel() for axis in np.meshgrid(*_approach_axes(len(chosen)), indexing="ij"))
        bucket = _bucket(len(lanes), config.buckets)
        routes = stations.route(_pad(paths.points[lanes], bucket, state.pos), _pad(shares, bucket, 1.0))
        durations = stations.stretch(routes, state, _pad(stretches, bucket, 1.0))
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

    @in_float64
    def warmup(state: FlatState) -> None:
        warm_up_search(lattices, world, config.path_capacity)
        for bucket in config.buckets:
            routes = stations.route(np.tile(np.asarray(state.pos), (bucket, config.path_capacity, 1)), np.ones(bucket))
            arrival = stations.allocate(routes, state, np.ones(bucket))
            jax.block_until_ready(stations.trace(state, routes, arrival.durations))
        for count in config.buckets:
            candidates = _around(state, count)
            plan_batch(state, candidates)
            approach(state, candidates)

    return Planner(plan_batch, approach, warmup, config)


def _compile_stations(config: PlannerConfig, world: World, vehicle: Vehicle, policy: Policy) -> _Stations:
    """Bind configuration and constants, and compile each station on its own so that it can be timed.

    The world is an argument of what is compiled, not a constant: a distance grid would bloat the program.
    """

    @jax.jit
    def reject(world: World, candidates: Candidates, start: Float[Array, "3"]) -> Candidates:
        return reject_early(candidates, world, start, config.padding, config.max_speed)

    @jax.jit
    def route(paths: Float[Array, "k l 3"], shares: Float[Array, "k"]) -> Routes:
        routes = jax.vmap(lambda path, share: select_route(path, config.knots, share))(paths, shares)
        return Routes(
            waypoints=jnp.moveaxis(routes.knots.waypoints, 0, -1),
            count=routes.knots.count,
            samples=jnp.moveaxis(routes.samples, 0, -1),
            reasons=bit(~routes.whole, Reason.PREFIX_ONLY),
        )

    @jax.jit
    def allocate(routes: Routes, state: FlatState, arrival_times: Float[Array, "k"]) -> Arrival:
        context = policy.encode(routes.waypoints, routes.count)
        initial = state.derivatives[1:]
        return match_arrival(lambda d: policy.decode(context, d), initial, arrival_times, config.arrival)

    @jax.jit
    def stretch(routes: Routes, state: FlatState, factor: Float[Array, "k"]) -> Float[Array, "m k"]:
        context = policy.encode(routes.waypoints, routes.count)
        initial = jnp.broadcast_to(state.derivatives[1:, :, None], (4, 3, len(factor)))
        return factor * policy.decode(context, initial)

    @jax.jit
    def trace(
        world: World, state: FlatState, routes: Routes, durations: Float[Array, "m k"]
    ) -> tuple[SplineBatch, Margins]:
        splines = fit(state, routes.waypoints, durations, config.max_yaw_rate)
        return splines, check(splines, routes.samples, world, vehicle, config.checks)

    return _Stations(functools.partial(reject, world), route, allocate, stretch, functools.partial(trace, world))


def _rejected(
    stations: _Stations, state: FlatState, candidates: Candidates, buckets: tuple[int, ...]
) -> tuple[UInt32[np.ndarray, "k"], Float[np.ndarray, "k 3"], Float[np.ndarray, "k"]]:
    """Early reasons, goals and arrival times of the candidates, on the host."""
    goals, times = np.asarray(candidates.goals), np.asarray(candidates.arrival_times)
    bucket = _bucket(len(goals), buckets)
    padded = Candidates(
        goals=_pad(goals, bucket, fill=np.nan),
        arrival_times=_pad(times, bucket, fill=np.nan),
        likelihood=_pad(np.asarray(candidates.likelihood), bucket, fill=0.0),
        reasons=_pad(np.asarray(candidates.reasons), bucket, fill=0),
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


def _bucket(count: int, buckets: tuple[int, ...]) -> int:
    for bucket in buckets:
        if count <= bucket:
            return bucket
    raise InputError(f"planner: {count} candidates, want at most {buckets[-1]}; raise PlannerConfig.buckets")


def _pad(values: np.ndarray, length: int, fill: Any) -> np.ndarray:
    """``values`` followed by rows of ``fill`` up to ``length``."""
    padding = np.broadcast_to(np.asarray(fill, dtype=values.dtype), (length - len(values), *values.shape[1:]))
    return np.concatenate([values, padding])


def _scatter(values: np.ndarray, chosen: Int[np.ndarray, "n"], length: int, fill: float) -> np.ndarray:
    """The first values put at the ``chosen`` places of an array of ``fill``."""
    full = np.full(length, fill)
    full[chosen] = values[: len(chosen)]
    return full
