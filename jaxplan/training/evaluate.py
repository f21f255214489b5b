"""How good a policy is: its times against the optimiser's, and whether the vehicle can follow what it plans."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxplan.feasibility.classifier import Classifier
from jaxplan.feasibility.features import motion_features
from jaxplan.policy.protocol import Policy
from jaxplan.precision import in_float64
from jaxplan.tracking.track import track
from jaxplan.training.active import judged, perturbed
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
from jaxplan.training.scores import binary_scores
from jaxplan.training.sequences import join, take
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle

ALPHAS = np.geomspace(0.5, 2.0, 7)
"""Factors of the initial state's speed at which the response is looked at."""
ENOUGH = 5
"""Of which so many must lie within the rotors' limits."""


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A policy and its labels on the same sequences; NumPy arrays."""

    counts: Int[np.ndarray, "b"]
    """Waypoints of each sequence."""
    relative_time: Float[np.ndarray, "b"]
    """T_policy / T_label."""
    label_time: Float[np.ndarray, "b"]
    """T_label [s]."""
    policy_tracked: Bool[np.ndarray, "b"]
    """Flown within 0.20 m and 15 degrees in the rollout."""
    label_tracked: Bool[np.ndarray, "b"]

    def by_length(self) -> dict[int, dict[str, float]]:
        """Times and shares of tracked flights for each number of waypoints: the mean of the relative times, and the
        mean time relative to the labels' mean time, in which flights of centimetres do not weigh."""
        rows = {}
        for count in np.unique(self.counts):
            mine = self.counts == count
            rows[int(count)] = {
                "sequences": int(mine.sum()),
                "relative_time": float(self.relative_time[mine].mean()),
                "relative_mean_time": float(np.average(self.relative_time[mine], weights=self.label_time[mine])),
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
        label_time=labels.sum(axis=0),
        policy_tracked=_tracked(vehicle, queries, found, config),
        label_tracked=_tracked(vehicle, queries, labels, config),
    )


def response(
    policy: Policy, queries: Queries, label: Callable[[Queries], tuple[np.ndarray, np.ndarray]]
) -> Float[np.ndarray, "b"]:
    """Correlation over ``ALPHAS`` of the policy's and the optimiser's log total times, for each sequence.

    Over those speeds from which the optimiser finds a flight; NaN where they are fewer than ``ENOUGH``.
    """
    mine, theirs = [], []
    for alpha in ALPHAS:
        faster = sped_up(queries, alpha)
        durations, feasible = label(faster)
        mine.append(np.log(policy_durations(policy, faster).sum(axis=0)))
        theirs.append(np.where(feasible, np.log(np.maximum(durations.sum(axis=0), 1e-6)), np.nan))
    known = np.isfinite(theirs)
    number = np.maximum(known.sum(axis=0), 1)
    a, b = (np.where(known, rows, 0.0) for rows in (mine, theirs))
    a, b = (np.where(known, rows - rows.sum(axis=0) / number, 0.0) for rows in (a, b))
    spread = np.sqrt(np.sum(a**2, axis=0) * np.sum(b**2, axis=0))
    return np.sum(a * b, axis=0) / np.where((spread > 0.0) & (number >= ENOUGH), spread, np.nan)


def _tracked(
    vehicle: Vehicle, queries: Queries, durations: Float[np.ndarray, "m b"], config: LabelConfig
) -> Bool[np.ndarray, "b"]:
    return np.asarray(track(build_flights(config)(queries, durations), vehicle=vehicle).feasible)


