"""The planner in a process of its own, in real time: how long setpoints take, what comes late, what a kill does.

python -m benchmarks.bench_runtime [--seconds 30] [--kills 3] [--world env1] [--planner mfrl] [--json FILE]

A vehicle that is exactly where it is to be chases a target that flies to and fro, seen ten times a second; setpoints
are asked for 200 times a second. ``kills`` of the planner's process come in flight, each when it plans again. Every
miss is counted once more by what most of its time went by with (Linux), see ``CAUSES``.
"""

import argparse
import os
import resource
import signal
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.config import InterceptConfig
from jaxplan.io.targets import Target, load_target
from jaxplan.runtime import Phase, Runtime, Setpoint, from_config, settle
from jaxplan.spline import hover
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.load import load_world

from . import _harness

PERIOD = 0.005
"""Seconds from one setpoint to the next; an answer that takes longer has missed one."""
CYCLE = 20
"""Setpoints from one observation to the next."""
CAUSES = ("computing", "without_processor", "asleep", "stood_still")
"""Computing; ready to run, and no processor free; waiting for a lock, another thread or a page from the disk; and none
of these: the thread had its processor, which did not run, as the machine (a virtual one) or an interrupt had it."""
_ACCOUNTS = "/proc/thread-self/schedstat"
"""Nanoseconds of this thread on a processor and waiting for one (Linux)."""


class Clocks(NamedTuple):
    """Of the thread that asks [s], and how often it gave its processor up."""

    wall: float
    computed: float
    ready: float
    """For a processor."""
    pauses: int

    def cause(self, before: "Clocks") -> str:
        """What most of the time since ``before`` went by with."""
        wall, computed, ready = (now - then for now, then in zip(self[:3], before[:3], strict=True))
        rest = wall - computed - ready
        shares = computed, ready, rest if self.pauses > before.pauses else 0.0, rest
        return CAUSES[int(np.argmax(shares))]


class Chase:
    """Asks for setpoints and remembers how long they took, and whether they jump or come too near to anything."""

    def __init__(self, runtime: Runtime, target: Target, world: str) -> None:
        self.runtime, self.target, self._world = runtime, target, load_world(world)
        self.took: list[float] = []
        """Seconds until each setpoint was there."""
        self.missed: list[str] = []
        """The cause of each that took longer than a period."""
        self.skipped = 0
        """Setpoints that were not asked for, because the clock woke this process too late."""
        self.jump, self.clearance = 0.0, np.inf
        self._last: Setpoint | None = None
        self._near: list[Float[np.ndarray, "3"]] = []
        self._accounts = os.open(_ACCOUNTS, os.O_RDONLY) if os.path.exists(_ACCOUNTS) else None

    def fly(self, until: Callable[[], bool]) -> None:
        """Until it is true."""
        begun, step = self.runtime.now(), 0
        while not until():
            now = self.runtime.now()
            if step % CYCLE == 0:
                self.runtime.observe(now, self._seen(now))
            before = self._clocks()
            setpoint = self.runtime.setpoint(now)
            self._note(before, self._clocks())
            self.runtime.odometry(now, setpoint.position, setpoint.velocity, setpoint.acceleration)
            self._look(setpoint)
            due = int((self.runtime.now() - begun) / PERIOD)
            self.skipped += max(due - step - 1, 0)
            step = max(step + 1, due)
            time.sleep(max(begun + step * PERIOD - self.runtime.now(), 0.0))

    def _clocks(self) -> Clocks:
        if self._accounts is None:
            return Clocks(time.perf_counter(), time.thread_time(), 0.0, 0)
        ready = 1e-9 * int(os.pread(self._accounts, 64, 0).split()[1])
        pauses = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
        return Clocks(time.perf_counter(), time.thread_time(), ready, pauses)

    def _note(self, before: Clocks, after: Clocks) -> None:
        self.took.append(after.wall - before.wall)
        if self.took[-1] > PERIOD:
            self.missed.append(after.cause(before))
            print(f"missed, {self.missed[-1]}: {before} to {after}", flush=True)

    def _seen(self, now: float) -> Float[np.ndarray, "3"]:
        """To the end of its trajectory, and back."""
        there = now % (2.0 * self.target.duration)
        return self.target.position(np.array([min(there, 2.0 * self.target.duration - there)]))[0]

    def _look(self, setpoint: Setpoint) -> None:
        if self._last is not None:
            speed = max(np.linalg.norm(setpoint.velocity), np.linalg.norm(self._last.velocity))
            apart = np.linalg.norm(setpoint.position - self._last.position)
            self.jump = max(self.jump, float(apart - speed * (setpoint.time - self._last.time)))
        self._last = setpoint
        self._near.append(setpoint.position)
        if len(self._near) == 200:
            self.clearance = min(self.clearance, float(host_free_distance(self._world, np.array(self._near)).min()))
            self._near = []


