"""The compiled stations of a replan, each on its own so that it can be timed, all for the same number of candidates.

The world is an argument of the one station that sees it, not a constant: a distance grid would bloat the program, and
the other stations serve every world.
"""

import functools
from typing import NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt32

from jaxplan.arrays import AnyArray, Scalar
from jaxplan.arrival import Arrival, match_arrival, time_to
from jaxplan.feasibility.classifier import Classifier
from jaxplan.kept import kept
from jaxplan.knots import MAX_WAYPOINTS, select_routes
from jaxplan.minsnap.quadratic_program import Passage
from jaxplan.minsnap.spline_batch import SplineBatch, fit
from jaxplan.numerics import safe_norm
from jaxplan.planner.kernels.profile import profile_arrival
from jaxplan.planner.records import PlannerConfig
from jaxplan.policy.protocol import Policy
from jaxplan.prediction.candidates import Candidates, reject_early
from jaxplan.selection import Margins, check_flight
from jaxplan.spline import FlatState
from jaxplan.status import Reason, bit
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.reach import reach, sideways_acceleration
from jaxplan.world.obstacles import World

LENGTHS = (7, MAX_WAYPOINTS)
"""Waypoints of the sequences that are compiled: most replans have no longer one than the first."""


class Routes(NamedTuple):
    """Searched paths in the form that the compiled stations want, batch axis last."""

    waypoints: Float[AnyArray, "n 3 k"]
    """Knots of each path [m, world]; the goal is repeated behind the last one."""
    count: Int[AnyArray, "k"]  # type: ignore[assignment]  # of waypoints, not tuple.count
    """Waypoints in use."""
    meet: Int[AnyArray, "k"]
    """Number of the waypoint at the goal, where the target is met; behind it there may be a stop point."""
    samples: Float[AnyArray, "p 3 k"]
    """The paths at equal steps of arc length [m, world], for the deviation test."""
    reasons: UInt32[AnyArray, "k"]
    velocity: Float[AnyArray, "3 k"]
    """At which the goal is passed [m/s, world]; NaN where that is free."""


class Trajectories(NamedTuple):
    """Solved and checked, batch axis last."""

    splines: SplineBatch
    margins: Margins


class Reject(Protocol):
    """Early reasons against candidates."""

    def __call__(self, world: World, candidates: Candidates, state: FlatState) -> Candidates:
        """``state`` is where the plan begins."""


class Route(Protocol):
    """Waypoints along paths."""

    def __call__(self, paths: Float[AnyArray, "k l 3"], stops: Float[AnyArray, "k 3"]) -> Routes:
        """Corners of the paths, and where each goes on to behind its goal [m, world]."""


@runtime_checkable
class Match(Protocol):
    """Durations that arrive at given times."""

    def __call__(
        self, state: FlatState, routes: Routes, arrival_times: Float[AnyArray, "k"], least_alpha: Float[AnyArray, "k"]
    ) -> Arrival:
        """For arrival times of 0 [s] it ends after one call of the policy, which has the durations at ``least_alpha``.

        The same program serves both.
        """


class Solve(Protocol):
    """Minimum-snap trajectories with all their checks but the one for obstacles."""

    def __call__(
        self,
        state: FlatState,
        routes: Routes,
        durations: Float[AnyArray, "m k"],
        target: Float[AnyArray, "3"],
        least_probability: Scalar,
    ) -> Trajectories:
        """``durations`` in seconds per segment, 0 behind the last one; ``target`` is where it is at the start [m].

        ``least_probability`` of being tracked is asked of a trajectory where a classifier decides.
        """


class Stations(NamedTuple):
    """The compiled functions."""

    reject: Reject
    route: Route
    match_policy: Match
    match_profile: Match
    solve: Solve


