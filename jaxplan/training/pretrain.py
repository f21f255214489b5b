"""Pretraining: imitate the optimiser's durations (paper, Sec. II-C), with a bottleneck of limited information.

The error is that of the logarithms, so that short and long flights count alike: of every duration, weighted by its
share of the flight, and of their sum, where too short counts more than too long: labels are at the boundary. Where a
sequence is labelled from a second initial state, it is imitated as well, and so is what the change of state does to the
total time, in which errors that both share cancel. States beyond the rotors' limits have no label; there the flight
time must only keep growing with alpha, as the arrival iteration needs. A run is a folder: ``state.msgpack`` to go on
from, ``metrics.jsonl``, and the best weights so far.
"""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import serialization
from jaxtyping import Array, Float, PRNGKeyArray

from jaxplan.arrival import sped_up
from jaxplan.errors import InputError
from jaxplan.policy.features import SEGMENT_FEATURES, STATE_FEATURES
from jaxplan.policy.network import Bottleneck, NetworkConfig, PolicyNetwork
from jaxplan.policy.neural import allocate_times, read_sequences
from jaxplan.search.knots import MAX_WAYPOINTS
from jaxplan.spline import FlatState
from jaxplan.training.examples import Examples, batches, lanes_of, load_examples
from jaxplan.training.runs import claim, write_whole


@dataclasses.dataclass(frozen=True)
class PretrainConfig:
    """How a policy is trained to imitate."""

    network: NetworkConfig = NetworkConfig()
    steps: int = 30_000
    batch: int = 512
    learning_rate: float = 3e-3
    """At its highest; warmed up and annealed by a cosine."""
    divergence_weight: float = 1e-4
    """Weight of the Kullback-Leibler divergence (as the predecessors')."""
    total_weight: float = 4.0
    """Weight of the error of the total time."""
    haste_weight: float = 1.25
    """The same weighs so much more where the total time is too short."""
    response_weight: float = 8.0
    """Weight of the error of the change of the total time with the initial state."""
    growth_weight: float = 4.0
    """Weight of ``growth_shortfall``."""
    average: float = 0.999
    """Decay of the running mean of the weights, which is what is kept."""
    evaluate_every: int = 500
    patience: int = 12
    """Evaluations without a better score after which training ends."""
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("steps", "batch", "evaluate_every", "patience"):
            if getattr(self, name) < 1:
                raise InputError(f"pretrain: {name} is {getattr(self, name)}, want 1 or more")
        if not self.learning_rate > 0.0:
            raise InputError(f"pretrain: learning_rate is {self.learning_rate}, want a positive number")


class State(NamedTuple):
    """All that a training run changes."""

    parameters: Any
    averaged: Any
    optimiser: Any
    step: Array


class Error(NamedTuple):
    """Errors of total times on a set of examples, by number of waypoints."""

    mean: dict[int, float]
    """Mean of T / T_label - 1."""
    absolute: dict[int, float]
    """Mean of its magnitude."""
    overall: float
    """Mean magnitude over all lengths, each counted alike."""


def start_training(config: PretrainConfig, start: Any = None) -> State:
    """Begin with weights ``start``, or with random ones."""
    network = PolicyNetwork(config.network)
    shapes = (MAX_WAYPOINTS - 1, SEGMENT_FEATURES, 2), (MAX_WAYPOINTS - 1, 2), (STATE_FEATURES, 2)
    features, real, state = (jnp.ones(shape, jnp.float32) for shape in shapes)
    parameters = start or network.init(jax.random.key(config.seed), features, real > 0.0, state)
    optimiser = _optimiser(config).init(parameters)
    return State(parameters, parameters, optimiser, jnp.int32(0))


