"""NaN-safe arithmetic and the borders between float64 and float32."""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

P = ParamSpec("P")
R = TypeVar("R")


def in_float64(function: Callable[P, R]) -> Callable[P, R]:
    """Run a host entry point with 64-bit JAX types, whatever the process's own setting."""

    @functools.wraps(function)
    def scoped(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.enable_x64(True):
            return function(*args, **kwargs)

    return scoped


def safe_norm(x: Float[Array, "..."], axis: int = -1, keepdims: bool = False) -> Float[Array, "..."]:
    """Euclidean norm whose gradient at 0 is 0 instead of NaN; NaN stays NaN."""
    squared = jnp.sum(x * x, axis=axis, keepdims=keepdims)
    zero = squared == 0.0
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, squared)))


def safe_divide(
    numerator: Float[Array, "..."], denominator: Float[Array, "..."], otherwise: float = 0.0
) -> Float[Array, "..."]:
    """``numerator / denominator``, and ``otherwise`` (with zero gradient) where the denominator is 0."""
    nonzero = denominator != 0.0
    return jnp.where(nonzero, numerator / jnp.where(nonzero, denominator, 1.0), otherwise)


def wrap_angle(angle: Float[Array, "..."]) -> Float[Array, "..."]:
    """The same direction in [-pi, pi)."""
    return (angle + jnp.pi) % (2.0 * jnp.pi) - jnp.pi
