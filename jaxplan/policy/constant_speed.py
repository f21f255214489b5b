"""The paper's *no policy* baseline: time is distance over one speed (paper, Sec. IV)."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxplan.arrays import AnyArray
from jaxplan.errors import InputError
from jaxplan.numerics import safe_norm
from jaxplan.policy.protocol import Policy
from jaxplan.spline import FlatStateBatch

SHORTEST_SEGMENT = 1e-3
"""Length [m] that coincident waypoints count as, so that no duration is 0 (arbitrary)."""


def constant_speed_policy(speed: float = 2.5) -> Policy:
    """Allocate |p_i - p_{i-1}| / ``speed`` [m/s] whatever the initial state, for any vehicle.

    The default is the paper's. Raises InputError for a speed that is not positive.
    """
    if not (speed > 0.0 and speed < float("inf")):
        raise InputError(f"policy: the speed is {speed} m/s, want a positive number")

    def encode(waypoints: Float[AnyArray, "n 3 k"], count: Int[AnyArray, "k"]) -> Float[Array, "m k"]:
        lengths = jnp.maximum(safe_norm(jnp.diff(waypoints, axis=0), axis=1), SHORTEST_SEGMENT)
        real = jnp.arange(lengths.shape[0], dtype=count.dtype)[:, None] < (count - 1)[None]
        return jnp.where(real, lengths / speed, 0.0)

    def decode(context: Float[Array, "m k"], initial: FlatStateBatch) -> Float[Array, "m k"]:
        return context

    return Policy("no-policy", encode, decode)
