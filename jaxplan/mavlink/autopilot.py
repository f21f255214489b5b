"""What is heard: the autopilot's mode and where its vehicle is, and where another vehicle, the target, is."""

import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.errors import ResourceError
from jaxplan.mavlink.codec import ARM, BODY_FRAMES, LOCAL_NED, SET_MODE
from jaxplan.mavlink.frames import Reference, rotated, turned

_ARMED = 128
"""MAV_MODE_FLAG_SAFETY_ARMED."""
_AUTOPILOT_COMPONENT = 1
_RECENT = 1.0
"""Seconds for which a position counts as the present one (arbitrary)."""
_ACCEPTED = (0, 5)
"""MAV_RESULT_ACCEPTED and MAV_RESULT_IN_PROGRESS."""


class Kind(NamedTuple):
    """An autopilot that is known: which mode obeys setpoints, and what else is said of it."""

    name: str
    guided: str
    """The mode's name."""
    parameters: tuple[float, float, float]
    """Of MAV_CMD_DO_SET_MODE: that a custom mode follows, and the mode and sub-mode."""
    hold: tuple[float, float, float] | None
    """Likewise, of the mode in which it stays where it is; None where it does so anyway."""

    def obeys(self, custom_mode: int) -> bool:
        """Whether this mode obeys setpoints."""
        return (custom_mode >> 16) & 0xFF == self.parameters[1] if self.name == "PX4" else custom_mode == 4


KINDS = {
    12: Kind("PX4", "OFFBOARD", (1, 6, 0), (1, 4, 3)),
    3: Kind("ArduPilot", "GUIDED", (1, 4, 0), None),
}
"""By MAV_AUTOPILOT. Modes as PX4's custom_mode (main mode in the third byte) and ArduCopter's number them."""


class Seen(NamedTuple):
    """A vehicle, where it was said to be."""

    time: float
    """When the message came [s]."""
    position: Float[np.ndarray, "3"]
    """[m, world]"""
    velocity: Float[np.ndarray, "3"]
    """[m/s, world]"""


class Autopilot:
    """What the first autopilot that is heard says of itself."""

    def __init__(self, origin: Float[np.ndarray, "3"], other: int | None = None) -> None:
        """``origin`` is where its local frame's origin stands [m, world]; ``other`` is a system that it is not."""
        self._origin, self._other = origin, other
        self.system = self.component = 0
        self.kind: Kind | None = None
        self.engaged = False
        """Whether it is armed and in the mode that obeys setpoints."""
        self.custom_mode = 0
        self.heard = -math.inf
        """When its last heartbeat came [s]."""
        self.vehicle: Seen | None = None
        self.reference: Reference | None = None
        """Where on the globe its local origin is."""
        self.denied = ""
        """Which request to obey it refused last, and with what result; empty where it accepted the last one."""
        self.other_frames: set[int] = set()
        """Frames that are not understood, in which positions came."""

    def hear(self, message: Any, now: float) -> None:
        """Take in a message that came at ``now`` [s]. Raises ``ResourceError`` for an autopilot that is not known."""
        name, system, component = message.get_type(), message.get_srcSystem(), message.get_srcComponent()
        if name == "HEARTBEAT" and self.kind is None and component == _AUTOPILOT_COMPONENT and system != self._other:
            self.kind = _known(message.autopilot)
            self.system, self.component = system, component
        if self.kind is None or (system, component) != (self.system, self.component):
            return
        if name == "HEARTBEAT":
            self.heard, self.custom_mode = now, message.custom_mode
            self.engaged = bool(message.base_mode & _ARMED) and self.kind.obeys(message.custom_mode)
        elif name == "LOCAL_POSITION_NED":
            position = [message.x, message.y, message.z]
            self._at(now, np.array(position), np.array([message.vx, message.vy, message.vz]))
        elif name == "ODOMETRY":
            self._odometry(message, now)
        elif name == "GPS_GLOBAL_ORIGIN":
            latitude, longitude = math.radians(1e-7 * message.latitude), math.radians(1e-7 * message.longitude)
            self.reference = Reference(latitude, longitude, 1e-3 * message.altitude)
        elif name == "COMMAND_ACK" and message.command in (SET_MODE, ARM):
            refusal = f"MAV_RESULT {message.result} to command {message.command}"
            self.denied = "" if message.result in _ACCEPTED else refusal

    def where(self, now: float) -> Seen | None:
        """Where its vehicle is; None where that was not said for a while."""
        recent = self.vehicle is not None and now - self.vehicle.time <= _RECENT
        return self.vehicle if recent else None

    def from_local(self, north_east_down: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """A place in the autopilot's local frame [m] as one in the world."""
        return self._origin + turned(north_east_down)

    def _odometry(self, message: Any, now: float) -> None:
        """Position in the local frame; velocity in it, or in the body."""
        velocity = np.array([message.vx, message.vy, message.vz])
        if message.child_frame_id in BODY_FRAMES:
            velocity = rotated(np.array(message.q), velocity)
        elif message.child_frame_id != LOCAL_NED:
            self.other_frames.add(int(message.child_frame_id))
            return
        if message.frame_id == LOCAL_NED:
            self._at(now, np.array([message.x, message.y, message.z]), velocity)
        else:
            self.other_frames.add(int(message.frame_id))

    def _at(self, now: float, position: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"]) -> None:
        if np.isfinite(position).all() and np.isfinite(velocity).all():
            self.vehicle = Seen(now, self.from_local(position), turned(velocity))


class TargetVehicle:
    """Where another vehicle says that it is."""

    def __init__(self, system: int | None, origin: Float[np.ndarray, "3"] | None) -> None:
        """Which one, and where it counts from.

        Args:
            system: its system; None: any but the autopilot's own.
            origin: where its local frame's origin stands [m, world]; None: its place on the globe counts, from the
                autopilot's origin.
        """
        self.system, self._origin = system, origin
        self.seen: Seen | None = None

    @property
    def by_globe(self) -> bool:
        """Whether it is found by its place on the globe."""
        return self._origin is None

    def hear(self, message: Any, now: float, autopilot: Autopilot) -> None:
        """Take in a message that came at ``now`` [s]."""
        system, name = message.get_srcSystem(), message.get_type()
        if system == autopilot.system or self.system not in (None, system):
            return
        if name == "LOCAL_POSITION_NED" and self._origin is not None:
            position = self._origin + turned(np.array([message.x, message.y, message.z]))
            velocity = turned(np.array([message.vx, message.vy, message.vz]))
        elif name == "GLOBAL_POSITION_INT" and self._origin is None and autopilot.reference is not None:
            latitude, longitude = math.radians(1e-7 * message.lat), math.radians(1e-7 * message.lon)
            local = autopilot.reference.north_east_down(latitude, longitude, 1e-3 * message.alt)
            position = autopilot.from_local(local)
            velocity = turned(1e-2 * np.array([message.vx, message.vy, message.vz]))
        else:
            return
        if np.isfinite(position).all() and np.isfinite(velocity).all():
            self.seen = Seen(now, position, velocity)


def _known(autopilot: int) -> Kind:
    if autopilot not in KINDS:
        known = ", ".join(f"{kind.name} ({number})" for number, kind in KINDS.items())
        raise ResourceError(f"autopilot: have MAV_AUTOPILOT {autopilot}, want {known}; connect another one")
    return KINDS[autopilot]
