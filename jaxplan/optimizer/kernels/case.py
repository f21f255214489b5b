"""One problem as plain numbers for compiled code (host)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.minsnap import hermite
from jaxplan.polynomials import derivative_table
from jaxplan.tracking.kernels.craft import Craft


class Case(NamedTuple):
    """What a descent needs beside its variables; SI units, world."""

    craft: Craft
    mixer: Float[np.ndarray, "4 4"]
    """From moment [N m] and specific thrust [m/s^2] to squared rotor speeds as shares of the largest."""
    solids: tuple
    """What is solid (``search.kernels.solids``)."""
    corners: tuple[float, float, float, float, float, float]
    """Lower and upper corner of the room."""
    start: Float[np.ndarray, "5 3"]
    """Position to snap where the plan begins."""
    yaw: float
    interval: float
    """Seconds between the rows of the target's motion."""
    position: Float[np.ndarray, "n 3"]
    """Of the target, moved to where it is met."""
    velocity: Float[np.ndarray, "n 3"]
    meet_radius: float
    kept: tuple[float, float, float, float]
    """The least distance [m], the speed [m/s] from which it is more, how much more [m per m/s], how much at
    most [m]."""
    dilation: float
    """See ``optimizer.problem.Limits``."""
    upright: float
    """The least upward part of the thrust's direction."""
    ahead: float
    """The least horizontal part of body x."""
    turning: float
    """Fastest turn of the thrust [rad/s]; may be infinite."""
    tables: "Tables"


def mixer_of(craft: Craft) -> Float[np.ndarray, "4 4"]:
    """The mixer of a case."""
    return craft.mixer * np.array([1.0, 1.0, 1.0, craft.mass]) / craft.fastest**2


class Tables(NamedTuple):
    """Constants of the splines and of where they are looked at."""

    energy: Float[np.ndarray, "10 10"]
    """Of a segment in its end values (``minsnap.hermite``)."""
    basis: Float[np.ndarray, "10 10"]
    """From end values to coefficients."""
    body: Float[np.ndarray, "s 5 10"]
    """From coefficients to position and derivatives in normalised time where the body is looked at."""
    places: Float[np.ndarray, "p 2 10"]
    """To position and its derivative where the distance to obstacles is."""
    ways: Float[np.ndarray, "2 10 l"]
    """The same with the places last, in whole vectors: 0 behind the last one."""


def make_tables(body_samples: int, place_samples: int) -> Tables:
    """For so many looks at the body and at obstacles in each segment, in the middles of even parts."""
    places = _table(place_samples, 2)
    ways = np.zeros((2, 10, -(-place_samples // 8) * 8))
    ways[:, :, :place_samples] = np.moveaxis(places, 0, -1)
    return Tables(hermite.energy(4).copy(), hermite.coefficients(4).copy(), _table(body_samples, 5), places, ways)


def _table(count: int, orders: int) -> Float[np.ndarray, "{count} {orders} 10"]:
    middles = (np.arange(count) + 0.5) / count
    return np.stack([derivative_table(10, middles, order) for order in range(orders)], axis=1)