def score_policy(policy: Policy, data: Path, flights: int, seed: int = 0) -> dict[str, Any]:
    """Scores of a policy on ``flights`` held-out sequences of a dataset, for its model card.

    ``relative_time`` is to labels slowed down until a rollout tracked them, ``..._at_limit`` to those at the rotors'
    limits.
    """
    held = load_held_out(data, flights, seed)
    config, vehicle = read_config(data).labels, load_vehicle(read_config(data).vehicle)
    found = compare(policy, vehicle, held.queries, held.slowed, config)
    deviation = np.abs(found.relative_time - 1.0)
    at_limit = found.relative_time * (held.slowed.sum(axis=0) / held.limits.sum(axis=0))
    limits_tracked = _tracked(vehicle, held.queries, held.limits, config)
    moving = np.flatnonzero(np.linalg.norm(held.queries.derivatives[0], axis=0) > 0.5)[:LANES]
    correlation = response(policy, take(held.queries, np.resize(moving, LANES)), build_labels(vehicle, config))
    return {
        "sequences": len(found.counts),
        "relative_time": round(float(found.relative_time.mean()), 4),
        "relative_mean_time": round(float(np.average(found.relative_time, weights=found.label_time)), 4),
        "mean_deviation": round(float(deviation.mean()), 4),
        "relative_time_at_limit": round(float(at_limit.mean()), 4),
        "policy_tracked": round(float(found.policy_tracked.mean()), 4),
        "label_tracked": round(float(found.label_tracked.mean()), 4),
        "label_tracked_at_limit": round(float(limits_tracked.mean()), 4),
        "median_response_correlation": round(float(np.nanmedian(correlation)), 4),
        "by_length": found.by_length(),
    }


def score_classifier(
    classifier: Classifier, policy: Policy, data: Path, flights: int, seed: int = 0
) -> dict[str, float]:
    """Scores of a classifier on fresh rollouts of a policy's flights of held-out sequences, near the boundary.

    The policy's durations are multiplied by 0.8 to 1.15 with 5 % noise on each, as in training.
    """
    made, held = read_config(data), load_held_out(data, flights, seed)
    vehicle, rng = load_vehicle(made.vehicle), np.random.default_rng(seed)
    tried = perturbed(policy_durations(policy, held.queries), (0.8, 1.15), 0.05, rng)
    splines = build_flights(made.labels)(held.queries, tried)
    motion = np.asarray(in_float64(jax.jit(motion_features))(splines, vehicle))
    feasible = np.asarray(track(splines, vehicle=vehicle, indices=10**6 + np.arange(len(tried.T))).feasible)
    scores = binary_scores(judged(classifier, motion), feasible)
    return {"flights": len(feasible), "tracked": float(feasible.mean()), **scores}


class HeldOut(NamedTuple):
    """Sequences of the held-out shards, with both labels."""

    queries: Queries
    limits: Float[np.ndarray, "m n"]
    """Durations at the rotors' limits [s]."""
    slowed: Float[np.ndarray, "m n"]
    """The same, slowed down until a rollout tracked them [s]."""


def load_held_out(data: Path, count: int, seed: int) -> HeldOut:
    """At most ``count`` held-out sequences with labels, the lengths as even as they can be."""
    shards = [read_shard(shard_path(data, index)) for index in range(read_config(data).shards) if is_held_out(index)]
    queries = join([shard.queries for shard in shards])
    durations = np.concatenate([shard.durations for shard in shards], axis=-1)
    slowdown = np.concatenate([shard.slowdown for shard in shards])
    chosen = _even_lengths(queries.count, slowdown < np.inf, count, seed)
    factor = np.where(np.isfinite(slowdown), slowdown, 1.0)[chosen]
    return HeldOut(take(queries, chosen), durations[:, chosen], durations[:, chosen] * factor)


def _even_lengths(
    counts: Int[np.ndarray, "b"], good: Bool[np.ndarray, "b"], count: int, seed: int
) -> Int[np.ndarray, "n"]:
    """At most ``count`` of the good ones, rare lengths more likely."""
    lanes = np.flatnonzero(good)
    rarity = 1.0 / np.bincount(counts[lanes])[counts[lanes]]
    rng = np.random.default_rng(seed)
    return rng.choice(lanes, min(count, len(lanes)), replace=False, p=rarity / rarity.sum())
