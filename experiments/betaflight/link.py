"""The firmware's packets, and one exchange after another in lockstep.

All little-endian. State, to UDP 9003: 18 doubles, time [s]; body rates FRD [rad/s]; specific force FLU, negated
[m/s^2]; attitude of FRD axes in the world that is turned likewise, (x, -y, -z), as a quaternion w x y z; velocity ENU
[m/s]; longitude, latitude [deg] and altitude [m]; pressure [Pa]. Radio, to UDP 9004: a double, time [s], and 16 uint16,
channels in the order AETR, then AUX1. Motors, from UDP 9002: 4 floats, 0 to 1, front right, rear left, front left, rear
right.
"""

import struct
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.errors import ResourceError

from .launcher import MOTOR_PORT, RADIO_PORT, STATE_PORT
from .process import Running

LOOPBACK = "127.0.0.1"
STATE, RADIO, MOTORS = struct.Struct("<18d"), struct.Struct("<d16H"), struct.Struct("<4f")
CHANNELS = 16
LOW, MIDDLE, HIGH = 1000, 1500, 2000
"""Microseconds, of a stick or a switch."""
PRESSURE = 101325.0
"""Pa, of the standard atmosphere at sea level; the firmware flies without a barometer."""
METRES_PER_DEGREE = 111_320.0
"""Of longitude and latitude at 0, 0, where the virtual satellite receiver is: it is not flown by."""
ANSWER_SECONDS = 10.0
"""Within which a motor packet comes (it takes 0.2 ms; arbitrary)."""


class Sensors(NamedTuple):
    """What the firmware is told of the vehicle. World ENU with z up, body FLU."""

    pos: Float[np.ndarray, "3"]
    """m, world."""
    vel: Float[np.ndarray, "3"]
    """m/s, world."""
    quat_wxyz: Float[np.ndarray, "4"]
    """Body to world."""
    body_rates: Float[np.ndarray, "3"]
    """rad/s, body: the gyroscope."""
    specific_force: Float[np.ndarray, "3"]
    """m/s^2, body: the accelerometer, +g along z at rest."""


class Sticks(NamedTuple):
    """What the radio sends: pulse widths [microseconds], 1000 to 2000."""

    roll: float
    pitch: float
    throttle: float
    yaw: float
    armed: bool


def state_packet(time: float, sensors: Sensors) -> bytes:
    """The state at ``time`` [s], in the firmware's axes."""
    p, q, r = sensors.body_rates
    w, x, y, z = sensors.quat_wxyz
    east, north, up = sensors.pos
    place = (east / METRES_PER_DEGREE, north / METRES_PER_DEGREE, up)
    force = (-value for value in sensors.specific_force)
    return STATE.pack(time, p, -q, -r, *force, w, x, -y, -z, *sensors.vel, *place, PRESSURE)


def radio_packet(time: float, sticks: Sticks) -> bytes:
    """The sticks at ``time`` [s], rounded and within range; channels that are not used are low."""
    widths = [round(min(max(width, LOW), HIGH)) for width in sticks[:4]]
    switches = [HIGH if sticks.armed else LOW] + [LOW] * (CHANNELS - 5)
    return RADIO.pack(time, *widths, *switches)


class Link:
    """Speaks with a firmware whose clock stands until it is told the time."""

    def __init__(self, firmware: Running, timeout: float = ANSWER_SECONDS) -> None:
        """Waits for the firmware to boot. ``timeout`` [s] is how long it may take to answer."""
        self._firmware, self._timeout, self.time = firmware, timeout, 0.0
        firmware.sockets.inbound.settimeout(timeout)
        self._motors()

    def step(self, time: float, sensors: Sensors, sticks: Sticks) -> Float[np.ndarray, "4"]:
        """Tell it the state and the sticks, let it run up to ``time`` [s], and hear what the motors shall do.

        0 to 1; front right, rear left, front left, rear right.

        Raises:
            ResourceError: it does not answer.
        """
        outbound, self.time = self._firmware.sockets.outbound, time
        outbound.sendto(radio_packet(time, sticks), (LOOPBACK, RADIO_PORT))
        outbound.sendto(state_packet(time, sensors), (LOOPBACK, STATE_PORT))
        return self._motors()

    def _motors(self) -> Float[np.ndarray, "4"]:
        try:
            packet = self._firmware.sockets.inbound.recv(256)
        except TimeoutError as error:
            raise ResourceError(
                f"firmware: no motor packet on UDP port {MOTOR_PORT} within {self._timeout:g} s at {self.time:g} s of "
                f"its clock; {self._firmware.condition()}"
            ) from error
        if len(packet) != MOTORS.size:
            raise ResourceError(
                f"firmware: a motor packet of {len(packet)} bytes on UDP port {MOTOR_PORT}, want {MOTORS.size}; does "
                "another program send there?"
            )
        return np.array(MOTORS.unpack(packet))
