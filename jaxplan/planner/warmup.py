"""Compiling every station at every size before the first replan."""

import jax
import numpy as np

from jaxplan.planner.lanes import round_sizes
from jaxplan.planner.records import PlannerConfig
from jaxplan.planner.stations import LENGTHS, Stations, shortened
from jaxplan.spline import FlatState


def compile_all(stations: Stations, config: PlannerConfig, state: FlatState) -> None:
    """Call every station at every size, each with what the one before it returns."""
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
