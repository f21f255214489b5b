"""Compiling every station for every length before the first replan."""

import functools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np

from jaxplan.compilation import uncollected
from jaxplan.planner.records import PlannerConfig
from jaxplan.planner.stations import LENGTHS, Match, Routes, Stations, cut
from jaxplan.precision import in_float64
from jaxplan.spline import FlatState


def compile_all(stations: Stations, asked: Sequence[Match], config: PlannerConfig, state: FlatState) -> None:
    """Compile the lengths side by side: XLA leaves a core idle for much of the time.

    ``asked``: those of the time allocations that the configuration can ask for; the others are not compiled.
    """
    with uncollected(), ThreadPoolExecutor(len(LENGTHS)) as pool:
        paths = np.tile(np.asarray(state.pos), (config.width, config.path_capacity, 1))
        whole = jax.tree.map(np.asarray, stations.route(paths, paths[:, -1]))
        list(pool.map(in_float64(functools.partial(_compile, stations, asked, state, whole)), LENGTHS))


def _compile(stations: Stations, asked: Sequence[Match], state: FlatState, whole: Routes, length: int) -> None:
    """Call the stations, each with what the one before it returns."""
    routes = cut(whole, length)
    nothing, once = np.zeros(len(routes.count)), np.ones(len(routes.count))
    arrival = [match(state, routes, nothing, once) for match in asked][-1]
    jax.block_until_ready(stations.solve(state, routes, arrival.durations, np.asarray(state.pos), 1.0))
