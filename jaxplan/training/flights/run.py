"""Training of the network: maximum likelihood of whole flights, and the error of what is expected beside it.

A run is a folder: the ``examples``, ``state.msgpack`` to go on from, ``metrics.jsonl``, and the best weights so far.
"""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import serialization
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxplan.arrays import AnyArray
from jaxplan.files import create_folder, state_configuration, write_atomically
from jaxplan.prediction.mdn.checkpoint import TrainedNetwork
from jaxplan.prediction.mdn.curves import Curves, coefficients_of, fitted_curves, flights_of
from jaxplan.prediction.mdn.network import NetworkConfig, initial_parameters, log_densities, mixture_of
from jaxplan.prediction.mdn.view import View, mirrored
from jaxplan.training.flights.examples import (
    INTERVALS,
    Examples,
    ExamplesConfig,
    joined,
    load_examples,
    make_examples,
    recorded_examples,
)
from jaxplan.training.gradient import State, annealed_adamw, begin, stepped
from jaxplan.validation import require_at_least, require_positive, require_within

FLOOR = 0.01
"""Standard deviation [m] of the noise added to what follows: nobody is certain to less than a centimetre."""
_TESTED, _AT_ONCE = 16384, 2048
"""Held-out flights that each evaluation looks at, and how many at a time."""


@dataclasses.dataclass(frozen=True)
class MdnConfig:
    """How the network is trained."""

    network: NetworkConfig = NetworkConfig()
    """Sizes of the network."""
    examples: ExamplesConfig = ExamplesConfig()
    """The flights that it is trained with."""
    steps: int = 40_000
    """Gradient steps."""
    batch: int = 512
    """Flights of each step."""
    learning_rate: float = 2e-3
    """At its highest; warmed up and annealed by a cosine."""
    average: float = 0.998
    """Decay of the running mean of the weights, which is what is kept."""
    error: float = 20.0
    """What a mean error of one unit of length counts, beside the negative log-likelihood."""
    evaluate_every: int = 1000
    """Gradient steps between two evaluations on held-out rooms."""
    training_seed: int = 0
    """Seed of the weights and batches."""

    def __post_init__(self) -> None:
        require_at_least("mdn", self, 1, "steps", "batch", "evaluate_every")
        require_at_least("mdn", self, 0, "training_seed")
        require_positive("mdn", self, "learning_rate")
        require_at_least("mdn", self, 0.0, "error")
        require_within("mdn", self, 0.0, 1.0, "average")


class Score(NamedTuple):
    """On flights through held-out rooms."""

    nll: float
    """Mean negative log-likelihood of their coefficients."""
    error: float
    """Mean distance of what is expected from what happens, in units of length."""


