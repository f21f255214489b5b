"""The optimiser in the policy's place: every decoding minimises rho T + sigma anew (paper, eq. 2)."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxplan.arrays import AnyArray
from jaxplan.minsnap.time_allocation import TimeAllocationConfig, optimise_durations
from jaxplan.policy.protocol import Policy
from jaxplan.spline import FlatStateBatch


def optimiser_policy(time_weight: float, config: TimeAllocationConfig | None = None) -> Policy:
    """Durations of least rho T + sigma from the initial state to rest; ``time_weight`` is rho [m^2/s^8].

    Rotor limits are not part of it: the planner's checks reject what breaks them. A sequence without a solution takes
    infinitely long.
    """
    settings = config or TimeAllocationConfig(tolerance=1e-4, max_evaluations=40)

    def encode(
        waypoints: Float[AnyArray, "n 3 k"], count: Int[AnyArray, "k"]
    ) -> tuple[Float[Array, "n 3 k"], Int[Array, "k"]]:
        return jnp.asarray(waypoints), jnp.asarray(count)

    def decode(context: tuple[Array, Array], initial: FlatStateBatch) -> Float[Array, "m k"]:
        waypoints, count = context
        weight = jnp.full(waypoints.shape[-1], time_weight, waypoints.dtype)
        found = optimise_durations(
            "weighted", None, settings, waypoints, count - 1, weight, jnp.asarray(initial.derivatives)[1:], None
        )
        real = jnp.arange(len(waypoints) - 1, dtype=count.dtype)[:, None] < (count - 1)[None]
        return jnp.where(jnp.isfinite(found.cost), found.durations, jnp.where(real, jnp.inf, 0.0))

    return Policy("optimiser", encode, decode)
