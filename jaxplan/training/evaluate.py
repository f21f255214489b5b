"""How good a policy is: its times against the optimiser's, and whether the vehicle can follow what it plans."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxplan.numerics import in_float64
from jaxplan.policy.protocol import Policy
from jaxplan.tracking.track import track
from jaxplan.training.dataset import (
    LANES,
    build_flights,
    build_labels,
    is_held_out,
    read_config,
    read_shard,
    shard_path,
)
from jaxplan.training.labels import LabelConfig, Queries, initial_states, sped_up
from jaxplan.training.sequences import join, take
from jaxplan.vehicle.params import Vehicle, load_vehicle

ALPHAS = np.geomspace(0.5, 2.0, 7)
"""Factors of the initial state's speed at which the response is looked at."""


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A policy and its labels on the same sequences; NumPy arrays."""

    counts: Int[np.ndarray, "b"]
    """Waypoints of each sequence."""
    relative_time: Float[np.ndarray, "b"]
    """T_policy / T_label."""
    policy_tracked: Bool[np.ndarray, "b"]
    """Flown within 0.20 m and 15 degrees in the rollout."""
    label_tracked: Bool[np.ndarray, "b"]

    def by_length(self) -> dict[int, dict[str, float]]:
        """Mean relative time and shares of tracked flights for each number of waypoints."""
        rows = {}
        for count in np.unique(self.counts):
            mine = self.counts == count
            rows[int(count)] = {
                "sequences": int(mine.sum()),
                "relative_time": float(self.relative_time[mine].mean()),
                "policy_tracked": float(self.policy_tracked[mine].mean()),
                "label_tracked": float(self.label_tracked[mine].mean()),
            }
        return rows


def policy_durations(policy: Policy, queries: Queries) -> Float[np.ndarray, "m b"]:
    """What a policy gives for each query [s] (host)."""
    allocate = jax.jit(lambda q: policy.decode(policy.encode(q.waypoints, q.count), initial_states(q)))
    return np.asarray(in_float64(allocate)(queries))


def compare(
    policy: Policy, vehicle: Vehicle, queries: Queries, labels: Float[np.ndarray, "m b"], config: LabelConfig
) -> Comparison:
    """Fly the policy's and the labels' trajectories of the same sequences."""
    found = policy_durations(policy, queries)
    return Comparison(
        counts=np.asarray(queries.count),
        relative_time=found.sum(axis=0) / labels.sum(axis=0),
        policy_tracked=_tracked(vehicle, queries, found, config),
        label_tracked=_tracked(vehicle, queries, labels, config),
    )


def response(
    policy: Policy, queries: Queries, label: Callable[[Queries], tuple[np.ndarray, np.ndarray]]
) -> Float[np.ndarray, "b"]:
    """Correlation over ``ALPHAS`` of the policy's and the optimiser's log total times, for each sequence.

    NaN where the optimiser finds no flight for one of the speeds.
    """
    mine, theirs = [], []
    for alpha in ALPHAS:
        faster = sped_up(queries, alpha)
        durations, feasible = label(faster)
        mine.append(np.log(policy_durations(policy, faster).sum(axis=0)))
        theirs.append(np.where(feasible, np.log(np.maximum(durations.sum(axis=0), 1e-6)), np.nan))
    a, b = (np.stack(rows) - np.mean(rows, axis=0) for rows in (mine, theirs))
    spread = np.sqrt(np.sum(a**2, axis=0) * np.sum(b**2, axis=0))
    return np.sum(a * b, axis=0) / np.where(spread > 0.0, spread, np.nan)


def _tracked(
    vehicle: Vehicle, queries: Queries, durations: Float[np.ndarray, "m b"], config: LabelConfig
) -> Bool[np.ndarray, "b"]:
    return np.asarray(track(build_flights(config)(queries, durations), vehicle=vehicle).feasible)


def sample(
    queries: Queries, labels: Float[np.ndarray, "m b"], good: Bool[np.ndarray, "b"], count: int, seed: int
) -> tuple[Queries, Float[np.ndarray, "m n"]]:
    """At most ``count`` of the good sequences, the lengths as even as they can be."""
    rng = np.random.default_rng(seed)
    lanes = np.flatnonzero(good)
    rarity = 1.0 / np.bincount(queries.count[lanes])[queries.count[lanes]]
    chosen = rng.choice(lanes, min(count, len(lanes)), replace=False, p=rarity / rarity.sum())
    return take(queries, chosen), labels[..., chosen]


def score_policy(policy: Policy, data: Path, flights: int, seed: int = 0) -> dict[str, Any]:
    """Scores of a policy on ``flights`` held-out sequences of a dataset, for its model card."""
    made = read_config(data)
    config, vehicle = made.labels, load_vehicle(made.vehicle)
    shards = [read_shard(shard_path(data, index)) for index in range(made.shards) if is_held_out(index)]
    queries, labels = join([shard.queries for shard in shards]), np.concatenate([s.durations for s in shards], axis=-1)
    slowdown = np.concatenate([shard.slowdown for shard in shards])
    labels *= np.where(np.isfinite(slowdown), slowdown, 1.0)
    queries, labels = sample(queries, labels, slowdown < np.inf, flights, seed)
    found = compare(policy, vehicle, queries, labels, config)
    moving = np.flatnonzero(np.linalg.norm(queries.derivatives[0], axis=0) > 0.5)[:LANES]
    correlation = response(policy, take(queries, np.resize(moving, LANES)), build_labels(vehicle, config))
    return {
        "sequences": len(found.counts),
        "relative_time": round(float(found.relative_time.mean()), 4),
        "policy_tracked": round(float(found.policy_tracked.mean()), 4),
        "label_tracked": round(float(found.label_tracked.mean()), 4),
        "median_response_correlation": round(float(np.nanmedian(correlation)), 4),
        "by_length": found.by_length(),
    }
