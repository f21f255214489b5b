"""Compiling every station for every length before the first replan."""

import jax
import numpy as np

from jaxplan.planner.records import PlannerConfig
from jaxplan.planner.stations import LENGTHS, Stations, cut
from jaxplan.spline import FlatState
from jaxplan.world.obstacles import World


def compile_all(stations: Stations, world: World, config: PlannerConfig, state: FlatState) -> None:
    """Call every station, each with what the one before it returns."""
    paths = np.tile(np.asarray(state.pos), (config.lanes, config.path_capacity, 1))
    whole = stations.route(paths, np.ones(config.lanes))
    for length in LENGTHS:
        routes = jax.tree.map(np.asarray, cut(whole, length))
        least = np.asarray(stations.allocate(state, routes))
        arrival = stations.match(state, routes, least.sum(axis=0))
        jax.block_until_ready(stations.clear(world, *stations.trace(state, routes, arrival.durations)))
