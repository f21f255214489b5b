"""The specific thrust that a motion takes, in the unit in which learned models see it."""

import jax.numpy as jnp
from jaxtyping import Array, Float

STANDARD_GRAVITY = 9.81
"""The unit [m/s^2] of thrust in features, and what stands for gravity in those that do not see the vehicle; as in the
presets."""
LEAST_THRUST = 0.5
"""Specific thrust [m/s^2] below which its direction counts as changing no faster (arbitrary)."""


def log_thrust(size: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Logarithm of the specific thrust [m/s^2] in units of ``STANDARD_GRAVITY``; finite where it is 0."""
    return jnp.log((size + 0.1) / STANDARD_GRAVITY)
