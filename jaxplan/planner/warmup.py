"""Compiling every station at every size before the first replan, side by side on all cores."""

import functools
import itertools
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from jaxplan.numerics import in_float64
from jaxplan.planner.lanes import round_sizes
from jaxplan.planner.records import PlannerConfig
from jaxplan.planner.stations import LENGTHS, Stations, shortened
from jaxplan.spline import FlatState


def compile_all(stations: Stations, config: PlannerConfig, state: FlatState) -> None:
    """Call every station with zeros of every shape that a replan may bring; the longest to compile come first.

    Then each with what the one before it returns: zeros do not tell which numbers are weakly typed.
    """
    calls = sorted(_calls(stations, config, state), key=lambda call: -call[0])
    run = in_float64(lambda call: jax.block_until_ready(call[1]()))
    with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
        list(pool.map(run, calls))
    for bucket in config.buckets:
        paths = np.tile(np.asarray(state.pos), (bucket, config.path_capacity, 1))
        for length in LENGTHS:
            some = shortened(stations.route(paths, np.ones(bucket)), length)
            context, _ = stations.read(some, state)
            if bucket == config.buckets[0]:
                jax.block_until_ready(stations.trace(state, some, stations.stretch(some, state, np.ones(bucket))))
            for size in {bucket} if config.exhaustive else set(round_sizes(config.buckets)):
                lanes = np.zeros(size, dtype=int)
                arrival = stations.match(stations.pick(context, lanes), state, np.ones(size))
                jax.block_until_ready(stations.trace(state, stations.pick(some, lanes), arrival.durations))


def _calls(stations: Stations, config: PlannerConfig, state: FlatState) -> Iterator[tuple[int, Callable[[], Any]]]:
    """Calls that do not depend on each other, with a weight that grows with the time to compile."""
    for bucket in config.buckets:
        paths = np.tile(np.asarray(state.pos), (bucket, config.path_capacity, 1))
        yield 1, functools.partial(stations.route, paths, np.ones(bucket))
        for length in LENGTHS:
            some = shortened(_zeros(stations.route, paths, np.ones(bucket)), length)
            yield 3, functools.partial(stations.read, some, state)
            context, _ = _zeros(stations.read, some, state)
            for size in {bucket} if config.exhaustive else set(round_sizes(config.buckets)):
                yield 0, functools.partial(stations.pick, some, np.zeros(size, dtype=int))
                yield 0, functools.partial(stations.pick, context, np.zeros(size, dtype=int))
    for size, length in itertools.product(_traced(config), LENGTHS):
        paths = np.tile(np.asarray(state.pos), (size, config.path_capacity, 1))
        some = shortened(_zeros(stations.route, paths, np.ones(size)), length)
        context, _ = _zeros(stations.read, some, state)
        durations = np.ones((length - 1, size))
        yield 4, functools.partial(stations.trace, state, some, durations)
        yield 2, functools.partial(stations.match, context, state, np.ones(size))
        if size == config.buckets[0]:
            yield 2, functools.partial(stations.stretch, some, state, np.ones(size))


def _traced(config: PlannerConfig) -> set[int]:
    """Sizes at which candidates are matched, solved and checked; approaches take the smallest."""
    return set(config.buckets) if config.exhaustive else {config.buckets[0], *round_sizes(config.buckets)}


def _zeros(function: Callable[..., Any], *arguments: Any) -> Any:
    """Zeros in the shape of what ``function`` returns, without compiling it."""
    return jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), jax.eval_shape(function, *arguments))
