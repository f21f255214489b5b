"""Training of the feasibility classifier: the feature network and both processes together, by their lower bounds."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float
from scipy.optimize import minimize
from scipy.special import ndtr

from jaxplan.errors import InputError
from jaxplan.feasibility.classifier import Model, high_inputs, low_inputs, new_model
from jaxplan.feasibility.features import FeatureConfig
from jaxplan.feasibility.gaussian_process import Related, lower_bound


@dataclasses.dataclass(frozen=True)
class ClassifierConfig:
    """How the classifier is trained."""

    features: FeatureConfig = FeatureConfig()
    inducing: int = 128
    steps: int = 3000
    batch: int = 256
    """Of each fidelity."""
    learning_rate: float = 3e-3
    """At its highest; warmed up and annealed by a cosine."""
    low_weight: float = 1.0
    """Weight of the low fidelity's bound; 0 trains on rollouts alone."""
    weight_decay: float = 1e-3
    """Of the feature network."""
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("inducing", "steps", "batch"):
            if getattr(self, name) < 1:
                raise InputError(f"classifier: {name} is {getattr(self, name)}, want 1 or more")
        if not self.learning_rate > 0.0 or not self.low_weight >= 0.0:
            raise InputError("classifier: want a positive learning_rate and a low_weight of 0 or more")


class Labelled(NamedTuple):
    """Trajectories (by their ``motion_features``) with labels of one fidelity."""

    motion: Float[Array, "n p f"]
    feasible: Bool[Array, "n"]


class _State(NamedTuple):
    model: Model
    optimiser: Any


def train_classifier(
    config: ClassifierConfig, low: Labelled, high: Labelled, start: Model | None = None
) -> tuple[Model, float]:
    """Fit to labels of both fidelities, from ``start`` or anew; also the mean loss of the last tenth (host)."""
    if not len(low.feasible) or not len(high.feasible):
        raise InputError("classifier: want labels of both fidelities, have none of one")
    optimiser = _optimiser(config)
    model = new_model(config.features, config.inducing, config.seed) if start is None else start
    state = _State(model, optimiser.init(model))
    advance = _build_advance(config)
    losses = []
    for step in range(config.steps):
        rng = np.random.default_rng([config.seed, step])
        drawn = _draw(low, config.batch, rng), _draw(high, config.batch, rng)
        state, loss = advance(state, *drawn, len(low.feasible), len(high.feasible))
        losses.append(loss)
    return state.model, float(np.mean(losses[-max(config.steps // 10, 1) :]))


def calibrate(model: Model, mean: Float[Array, "n"], variance: Float[Array, "n"], feasible: Bool[Array, "n"]) -> Model:
    """The model with its latent f replaced by a f + b, most likely for rollouts that it has not learnt from (host).

    Args:
        mean: posterior of the high fidelity's f at those rollouts, as is ``variance``.
    """
    positive = np.asarray(feasible)

    def loss(values: Float[np.ndarray, "2"]) -> float:
        scale, shift = np.exp(values[0]), values[1]
        chance = ndtr((scale * np.asarray(mean, float) + shift) / np.sqrt(1.0 + scale**2 * np.asarray(variance, float)))
        return -float(np.mean(np.log(np.maximum(np.where(positive, chance, 1.0 - chance), 1e-12))))

    log_scale, shift = minimize(loss, np.zeros(2), method="Nelder-Mead").x
    kernel = model.high.kernel
    assert isinstance(kernel, Related)
    own = kernel.own._replace(log_scale=kernel.own.log_scale + log_scale)
    correlation = kernel.correlation._replace(log_scale=kernel.correlation.log_scale + log_scale)
    offset = jnp.float32(np.exp(log_scale) * model.high.offset + shift)
    return model._replace(high=model.high._replace(kernel=Related(own, correlation, kernel.low), offset=offset))


def _build_advance(config: ClassifierConfig) -> Callable[..., tuple[_State, Array]]:
    optimiser = _optimiser(config)

    def loss(model: Model, low: Labelled, high: Labelled, low_size: Array, high_size: Array) -> Array:
        inputs = high_inputs(config.features, model, high.motion)
        bound = lower_bound(model.high, inputs, high.feasible, high_size)
        if config.low_weight > 0.0:
            inputs = low_inputs(config.features, model, low.motion)
            bound += config.low_weight * lower_bound(model.low, inputs, low.feasible, low_size)
        return -bound

    @jax.jit
    def advance(state: _State, *data: Any) -> tuple[_State, Array]:
        value, slope = jax.value_and_grad(loss)(state.model, *data)
        change, memory = optimiser.update(slope, state.optimiser, state.model)
        return _State(optax.apply_updates(state.model, change), memory), value

    return advance


def _draw(labelled: Labelled, count: int, rng: np.random.Generator) -> Labelled:
    lanes = rng.integers(len(labelled.feasible), size=count)
    return Labelled(labelled.motion[lanes], labelled.feasible[lanes])


def _optimiser(config: ClassifierConfig) -> optax.GradientTransformation:
    def decayed(model: Model) -> Model:
        flags = [jax.tree.map(lambda _, part=part: part == 0, tree) for part, tree in enumerate(model)]
        return Model(*flags)

    warm = min(100, config.steps // 10 + 1)
    rate = optax.warmup_cosine_decay_schedule(0.0, config.learning_rate, warm, max(config.steps, warm + 1))
    return optax.chain(
        optax.clip_by_global_norm(10.0), optax.adamw(rate, weight_decay=config.weight_decay, mask=decayed)
    )
