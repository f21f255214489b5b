"""What a tracking controller reads, and the one signature that all controllers share."""

from typing import Protocol, runtime_checkable

from jaxtyping import Bool, Float

from jaxplan.arrays import AnyArray
from jaxplan.records import record
from jaxplan.spline import FlatState
from jaxplan.tracking.filters import FilterState
from jaxplan.vehicle.params import Vehicle


@record
class Sensed:
    """What the controller reads: true position, velocity, attitude and rotor speeds, and four filtered signals."""

    pos: Float[AnyArray, "3"]
    """m, world."""
    vel: Float[AnyArray, "3"]
    """m/s, world."""
    rotation: Float[AnyArray, "3 3"]
    """Body to world."""
    rotor_speeds: Float[AnyArray, "4"]
    """rad/s."""
    signals: FilterState
    """(4, 3): rows ``SPECIFIC_FORCE``, ``THRUST``, ``RATES``, ``MOMENT``."""


SPECIFIC_FORCE, THRUST, RATES, MOMENT = range(4)
"""Rows of the filtered signals: accelerometer turned into the world [m/s^2], specific thrust vector in the world
[m/s^2], gyroscope [rad/s, body], moment that the rotors make, their reaction included [N m, body]."""


@runtime_checkable
class Controller(Protocol):
    """Follows a reference."""

    def __call__(
        self, vehicle: Vehicle, sensed: Sensed, reference: FlatState
    ) -> tuple[Float[AnyArray, "4"], Bool[AnyArray, ""]]:
        """Rotor speeds to command [rad/s], and whether a limit changed them.

        ``vehicle`` is cast already; the gains are its own.
        """
