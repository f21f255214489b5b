"""Reinforcement of a policy by the feasibility classifier (paper, Sec. II-D; MFRL, Sec. III).

Reward of one flight: r = (bonus + min(1 - T / T_MS, ceiling)) * P(feasible), where T_MS is the total time of the
minimum-snap label. With bonus 0 and no ceiling it is the paper's; the predecessors add the bonus, which weighs safety
against time. A flight is one decision, the logarithms of its durations, so there is nothing to discount.

Two ways to climb it: ``ppo``, proximal policy optimisation on noisy durations with the mean reward of several tries of
the same sequence as the baseline; ``gradient``, the reward's own gradient through classifier and minimum-snap solve.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from jaxplan.errors import InputError
from jaxplan.feasibility.classifier import Classifier
from jaxplan.minsnap.spline_batch import SplineBatch, fit_each
from jaxplan.policy.network import NetworkConfig, PolicyNetwork
from jaxplan.policy.neural import allocate_times, read_sequences
from jaxplan.training.examples import Examples
from jaxplan.validation import require_at_least, require_positive
from jaxplan.vehicle.params import Vehicle


@dataclasses.dataclass(frozen=True)
class ReinforceConfig:
    """How a policy is reinforced."""

    method: Literal["ppo", "gradient"] = "gradient"
    """ppo: proximal policy optimisation; gradient: along the reward's own gradient."""
    bonus: float = 0.6
    """Reward of a feasible flight that is no faster than the minimum-snap label; 0 is the paper's."""
    ceiling: float = float("inf")
    """Largest gain of time that is rewarded."""
    learning_rate: float = 3e-4
    """Learning rate of the policy at first."""
    halved: int = 2000
    """Gradient steps after which the learning rate is half of that; after twice as many it is a third."""
    anchor: float = 0.001
    """Weight of the divergence from the policy that training began with, both as normal distributions of
    ``deviation`` about the logarithms of the durations."""
    deviation: float = 0.1
    """Standard deviation of the logarithms of the durations that are tried."""
    tries: int = 4
    """Durations that are tried for each sequence (ppo)."""
    passes: int = 4
    """Gradient steps on the same tries (ppo)."""
    ratio: float = 0.2
    """Change of a try's likelihood beyond which it is not rewarded (ppo)."""
    entropy: float = 1e-3
    """Weight of the logarithm of the deviation, which ppo learns."""
    max_yaw_rate: float = 1.5
    """Largest yaw rate of the flights that are solved [rad/s]."""

    def __post_init__(self) -> None:
        if self.method not in ("ppo", "gradient"):
            raise InputError(f"reinforce: method is {self.method!r}, want ppo or gradient")
        require_positive("reinforce", self, "learning_rate", "deviation", "ratio", "max_yaw_rate")
        require_at_least("reinforce", self, 1, "tries", "passes", "halved")
        require_at_least("reinforce", self, 0.0, "anchor", "entropy")


class Learner(NamedTuple):
    """All that reinforcement changes."""

    parameters: Any
    """The policy's weights, a tree as Flax has it."""
    log_deviation: Float[Array, ""]
    optimiser: optax.OptState


class Return(NamedTuple):
    """What a batch of flights earned, on average."""

    reward: Float[Array, ""]
    probability: Float[Array, ""]
    relative_time: Float[Array, ""]


@runtime_checkable
class Probability(Protocol):
    """What says whether flights can be tracked."""

    def __call__(self, splines: SplineBatch, /) -> Float[Array, "b"]:
        """P(tracked) of b flights (traced)."""


@runtime_checkable
class Climb(Protocol):
    """One compiled step."""

    def __call__(
        self, learner: Learner, classifier: Classifier, batch: Examples, key: PRNGKeyArray, /
    ) -> tuple[Learner, Return]:
        """The learner after learning from ``batch``, and what the batch earned before."""


def start_learning(parameters: Any, config: ReinforceConfig) -> Learner:
    """Begin with the weights of a pretrained policy."""
    deviation = jnp.float32(jnp.log(config.deviation))
    return Learner(parameters, deviation, _optimiser(config).init((parameters, deviation)))


def build_climb(network: NetworkConfig, anchor: Any, vehicle: Vehicle, config: ReinforceConfig) -> Climb:
    """One compiled step: batches are tried, classified and learnt from.

    Args:
        network: sizes of the policy.
        anchor: the weights that the policy must not leave too far behind.
        vehicle: that flies.
        config: how to reinforce.
    """
    optimiser, decoder = _optimiser(config), PolicyNetwork(network)

    def update(learner: Learner, objective: Callable[..., Any]) -> tuple[Learner, Any]:
        trained = (learner.parameters, learner.log_deviation)
        slope, found = jax.grad(objective, has_aux=True)(trained)
        with jax.numpy_dtype_promotion("standard"):  # optax counts steps in int32
            change, memory = optimiser.update(slope, learner.optimiser, trained)
        parameters, log_deviation = optax.apply_updates(trained, change)
        return Learner(parameters, log_deviation, memory), found

    @jax.jit
    def climb(learner: Learner, classifier: Classifier, batch: Examples, key: PRNGKeyArray) -> tuple[Learner, Return]:
        known = log_durations(decoder, anchor, batch)
        chance = lambda splines: classifier.predict(splines, vehicle).probability  # noqa: E731
        if config.method == "gradient":
            direct = lambda trained: _gradient_loss(trained[0], known, decoder, chance, batch, config)  # noqa: E731
            return update(learner, direct)
        tries = _try(learner, decoder, chance, batch, key, config)
        for _ in range(config.passes):
            learner, found = update(learner, lambda trained: _ppo_loss(trained, tries, known, decoder, batch, config))
        return learner, found

    return climb


