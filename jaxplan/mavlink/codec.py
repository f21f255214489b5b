"""MAVLink 2 to and from bytes, by pymavlink (extra ``mavlink``), which is imported when it is needed."""

from typing import Any

from jaxplan.errors import ResourceError
from jaxplan.mavlink.frames import NedSetpoint

LOCAL_NED = 1
"""MAV_FRAME_LOCAL_NED: metres from the autopilot's origin."""
BODY_FRAMES = (8, 12)
"""MAV_FRAME_BODY_NED and MAV_FRAME_BODY_FRD."""
SET_MODE, ARM, REQUEST_MESSAGE = 176, 400, 512
"""Commands: MAV_CMD_DO_SET_MODE, MAV_CMD_COMPONENT_ARM_DISARM, MAV_CMD_REQUEST_MESSAGE."""
GPS_GLOBAL_ORIGIN = 49
"""The message that says where on the globe the autopilot's origin is."""
_ONBOARD, _NO_AUTOPILOT, _ACTIVE = 18, 8, 4
"""MAV_TYPE_ONBOARD_CONTROLLER, MAV_AUTOPILOT_INVALID, MAV_STATE_ACTIVE."""
_V1, _V2 = 0xFE, 0xFD
_SIGNED = 1
_WRAP = 2**32


class Codec:
    """Encodes as one system, decodes from all."""

    def __init__(self, system: int, component: int) -> None:
        """Raises ``ResourceError`` where pymavlink is not installed."""
        try:
            from pymavlink.dialects.v20 import common
        except ImportError as error:
            raise ResourceError(
                "streaming needs pymavlink, which is not installed; pip install 'jaxplan[mavlink]'"
            ) from error
        self._mav = common.MAVLink(None, srcSystem=system, srcComponent=component)
        self._error = common.MAVError
        self.damaged = 0
        """Frames that were none, or were damaged."""

    def heartbeat(self) -> bytes:
        """That a companion computer is there."""
        return self._packed(self._mav.heartbeat_encode(_ONBOARD, _NO_AUTOPILOT, 0, 0, _ACTIVE))

    def setpoint(self, seconds: float, system: int, component: int, target: NedSetpoint) -> bytes:
        """SET_POSITION_TARGET_LOCAL_NED with nothing left out (type mask 0), ``seconds`` after the start."""
        return self._packed(
            self._mav.set_position_target_local_ned_encode(
                int(1e3 * seconds) % _WRAP,
                system,
                component,
                LOCAL_NED,
                0,
                *target.position.tolist(),
                *target.velocity.tolist(),
                *target.acceleration.tolist(),
                target.yaw,
                target.yaw_rate,
            )
        )

    def command(self, system: int, component: int, command: int, *parameters: float) -> bytes:
        """COMMAND_LONG; parameters that are not given are 0."""
        padded = [*map(float, parameters), *[0.0] * (7 - len(parameters))]
        return self._packed(self._mav.command_long_encode(system, component, command, 0, *padded))

    def decode(self, datagram: bytes) -> list[Any]:
        """The messages of a datagram; what is damaged is counted and left out."""
        found, rest = [], memoryview(datagram)
        while len(rest) > 2:
            length = _frame_length(rest)
            if length == 0 or length > len(rest):
                self.damaged += 1
                break
            try:
                found.append(self._mav.decode(bytearray(rest[:length])))
            except (self._error, ValueError, IndexError, UnicodeError):
                self.damaged += 1
            rest = rest[length:]
        return found

    def _packed(self, message: Any) -> bytes:
        content = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return content


def _frame_length(content: memoryview) -> int:
    """Of the frame at the beginning; 0 where there is none."""
    if content[0] == _V1:
        return 8 + content[1]
    if content[0] == _V2:
        return 12 + content[1] + 13 * bool(content[2] & _SIGNED)
    return 0
