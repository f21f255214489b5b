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
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from flax import serialization
from jaxtyping import Array, Float

from jaxplan.errors import InputError
from jaxplan.feasibility.classifier import Model, make_classifier, new_model
from jaxplan.files import state_configuration, write_atomically
from jaxplan.policy.checkpoint import TrainedPolicy
from jaxplan.policy.network import PolicyNetwork
from jaxplan.precision import in_float64
from jaxplan.training import active
from jaxplan.training.classifier import ClassifierConfig, Labelled, calibrate, train_classifier
from jaxplan.training.examples import Examples, as_queries, batches, take_examples
from jaxplan.training.labels import LabelConfig
from jaxplan.training.reinforce import Learner, ReinforceConfig, build_climb, log_durations, start_learning
from jaxplan.training.scores import binary_scores
from jaxplan.validation import require_at_least
from jaxplan.vehicle.identity import require_same_vehicle
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
        counts = ("first_steps", "first_labels", "rounds", "pool", "steps", "batch", "calibration")
        require_at_least("mfrl", self, 1, *counts)
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
    start: TrainedPolicy,
    config: MfrlConfig,
    labels: LabelConfig,
    report: Callable[[str], None] = print,
) -> Run:
    """Reinforce a pretrained policy for a vehicle; goes on where ``folder`` was left.

    Args:
        folder: of the run.
        examples: training sequences with their minimum-snap labels.
        vehicle: that the labels are for, and that flies.
        start: the pretrained policy, which must be for the same vehicle.
        config: how to train.
        labels: how the labels were made.
        report: takes a line of progress.

    Raises:
        InputError: ``start`` was made for another vehicle.
        FileError: ``folder`` holds a run of another configuration.
    """
    require_same_vehicle("pretrained policy", start.vehicle, vehicle)
    state_configuration(folder, dataclasses.asdict(config), may_differ=("rounds",))
    climb = in_float64(build_climb(start.network, start.parameters, vehicle, config.reinforce))
    trials = _Trials(config, examples, vehicle, active.build_solve(vehicle, labels), _build_durations(start))
    first = Run(start_learning(start.parameters, config.reinforce), trials.prior(start.parameters), 0)
    run = _resume(folder, first)
    for index in range(run.done, config.rounds):
        row = _collect_labels(folder, index, run, trials)
        run = _fit_classifier(folder, index, run, config)
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
    return run._replace(model=_calibrated(run, trials))


@runtime_checkable
class _Durations(Protocol):
    def __call__(self, parameters: Any, examples: Examples, /) -> Float[Array, "m n"]:
        """The durations [s] that a policy with these weights gives."""


def _build_durations(policy: TrainedPolicy) -> _Durations:
    network = PolicyNetwork(policy.network)
    return in_float64(jax.jit(lambda weights, some: jnp.exp(log_durations(network, weights, some))))


class _Trials(NamedTuple):
    """What trial flights of a policy are made of: sequences, durations with noise, and the solver."""

    config: MfrlConfig
    examples: Examples
    vehicle: Vehicle
    solve: active.Solve
    durations: _Durations

    def fly(self, parameters: Any, size: int, rng: np.random.Generator) -> active.Flights:
        """``size`` flights on random sequences, with a policy's durations and noise on them."""
        some = take_examples(self.examples, rng.integers(len(self.examples.count), size=size))
        filled = np.resize(np.arange(size), -(-size // active.WIDTH) * active.WIDTH)
        parts = [
            np.asarray(self.durations(parameters, take_examples(some, members)), float)
            for members in np.split(filled, len(filled) // active.WIDTH)
        ]
        durations = np.concatenate(parts, axis=-1)[:, :size]
        tried = active.perturbed(durations, self.config.span, self.config.noise, rng)
        return self.solve(as_queries(some), np.where(some.durations > 0.0, tried, 0.0))

    def prior(self, parameters: Any) -> Model:
        """A classifier that has seen where a policy's flights lie, but no rollout."""
        flights = self.fly(parameters, active.WIDTH, np.random.default_rng([self.config.seed, 3]))
        return new_model(self.config.classifier.inducing, self.config.seed, flights.motion)


def _collect_labels(folder: Path, index: int, run: Run, trials: _Trials) -> dict[str, Any]:
    """Fly, choose, roll out and keep one round's labels; the classifier's scores on those taken at random."""
    config, first = trials.config, index == 0
    size = config.first_labels if first else config.pool
    flights = trials.fly(run.learner.parameters, size, np.random.default_rng([config.seed, index, 1]))
    believed = active.probabilities(make_classifier(run.model), flights.motion)
    unbiased = np.arange(size if first else config.random)
    chosen = np.arange(0) if first else len(unbiased) + active.least_certain(believed[len(unbiased) :], config.chosen)
    flown = np.concatenate([unbiased, chosen])
    feasible = active.roll_out(flights, flown, trials.vehicle, seed=config.seed + index)
    active.save_labels(_labels_of(folder, index), Labelled(flights.motion[..., flown], feasible))
    scores = binary_scores(believed[unbiased], feasible[: len(unbiased)])
    return {"tracked_at_random": float(feasible[: len(unbiased)].mean()), "rollouts": len(flown), **scores}


def _calibrated(run: Run, trials: _Trials) -> Model:
    """The final model, its probabilities set right on fresh rollouts of the final policy, unseen in training."""
    config, size = trials.config, trials.config.calibration
    flights = trials.fly(run.learner.parameters, size, np.random.default_rng([config.seed, config.rounds, 2]))
    feasible = active.roll_out(flights, np.arange(size), trials.vehicle, seed=config.seed + config.rounds)
    return calibrate(run.model, *active.latents(run.model, flights.motion), feasible)


def _fit_classifier(folder: Path, index: int, run: Run, config: MfrlConfig) -> Run:
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
