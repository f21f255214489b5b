"""Multi-fidelity reinforcement: policy and classifier in turn, from a pretrained policy (MFRL; paper, Sec. II-D).

Each round flies the present policy on random sequences, spends rollouts where the classifier is least sure (and some at
random, by which it is scored before it learns from them), trains the classifier on all labels so far, and reinforces
the policy. A run is a folder: ``state.msgpack`` to go on from, ``labels-*.npz`` and ``metrics.jsonl``. It may be asked
for more rounds later.
"""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import serialization
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.feasibility.classifier import Model, make_classifier, new_model
from jaxplan.files import state_configuration, write_atomically
from jaxplan.policy.network import NetworkConfig, PolicyNetwork
from jaxplan.precision import in_float64
from jaxplan.training import active
from jaxplan.training.classifier import ClassifierConfig, Labelled, calibrate, train_classifier
from jaxplan.training.examples import Examples, as_queries, batches, lanes_of
from jaxplan.training.labels import LabelConfig
from jaxplan.training.reinforce import Learner, ReinforceConfig, build_climb, log_durations, start_learning
from jaxplan.training.scores import binary_scores
from jaxplan.vehicle.params import Vehicle


@dataclasses.dataclass(frozen=True)
class MfrlConfig:
    """One run."""

    reinforce: ReinforceConfig = ReinforceConfig()
    """How the policy is reinforced."""
    classifier: ClassifierConfig = ClassifierConfig(steps=200, learning_rate=1e-3)
    """Steps and learning rate of every round but the first."""
    first_steps: int = 2000
    """Classifier's steps in the first round, at three times the learning rate."""
    first_labels: int = 10_000
    """Rollouts of the first round, at random."""
    rounds: int = 50
    """Rounds of labelling, training of the classifier, and reinforcement."""
    pool: int = 2048
    """Flights of which each round chooses what to label."""
    chosen: int = 256
    """Rollouts of each round by variation ratio."""
    random: int = 128
    """Rollouts of each round at random."""
    calibration: int = 2048
    """Rollouts at the end, at random, on which the classifier's probabilities are set right."""
    span: tuple[float, float] = (0.8, 1.15)
    """Factors of the policy's durations that are tried."""
    noise: float = 0.05
    """Standard deviation of the logarithm of each duration that is tried."""
    steps: int = 120
    """Gradient steps of the policy in each round."""
    batch: int = 256
    """Sequences of each gradient step."""
    seed: int = 0
    """Seed of sequences, noise and batches."""

    def __post_init__(self) -> None:
        for name in ("first_steps", "first_labels", "rounds", "pool", "steps", "batch", "calibration"):
            if getattr(self, name) < 1:
                raise InputError(f"mfrl: {name} is {getattr(self, name)}, want 1 or more")
        if self.chosen + self.random > self.pool or min(self.chosen, self.random) < 0:
            raise InputError(f"mfrl: have {self.chosen} + {self.random} rollouts of a pool of {self.pool}, want fewer")


class Run(NamedTuple):
    """State of a run."""

    learner: Learner
    model: Model
    done: int
    """Rounds."""


def reinforce(
    folder: Path,
    examples: Examples,
    vehicle: Vehicle,
    network: NetworkConfig,
    parameters: Any,
    config: MfrlConfig,
    labels: LabelConfig,
    report: Callable[[str], None] = print,
) -> Run:
    """Reinforce a pretrained policy; goes on where ``folder`` was left.

    Args:
        examples: training sequences with their minimum-snap labels.
        parameters: the pretrained weights.
    """
    state_configuration(folder, dataclasses.asdict(config), may_differ=("rounds",))
    climb = in_float64(build_climb(network, parameters, vehicle, config.reinforce))
    durations = in_float64(jax.jit(lambda weights, some: jnp.exp(log_durations(PolicyNetwork(network), weights, some))))
    airfield = _Airfield(config, examples, vehicle, active.build_solve(vehicle, labels), durations)
    run = _resume(folder, Run(start_learning(parameters, config.reinforce), airfield.prior(parameters), 0))
    for index in range(run.done, config.rounds):
        row = _label(folder, index, run, airfield)
        run = _teach(folder, index, run, config)
        classifier = make_classifier(run.model)
        learner, earned = run.learner, []
        steps = range(index * config.steps, (index + 1) * config.steps)
        for batch, key in batches(examples, config.batch, config.seed, steps):
            learner, found = climb(learner, classifier, batch, key)
            earned.append(found)
        means = jax.tree.map(lambda *leaves: float(np.mean(leaves)), *earned)
        run = Run(learner, run.model, index + 1)
        write_atomically(folder / "state.msgpack", serialization.to_bytes(_savable(run)))
        row |= {"round": index + 1, **means._asdict(), "deviation": float(np.exp(learner.log_deviation))}
        with (folder / "metrics.jsonl").open("a") as log:
            log.write(json.dumps(row) + "\n")
        report(
            f"round {index + 1} of {config.rounds}: T / T_MS {means.relative_time:.3f}, P {means.probability:.3f}; "
            f"classifier on fresh rollouts: AUC {row['auc']:.3f}, Brier {row['brier']:.3f}"
        )
    return run._replace(model=_calibrated(run, airfield))


