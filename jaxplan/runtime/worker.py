"""The planner's process: builds, warms up, and replans ten times a second until it is told to end.

It owns nothing that flies: its plans are offers, and what the pilot has not taken is taken back.
"""

import contextlib
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Mapping
from multiprocessing import parent_process
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxplan.compilation import compilations
from jaxplan.errors import InputError, JaxplanError
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.stream import ObservationStream
from jaxplan.replanner import CommittedPlan, Cycle, Measured, Replanner
from jaxplan.runtime.channel import CHANGES_KEPT, Channel
from jaxplan.runtime.memory import settle
from jaxplan.runtime.messages import (
    REPORT_BYTES,
    Answer,
    Odometry,
    cycle_as_json,
    pack_json,
    pack_plan,
    unpack_answer,
    unpack_json,
    unpack_odometry,
    unpack_sample,
)
from jaxplan.runtime.records import Build, Built, Phase, RuntimeConfig
from jaxplan.runtime.table import tabulate
from jaxplan.spline import FlatState
from jaxplan.world.update import update_world

EXIT_REFUSED = 3
"""Exit code where ``build`` raised an error of the library: to try again would not help."""
_TO_WRITE = 1e-3
"""Seconds before its takeover by which a plan is written at the latest (arbitrary: writing takes 0.1 ms)."""
_FORGOTTEN = 1.0
"""Seconds after which plans that were flown are forgotten (arbitrary)."""


class Task(NamedTuple):
    """What a process begins with."""

    build: Build
    config: RuntimeConfig
    flown: CommittedPlan
    """The newest plan that the pilot holds."""
    answer: Answer
    """Its number, and the newest that the pilot has seen."""
    changes: tuple[Mapping[str, Any], ...]
    """Of the world so far."""


