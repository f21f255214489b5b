"""What tests of the MAVLink streamer share."""

import socket

import numpy as np

from jaxplan.mavlink import Endpoint, Phase, PlannedFlight, StreamConfig, Streamer
from jaxplan.runtime import Setpoint
from jaxplan.spline import PiecewisePolynomial
from oracles.fake_autopilot import FakeAutopilot

ORIGIN = (1.0, 2.0, 0.0)
"""The vehicle begins below the start of ``straight``."""


def straight() -> PiecewisePolynomial:
    """A metre to the east and back to rest, turning a little: degree 7 and 5, by their closed forms."""
    position, yaw = np.zeros((1, 10, 3)), np.zeros((1, 6))
    position[0, 0], position[0, 4:8, 0] = [1.0, 2.0, 1.5], [35.0, -84.0, 70.0, -20.0]
    yaw[0, 3:6] = 0.5 * np.array([10.0, -15.0, 6.0])
    return PiecewisePolynomial(durations=np.array([1.5]), position=position, yaw=yaw)


def free_port() -> int:
    """Of UDP, on this machine, a moment ago."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Recorded(PlannedFlight):
    """Remembers what it said."""

    def __init__(self) -> None:
        super().__init__(straight())
        self.said: list[Setpoint] = []
        self.told: list[tuple] = []

    def setpoint(self, now: float) -> Setpoint:
        self.said.append(super().setpoint(now))
        return self.said[-1]

    def tell(self, now: float, vehicle, target) -> None:
        self.told.append((now, vehicle, target))


class Together:
    """A streamer and an autopilot, with one clock for both."""

    def __init__(self, kind: int = 12, listening: bool = True, **config: object) -> None:
        self.now, self.events = 100.0, []
        self.flight = Recorded()
        if listening:
            self.link = Endpoint(f"udpin:127.0.0.1:{free_port()}")
            self.autopilot = FakeAutopilot(self.link.port, kind)
        else:
            self.autopilot = FakeAutopilot(None, kind)
            self.link = Endpoint(f"udpout:127.0.0.1:{self.autopilot.port}")
        self.config = StreamConfig(**{"origin": ORIGIN, "hold": 1.0, **config})
        self.streamer = self.streaming()

    def streaming(self, **more: object) -> Streamer:
        tell = lambda seconds, text: self.events.append((seconds, text))  # noqa: E731
        return Streamer(self.link, self.flight, self.config, tell=tell, clock=lambda: self.now, **more)

    def pass_time(self, seconds: float, step: float = 0.005) -> None:
        for _ in range(round(seconds / step)):
            self.now += step
            self.autopilot.step(self.now)
            self.streamer.step()

    def until(self, *phases: Phase, within: float = 20.0) -> None:
        begun = self.now
        while self.streamer.phase not in phases:
            assert self.now < begun + within, (self.streamer.phase, self.events)
            self.pass_time(0.01)

    @property
    def phases(self) -> list[str]:
        return [text for _, text in self.events if text in {phase.value for phase in Phase}]

    def close(self) -> None:
        self.link.close()
        self.autopilot.close()
