"""Compiling every station for every length before the first replan."""

import functools
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np

from jaxplan.numerics import in_float64
from jaxplan.planner.records import PlannerConfig
from jaxplan.planner.stations import LENGTHS, Routes, Stations, cut
from jaxplan.spline import FlatState
from jaxplan.world.obstacles import World


def compile_all(stations: Stations, world: World, config: PlannerConfig, state: FlatState) -> None:
    """Compile the lengths side by side: XLA leaves a core idle for much of the time."""
    paths = np.tile(np.asarray(state.pos), (config.lanes, config.path_capacity, 1))
    whole = jax.tree.map(np.asarray, stations.route(paths, np.ones(config.lanes)))
    with ThreadPoolExecutor(len(LENGTHS)) as pool:
        list(pool.map(in_float64(functools.partial(_compile, stations, world, state, whole)), LENGTHS))


def _compile(stations: Stations, world: World, state: FlatState, whole: Routes, length: int) -> None:
    """Call the stations, each with what the one before it returns."""
    routes = cut(whole, length)
    least = np.asarray(stations.allocate(state, routes))
    arrival = stations.match(state, routes, least.sum(axis=0))
    jax.block_until_ready(stations.clear(world, *stations.trace(state, routes, arrival.durations)))
