"""How far a vehicle can get: what no flight exceeds, whatever it does with its attitude."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.arrays import AnyArray
from jaxplan.vehicle.gains import slowness
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


def farthest(vehicle: Vehicle, speed: float, times: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
    """``reach`` on the host, in NumPy."""
    most = float(np.asarray(most_thrust(vehicle))) + float(vehicle.gravity)
    drag = max(float(vehicle.drag_coefficient) / float(vehicle.mass), 1e-9)
    rate = np.sqrt(most * drag) * np.maximum(times, 0.0)
    grown = 2.0 * np.sinh(0.5 * rate) ** 2 + speed * np.sqrt(drag / most) * np.sinh(rate)
    return np.asarray(np.log1p(grown) / drag)


SPARED = 0.26
"""Share of the acceleration that there is beside hovering that a profile of speeds asks for (arbitrary)."""
MOST_SIDEWAYS = 10.0
"""Largest acceleration [m/s^2] that it asks of any vehicle: what it was tuned with (docs/decisions/0022)."""


def sideways_acceleration(vehicle: Vehicle) -> float:
    """What a profile of speeds may ask of a vehicle [m/s^2] (host), by what it has beside hovering.

    A vehicle of thrust-to-weight ratio r can push g sqrt(r^2 - 1) sideways without sinking. Slow motors make a vehicle
    slow: gains and plans take longer by the root of the lag (``gains_for``), accelerations are less by the lag.
    """
    ratio = float(np.asarray(most_thrust(vehicle)) / np.asarray(vehicle.gravity))
    most = min(MOST_SIDEWAYS, SPARED * float(vehicle.gravity) * float(np.sqrt(ratio**2 - 1.0)))
    return most * slowness(float(vehicle.motor_time_constant)) ** 2
