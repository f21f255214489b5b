"""How far a vehicle can get: what no flight exceeds, whatever it does with its attitude."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplan.arrays import AnyArray
from jaxplan.vehicle.limits import most_thrust
from jaxplan.vehicle.params import Vehicle


def reach(vehicle: Vehicle, speed: Float[AnyArray, ""], times: Float[AnyArray, "k"]) -> Float[Array, "k"]:
    """Upper bound of the distance [m] flown within ``times`` [s] from a ``speed`` [m/s] on.

    All rotors push along the way, gravity too, and the drag c v^2 is against it: v' = a - (c / m) v^2, whose integral
    is (m / c) log(cosh(t / tau) + speed / v_inf sinh(t / tau)) with v_inf = sqrt(a m / c) and tau = v_inf / a.
    """
    vehicle = vehicle.astype(jnp.asarray(times).dtype)
    most = most_thrust(vehicle) + vehicle.gravity
    drag = jnp.maximum(vehicle.drag_coefficient / vehicle.mass, 1e-9)
    rate = jnp.sqrt(most * drag) * jnp.maximum(times, 0.0)
    grown = 2.0 * jnp.sinh(0.5 * rate) ** 2 + speed * jnp.sqrt(drag / most) * jnp.sinh(rate)
    return jnp.log1p(grown) / drag
