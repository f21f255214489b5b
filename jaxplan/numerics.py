"""NaN-safe arithmetic."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplan.arrays import AnyArray


def safe_norm(x: Float[AnyArray, "..."], axis: int = -1, keepdims: bool = False) -> Float[Array, "..."]:
    """Euclidean norm whose gradient at 0 is 0 instead of NaN; NaN stays NaN."""
    squared = jnp.sum(x * x, axis=axis, keepdims=keepdims)
    zero = squared == 0.0
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, squared)))


def safe_divide(
    numerator: Float[AnyArray, "..."], denominator: Float[AnyArray, "..."], otherwise: float = 0.0
) -> Float[Array, "..."]:
    """``numerator / denominator``, and ``otherwise`` (with zero gradient) where the denominator is 0."""
    nonzero = denominator != 0.0
    return jnp.where(nonzero, numerator / jnp.where(nonzero, denominator, 1.0), otherwise)


def wrap_angle(angle: Float[AnyArray, "*shape"]) -> Float[AnyArray, "*shape"]:
    """The same direction in [-pi, pi) [rad]."""
    return (angle + jnp.pi) % (2.0 * jnp.pi) - jnp.pi
