"""A stream of setpoints over loopback: how even it is, and whether all of it arrives as it was said.

python -m benchmarks.bench_mavlink [--seconds 30] [--rate 50] [--json FILE]

Another process plays the autopilot as far as a stream needs one: a heartbeat in the mode that obeys, and a vehicle at
the start. It notes when each datagram comes; afterwards pymavlink decodes them.
"""

import argparse
import multiprocessing
import select
import socket
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxplan.mavlink import Endpoint, PlannedFlight, StreamConfig, Streamer, stated
from jaxplan.mavlink.codec import Codec
from jaxplan.mavlink.frames import to_ned
from jaxplan.runtime import Setpoint
from jaxplan.spline import PiecewisePolynomial

from . import _harness

FIELDS = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
LEG = 2.0
"""Seconds from one end to the other."""


class Remembered(PlannedFlight):
    """Remembers what it said."""

    def __init__(self, spline: PiecewisePolynomial) -> None:
        super().__init__(spline)
        self.said: list[Setpoint] = []

    def setpoint(self, now: float) -> Setpoint:
        """The last one may be one that was only looked at."""
        found = super().setpoint(now)
        self.said.append(found)
        return found


def to_and_fro(seconds: float) -> PiecewisePolynomial:
    """Four metres east and back, from rest to rest, and half a turn."""
    legs = max(round(seconds / LEG), 1)
    position, yaw = np.zeros((legs, 10, 3)), np.zeros((legs, 6))
    for leg in range(legs):
        there = 1.0 if leg % 2 == 0 else -1.0
        position[leg, 0], yaw[leg, 0] = [2.0 - 2.0 * there, 0.0, 1.5], 0.75 * (1.0 - there)
        position[leg, 4:8, 0] = 4.0 * there * np.array([35.0, -84.0, 70.0, -20.0])
        yaw[leg, 3:6] = 1.5 * there * np.array([10.0, -15.0, 6.0])
    return PiecewisePolynomial(durations=np.full(legs, LEG), position=position, yaw=yaw)


def play_autopilot(peer: int, start: Float[np.ndarray, "3"], pipe: Connection) -> None:
    """Until something comes through the pipe; then what was heard goes back through it."""
    from pymavlink.dialects.v20 import common

    mavlink = common.MAVLink(None, srcSystem=1, srcComponent=1)
    x, y, z = start.tolist()
    heard, next_words = [], 0.0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        while not pipe.poll():
            if time.monotonic() >= next_words:
                next_words = time.monotonic() + 0.1
                for message in (
                    mavlink.heartbeat_encode(2, 12, 129, 6 << 16, 4),
                    mavlink.local_position_ned_encode(0, y, x, -z, 0.0, 0.0, 0.0),
                ):
                    link.sendto(message.pack(mavlink), ("127.0.0.1", peer))
            if select.select([link], [], [], 0.02)[0]:
                heard.append((time.monotonic(), link.recv(65_535)))
    pipe.send(heard)


def measure(seconds: float, rate: float) -> list[dict[str, Any]]:
    """One row: what was sent, what came, and the gaps at both ends [ms]."""
    flight = Remembered(to_and_fro(seconds))
    ours, theirs = multiprocessing.Pipe()
    spawn = multiprocessing.get_context("spawn")
    with Endpoint("udpin:127.0.0.1:14940") as link:
        start = np.asarray(flight.setpoint(0.0).position)
        other = spawn.Process(target=play_autopilot, args=(link.port, start, theirs), daemon=True)
        other.start()
        report = Streamer(link, flight, StreamConfig(rate=rate, hold=0.5)).run()
        time.sleep(0.2)
        ours.send("over")
        heard = ours.recv()
        other.join()
    codec = Codec(245, 191)
    decoded = [(at, message) for at, content in heard for message in codec.decode(content)]
    arrivals = np.array([at for at, m in decoded if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"])
    came = {tuple(getattr(m, field) for field in FIELDS) for _, m in decoded if hasattr(m, "type_mask")}
    said = {_single(setpoint) for setpoint in flight.said}
    gaps = {f"arrival_gap_p{q}_ms": 1e3 * float(np.percentile(np.diff(arrivals), q)) for q in (50, 99, 100)}
    shares = {"decoded": len(decoded) / len(heard), "exact": len(came & said) / len(came)}
    sent = {name: value for name, value in stated(report).items() if not name.startswith("off")}  # it does not fly
    return [{"rate_hz": rate, **sent, "came": len(arrivals), **shares, **gaps}]


def _single(setpoint: Setpoint) -> tuple[float, ...]:
    """What is said of a setpoint, in single precision."""
    target = to_ned(setpoint, np.zeros(3))
    rows = [*target.position, *target.velocity, *target.acceleration, target.yaw, target.yaw_rate]
    return tuple(np.float32(rows).astype(float).tolist())


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--rate", type=float, default=50.0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(arguments)
    rows = measure(options.seconds, options.rate)
    _harness.show(rows)
    if options.json:
        _harness.write(options.json, rows)


if __name__ == "__main__":
    main()
