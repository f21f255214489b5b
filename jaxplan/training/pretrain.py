"""Pretraining: imitate the optimiser's durations (paper, Sec. II-C), with a bottleneck of limited information.

A run is a folder: ``state.msgpack`` to go on from, ``metrics.jsonl``, and the best weights so far.
"""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import serialization
from jaxtyping import Array, Float, PRNGKeyArray

from jaxplan.files import state_configuration, write_atomically
from jaxplan.knots import MAX_WAYPOINTS
from jaxplan.policy.features import SEGMENT_FEATURES, STATE_FEATURES
from jaxplan.policy.network import NetworkConfig, PolicyNetwork
from jaxplan.policy.neural import allocate_times, read_sequences
from jaxplan.precision import in_float64
from jaxplan.training.dataset import dataset_vehicle
from jaxplan.training.examples import Examples, batches, load_examples, take_examples
from jaxplan.training.gradient import State, annealed_adamw, begin, stepped
from jaxplan.training.imitation import ImitationConfig, imitation_loss
from jaxplan.validation import require_at_least, require_positive, require_within
from jaxplan.vehicle.params import Vehicle


@dataclasses.dataclass(frozen=True)
class PretrainConfig:
    """How a policy is trained to imitate."""

    network: NetworkConfig = NetworkConfig()
    """Sizes of the network."""
    steps: int = 30_000
    """Gradient steps at most."""
    batch: int = 512
    """Sequences of each step."""
    learning_rate: float = 3e-3
    """At its highest; warmed up and annealed by a cosine."""
    imitation: ImitationConfig = ImitationConfig()
    """What counts how much."""
    average: float = 0.999
    """Decay of the running mean of the weights, which is what is kept."""
    evaluate_every: int = 500
    """Gradient steps between two evaluations on held-out sequences."""
    patience: int = 12
    """Evaluations without a better score after which training ends."""
    seed: int = 0
    """Seed of the weights and batches."""

    def __post_init__(self) -> None:
        require_at_least("pretrain", self, 1, "steps", "batch", "evaluate_every", "patience")
        require_positive("pretrain", self, "learning_rate")
        require_within("pretrain", self, 0.0, 1.0, "average")


@runtime_checkable
class Step(Protocol):
    """One compiled gradient step."""

    def __call__(self, state: State, batch: Examples, key: PRNGKeyArray, /) -> tuple[State, Float[Array, ""]]:
        """The state after a step on ``batch``, and its loss before."""


class Error(NamedTuple):
    """Errors of total times on a set of examples, by number of waypoints."""

    mean: dict[int, float]
    """Mean of T / T_label - 1."""
    absolute: dict[int, float]
    """Mean of its magnitude."""
    overall: float
    """Mean magnitude over all lengths, each counted alike."""


@runtime_checkable
class Measure(Protocol):
    """How far total times are from the labels."""

    def __call__(self, parameters: Any, examples: Examples, /) -> Error:
        """Errors of a policy with these weights (host)."""


def start_training(config: PretrainConfig, start: Any = None) -> State:
    """Begin with weights ``start``, or with random ones."""
    network = PolicyNetwork(config.network)
    shapes = (MAX_WAYPOINTS - 1, SEGMENT_FEATURES, 2), (MAX_WAYPOINTS - 1, 2), (STATE_FEATURES, 2)
    features, real, state = (jnp.ones(shape, jnp.float32) for shape in shapes)
    parameters = start or network.init(jax.random.key(config.seed), features, real > 0.0, state)
    return begin(parameters, _optimiser(config))


def build_step(config: PretrainConfig, vehicle: Vehicle) -> Step:
    """The gradient step for a vehicle, compiled once for each length of the sequences."""
    network, optimiser = PolicyNetwork(config.network), _optimiser(config)

    @jax.jit
    def advance(state: State, batch: Examples, key: PRNGKeyArray) -> tuple[State, Float[Array, ""]]:
        cost = lambda p: imitation_loss(network, p, batch, key, config.imitation, vehicle)  # noqa: E731
        loss, slope = jax.value_and_grad(cost)(state.parameters)
        return stepped(state, slope, optimiser, config.average), loss

    return in_float64(advance)


