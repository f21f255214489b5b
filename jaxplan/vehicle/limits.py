"""Is a trajectory within the rotors' reach? The low-fidelity feasibility test of MFRL (no drag, no rotor lag)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplan.spline import FlatState
from jaxplan.vehicle.flatness import differential_flatness
from jaxplan.vehicle.params import Vehicle


def rotor_limit_margin(vehicle: Vehicle, state: FlatState) -> Float[Array, ""]:
    """Distance [rad/s] of the worst rotor from its nearest limit: positive inside, -inf for a state not finite."""
    state = jax.tree.map(jnp.asarray, state)
    vehicle = vehicle.astype(state.derivatives.dtype)
    speeds = differential_flatness(vehicle, state).rotor_speeds
    margin = jnp.min(jnp.minimum(speeds - vehicle.rotor_speed_min, vehicle.rotor_speed_max - speeds))
    finite = jnp.all(jnp.isfinite(state.derivatives)) & jnp.all(jnp.isfinite(state.yaw)) & jnp.isfinite(margin)
    return jnp.where(finite, margin, -jnp.inf)
