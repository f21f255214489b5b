"""Compiling every station for every length, and what works on chosen plans, before the first replan."""

import functools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np

from jaxplan.compilation import uncollected
from jaxplan.planner.fallbacks import Stops
from jaxplan.planner.parts import Parts
from jaxplan.planner.records import PlannerConfig
from jaxplan.planner.refined import Seed
from jaxplan.planner.refinement import refine
from jaxplan.planner.rollouts import Rollout, sampled
from jaxplan.planner.stations import LENGTHS, Match, Routes, Stations, cut
from jaxplan.precision import in_float64
from jaxplan.prediction.candidates import Candidates, candidates_from
from jaxplan.spline import FlatState, PiecewisePolynomial, hover
from jaxplan.tracking.rates import CONTROL_RATE


def compile_all(stations: Stations, asked: Sequence[Match], config: PlannerConfig, state: FlatState) -> None:
    """Compile the lengths side by side: XLA leaves a core idle for much of the time.

    ``asked``: those of the time allocations that the configuration can ask for; the others are not compiled.
    """
    with uncollected(), ThreadPoolExecutor(len(LENGTHS)) as pool:
        whole = _compile_route(stations, config, state)
        list(pool.map(in_float64(functools.partial(_compile, stations, asked, state, whole)), LENGTHS))


def compile_first(stations: Stations, config: PlannerConfig, state: FlatState) -> None:
    """Compile what every replan calls, for the length that most have: work on the host leaves a core idle."""
    with uncollected():
        routes = cut(_compile_route(stations, config, state), LENGTHS[0])
        durations = np.ones((LENGTHS[0] - 1, config.width))
        jax.block_until_ready(stations.solve(state, routes, durations, np.asarray(state.pos), 1.0))


def _compile_route(stations: Stations, config: PlannerConfig, state: FlatState) -> Routes:
    """Call the station that places waypoints; routes that stay where they begin."""
    paths = np.tile(np.asarray(state.pos), (config.width, config.path_capacity, 1))
    return Routes(*(np.asarray(part) for part in stations.route(paths, paths[:, -1])))


def _compile(stations: Stations, asked: Sequence[Match], state: FlatState, whole: Routes, length: int) -> None:
    """Call the stations, each with what the one before it returns."""
    routes = cut(whole, length)
    nothing, once = np.zeros(len(routes.count)), np.ones(len(routes.count))
    arrival = [match(state, routes, nothing, once) for match in asked][-1]
    jax.block_until_ready(stations.solve(state, routes, arrival.durations, np.asarray(state.pos), 1.0))


def compile_refinement(parts: Parts, state: FlatState, candidates: Candidates) -> None:
    """Compile what works on one chosen plan: the refinement, from a plan that stays where it is."""
    if parts.config.refinement is not None:
        still = PiecewisePolynomial(durations=np.ones(2), position=np.zeros((2, 10, 3)), yaw=np.zeros((2, 6)))
        refine(parts, hover(state.pos), candidates, Seed(still, 0.0, 1.0, np.asarray(state.pos), 1.0))


def fly_once(parts: Parts, stops: Stops) -> None:
    """Compile what samples trajectories, and the model, where plans are flown in it."""
    references = sampled(stops.splines, np.arange(CONTROL_RATE + 1) / CONTROL_RATE)
    if parts.flyer is not None:
        flown = jax.tree.map(lambda rows: rows[0], references)
        Rollout(parts.flyer, parts.room, parts.radius, flown, flown.pos[-1], flown.vel[-1]).along(references)


def candidates_around(state: FlatState, count: int) -> Candidates:
    """Candidates near a state, to warm up with."""
    goals = np.asarray(state.pos) + 0.3 * np.random.default_rng(0).standard_normal((count, 3)) * [1.0, 1.0, 0.1]
    return candidates_from(np.asarray(state.pos), goals, np.linspace(0.5, 1.5, count), np.zeros(count))
