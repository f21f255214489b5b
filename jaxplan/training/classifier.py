"""Training of the feasibility classifier: its process, by the evidence's lower bound."""

import dataclasses
import functools
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float, Int
from scipy.optimize import minimize
from scipy.special import ndtr

from jaxplan.arrays import AnyArray
from jaxplan.errors import InputError
from jaxplan.feasibility.classifier import Model, new_model
from jaxplan.feasibility.gaussian_process import Related, lower_bound
from jaxplan.validation import require_at_least, require_positive


@dataclasses.dataclass(frozen=True)
class ClassifierConfig:
    """How the classifier is trained."""

    inducing: int = 128
    steps: int = 3000
    batch: int = 256
    learning_rate: float = 3e-3
    """At its highest; warmed up and annealed by a cosine."""
    related_to_low: bool = True
    """Whether the low fidelity is seen; without it there are the rollouts alone."""
    seed: int = 0

    def __post_init__(self) -> None:
        require_at_least("classifier", self, 1, "inducing", "steps", "batch")
        require_positive("classifier", self, "learning_rate")


class Labelled(NamedTuple):
    """Trajectories, by their ``motion_features``, that a rollout has tracked or not."""

    motion: Float[AnyArray, "f p n"]
    feasible: Bool[AnyArray, "n"]


class _State(NamedTuple):
    model: Model
    optimiser: optax.OptState


@runtime_checkable
class _Advance(Protocol):
    def __call__(self, state: _State, drawn: Labelled, size: int) -> tuple[_State, Float[Array, ""]]:
        """One gradient step on labels drawn from a set of ``size``; also the loss."""


def train_classifier(config: ClassifierConfig, labelled: Labelled, start: Model | None = None) -> tuple[Model, float]:
    """Fit to labels, from ``start`` or anew; also the mean loss of the last tenth (host)."""
    if not len(labelled.feasible):
        raise InputError("classifier: want labels, have none")
    optimiser, model = _optimiser(config.steps, config.learning_rate), start
    if model is None:
        model = new_model(config.inducing, config.seed, labelled.motion, related_to_low=config.related_to_low)
    state = _State(model, optimiser.init(model))
    advance = _build_advance(config.steps, config.learning_rate)
    losses = []
    for step in range(config.steps):
        rng = np.random.default_rng([config.seed, step])
        state, loss = advance(state, _draw(labelled, config.batch, rng), len(labelled.feasible))
        losses.append(loss)
    return state.model, float(np.mean(losses[-max(config.steps // 10, 1) :]))


def calibrate(
    model: Model, mean: Float[AnyArray, "n"], variance: Float[AnyArray, "n"], feasible: Bool[AnyArray, "n"]
) -> Model:
    """The model with its latent f replaced by a f + b, most likely for rollouts that it has not learnt from (host).

    Args:
        model: with a kernel that relates the fidelities.
        mean: posterior of f at those rollouts, as is ``variance``.
        variance: see ``mean``.
        feasible: whether they were tracked.
    """
    positive = np.asarray(feasible)

    def loss(values: Float[np.ndarray, "2"]) -> float:
        scale, shift = np.exp(values[0]), values[1]
        chance = ndtr((scale * np.asarray(mean, float) + shift) / np.sqrt(1.0 + scale**2 * np.asarray(variance, float)))
        return -float(np.mean(np.log(np.maximum(np.where(positive, chance, 1.0 - chance), 1e-12))))

    log_scale, shift = minimize(loss, np.zeros(2), method="Nelder-Mead").x
    kernel = model.process.kernel
    assert isinstance(kernel, Related)
    own = kernel.own._replace(log_scale=kernel.own.log_scale + log_scale)
    correlation = kernel.correlation._replace(log_scale=kernel.correlation.log_scale + log_scale)
    offset = jnp.float32(np.exp(log_scale) * model.process.offset + shift)
    return model._replace(process=model.process._replace(kernel=Related(own, correlation, kernel.low), offset=offset))


@functools.cache
def _build_advance(steps: int, learning_rate: float) -> _Advance:
    """A step of training, compiled once for all that are trained alike."""
    optimiser = _optimiser(steps, learning_rate)

    def loss(model: Model, drawn: Labelled, size: Int[Array, ""]) -> Float[Array, ""]:
        return -lower_bound(model.process, model.inputs(drawn.motion), jnp.asarray(drawn.feasible), size)

    @jax.jit
    def advance(state: _State, drawn: Labelled, size: Int[Array, ""]) -> tuple[_State, Float[Array, ""]]:
        value, slope = jax.value_and_grad(loss)(state.model, drawn, size)
        with jax.numpy_dtype_promotion("standard"):  # optax counts steps in int32
            change, memory = optimiser.update(slope, state.optimiser, state.model)
        return _State(optax.apply_updates(state.model, change), memory), value

    return advance


def _draw(labelled: Labelled, count: int, rng: np.random.Generator) -> Labelled:
    drawn = rng.integers(len(labelled.feasible), size=count)
    return Labelled(labelled.motion[..., drawn], labelled.feasible[drawn])


def _optimiser(steps: int, learning_rate: float) -> optax.GradientTransformation:
    warm = min(100, steps // 10 + 1)
    rate = optax.warmup_cosine_decay_schedule(0.0, learning_rate, warm, max(steps, warm + 1))
    return optax.chain(optax.clip_by_global_norm(10.0), optax.adam(rate))
