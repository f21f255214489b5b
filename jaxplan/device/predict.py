"""Predictors as traced functions: what was seen of a target, and what it will do, to the goals of one cycle.

They are those of ``jaxplan.prediction`` that need no search through a room, with draws of JAX's instead of NumPy's.
"""

import functools
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxplan.arrays import AnyArray
from jaxplan.device.stations import Goals
from jaxplan.errors import InputError
from jaxplan.names import meant
from jaxplan.prediction.kinematic import VELOCITY_FROM
from jaxplan.prediction.mixture import ConditionalMixture, condition, draw, log_density
from jaxplan.prediction.mixture_predictor import LEAST_SEEN, UNUSUAL
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.target_model import TargetModel, check_model

PREDICTORS = ("none", "ground-truth", "noisy", "constant-velocity", "gmm")
"""By name; those that are not here are asked on the host."""


class Seen(NamedTuple):
    """A target as it was seen, at even intervals."""

    positions: Float[AnyArray, "n 3"]
    """Oldest first [m, world]; where fewer were seen, any in their place."""
    known: Int[AnyArray, ""]
    """How many of the newest count, at least 1."""
    interval: Float[AnyArray, ""]
    """Between them, and between the steps that are predicted [s]."""


@runtime_checkable
class Predict(Protocol):
    """Goals for the coming steps."""

    def __call__(
        self, seen: Seen, truth: Float[AnyArray, "s 3"], mixture: ConditionalMixture | None, key: PRNGKeyArray
    ) -> Goals:
        """Traced. Times count from the newest position.

        ``truth`` is where the target will be at the steps [m], ``mixture`` one of ``mixtures_for`` for each count.
        """


def build_predict(name: str, config: PredictionConfig) -> Predict:
    """The predictor called ``name``, one of ``PREDICTORS``; raises InputError for another name.

    Of ``config``, the interval is that of what is seen.
    """
    if name not in PREDICTORS:
        raise InputError(f"predictor: have {name!r}, want one of {', '.join(PREDICTORS)}{meant(name, PREDICTORS)}")
    draws = {"noisy": _noisy, "gmm": _from_mixture}.get(name, functools.partial(_certain, name))
    return functools.partial(draws, config)


def goals_of(name: str, config: PredictionConfig) -> int:
    """How many goals the predictor called ``name`` proposes."""
    return config.steps * (config.batch if name in ("noisy", "gmm") else 1)


def mixtures_for(config: PredictionConfig, model: TargetModel) -> ConditionalMixture:
    """The mixture made ready for each number of positions that may have been seen, along a first axis (host).

    Raises InputError where it is for other windows.
    """
    check_model(model, observations=config.observations, steps=config.steps, dt=config.dt, world=None)
    ready = [model.conditional(count) for count in range(LEAST_SEEN, config.observations + 1)]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *ready)


def _goals(seen: Seen, positions: Float[Array, "s b 3"], log_densities: Float[Array, "s b"]) -> Goals:
    """Flat, with likelihoods relative to the best one."""
    steps, draws, _ = positions.shape
    times = jnp.repeat(jnp.arange(1, steps + 1, dtype=positions.dtype) * seen.interval, draws)
    return Goals(positions.reshape(-1, 3), times, jnp.exp(log_densities - jnp.max(log_densities)).reshape(-1))


def _certain(
    name: str,
    config: PredictionConfig,
    seen: Seen,
    truth: Float[AnyArray, "s 3"],
    mixture: ConditionalMixture | None,
    key: PRNGKeyArray,
) -> Goals:
    """One position at each step."""
    positions = {
        "none": jnp.broadcast_to(jnp.asarray(seen.positions)[-1], (config.steps, 3)),
        "ground-truth": jnp.asarray(truth),
        "constant-velocity": _straight_on(config, seen),
    }[name]
    return _goals(seen, positions[:, None], jnp.zeros((config.steps, 1), positions.dtype))


def _noisy(
    config: PredictionConfig,
    seen: Seen,
    truth: Float[AnyArray, "s 3"],
    mixture: ConditionalMixture | None,
    key: PRNGKeyArray,
) -> Goals:
    """Where it will really be, with noise whose variance grows with the step."""
    truth = jnp.asarray(truth)
    normal = jax.random.normal(key, (config.steps, config.batch, 3), truth.dtype)
    deviations = jnp.asarray(config.sigma * np.sqrt(np.arange(1, config.steps + 1)), truth.dtype)
    log_densities = -0.5 * jnp.sum(normal**2, axis=-1) - 3.0 * jnp.log(deviations)[:, None]
    return _goals(seen, truth[:, None] + deviations[:, None, None] * normal, log_densities)


def _from_mixture(
    config: PredictionConfig,
    seen: Seen,
    truth: Float[AnyArray, "s 3"],
    mixture: ConditionalMixture | None,
    key: PRNGKeyArray,
) -> Goals:
    """The conditional mixture's draws; constant velocity where too little, or nothing like it in training, was seen."""
    assert mixture is not None, "a mixture is given where it is asked for"
    positions = jnp.asarray(seen.positions)
    at = jnp.clip(seen.known - LEAST_SEEN, 0, config.observations - LEAST_SEEN)
    ready = jax.tree.map(lambda leaf: jnp.asarray(leaf, positions.dtype)[at], mixture)
    relative = (positions[:-1] - positions[-1:]).reshape(-1)
    anchored = ready.rows.shape[-1] > len(relative)
    observed = jnp.concatenate([positions[-1], relative]) if anchored else relative
    log_weights, means, distance = condition(ready, observed)
    means = means + positions[-1][None, :, None]
    keys = jax.random.split(key)
    uniform = jax.random.uniform(keys[0], (config.steps, config.batch), positions.dtype)
    normal = jax.random.normal(keys[1], (config.steps, config.batch, 3), positions.dtype)
    drawn = draw(log_weights, means, ready.factors, uniform, normal)
    densities = log_density(log_weights, means, ready.inverses, ready.log_volumes, drawn)
    coordinates = (3 * (seen.known - 1 + int(anchored))).astype(distance.dtype)
    usual = (seen.known >= LEAST_SEEN) & (distance <= UNUSUAL * coordinates)
    straight = jnp.broadcast_to(_straight_on(config, seen)[:, None], drawn.shape)
    return _goals(seen, jnp.where(usual, drawn, straight), jnp.where(usual, densities, 0.0))


def _straight_on(config: PredictionConfig, seen: Seen) -> Float[Array, "s 3"]:
    """On the line through the newest positions; where it is, if it was seen once."""
    positions = jnp.asarray(seen.positions)
    newest = positions[-1]
    two = (newest - positions[-2]) / seen.interval
    three = (newest - positions[-VELOCITY_FROM]) / (seen.interval * (VELOCITY_FROM - 1))  # least squares, even steps
    velocity = jnp.where(seen.known >= VELOCITY_FROM, three, jnp.where(seen.known == 2, two, 0.0))
    offsets = jnp.arange(1, config.steps + 1, dtype=positions.dtype) * seen.interval
    return newest[None] + offsets[:, None] * velocity[None]
