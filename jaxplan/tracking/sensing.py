"""What a tracking controller reads, and the one signature that all controllers share."""

from collections.abc import Callable

from jaxtyping import Array, Bool, Float

from jaxplan.records import record
from jaxplan.spline import FlatState
from jaxplan.tracking.filters import FilterState
from jaxplan.vehicle.params import Vehicle


@record
class Sensed:
    """What the controller reads: true position, velocity, attitude and rotor speeds, and four filtered signals."""

    pos: Float[Array, "3"]
    """m, world."""
    vel: Float[Array, "3"]
    """m/s, world."""
    rotation: Float[Array, "3 3"]
    """Body to world."""
    rotor_speeds: Float[Array, "4"]
    """rad/s."""
    signals: FilterState
    """(4, 3): rows ``SPECIFIC_FORCE``, ``THRUST``, ``RATES``, ``MOMENT``."""


SPECIFIC_FORCE, THRUST, RATES, MOMENT = range(4)
"""Rows of the filtered signals: accelerometer turned into the world [m/s^2], specific thrust vector in the world
[m/s^2], gyroscope [rad/s, body], moment that the rotors make, their reaction included [N m, body]."""

Controller = Callable[[Vehicle, Sensed, FlatState], tuple[Float[Array, "4"], Bool[Array, ""]]]
"""``controller(vehicle, sensed, reference)``: rotor speeds to command [rad/s], and whether a limit changed them. The
vehicle is cast already; gains are the vehicle's."""