def compile_stations(
    config: PlannerConfig, vehicle: Vehicle, policy: Policy, classifier: Classifier | None
) -> Stations:
    """Bind configuration and constants, and compile."""

    @kept
    def reject(world: World, candidates: Candidates, state: FlatState) -> Candidates:
        times = jnp.asarray(candidates.arrival_times)
        farthest = jnp.asarray(reach(vehicle, safe_norm(jnp.asarray(state.vel)), times))
        return reject_early(candidates, world, jnp.asarray(state.pos), config.padding, farthest)

    @kept
    def route(paths: Float[Array, "k l 3"], stops: Float[Array, "k 3"]) -> Routes:
        routes = select_routes(paths, config.knots, stops=stops)
        return Routes(
            waypoints=jnp.moveaxis(routes.knots.waypoints, 0, -1),
            count=routes.knots.count,
            meet=routes.meet,
            samples=jnp.moveaxis(routes.samples, 0, -1),
            reasons=bit(~routes.whole, Reason.PREFIX_ONLY),
            velocity=jnp.full((3, len(paths)), jnp.nan),
        )

    def match(
        policy: Policy,
        state: FlatState,
        routes: Routes,
        arrival_times: Float[Array, "k"],
        least_alpha: Float[Array, "k"],
    ) -> Arrival:
        context = policy.encode(jnp.asarray(routes.waypoints), jnp.asarray(routes.count))
        meet = jnp.asarray(routes.meet)
        return match_arrival(
            lambda d: policy.decode(context, d), state, arrival_times, config.arrival, meet, least_alpha
        )

    max_yaw_rate = 0.0 if config.heading == "hold" else config.max_yaw_rate

    @kept
    def solve(
        state: FlatState,
        routes: Routes,
        durations: Float[Array, "m k"],
        target: Float[Array, "3"],
        least_probability: Scalar,
    ) -> Trajectories:
        looking = _at_target(routes, durations, target) if config.heading == "target" else None
        passage = _passage(routes) if config.meet == "match" else None
        splines = fit(state, jnp.asarray(routes.waypoints), durations, max_yaw_rate, looking, passage)
        probability = None if classifier is None else classifier.predict(splines, vehicle).probability
        paths = jnp.asarray(routes.samples)
        return Trajectories(
            splines, check_flight(splines, paths, vehicle, config.checks, probability, least_probability)
        )

    acceleration = sideways_acceleration(vehicle)

    def by_profile(
        state: FlatState, routes: Routes, arrival_times: Float[AnyArray, "k"], least_alpha: Float[AnyArray, "k"]
    ) -> Arrival:
        waypoints, count, meet, velocity = (np.asarray(part) for part in (*routes[:3], state.vel))
        times, least = np.asarray(arrival_times), np.asarray(least_alpha)
        return profile_arrival(waypoints, count, meet, velocity, times, least, acceleration, config.arrival)

    return Stations(reject, route, kept(functools.partial(match, policy)), by_profile, solve)


def _at_target(routes: Routes, durations: Float[Array, "m k"], target: Float[Array, "3"]) -> Float[Array, "n 2 k"]:
    """Horizontal directions [m] from each waypoint to a target that flies evenly to the meeting; 0 from there on."""
    waypoints, meet = jnp.asarray(routes.waypoints), jnp.asarray(routes.meet)
    goal = jnp.take_along_axis(waypoints, meet[None, None], axis=0)
    times = jnp.concatenate([jnp.zeros_like(durations[:1]), jnp.cumsum(durations, axis=0)])
    share = (times / time_to(durations, meet)[None])[:, None]
    before = (jnp.arange(len(waypoints), dtype=meet.dtype)[:, None] < meet[None])[:, None]
    now = target[None, :, None]
    there = now + (goal - now) * share
    return jnp.where(before, there - waypoints, 0.0)[:, :2]


def _passage(routes: Routes) -> Passage:
    """The goals that are passed at a velocity of their own, where the sequence goes on behind them."""
    velocity, meet = jnp.asarray(routes.velocity), jnp.asarray(routes.meet)
    given = jnp.isfinite(velocity).all(axis=0) & (meet < jnp.asarray(routes.count) - 1)
    return Passage(jnp.where(given, meet, 0), jnp.where(given[None], velocity, 0.0))


def shortened(routes: Routes) -> Routes:
    """The same sequences in arrays of the smallest compiled length that holds them."""
    return cut(routes, next(length for length in LENGTHS if np.max(routes.count) <= length))


def cut(routes: Routes, length: int) -> Routes:
    """The same sequences in arrays of ``length`` waypoints."""
    return routes._replace(waypoints=np.asarray(routes.waypoints)[:length])


def lengthened(trajectories: Trajectories, segments: int) -> Trajectories:
    """The same with padding behind their last segments until there are ``segments``."""
    splines, margins = trajectories
    missing = segments - len(splines.durations)
    if missing == 0:
        return trajectories
    durations = np.pad(np.asarray(splines.durations), [(0, missing), (0, 0)])
    position, yaw = _staying(np.asarray(splines.position), missing), _staying(np.asarray(splines.yaw), missing)
    return Trajectories(SplineBatch(durations=durations, position=position, yaw=yaw), margins)


def _staying(coefficients: Float[np.ndarray, "m n d k"], more: int) -> Float[np.ndarray, "l n d k"]:
    """Polynomials on [0, 1] and so many more behind them that stay where the last one ends."""
    rest = np.zeros((more, *coefficients.shape[1:]))
    rest[:, 0] = coefficients[-1].sum(axis=0)
    return np.concatenate([coefficients, rest])


def no_trajectories() -> Trajectories:
    """What the stations give for no candidate at all."""
    segments, none = MAX_WAYPOINTS - 1, np.zeros(0)
    splines = SplineBatch(
        durations=np.zeros((segments, 0)), position=np.zeros((segments, 10, 3, 0)), yaw=np.zeros((segments, 6, 1, 0))
    )
    reasons = np.zeros(0, np.uint32)
    margins = Margins(deviation=none, clearance=none, rotor_speed=none, probability=none, reasons=reasons)
    return Trajectories(splines, margins)