def pretrain(
    folder: Path, data: Path, config: PretrainConfig, report: Callable[[str], None] = print, start: Any = None
) -> tuple[State, Error]:
    """Train for the dataset's vehicle until the end or until nothing improves; goes on where ``folder`` was left.

    Args:
        folder: of the run.
        data: folder of the dataset.
        config: how to train.
        report: takes a line of progress.
        start: weights that a new run begins with, of any vehicle's policy; random ones by default.
    """
    training, held_out = load_examples(data, held_out=False), load_examples(data, held_out=True)
    state, best, stale = _resume(folder, config, start)
    advance = build_step(config, dataset_vehicle(data))
    measure = build_measure(config)
    for batch, key in batches(training, config.batch, config.seed, range(int(state.step), config.steps)):
        state, loss = advance(state, batch, key)
        step = int(state.step)
        if step % config.evaluate_every and step < config.steps:
            continue
        error = measure(state.averaged, held_out)
        better = error.overall < best
        best, stale = (error.overall, 0) if better else (best, stale + 1)
        if better:
            write_atomically(folder / "best.msgpack", serialization.to_bytes(state.averaged))
        write_atomically(folder / "state.msgpack", serialization.to_bytes((state._asdict(), best, stale)))
        row = {"step": step, "loss": float(loss), "error": error.overall, "bias": error.mean}
        with (folder / "metrics.jsonl").open("a") as log:
            log.write(json.dumps(row) + "\n")
        report(f"step {step}: loss {float(loss):.4f}, held-out error of the total time {error.overall:.2%}")
        if stale >= config.patience:
            break
    averaged = serialization.from_bytes(state.averaged, (folder / "best.msgpack").read_bytes())
    return state._replace(averaged=averaged), measure(averaged, held_out)


def build_measure(config: PretrainConfig) -> Measure:
    """Errors of the total times, with the latent's mean."""
    network = PolicyNetwork(config.network)

    @jax.jit
    def totals(parameters: Any, examples: Examples) -> Float[Array, "b"]:
        frame, memory, _ = read_sequences(network, parameters, examples.waypoints, examples.count)
        return jnp.sum(allocate_times(network, parameters, memory, frame, examples.initial), axis=0)

    def measure(parameters: Any, examples: Examples) -> Error:
        size = len(examples.count)
        found = [
            np.asarray(totals(parameters, take_examples(examples, some)))
            for some in np.array_split(np.resize(np.arange(size), -(-size // 4096) * 4096), -(-size // 4096))
        ]
        relative = np.concatenate(found)[:size] / examples.durations.sum(axis=0) - 1.0
        lengths = np.unique(examples.count)
        mean = {int(n): float(relative[examples.count == n].mean()) for n in lengths}
        absolute = {int(n): float(np.abs(relative[examples.count == n]).mean()) for n in lengths}
        return Error(mean, absolute, float(np.mean(list(absolute.values()))))

    return measure


def _optimiser(config: PretrainConfig) -> optax.GradientTransformation:
    return annealed_adamw(config.learning_rate, config.steps, warmup=500, last=1e-3, weight_decay=1e-2)


def _resume(folder: Path, config: PretrainConfig, start: Any) -> tuple[State, float, int]:
    """The run in ``folder``, or a new one."""
    state_configuration(folder, dataclasses.asdict(config))
    saved = folder / "state.msgpack"
    fresh = start_training(config, start)
    if not saved.exists():
        return fresh, np.inf, 0
    fields, best, stale = serialization.from_bytes((fresh._asdict(), 0.0, 0), saved.read_bytes())
    return State(**fields), float(best), int(stale)