class _Airfield(NamedTuple):
    """What flights of a policy are made of."""

    config: MfrlConfig
    examples: Examples
    vehicle: Vehicle
    solve: active.Solve
    durations: Callable[..., Float[np.ndarray, "m n"]]
    """(weights, sequences): a policy's durations [s]."""

    def try_out(self, parameters: Any, size: int, rng: np.random.Generator) -> active.Flights:
        """Noisy flights of the present policy on random sequences."""
        some = lanes_of(self.examples, rng.integers(len(self.examples.count), size=size))
        filled = np.resize(np.arange(size), -(-size // active.LANES) * active.LANES)
        parts = [
            np.asarray(self.durations(parameters, lanes_of(some, lanes)), float)
            for lanes in np.split(filled, len(filled) // active.LANES)
        ]
        durations = np.concatenate(parts, axis=-1)[:, :size]
        tried = active.perturbed(durations, self.config.span, self.config.noise, rng)
        return self.solve(as_queries(some), np.where(some.durations > 0.0, tried, 0.0))

    def prior(self, parameters: Any) -> Model:
        """A classifier that has seen where a policy's flights lie, but no rollout."""
        flights = self.try_out(parameters, active.LANES, np.random.default_rng([self.config.seed, 3]))
        return new_model(self.config.classifier.inducing, self.config.seed, flights.motion)


def _label(folder: Path, index: int, run: Run, airfield: _Airfield) -> dict[str, Any]:
    """Fly, choose, roll out and keep one round's labels; the classifier's scores on those taken at random."""
    config, first = airfield.config, index == 0
    size = config.first_labels if first else config.pool
    flights = airfield.try_out(run.learner.parameters, size, np.random.default_rng([config.seed, index, 1]))
    believed = active.judged(make_classifier(run.model), flights.motion)
    unbiased = np.arange(size if first else config.random)
    chosen = np.arange(0) if first else len(unbiased) + active.least_certain(believed[len(unbiased) :], config.chosen)
    lanes = np.concatenate([unbiased, chosen])
    feasible = active.roll_out(flights, lanes, airfield.vehicle, seed=config.seed + index)
    active.save_labels(_labels_of(folder, index), Labelled(flights.motion[..., lanes], feasible))
    scores = binary_scores(believed[unbiased], feasible[: len(unbiased)])
    return {"tracked_at_random": float(feasible[: len(unbiased)].mean()), "rollouts": len(lanes), **scores}


def _calibrated(run: Run, airfield: _Airfield) -> Model:
    """The final model, its probabilities set right on fresh rollouts of the final policy, unseen in training."""
    config, size = airfield.config, airfield.config.calibration
    flights = airfield.try_out(run.learner.parameters, size, np.random.default_rng([config.seed, config.rounds, 2]))
    feasible = active.roll_out(flights, np.arange(size), airfield.vehicle, seed=config.seed + config.rounds)
    return calibrate(run.model, *active.latents(run.model, flights.motion), feasible)


def _teach(folder: Path, index: int, run: Run, config: MfrlConfig) -> Run:
    """Train the classifier on all labels so far."""
    labelled = active.load_labels([_labels_of(folder, k) for k in range(index + 1)])
    settings = dataclasses.replace(config.classifier, seed=config.seed + index)
    if index == 0:
        rate = 3.0 * config.classifier.learning_rate
        settings = dataclasses.replace(settings, steps=config.first_steps, learning_rate=rate)
    model, _ = train_classifier(settings, labelled, run.model)
    return run._replace(model=model)


def _resume(folder: Path, fresh: Run) -> Run:
    """The run in ``folder``, or a new one."""
    saved = folder / "state.msgpack"
    if not saved.exists():
        return fresh
    leaves = serialization.from_bytes(_savable(fresh), saved.read_bytes())
    run = jax.tree.unflatten(jax.tree.structure(fresh), [jnp.asarray(leaves[str(k)]) for k in range(len(leaves))])
    return run._replace(done=int(run.done))


def _savable(run: Run) -> dict[str, Any]:
    """Leaves by number: named tuples within the optimiser have no stable names."""
    return {str(index): np.asarray(leaf) for index, leaf in enumerate(jax.tree.leaves(run))}


def _labels_of(folder: Path, index: int) -> Path:
    return folder / f"labels-{index:04d}.npz"
