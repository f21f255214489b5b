"""Between the world (x east, y north, z up) and an autopilot's local frame (north, east, down), and from the globe.

The autopilot's origin stands somewhere in the world; both frames' axes are fixed to the compass.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.runtime import Setpoint

_EARTH = 6_371_000.0
"""m: the radius of the sphere that PX4 and ArduPilot project from."""


class NedSetpoint(NamedTuple):
    """What SET_POSITION_TARGET_LOCAL_NED says."""

    position: Float[np.ndarray, "3"]
    """Metres from the autopilot's origin."""
    velocity: Float[np.ndarray, "3"]
    acceleration: Float[np.ndarray, "3"]
    yaw: float
    """Radians from north, clockwise, in (-pi, pi]."""
    yaw_rate: float


def turned(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """East, north, up as north, east, down, and back."""
    x, y, z = vector
    return np.array([y, x, -z])


def to_ned(setpoint: Setpoint, origin: Float[np.ndarray, "3"]) -> NedSetpoint:
    """A setpoint in the world as the autopilot is told; ``origin`` is where its own stands [m, world]."""
    yaw = math.remainder(0.5 * math.pi - float(setpoint.yaw[0]), 2.0 * math.pi)
    return NedSetpoint(
        position=turned(setpoint.position - origin),
        velocity=turned(setpoint.velocity),
        acceleration=turned(setpoint.acceleration),
        yaw=math.pi if yaw <= -math.pi else yaw,
        yaw_rate=-float(setpoint.yaw[1]),
    )


class Reference(NamedTuple):
    """Where on the globe a local frame's origin is."""

    latitude: float
    """Radians."""
    longitude: float
    altitude: float
    """Metres above the sea."""

    def north_east_down(self, latitude: float, longitude: float, altitude: float) -> Float[np.ndarray, "3"]:
        """Metres from the origin, by the azimuthal equidistant projection (Snyder 1987, eq. 22-4, 22-5, 25-2)."""
        difference = longitude - self.longitude
        here, there = math.sin(self.latitude), math.sin(latitude)
        cos_here, cos_there = math.cos(self.latitude), math.cos(latitude)
        north = cos_here * there - here * cos_there * math.cos(difference)
        east = cos_there * math.sin(difference)
        # The same angle as by its cosine, but exact where it is small.
        angle = math.atan2(math.hypot(north, east), here * there + cos_here * cos_there * math.cos(difference))
        scale = _EARTH * (angle / math.sin(angle) if angle > 0.0 else 1.0)
        return np.array([scale * north, scale * east, self.altitude - altitude])


def rotated(quat_wxyz: Float[np.ndarray, "4"], vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """A vector in the body as one in the frame that the attitude is against."""
    w, axis = quat_wxyz[0], quat_wxyz[1:]
    once = np.cross(axis, vector)
    return np.asarray(vector + 2.0 * (w * once + np.cross(axis, once)))