def train_mdn(
    folder: Path,
    config: MdnConfig,
    *,
    workers: int = 0,
    recordings: Sequence[Float[np.ndarray, "_ 3"]] = (),
    report: Callable[[str], None] = print,
) -> tuple[TrainedNetwork, Score]:
    """Make what is missing of the examples, and train to the end; goes on where ``folder`` was left.

    Args:
        folder: of the run.
        config: how to train.
        workers: processes that make examples.
        recordings: flights to learn from too, as ``recorded_examples`` takes them.
        report: takes a line of progress.

    Gives the best weights and their score.
    """
    create_folder(folder)
    hashes = [hashlib.sha256(flight.astype("<f8").tobytes()).hexdigest() for flight in recordings]
    state_configuration(folder, dataclasses.asdict(config) | {"recordings": hashes})
    make_examples(folder / "examples", config.examples, workers, report)
    training, held_out = (load_examples(folder / "examples", held_out=which) for which in (False, True))
    if recordings:
        others = recorded_examples(recordings, len(training.future), config.training_seed)
        training = joined([training, others])
    held_out = _taken(held_out, np.random.default_rng(0).permutation(len(held_out.future))[:_TESTED])
    curves = fitted_curves(training.future[:: max(1, len(training.future) // 100_000)])
    state, best = _resume(folder, config)
    advance, measure = _build_advance(config, curves), _build_measure(curves)
    for step in range(int(state.step), config.steps):
        rng = np.random.default_rng([config.training_seed, step])
        some = _taken(training, rng.integers(len(training.future), size=config.batch))
        state, loss = advance(state, some, rng.random(config.batch) < 0.5, jax.random.key(step))
        if (step + 1) % config.evaluate_every and step + 1 < config.steps:
            continue
        score = measure(state.averaged, held_out)
        if score.nll < best:
            best = score.nll
            write_atomically(folder / "best.msgpack", serialization.to_bytes(state.averaged))
        write_atomically(folder / "state.msgpack", serialization.to_bytes((state._asdict(), best)))
        with (folder / "metrics.jsonl").open("a") as log:
            log.write(json.dumps({"step": step + 1, "train_loss": float(loss), **score._asdict()}) + "\n")
        report(f"step {step + 1}: loss {float(loss):.3f}; held out: nll {score.nll:.3f}, error {score.error:.4f}")
    weights = serialization.from_bytes(state.averaged, (folder / "best.msgpack").read_bytes())
    kept = jax.tree.map(np.asarray, weights)
    return TrainedNetwork(config.network, kept, curves, INTERVALS), measure(weights, held_out)


def mdn_loss(
    parameters: Any, curves: Curves, view: View, future: Float[AnyArray, "n s 3"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Mean negative log-likelihood of flights, and mean error of what is expected."""
    mixture = mixture_of(parameters, view)
    coefficients = coefficients_of(curves, future)
    expected = (jnp.exp(mixture.log_weights)[..., None] * mixture.means).sum(axis=1)
    apart = flights_of(curves, expected) - flights_of(curves, coefficients)
    distance = jnp.sqrt((apart * apart).sum(axis=-1) + 1e-6)
    return -log_densities(mixture, coefficients).mean(), distance.mean()


def _build_advance(
    config: MdnConfig, curves: Curves
) -> Callable[[State, Examples, Bool[np.ndarray, "n"], PRNGKeyArray], tuple[State, Float[Array, ""]]]:
    """The gradient step, compiled once."""
    optimiser = _optimiser(config)

    def cost(parameters: Any, view: View, future: Float[Array, "n s 3"]) -> Float[Array, ""]:
        nll, error = mdn_loss(parameters, curves, view, future)
        return nll + config.error * error

    @jax.jit
    def advance(
        state: State, some: Examples, flip: Bool[Array, "n"], key: PRNGKeyArray
    ) -> tuple[State, Float[Array, ""]]:
        view, future = _either(flip, some)
        noise = FLOOR / view.scale[:, None, None] * jax.random.normal(key, future.shape, jnp.float32)
        loss, slope = jax.value_and_grad(cost)(state.parameters, view, future + noise)
        return stepped(state, slope, optimiser, config.average), loss

    return advance


def _either(flip: Bool[Array, "n"], some: Examples) -> tuple[View, Float[Array, "n s 3"]]:
    """The examples, some as in a mirror."""
    other = mirrored(some.view)
    side = jnp.where(flip, -1.0, 1.0).astype(jnp.float32)[:, None]
    view = some.view._replace(
        relative=jnp.where(flip[:, None, None], other.relative, some.view.relative),
        room=jnp.where(flip[:, None], other.room, some.view.room),
    )
    return view, jnp.stack([some.future[..., 0], side * some.future[..., 1], some.future[..., 2]], axis=-1)


def _build_measure(curves: Curves) -> Callable[[Any, Examples], Score]:
    """The score, compiled once; the floor's noise has a seed of its own."""

    @jax.jit
    def scored(parameters: Any, some: Examples, noise: Float[Array, "n s 3"]) -> Float[Array, "2"]:
        future = some.future + FLOOR / some.view.scale[:, None, None] * noise
        return jnp.stack(mdn_loss(parameters, curves, some.view, future))

    def measure(parameters: Any, held_out: Examples) -> Score:
        rng, parts, n = np.random.default_rng(0), [], len(held_out.future)
        for begin_at in range(0, n, _AT_ONCE):
            some = _taken(held_out, np.arange(begin_at, min(begin_at + _AT_ONCE, n)))
            noise = rng.standard_normal(some.future.shape).astype(np.float32)
            parts.append(len(noise) * np.asarray(scored(parameters, some, noise), float))
        nll, error = np.sum(parts, axis=0) / n
        return Score(float(nll), float(error))

    return measure


def _taken(examples: Examples, index: np.ndarray) -> Examples:
    """Those of these numbers, all in float32."""
    view = View(*(np.asarray(part[index], np.float32) for part in examples.view))
    return Examples(view, examples.future[index])


def _optimiser(config: MdnConfig) -> Any:
    return annealed_adamw(config.learning_rate, config.steps, warmup=500, last=1e-3, weight_decay=1e-4)


def _resume(folder: Path, config: MdnConfig) -> tuple[State, float]:
    """The state in the folder, or the first one; and the best score so far."""
    parameters = jax.tree.map(jnp.asarray, initial_parameters(config.network, config.training_seed))
    state = begin(parameters, _optimiser(config))
    path = folder / "state.msgpack"
    if not path.is_file():
        return state, float("inf")
    saved, best = serialization.from_bytes((state._asdict(), 0.0), path.read_bytes())
    return State(**saved), float(best)
