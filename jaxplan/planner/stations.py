"""The compiled stations of a replan, each on its own so that it can be timed, all for the same number of lanes.

The world is an argument of the two stations that see it, not a constant: a distance grid would bloat the program, and
the other stations serve every world.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt32

from jaxplan.arrival import Arrival, match_arrival
from jaxplan.feasibility.classifier import Classifier
from jaxplan.knots import MAX_WAYPOINTS, select_routes
from jaxplan.minsnap.spline_batch import SplineBatch, fit
from jaxplan.planner.records import PlannerConfig
from jaxplan.policy.protocol import Policy
from jaxplan.prediction.candidates import Candidates, reject_early
from jaxplan.selection import Margins, check_clearance, check_flight
from jaxplan.spline import FlatState
from jaxplan.status import Reason, bit
from jaxplan.vehicle.params import Vehicle
from jaxplan.world.obstacles import World

LENGTHS = (7, MAX_WAYPOINTS)
"""Waypoints of the sequences that are compiled: most replans have no longer one than the first."""


class Routes(NamedTuple):
    """Searched paths in the form that the compiled stations want, batch axis last."""

    waypoints: Float[Array, "n 3 k"]
    count: Int[Array, "k"]
    samples: Float[Array, "p 3 k"]
    reasons: UInt32[Array, "k"]


class Stations(NamedTuple):
    """The compiled functions."""

    reject: Callable[..., Candidates]
    """(world, candidates, start)."""
    route: Callable[..., Routes]
    match: Callable[..., Arrival]
    """(state, routes, arrival times). For arrival times of 0 it ends after one call of the policy, which has its least
    durations: the same program serves both."""
    trace: Callable[..., tuple[SplineBatch, Margins]]
    """(state, routes, durations): solved and checked, but for obstacles."""
    clear: Callable[..., Margins]
    """(world, splines, margins): with the clearance."""


def compile_stations(
    config: PlannerConfig, vehicle: Vehicle, policy: Policy, classifier: Classifier | None
) -> Stations:
    """Bind configuration and constants, and compile."""

    @jax.jit
    def reject(world: World, candidates: Candidates, start: Float[Array, "3"]) -> Candidates:
        return reject_early(candidates, world, start, config.padding, config.max_speed)

    @jax.jit
    def route(paths: Float[Array, "k l 3"], shares: Float[Array, "k"]) -> Routes:
        routes = select_routes(paths, config.knots, shares)
        return Routes(
            waypoints=jnp.moveaxis(routes.knots.waypoints, 0, -1),
            count=routes.knots.count,
            samples=jnp.moveaxis(routes.samples, 0, -1),
            reasons=bit(~routes.whole, Reason.PREFIX_ONLY),
        )

    @jax.jit
    def match(state: FlatState, routes: Routes, arrival_times: Float[Array, "k"]) -> Arrival:
        context = policy.encode(routes.waypoints, routes.count)
        return match_arrival(lambda d: policy.decode(context, d), state, arrival_times, config.arrival)

    @jax.jit
    def trace(state: FlatState, routes: Routes, durations: Float[Array, "m k"]) -> tuple[SplineBatch, Margins]:
        splines = fit(state, routes.waypoints, durations, config.max_yaw_rate)
        probability = None if classifier is None else classifier.predict(splines, vehicle).probability
        return splines, check_flight(splines, routes.samples, vehicle, config.checks, probability)

    @jax.jit
    def clear(world: World, splines: SplineBatch, margins: Margins) -> Margins:
        return check_clearance(margins, splines, world, vehicle, config.checks)

    return Stations(reject, route, match, trace, clear)


def shortened(routes: Routes) -> Routes:
    """The same sequences in arrays of the smallest compiled length that holds them."""
    return cut(routes, next(length for length in LENGTHS if np.max(routes.count) <= length))


def cut(routes: Routes, length: int) -> Routes:
    """The same sequences in arrays of ``length`` waypoints."""
    return routes._replace(waypoints=np.asarray(routes.waypoints)[:length])


def no_trajectories() -> tuple[SplineBatch, Margins]:
    """What ``trace`` and ``clear`` give for no candidate at all."""
    segments, none = MAX_WAYPOINTS - 1, np.zeros(0)
    splines = SplineBatch(
        durations=np.zeros((segments, 0)), position=np.zeros((segments, 10, 3, 0)), yaw=np.zeros((segments, 6, 1, 0))
    )
    reasons = np.zeros(0, np.uint32)
    return splines, Margins(deviation=none, clearance=none, rotor_speed=none, probability=none, reasons=reasons)