def build_step(config: PretrainConfig) -> Callable[[State, Examples, PRNGKeyArray], tuple[State, Array]]:
    """One compiled gradient step on a batch."""
    network, optimiser = PolicyNetwork(config.network), _optimiser(config)

    @jax.jit
    def advance(state: State, batch: Examples, key: PRNGKeyArray) -> tuple[State, Array]:
        loss, slope = jax.value_and_grad(lambda p: imitation_loss(network, p, batch, key, config))(state.parameters)
        change, optimiser_state = optimiser.update(slope, state.optimiser, state.parameters)
        parameters = optax.apply_updates(state.parameters, change)
        rate = jnp.minimum(config.average, (1.0 + state.step) / (10.0 + state.step))
        averaged = optax.incremental_update(parameters, state.averaged, 1.0 - rate)
        return State(parameters, averaged, optimiser_state, state.step + 1), loss

    return advance


def imitation_loss(
    network: PolicyNetwork, parameters: Any, batch: Examples, key: PRNGKeyArray, config: PretrainConfig
) -> Float[Array, ""]:
    """Squared errors of the log-durations, of the log total time and its response, and the bottleneck's divergence."""
    mirror_key, latent_key = jax.random.split(key)
    batch = _mirrored(batch, mirror_key)
    frame, memory, bottleneck = read_sequences(network, parameters, batch.waypoints, batch.count)
    spread = jnp.exp(0.5 * bottleneck.log_variance)
    noise = jax.random.normal(latent_key, spread.shape, spread.dtype)
    memory = memory._replace(latent=bottleneck.mean + spread * noise)
    known = jnp.sum(batch.sped_up, axis=0) > 0.0
    alpha = jnp.where(known, batch.alpha, batch.alpha**2)
    found = allocate_times(network, parameters, memory, frame, batch.initial)
    later = allocate_times(network, parameters, memory, frame, sped_up(batch.initial, alpha))
    change = _log_total(later) - _log_total(found)
    wanted = _log_total(batch.sped_up) - _log_total(batch.durations)
    imitated = _error(later, batch.sped_up, config) + config.response_weight * _huber(change - wanted)
    response = jnp.where(known, imitated, config.growth_weight * _huber(growth_shortfall(change, alpha)))
    imitation = jnp.sum(_error(found, batch.durations, config) + response) / jnp.sum(1.0 + known)
    return imitation + config.divergence_weight * jnp.mean(_divergence(bottleneck))


def growth_shortfall(change: Float[Array, "b"], alpha: Float[Array, "b"]) -> Float[Array, "b"]:
    """How far the flight time alpha T(alpha D) is from growing like the square root of alpha, at least.

    Args:
        change: log T(alpha D) - log T(D).
    """
    growth = jnp.log(alpha)
    return jax.nn.relu(0.5 * jnp.abs(growth) - (change + growth) * jnp.sign(growth))


def pretrain(
    folder: Path, data: Path, config: PretrainConfig, report: Callable[[str], None] = print, start: Any = None
) -> tuple[State, Error]:
    """Train until the end or until nothing improves; goes on where ``folder`` was left.

    Args:
        start: weights that a new run begins with; random ones by default.
    """
    training, held_out = load_examples(data, held_out=False), load_examples(data, held_out=True)
    state, best, stale = _resume(folder, config, start)
    advance = build_step(config)
    measure = build_measure(config)
    for batch, key in batches(training, config.batch, config.seed, range(int(state.step), config.steps)):
        state, loss = advance(state, batch, key)
        step = int(state.step) if int(state.step) % config.evaluate_every == 0 else 0
        if not step:
            continue
        error = measure(state.averaged, held_out)
        better = error.overall < best
        best, stale = (error.overall, 0) if better else (best, stale + 1)
        if better:
            write_whole(folder / "best.msgpack", serialization.to_bytes(state.averaged))
        write_whole(folder / "state.msgpack", serialization.to_bytes((state._asdict(), best, stale)))
        row = {"step": step, "loss": float(loss), "error": error.overall, "bias": error.mean}
        with (folder / "metrics.jsonl").open("a") as log:
            log.write(json.dumps(row) + "\n")
        report(f"step {step}: loss {float(loss):.4f}, held-out error of the total time {error.overall:.2%}")
        if stale >= config.patience:
            break
    averaged = serialization.from_bytes(state.averaged, (folder / "best.msgpack").read_bytes())
    return state._replace(averaged=averaged), measure(averaged, held_out)


