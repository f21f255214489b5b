"""What a streamer is told, what it is doing, and what came of it."""

import dataclasses
import enum
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from jaxplan.validation import as_finite, checks_itself, require_positive, require_within


class Phase(enum.Enum):
    """What the streamer is doing."""

    CONNECTING = "connecting"
    """No autopilot was heard yet; nothing but a heartbeat is sent."""
    READY = "ready"
    """The hover at the start is streamed; the autopilot does not obey it yet."""
    APPROACHING = "approaching"
    """It obeys, and flies to the start."""
    FLYING = "flying"
    """The flight is streamed."""
    HOLDING = "holding"
    """The flight is over, its end is streamed."""
    DONE = "done"
    """It was held for as long as it was to be, or until somebody took over."""
    RELEASED = "released"
    """The autopilot obeys no longer: a person took over, or a failsafe. It is not asked again."""


@checks_itself
@dataclasses.dataclass(frozen=True)
class StreamConfig:
    """How setpoints are streamed, and what is waited for."""

    rate: float = 50.0
    """Setpoints a second."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the origin of the autopilot's local frame stands: X Y Z [m, world]."""
    engage: bool = False
    """Ask the autopilot to obey (OFFBOARD, GUIDED) and to arm; otherwise a person does."""
    hold: float = 10.0
    """Seconds for which the end of the flight is streamed."""
    farthest: float = 5.0
    """Farther [m] than this from the start, the vehicle is not called there."""
    patience: float = 30.0
    """Seconds of silence, or on the way to the start, after which it is given up."""
    system: int = 245
    """This program's MAVLink system."""

    def __post_init__(self) -> None:
        require_within("--rate", self, 4.0, 500.0, "rate")
        require_positive("stream", self, "hold", "farthest", "patience")
        require_within("stream", self, 1, 255, "system")
        as_finite("--origin", self.origin, (3,))


class StreamReport(NamedTuple):
    """What came of a stream."""

    phase: Phase
    reason: str
    """Why it ended, where the phase does not say it."""
    sent: int
    """Setpoints."""
    lost: int
    """Setpoints that the network did not take."""
    gaps: np.ndarray
    """Seconds from each setpoint to the next."""
    off: np.ndarray
    """Metres from the setpoint to where the vehicle said it was, in flight."""
    damaged: int
    """Frames that could not be read."""


@runtime_checkable
class Tell(Protocol):
    """Told what happens."""

    def __call__(self, seconds: float, text: str, /) -> None:
        """``seconds`` after the start, in a few words."""


def tell_nobody(seconds: float, text: str, /) -> None:
    """Events that nobody asked for."""
