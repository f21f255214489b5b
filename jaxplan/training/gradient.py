"""What trainings by gradient share: a state with a running mean of the weights, a step of it, and the optimiser."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Int


class State(NamedTuple):
    """All that a training run changes."""

    parameters: Any
    """Weights, a tree as Flax has it."""
    averaged: Any
    """Their running mean."""
    optimiser: optax.OptState
    step: Int[Array, ""]


def begin(parameters: Any, optimiser: optax.GradientTransformation) -> State:
    """Before the first step."""
    return State(parameters, parameters, optimiser.init(parameters), jnp.int32(0))


def stepped(state: State, slope: Any, optimiser: optax.GradientTransformation, average: float) -> State:
    """After a step against ``slope``; ``average`` is the running mean's decay, less in the first steps (traced)."""
    with jax.numpy_dtype_promotion("standard"):  # optax counts steps in int32
        change, memory = optimiser.update(slope, state.optimiser, state.parameters)
        parameters = optax.apply_updates(state.parameters, change)
        rate = jnp.minimum(average, (1.0 + state.step) / (10.0 + state.step))
        averaged = optax.incremental_update(parameters, state.averaged, 1.0 - rate)
    return State(parameters, averaged, memory, state.step + 1)


def annealed_adamw(
    learning_rate: float, steps: int, *, warmup: int, last: float, weight_decay: float
) -> optax.GradientTransformation:
    """AdamW of clipped gradients, its rate warmed up and annealed by a cosine down to a share ``last``."""
    warm = min(warmup, steps // 10 + 1)
    rate = optax.warmup_cosine_decay_schedule(0.0, learning_rate, warm, steps, last * learning_rate)
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(rate, weight_decay=weight_decay))