def build_measure(config: PretrainConfig) -> Callable[[Any, Examples], Error]:
    """Errors of the total times, with the latent's mean."""
    network = PolicyNetwork(config.network)

    @jax.jit
    def totals(parameters: Any, examples: Examples) -> Float[Array, "b"]:
        frame, memory, _ = read_sequences(network, parameters, examples.waypoints, examples.count)
        return jnp.sum(allocate_times(network, parameters, memory, frame, examples.initial), axis=0)

    def measure(parameters: Any, examples: Examples) -> Error:
        size = len(examples.count)
        found = [
            np.asarray(totals(parameters, lanes_of(examples, lanes)))
            for lanes in np.array_split(np.resize(np.arange(size), -(-size // 4096) * 4096), -(-size // 4096))
        ]
        relative = np.concatenate(found)[:size] / examples.durations.sum(axis=0) - 1.0
        lengths = np.unique(examples.count)
        mean = {int(n): float(relative[examples.count == n].mean()) for n in lengths}
        absolute = {int(n): float(np.abs(relative[examples.count == n]).mean()) for n in lengths}
        return Error(mean, absolute, float(np.mean(list(absolute.values()))))

    return measure


def _error(durations: Float[Array, "m b"], wanted: Float[Array, "m b"], config: PretrainConfig) -> Float[Array, "b"]:
    """Loss of each sequence."""
    real = durations > 0.0
    share = 0.5 * wanted / (jnp.sum(wanted, axis=0) + 1e-9) + 0.5 * real / jnp.sum(real, axis=0)
    error = jnp.where(real, _log(durations) - _log(wanted), 0.0)
    total = _log_total(durations) - _log_total(wanted)
    weight = config.total_weight * jnp.where(total < 0.0, config.haste_weight, 1.0)
    return jnp.sum(share * _huber(error), axis=0) + weight * _huber(total)


def _optimiser(config: PretrainConfig) -> optax.GradientTransformation:
    warm = min(500, config.steps // 10 + 1)
    rate = optax.warmup_cosine_decay_schedule(
        0.0, config.learning_rate, warm, config.steps, 1e-3 * config.learning_rate
    )
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(rate, weight_decay=1e-2))


def _resume(folder: Path, config: PretrainConfig, start: Any) -> tuple[State, float, int]:
    """The run in ``folder``, or a new one."""
    claim(folder, config)
    saved = folder / "state.msgpack"
    fresh = start_training(config, start)
    if not saved.exists():
        return fresh, np.inf, 0
    fields, best, stale = serialization.from_bytes((fresh._asdict(), 0.0, 0), saved.read_bytes())
    return State(**fields), float(best), int(stale)


def _mirrored(batch: Examples, key: PRNGKeyArray) -> Examples:
    """Half of the batch reflected in a vertical plane: a quadrotor flies left as it flies right."""
    side = jnp.where(jax.random.bernoulli(key, 0.5, batch.count.shape), 1.0, -1.0).astype(batch.waypoints.dtype)
    flip = jnp.stack([jnp.ones_like(side), side, jnp.ones_like(side)])
    state = FlatState(derivatives=batch.initial.derivatives * flip, yaw=batch.initial.yaw * side)
    return batch._replace(waypoints=batch.waypoints * flip, initial=state)


def _divergence(bottleneck: Bottleneck) -> Float[Array, "k"]:
    """Kullback-Leibler divergence from the standard normal distribution."""
    mean, log_variance = bottleneck
    return 0.5 * jnp.sum(mean**2 + jnp.exp(log_variance) - 1.0 - log_variance, axis=0)


def _huber(error: Float[Array, "..."]) -> Float[Array, "..."]:
    """Squared where small, linear where a label is an outlier."""
    return optax.losses.huber_loss(error, delta=0.2)


def _log(x: Float[Array, "..."]) -> Float[Array, "..."]:
    return jnp.log(jnp.maximum(x, 1e-3))


def _log_total(durations: Float[Array, "m b"]) -> Float[Array, "b"]:
    return _log(jnp.sum(durations, axis=0))
