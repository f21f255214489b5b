"""An autopilot as far as a stream of setpoints sees one: real UDP, modes and failsafe as PX4's documentation has them.

It obeys only who has streamed for a second at more than 2 Hz, gives up after a second of silence, and goes where it is
told at 3 m/s at most. ``step`` does what is due; ``Running`` steps it in real time in a thread.
"""

import socket
import threading
import time
from types import TracebackType
from typing import Any

import numpy as np

from oracles.mavlink_wire import Message, decode, encode

PX4, ARDUPILOT = 12, 3
OFFBOARD, HOLD, GUIDED, LOITER = 6 << 16, (4 << 16) | (3 << 24), 4, 5
SET_MODE, ARM, REQUEST_MESSAGE = 176, 400, 512
ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED = 0, 1, 2, 3
GIVES_UP = 1.0
"""s; PX4's COM_OF_LOSS_T."""
SPEED = 3.0
"""m/s"""


class FakeAutopilot:
    """Speaks from a port of its own; ``peer`` is whom it speaks to, or None to wait for who speaks first."""

    def __init__(self, peer: int | None = None, kind: int = PX4, system: int = 1) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.peer = None if peer is None else ("127.0.0.1", peer)
        self.kind, self.system, self.sequence = kind, system, 0
        self.mode, self.armed = (HOLD if kind == PX4 else LOITER), False
        self.position, self.velocity = np.zeros(3), np.zeros(3)
        self.origin: dict[str, int] | None = None
        self.refuses = False
        self.mute = self.deaf = self.lost = False
        """Whether it says nothing, hears nothing, and does not know where it is."""
        self.speaks_odometry: int | None = None
        """The frame in which it says where it is, by ODOMETRY, instead of LOCAL_POSITION_NED."""
        self.heard: list[tuple[float, Message]] = []
        self.setpoints: list[tuple[float, dict[str, Any]]] = []
        self.undecoded = 0
        self._last, self._next_heartbeat, self._next_position = 0.0, 0.0, 0.0

    @property
    def port(self) -> int:
        return int(self.socket.getsockname()[1])

    @property
    def obeys(self) -> bool:
        return self.armed and self.mode == (OFFBOARD if self.kind == PX4 else GUIDED)

    def engage(self, now: float) -> None:
        """What a person does with a transmitter."""
        assert self.streamed(now), "PX4 refuses the mode without a stream"
        self.mode, self.armed = (OFFBOARD if self.kind == PX4 else GUIDED), True

    def streamed(self, now: float) -> bool:
        """Whether setpoints have come at more than 2 Hz for a second."""
        times = [time for time, _ in self.setpoints[-1000:] if time > now - 1.2]
        return bool(times) and times[0] < now - 1.0 and float(np.diff([*times, now]).max()) < 0.5

    def step(self, now: float) -> None:
        self._receive(now)
        self._move(now)
        silent = now - (self.setpoints[-1][0] if self.setpoints else -np.inf)
        if self.obeys and silent > GIVES_UP:
            self.mode = HOLD if self.kind == PX4 else LOITER
        if now >= self._next_heartbeat:
            self._next_heartbeat = now + 0.2
            base = 1 | 128 * self.armed
            self.send("HEARTBEAT", type=2, autopilot=self.kind, base_mode=base, custom_mode=self.mode, system_status=4)
        if now >= self._next_position and not self.lost:
            self._next_position = now + 0.02
            self._say_where(now)

    def send(self, name: str, **fields: Any) -> None:
        if self.peer is not None and not self.mute:
            self.socket.sendto(encode(name, self.system, 1, self.sequence, **fields), self.peer)
            self.sequence += 1

    def close(self) -> None:
        self.socket.close()

    def _say_where(self, now: float) -> None:
        place = dict(zip("xyz", self.position.tolist(), strict=True))
        moving = dict(zip(("vx", "vy", "vz"), self.velocity.tolist(), strict=True))
        if self.speaks_odometry is None:
            self.send("LOCAL_POSITION_NED", time_boot_ms=int(1e3 * now), **place, **moving)
        else:
            frames = {"frame_id": self.speaks_odometry, "child_frame_id": 12, "q": [1.0, 0.0, 0.0, 0.0]}
            self.send("ODOMETRY", time_usec=int(1e6 * now), **frames, **place, **moving)

    def _receive(self, now: float) -> None:
        while True:
            try:
                content, sender = self.socket.recvfrom(65_535)
            except BlockingIOError:
                return
            if self.deaf:
                continue
            self.peer = self.peer or sender
            try:
                message = decode(content)
            except (AssertionError, KeyError):
                self.undecoded += 1
                continue
            self.heard.append((now, message))
            if message.name == "SET_POSITION_TARGET_LOCAL_NED":
                self.setpoints.append((now, message.fields))
            if message.name == "COMMAND_LONG":
                self._command(message.fields, now)

    def _command(self, fields: dict[str, Any], now: float) -> None:
        command, result = fields["command"], ACCEPTED
        if self.refuses:
            result = DENIED
        elif command == SET_MODE:
            wanted = (int(fields["param2"]) << 16) | (int(fields["param3"]) << 24)
            wanted = wanted if self.kind == PX4 else int(fields["param2"])
            if wanted in (OFFBOARD, GUIDED) and not self.streamed(now):
                result = TEMPORARILY_REJECTED
            else:
                self.mode = wanted
        elif command == ARM:
            self.armed = fields["param1"] == 1.0
        elif command == REQUEST_MESSAGE and self.origin is not None and fields["param1"] == 49:
            self.send("GPS_GLOBAL_ORIGIN", **self.origin)
        else:
            result = UNSUPPORTED
        self.send("COMMAND_ACK", command=command, result=result)

    def _move(self, now: float) -> None:
        passed, self._last = now - self._last, now
        if not self.obeys or not self.setpoints:
            self.velocity = np.zeros(3)
            return
        fields = self.setpoints[-1][1]
        there = np.array([fields[axis] for axis in "xyz"]) - self.position
        apart = float(np.linalg.norm(there))
        far = apart > 0.5
        self.position = self.position + there * (min(SPEED * passed / apart, 1.0) if far else 1.0)
        moving = np.array([fields[axis] for axis in ("vx", "vy", "vz")])
        self.velocity = SPEED * there / apart if far else moving


class Running:
    """Steps it a hundred times a second, in real time."""

    def __init__(self, autopilot: FakeAutopilot) -> None:
        self.autopilot, self._over = autopilot, threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> FakeAutopilot:
        self._thread.start()
        return self.autopilot

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()
        self.autopilot.close()

    def _run(self) -> None:
        while not self._over.wait(0.01):
            self.autopilot.step(time.monotonic())
