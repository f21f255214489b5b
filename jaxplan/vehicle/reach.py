"""How far a vehicle can get: what no flight exceeds, whatever it does with its attitude."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxplan.arrays import AnyArray, Scalar, namespace
from jaxplan.vehicle.gains import slowness
from jaxplan.vehicle.limits import most_thrust
from jaxplan.vehicle.params import Vehicle


def reach(vehicle: Vehicle, speed: Scalar, times: Float[AnyArray, "k"]) -> Float[AnyArray, "k"]:
    """Upper bound of the distance [m] flown within ``times`` [s] from a ``speed`` [m/s] on.

    All rotors push along the way, gravity too, and the drag c v^2 is against it: v' = a - (c / m) v^2, whose integral
    is (m / c) log(cosh(t / tau) + speed / v_inf sinh(t / tau)) with v_inf = sqrt(a m / c) and tau = v_inf / a.
    NumPy's times are computed with on the host.
    """
    xp = namespace(times)
    if xp is jnp:
        vehicle = vehicle.astype(times.dtype)
    most = most_thrust(vehicle) + vehicle.gravity
    drag = xp.maximum(vehicle.drag_coefficient / vehicle.mass, 1e-9)
    rate = xp.sqrt(most * drag) * xp.maximum(times, 0.0)
    grown = 2.0 * xp.sinh(0.5 * rate) ** 2 + speed * xp.sqrt(drag / most) * xp.sinh(rate)
    return xp.log1p(grown) / drag


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