def log_durations(network: PolicyNetwork, parameters: Any, batch: Examples) -> Float[Array, "m b"]:
    """Logarithms of a policy's durations, 0 on padding."""
    frame, memory, _ = read_sequences(network, parameters, batch.waypoints, batch.count)
    durations = allocate_times(network, parameters, memory, frame, batch.initial)
    return jnp.where(memory.real, jnp.log(jnp.maximum(durations, 1e-3)), 0.0)


def rewards(
    chance: Probability, batch: Examples, logs: Float[Array, "m b"], config: ReinforceConfig
) -> tuple[Float[Array, "b"], Float[Array, "b"], Float[Array, "b"]]:
    """Reward, probability to be feasible, and T / T_MS of each flight.

    Args:
        chance: the classifier, for one vehicle.
        batch: sequences with their labels, whose total times are T_MS.
        logs: logarithms of the durations [s] that are flown.
        config: what is rewarded.
    """
    durations = jnp.where(batch.durations > 0.0, jnp.exp(logs.astype(batch.waypoints.dtype)), 0.0)
    splines = fit_each(batch.initial, jnp.asarray(batch.waypoints), durations, config.max_yaw_rate)
    feasible = chance(splines)
    relative = jnp.sum(durations, axis=0) / jnp.sum(batch.durations, axis=0)
    gain = config.bonus + jnp.minimum(1.0 - relative, config.ceiling)
    return gain * feasible.astype(gain.dtype), feasible, relative


class _Tries(NamedTuple):
    """Several noisy versions of every sequence's durations; t x b flights."""

    logs: Float[Array, "t m b"]
    log_likelihood: Float[Array, "t b"]
    advantage: Float[Array, "t b"]
    found: Return


def _gradient_loss(
    parameters: Any,
    known: Float[Array, "m b"],
    network: PolicyNetwork,
    chance: Probability,
    batch: Examples,
    config: ReinforceConfig,
) -> tuple[Float[Array, ""], Return]:
    logs = log_durations(network, parameters, batch)
    reward, feasible, relative = rewards(chance, batch, logs, config)
    kept = config.anchor * _divergence(logs, known, config.deviation)
    loss = kept.astype(reward.dtype) - jnp.mean(reward)
    return loss, Return(jnp.mean(reward), jnp.mean(feasible), jnp.mean(relative))


def _try(
    learner: Learner,
    network: PolicyNetwork,
    chance: Probability,
    batch: Examples,
    key: PRNGKeyArray,
    config: ReinforceConfig,
) -> _Tries:
    mean = log_durations(network, learner.parameters, batch)
    noise = jax.random.normal(key, (config.tries, *mean.shape), mean.dtype)
    logs = mean[None] + jnp.exp(learner.log_deviation) * noise * (batch.durations > 0.0).astype(mean.dtype)[None]
    reward, feasible, relative = jax.lax.map(lambda one: rewards(chance, batch, one, config), logs)
    advantage = reward - jnp.mean(reward, axis=0, keepdims=True)
    advantage = advantage / (jnp.std(advantage) + 1e-6)
    likelihood = _log_likelihood(logs, mean, learner.log_deviation, batch)
    return _Tries(logs, likelihood, advantage, Return(jnp.mean(reward), jnp.mean(feasible), jnp.mean(relative)))


def _ppo_loss(
    trained: tuple[Any, Float[Array, ""]],
    tries: _Tries,
    known: Float[Array, "m b"],
    network: PolicyNetwork,
    batch: Examples,
    config: ReinforceConfig,
) -> tuple[Float[Array, ""], Return]:
    """The clipped surrogate (Schulman et al. 2017, eq. 7)."""
    parameters, log_deviation = trained
    mean = log_durations(network, parameters, batch)
    ratio = jnp.exp(_log_likelihood(tries.logs, mean, log_deviation, batch) - tries.log_likelihood)
    clipped = jnp.clip(ratio, 1.0 - config.ratio, 1.0 + config.ratio)
    precise = tries.advantage.dtype
    gain = jnp.mean(jnp.minimum(ratio.astype(precise) * tries.advantage, clipped.astype(precise) * tries.advantage))
    kept = config.anchor * _divergence(mean, known, config.deviation) - config.entropy * log_deviation
    return kept.astype(precise) - gain, tries.found


def _log_likelihood(
    logs: Float[Array, "t m b"], mean: Float[Array, "m b"], log_deviation: Float[Array, ""], batch: Examples
) -> Float[Array, "t b"]:
    """Of normal distributions about ``mean``, without their constant."""
    each = -0.5 * ((logs - mean[None]) * jnp.exp(-log_deviation)) ** 2 - log_deviation
    return jnp.sum(jnp.where((batch.durations > 0.0)[None], each, 0.0), axis=-2)


def _divergence(logs: Float[Array, "m b"], known: Float[Array, "m b"], deviation: float) -> Float[Array, ""]:
    """Kullback-Leibler divergence of normal distributions of equal width, averaged over the batch."""
    return jnp.mean(jnp.sum(0.5 * ((logs - known) / deviation) ** 2, axis=0))


def _optimiser(config: ReinforceConfig) -> optax.GradientTransformation:
    rate = lambda step: config.learning_rate / (1.0 + step / config.halved)  # noqa: E731
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adam(rate))