def work(task: Task, block: Any) -> None:
    """What the process runs: to its end, or to an error that the last report names."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the pilot says when to end
    _end_with_parent()
    with contextlib.suppress(OSError):
        os.nice(task.config.niceness)
    channel = Channel(block)
    try:
        built = task.build()
        _warm_up(built, task.config)
    except JaxplanError as error:
        _tell(channel, Phase.FAILED, str(error), error=type(error).__name__)
        sys.exit(EXIT_REFUSED)
    except Exception as error:
        _tell(channel, Phase.FAILED, f"{type(error).__name__}: {error}")
        sys.exit(1)
    worker = Worker(built, task, channel)
    try:
        worker.run()
    except Exception as error:
        _tell(channel, Phase.FAILED, f"{type(error).__name__}: {error}")
        sys.exit(1)


class Worker:
    """One loop of predicting, planning and offering; ``tick`` is one round of it."""

    def __init__(self, built: Built, task: Task, channel: Channel) -> None:
        self.config, self.channel = task.config, channel
        self.late = self.cycles = 0
        self.reason = ""
        self._world, self._warm = built.world, compilations()
        self._stream = ObservationStream(self.config.stream)
        loop = self.config.replanning
        self._replanner = Replanner(built.planner, built.predictor, task.flown, loop, clock=time.monotonic)
        self._standing, self._last = task.answer.accepted, task.answer.seen
        """Numbers of the plan that the replanner holds as its newest, and of the last that was offered."""
        self._offered: dict[int, int] = {}
        """By the number of a plan that the pilot has not answered yet, oldest first, how many the replanner holds for
        it: a cycle may turn what is committed and replace it."""
        self._next_sample = self._next_change = 0
        for change in task.changes:
            self._change(change)

    @property
    def now(self) -> float:
        """On the clock that the pilot has set [s]."""
        return time.monotonic() - self.channel.epoch

    def run(self) -> None:
        """A round in each period, until the pilot says that it is enough."""
        self.report(Phase.WAITING)
        due = time.monotonic()
        while not self.channel.stop:
            self.tick()
            due = max(due + self.config.replanning.period, time.monotonic())
            time.sleep(max(due - time.monotonic(), 0.0))

    def tick(self) -> Cycle | None:
        """Take in what has come, plan, and offer; None while a target was never seen that nobody looks for."""
        self._hear_changes()
        self._hear_answers()
        now = self.now
        for number, message in self.channel.samples.since(self._next_sample):
            self._next_sample = number + 1
            self._stream.add(*unpack_sample(message), now)
        observations = self._stream.observe(now)
        if observations is None and not self._replanner.searches:
            self.report(Phase.WAITING)
            return None
        before = len(self._replanner.plans)
        cycle = self._replanner.step(now, observations, self._measured(now))
        added = len(self._replanner.plans) - before
        if added:
            self._offer(self._replanner.committed, added)
        if not self._offered:
            self._replanner.forget(now - _FORGOTTEN)
        self.cycles += 1
        self.report(Phase.PLANNING, cycle)
        return cycle

    def report(self, phase: Phase, cycle: Cycle | None = None) -> None:
        """Tell the pilot what is going on, and that this process is alive."""
        numbers = {"cycles": self.cycles, "late": self.late, "compilations": compilations() - self._warm}
        _tell(self.channel, phase, self.reason, cycle=None if cycle is None else cycle_as_json(cycle), **numbers)
        self.channel.beat = time.monotonic()

    def _offer(self, plan: CommittedPlan, added: int) -> None:
        """Write the newest of the ``added`` plans for the pilot; take them back where that would be too late."""
        message = pack_plan(tabulate(self._last + 1, self._standing, plan))
        if self.now + _TO_WRITE >= plan.start_time:
            self._take_back(added)
            return
        self._last = self._standing = self._last + 1
        self._offered[self._last] = added
        self.channel.plans.write(message)

    def _take_back(self, added: int) -> None:
        """The newest plans, which nobody will fly."""
        for _ in range(added):
            self._replanner.withdraw()
        self.late += 1

    def _hear_answers(self) -> None:
        """Take back what the pilot has refused, and what goes on from it."""
        message = self.channel.answers.newest()
        if message is None:
            return
        answer = unpack_answer(message)
        if any(answer.accepted < number <= answer.seen for number in self._offered):
            for number, added in self._offered.items():
                if number > answer.accepted:
                    self._take_back(added)
            self._standing, self._offered = answer.accepted, {}
        self._offered = {number: added for number, added in self._offered.items() if number > answer.accepted}

    def _measured(self, now: float) -> Measured | None:
        """The vehicle as it should be by now, from where it was a moment ago; None where that is too long ago."""
        message = self.channel.odometry.newest()
        if message is None:
            return None
        odometry = unpack_odometry(message)
        return carried_to(odometry, now, self.config.odometry_age, self._flown(odometry.time, now))

    def _flown(self, begin: float, end: float) -> FlatState | None:
        """The reference at two instants [s]; None where it jumps to the vehicle in between."""
        first, last = min(begin, end), max(begin, end)
        if any(plan.from_measured and first <= plan.start_time <= last for plan in self._replanner.plans):
            return None
        return self._replanner.reference(np.array([begin, end]))

    def _hear_changes(self) -> None:
        if self.channel.changes.written - self._next_change > CHANGES_KEPT:
            raise InputError(f"runtime: more than {CHANGES_KEPT} changes of the world have come at once")
        for number, message in self.channel.changes.since(self._next_change):
            self._next_change = number + 1
            self._change(unpack_json(message))

    def _change(self, change: Mapping[str, Any]) -> None:
        """Patch the world; a change that it refuses is reported."""
        known: dict[str, Any] = {
            name: what if name == "remove_box" else (np.array(what[0]), np.array(what[1]))
            for name, what in change.items()
        }
        try:
            changed = update_world(self._world, **known)
        except InputError as error:
            self.reason = str(error)
            return
        self._replanner.update(changed)
        self._world = changed.world


def carried_to(odometry: Odometry, now: float, oldest: float, flown: FlatState | None = None) -> Measured | None:
    """A measurement carried on to ``now`` [s]; None where it is older than ``oldest`` [s].

    What the vehicle is off its reference goes on at the acceleration that it is off; how the reference itself goes on
    is known: ``flown``, at the instant of the measurement and at ``now``. Without one it is the vehicle that goes on at
    its acceleration. The attitude stays as it was.
    """
    (position, velocity, acceleration, attitude), passed = odometry.measured, now - odometry.time
    finite = np.isfinite(position).all() and np.isfinite(velocity).all()
    if not finite or not abs(passed) <= oldest:
        return None
    before, after = np.zeros((2, 3, 3)) if flown is None else np.asarray(flown.derivatives)[:, :3]
    apart, faster = position - before[0], velocity - before[1]
    turn = np.zeros(3) if acceleration is None else acceleration - before[2]
    moved = after[0] + apart + passed * faster + 0.5 * passed**2 * turn
    return Measured(
        moved, after[1] + faster + passed * turn, None if acceleration is None else after[2] + turn, attitude
    )


def _warm_up(built: Built, config: RuntimeConfig) -> None:
    """Compile everything that a round calls."""
    built.planner.warmup(built.start)
    count = config.stream.observations
    still = np.tile(np.asarray(built.start.pos, dtype=float), (count, 1))
    built.predictor(Observations(times=config.stream.dt * np.arange(count), positions=still), 0)
    settle()


def _tell(channel: Channel, phase: Phase, reason: str, **more: Any) -> None:
    report = {"phase": phase.value, "reason": reason, "memory_mb": _memory_mb(), **more}
    channel.reports.write(pack_json(report, REPORT_BYTES))


def _memory_mb() -> float:
    """Resident memory of this process now; where only its largest is known, that."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
        return 1e-6 * pages * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        return 1e-3 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _end_with_parent() -> None:
    """No planner goes on without its pilot, however that one ended."""
    parent = parent_process()

    def wait() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
