"""Labelled sequences of a dataset in memory, and batches of them."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int, PRNGKeyArray

from jaxplan.arrays import AnyArray
from jaxplan.errors import FileError
from jaxplan.knots import MAX_WAYPOINTS
from jaxplan.spline import FlatStateBatch
from jaxplan.training.dataset import is_held_out, read_config, read_shard, shard_path
from jaxplan.training.labels import Queries

SHORT = 7
"""Sequences of up to this many waypoints train in batches of their own, at half the cost."""


class Examples(NamedTuple):
    """Labelled sequences, batch axis last."""

    waypoints: Float[AnyArray, "n 3 b"]
    """From where the vehicle is [m]; behind the last real one the goal is repeated."""
    count: Int[AnyArray, "b"]  # type: ignore[assignment]  # hides tuple.count, which nobody calls
    """Waypoints in use."""
    initial: FlatStateBatch
    durations: Float[AnyArray, "m b"]
    """The label [s]; m = n - 1."""
    alpha: Float[AnyArray, "b"]
    """Factor by which the initial state is sped up for the second label."""
    sped_up: Float[AnyArray, "m b"]
    """Durations [s] from there; zeros where there is no second label."""


def load_examples(folder: Path, *, held_out: bool) -> Examples:
    """The labelled sequences of a dataset's training or held-out shards."""
    parts = []
    for index in range(read_config(folder).shards):
        path = shard_path(folder, index)
        if is_held_out(index) != held_out or not path.exists():
            continue
        shard = read_shard(path)
        good = shard.feasible & (shard.durations.sum(axis=0) > 0.0) & (shard.slowdown != np.inf)
        slowdown = np.where(np.isfinite(shard.slowdown), shard.slowdown, 1.0)
        waypoints = shard.queries.waypoints - shard.queries.waypoints[:1]
        derivatives = np.concatenate([np.zeros_like(shard.queries.derivatives[:1]), shard.queries.derivatives])
        state = FlatStateBatch(derivatives=derivatives, yaw=shard.queries.yaw)
        labels = shard.durations * slowdown, shard.alpha, shard.sped_up * slowdown
        example = Examples(waypoints, shard.queries.count, state, *labels)
        parts.append(take_examples(example, np.flatnonzero(good)))
    if not parts:
        raise FileError(f"{folder}: has no {'held-out' if held_out else 'training'} shards; make more")
    return jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1), *parts)


def batches(examples: Examples, size: int, seed: int, steps: Iterable[int]) -> Iterator[tuple[Examples, PRNGKeyArray]]:
    """Random batches of ``size``; the batch of a step depends on the seed and the step alone."""
    groups = [np.flatnonzero(examples.count <= SHORT), np.flatnonzero(examples.count > SHORT)]
    chances = [_chances(np.asarray(examples.count)[group]) for group in groups]
    for step in steps:
        rng = np.random.default_rng([seed, step])
        which = int(rng.random() < 0.5 and len(groups[1]) > 0) if len(groups[0]) else 1
        drawn = groups[which][np.searchsorted(chances[which], rng.random(size))]
        segments = (SHORT if which == 0 else MAX_WAYPOINTS) - 1
        batch = take_examples(examples, drawn)
        batch = batch._replace(
            waypoints=batch.waypoints[: segments + 1],
            durations=batch.durations[:segments],
            sped_up=batch.sped_up[:segments],
        )
        yield batch, jax.random.fold_in(jax.random.key(seed), step)


def as_queries(examples: Examples) -> Queries:
    """The same sequences without their labels."""
    state = examples.initial
    return Queries(examples.waypoints, examples.count, state.derivatives[1:], state.yaw)


def take_examples(examples: Examples, members: Int[np.ndarray, "n"]) -> Examples:
    """Some of the examples, by their index."""
    return jax.tree.map(lambda leaf: leaf[..., members], examples)


def _chances(counts: Int[np.ndarray, "b"]) -> Float[np.ndarray, "b"]:
    """Cumulative chances of being drawn: rare lengths more often, by the square root of their rarity."""
    weights = 1.0 / np.sqrt(np.bincount(counts, minlength=MAX_WAYPOINTS + 1))[counts]
    return np.cumsum(weights) / weights.sum()