def measure(seconds: float, kills: int, world: str, planner: Any, seed: int = 0) -> list[dict[str, Any]]:
    """A row for the undisturbed chase, and one for the kills."""
    target = load_target(None, world=world, speed=None)
    config = InterceptConfig(world=world, predictor="constant-velocity", planner=planner)
    rng = np.random.default_rng(seed)
    with Runtime(from_config(config), hover(np.asarray(load_world(world).start))) as runtime:
        began = time.monotonic()
        runtime.wait_ready()
        settle()
        ready = time.monotonic() - began
        chase = Chase(runtime, target, world)
        _fly_for(chase, 5.0)
        memory = runtime.status().memory_mb
        chase.took, chase.missed, chase.skipped = [], [], 0
        _fly_for(chase, seconds)
        rows = [_row("undisturbed", chase, ready_s=ready, memory_growth_mb=runtime.status().memory_mb - memory)]
        for k in range(kills):
            _fly_for(chase, rng.uniform(0.5, 3.0))
            speed = float(np.linalg.norm(runtime.setpoint().velocity))
            os.kill(runtime.planner_pid or 0, signal.SIGKILL)
            chase.fly(lambda count=k + 1: runtime.status().restarts == count)
            chase.fly(lambda: runtime.status().phase in (Phase.PLANNING, Phase.FAILED))
            print(f"kill {k + 1} at {speed:.1f} m/s: {runtime.status().phase.value}", flush=True)
        if kills:
            row = _row("killed", chase, kills=kills, restarts=runtime.status().restarts)
            rows.append(row | {"recovered": runtime.status().phase is Phase.PLANNING})
        return rows


def _fly_for(chase: Chase, seconds: float) -> None:
    end = chase.runtime.now() + seconds
    chase.fly(lambda: chase.runtime.now() >= end)


def _row(what: str, chase: Chase, **more: Any) -> dict[str, Any]:
    status, took = chase.runtime.status(), 1e6 * np.array(chase.took)
    radius = np.asarray(load_vehicle().radius).item()
    return {
        "what": what,
        "setpoints": len(took),
        "missed": len(chase.missed),
        **{f"missed_{cause}": chase.missed.count(cause) for cause in CAUSES},
        "skipped": chase.skipped,
        "setpoint_p50_us": float(np.median(took)),
        "setpoint_p99_us": float(np.quantile(took, 0.99)),
        "setpoint_max_us": float(took.max()),
        "setpoint_again_us": _again(chase.runtime),
        "cycles": status.cycles,
        "late": status.late,
        "refused": sum(status.refused.values()),
        "compilations": status.compilations_after_warmup,
        "largest_jump_m": chase.jump,
        "clearance_beyond_radius_m": chase.clearance - radius,
        **more,
    }


def _again(runtime: Runtime, calls: int = 2000) -> float:
    """What one takes after another, in the median, where nothing else has filled the caches [microseconds]."""
    took = []
    for _ in range(calls):
        asked = time.perf_counter()
        runtime.setpoint()
        took.append(time.perf_counter() - asked)
    return 1e6 * float(np.median(took))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--kills", type=int, default=3)
    parser.add_argument("--world", default="env1")
    parser.add_argument("--planner", default="mfrl")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(arguments)
    rows = measure(options.seconds, options.kills, options.world, options.planner)
    _harness.show(rows)
    if options.json:
        _harness.write(options.json, rows)


if __name__ == "__main__":
    main()
