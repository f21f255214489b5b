"""The stations of a replan on a device, each a traced function of all goals or of some rows."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, UInt32

from jaxplan.arrays import AnyArray
from jaxplan.arrival import sped_up, time_to
from jaxplan.device.paths import Ways
from jaxplan.device.room import Room
from jaxplan.device.stops import stop_points
from jaxplan.feasibility.classifier import Classifier
from jaxplan.knots import SelectedRoutes, select_routes
from jaxplan.minsnap.spline_batch import SplineBatch, fit
from jaxplan.numerics import safe_norm
from jaxplan.planner.records import PlannerConfig
from jaxplan.policy.protocol import Context, Policy
from jaxplan.prediction.candidates import Candidates, reject_early
from jaxplan.selection import Margins, check_clearance, check_flight
from jaxplan.spline import FlatState
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.reach import reach
from jaxplan.world.clearance import clearance_at_once, free_distance_at_once
from jaxplan.world.obstacles import World


class Goals(NamedTuple):
    """Where and when a target could be met; k of them."""

    positions: Float[AnyArray, "k 3"]
    """[m, world]"""
    times: Float[AnyArray, "k"]
    """[s from the start state]"""
    likelihood: Float[AnyArray, "k"]
    """In [0, 1]."""


class Allotted(NamedTuple):
    """All goals' waypoints, and what the policy makes of them."""

    routes: SelectedRoutes
    waypoints: Float[Array, "n 3 k"]
    samples: Float[Array, "p 3 k"]
    context: Context
    length: Float[Array, "k"]
    """Of the whole ways [m]."""

    def some(self, rows: Int[Array, "w"]) -> "Allotted":
        """Those of some rows."""
        first, length = jax.tree.map(lambda leaf: leaf[rows], (self.routes, self.length))
        waypoints, samples, context = jax.tree.map(
            lambda leaf: leaf[..., rows], (self.waypoints, self.samples, self.context)
        )
        return Allotted(first, waypoints, samples, context, length)


class Tried(NamedTuple):
    """Trajectories of some rows."""

    splines: SplineBatch
    margins: Margins
    alpha: Float[Array, "w"]
    arrival: Float[Array, "w"]
    """When each is at its goal [s]; of the beginning of a way, when it would be there at that pace."""


class Stations:
    """What a replan is made of, for one vehicle and what was learned for it."""

    def __init__(
        self, config: PlannerConfig, pieces: int, vehicle: Vehicle, policy: Policy, classifier: Classifier | None
    ) -> None:
        """``pieces``: into which the clearance check cuts a segment."""
        self._config, self._pieces, self._vehicle, self._classifier = config, pieces, vehicle, classifier
        self.policy = policy

    def reject(self, room: Room, state: FlatState, goals: Goals) -> UInt32[Array, "k"]:
        """Early reasons against each goal."""
        times = jnp.asarray(goals.times)
        candidates = Candidates(
            goals=goals.positions,
            arrival_times=times,
            likelihood=goals.likelihood,
            reasons=jnp.zeros(times.shape, jnp.uint32),
            target=jnp.asarray(goals.positions)[0],
        )
        world = _in_precision_of(room.world, times)
        far = self.reach(state, goals)
        marked = reject_early(candidates, world, jnp.asarray(state.pos), self._config.padding, far, clearance_at_once)
        return jnp.asarray(marked.reasons)

    def reach(self, state: FlatState, goals: Goals) -> Float[Array, "k"]:
        """What no flight exceeds until each goal's time [m]."""
        return jnp.asarray(reach(self._vehicle, safe_norm(jnp.asarray(state.vel)), jnp.asarray(goals.times)))

    def allot(self, room: Room, ways: Ways) -> Allotted:
        """Waypoints along all ways, stop points behind their goals, and the policy's view of them."""
        stops = ways.points[:, -1] if self._config.meet == "rest" else stop_points(room, ways.points)
        wide = jnp.result_type(float)
        routes = select_routes(ways.points.astype(wide), self._config.knots, stops=stops.astype(wide))
        waypoints = jnp.moveaxis(routes.knots.waypoints, 0, -1)
        context = self.policy.encode(waypoints, routes.knots.count)
        return Allotted(routes, waypoints, jnp.moveaxis(routes.samples, 0, -1), context, ways.length.astype(wide))

    def least_times(self, every: Allotted, state: FlatState) -> Float[Array, "k"]:
        """Until each goal, at the least scale factor [s]."""
        width = every.waypoints.shape[-1]
        least = jnp.full(width, self._config.arrival.least_alpha, every.waypoints.dtype)
        durations = self.policy.decode(every.context, sped_up(state.repeated(width), least))
        return least * jnp.asarray(time_to(durations, every.routes.meet))

    def solve(
        self,
        room: Room,
        state: FlatState,
        some: Allotted,
        durations: Float[Array, "m w"],
        alpha: Float[Array, "w"],
    ) -> Tried:
        """Minimum snap and every check."""
        planner = self._config
        rate = 0.0 if planner.heading == "hold" else planner.max_yaw_rate
        splines = fit(state, some.waypoints, durations, rate)
        probability = None
        if self._classifier is not None:
            probability = self._classifier.predict(splines, self._vehicle).probability
        world = _in_precision_of(room.world, durations)
        flown = check_flight(splines, some.samples, self._vehicle, planner.checks, probability)
        finer = dataclasses.replace(planner.checks, samples_per_segment=self._pieces)
        margins = check_clearance(flown, splines, world, self._vehicle, finer, free_distance_at_once)
        covered = jnp.sum(safe_norm(jnp.diff(some.samples, axis=0), axis=1), axis=0)
        left_out = jnp.where(some.routes.whole, 1.0, some.length / jnp.maximum(covered, 1e-9))
        return Tried(splines, margins, alpha, jnp.asarray(time_to(durations, some.routes.meet)) * left_out)


def _in_precision_of(world: World, like: Float[Array, "*n"]) -> World:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf).astype(like.dtype), world)
