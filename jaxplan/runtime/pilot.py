"""The pilot: answers at once what the vehicle is to do, whatever the planner's process is doing.

It holds the certified plans itself. A planner that is silent, dead or starting anew changes nothing about what is
flown: the newest plan, to rest at its end, and the hover there.
"""

import math
import threading
import time
from collections import deque
from collections.abc import Mapping
from types import TracebackType
from typing import Annotated, Any, no_type_check

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from jaxplan.errors import InputError, JaxplanError, ResourceError
from jaxplan.replanner import CommittedPlan, Cycle, Measured
from jaxplan.replanner.committed import hold
from jaxplan.replanner.measured import usual_measured
from jaxplan.runtime.channel import SAMPLES_KEPT
from jaxplan.runtime.held import HeldPlans, Setpoint
from jaxplan.runtime.messages import (
    CHANGE_BYTES,
    Odometry,
    cycle_from_json,
    pack_answer,
    pack_json,
    pack_odometry,
    pack_sample,
    unpack_plan,
)
from jaxplan.runtime.process import PlannerProcess
from jaxplan.runtime.records import Build, Phase, RuntimeConfig, RuntimeStatus
from jaxplan.runtime.worker import Task
from jaxplan.spline import FlatState
from jaxplan.status import PlanStatus
from jaxplan.validation import as_numbers
from jaxplan.world.update import Corners

PROMISED = 0.1
"""Seconds ahead of the clock up to which a setpoint that was given stays what it is."""
_LOOKS = 0.05
"""Seconds between two looks of the watchdog (arbitrary)."""
_UNASKED = 0.2
"""Seconds without a question after which the watchdog takes in plans itself (arbitrary)."""


class Runtime:
    """Plans in a process of its own, and says what is to be flown.

    ``setpoint`` never waits and always answers. All times are seconds on the clock of ``now``.
    """

    def __init__(self, build: Build, start: FlatState, config: RuntimeConfig | None = None) -> None:
        """Start the process; until it is ready the setpoint is a hover at ``start``.

        Raises:
            InputError: ``build`` cannot be sent to another process.
        """
        self.config = config or RuntimeConfig()
        self._build, self._lock = build, threading.Lock()
        self._held = HeldPlans(hold(start), self.config.remembered)
        self._epoch = time.monotonic()
        self._asked = -np.inf
        self._samples: deque[bytes] = deque(maxlen=SAMPLES_KEPT)
        self._changes: list[Mapping[str, Any]] = []
        self._cycles: deque[Cycle] = deque(maxlen=self.config.remembered)
        self._next_plan = self._next_report = 0
        self._restarts = self._in_a_row = 0
        self._why = ""
        """Of the last restart."""
        self._over: tuple[Phase, str, type[JaxplanError]] | None = None
        """How it ended, where it did."""
        self._planner = self._next_process()
        self._planner.start()
        self._watchdog = threading.Thread(target=self._watch, name="jaxplan-watchdog", daemon=True)
        self._watchdog.start()

    def __enter__(self) -> "Runtime":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def now(self) -> float:
        """Seconds on the runtime's clock, which no one can set back."""
        return time.monotonic() - self._epoch

    def setpoint(self, now: float | None = None) -> Setpoint:
        """What the vehicle is to do at ``now`` [s], by default this instant. Never waits for the planner.

        No plan changes what was said, of an instant that was at most ``PROMISED`` ahead.

        Raises:
            InputError: ``now`` is not finite.
        """
        clock = self.now()
        instant = clock if now is None else now
        if not math.isfinite(instant):
            raise InputError(f"setpoint: now is {now}, want a finite time [s]")
        self._asked = clock
        with self._lock:
            if self._planner.channel.plans.written > self._next_plan:
                self._take()
            return self._held.at(instant, clock + PROMISED)

    def preview(self, times: Float[np.ndarray, "n"]) -> FlatState:
        """What will be demanded at ``times`` [s] unless better plans come, for controllers that look ahead."""
        return self._held.preview(times)

    @no_type_check
    def observe(self, time: float, position: Annotated[ArrayLike, "3"]) -> None:
        """The target was seen at ``time`` [s] at ``position`` [m, world]. Raises ``InputError`` for other shapes."""
        message = pack_sample(_instant("observe: the time", time), _three("observe: the position", position))
        with self._lock:
            self._samples.append(message)
            self._planner.channel.samples.write(message)

    @no_type_check
    def odometry(
        self,
        time: float,
        position: Annotated[ArrayLike, "3"],
        velocity: Annotated[ArrayLike, "3"],
        acceleration: Annotated[ArrayLike, "3"] | None = None,
        attitude: Annotated[ArrayLike, "4"] | None = None,
    ) -> None:
        """The vehicle was at ``time`` [s] where its estimator says [m, m/s, m/s^2, world].

        ``attitude`` is a quaternion w x y z, body FLU to world: a vehicle that cannot hold the heading that is planned
        keeps its own where this is told. Raises ``InputError`` for what is not three finite numbers each, or four.
        """
        measured = usual_measured(Measured(position, velocity, acceleration, attitude))
        self._planner.channel.odometry.write(pack_odometry(Odometry(_instant("odometry: the time", time), measured)))

    @no_type_check
    def update_world(
        self,
        *,
        add_box: Corners | None = None,
        remove_box: int | None = None,
        occupy: Corners | None = None,
        free: Corners | None = None,
    ) -> None:
        """Tell of a change, as ``jaxplan.update_world``; the next cycle looks whether what is flown is still clear.

        A change that the planner's world refuses is named in ``status().reason``.

        Raises:
            InputError: corners that are not three finite numbers each, or none or several changes at once.
        """
        boxes = {"add_box": add_box, "occupy": occupy, "free": free}
        change: dict[str, Any] = {
            name: [_three(f"update_world: {name}", corner).tolist() for corner in corners]
            for name, corners in boxes.items()
            if corners is not None
        }
        if remove_box is not None:
            change["remove_box"] = int(_instant("update_world: remove_box", remove_box))
        if len(change) != 1:
            raise InputError(f"update_world: have {len(change)} changes, want one at a time")
        with self._lock:
            self._changes.append(change)
            self._planner.channel.changes.write(pack_json(change, CHANGE_BYTES))

    def restart_clock(self) -> None:
        """Make this instant 0. Raises ``InputError`` once something was observed or planned."""
        if self._samples or self._held.newest.head.number:
            raise InputError("runtime: the clock cannot be set any more, want it set before the first observation")
        self._epoch = self._planner.channel.epoch = time.monotonic()

    def wait_ready(self, timeout: float | None = None) -> None:
        """Wait until the planner is ready.

        Raises:
            InputError: ``build`` refused, with its message.
            ResourceError: it was not ready in ``timeout`` [s], or cannot be started.
        """
        began = time.monotonic()
        while self.status().phase in (Phase.STARTING, Phase.RESTARTING):
            if timeout is not None and time.monotonic() - began > timeout:
                raise ResourceError(f"runtime: the planner is not ready after {timeout:g} s, want more time")
            time.sleep(_LOOKS)
        if self._over is not None and self._over[0] is Phase.FAILED:
            raise self._over[2](self._over[1])

    def status(self) -> RuntimeStatus:
        """How the planner is doing. Takes some 0.1 ms."""
        planner, newest = self._planner, self._held.newest
        report, age = planner.report(), planner.silence
        phase = Phase(report.get("phase", Phase.STARTING.value))
        if self._over is not None:
            phase = self._over[0]
        elif not planner.ready:
            phase = Phase.RESTARTING if self._restarts else Phase.STARTING
        elif phase is Phase.FAILED:  # it has said so, and the watchdog has not looked yet
            phase = Phase.RESTARTING
        elif age > self.config.silent_after:
            phase = Phase.SILENT
        cycle = report.get("cycle")
        return RuntimeStatus(
            phase=phase,
            reason=self._over[1] if self._over is not None else report.get("reason", "") or self._why,
            age=age,
            plan_age=self.now() - newest.start_time,
            plan_status=PlanStatus.NOT_SET if cycle is None else PlanStatus(cycle["status"]),
            latency=np.nan if cycle is None else cycle["latency"],
            cycles=report.get("cycles", 0),
            late=report.get("late", 0),
            refused=dict(self._held.refused),
            restarts=self._restarts,
            compilations_after_warmup=report.get("compilations", 0),
            memory_mb=report.get("memory_mb", np.nan),
        )

    @property
    def plans(self) -> list[CommittedPlan]:
        """The last plans that were taken over, oldest first."""
        return self._held.plans

    @property
    def cycles(self) -> tuple[Cycle, ...]:
        """The last cycles, without their candidates, oldest first."""
        return tuple(self._cycles)

    @property
    def planner_pid(self) -> int | None:
        """Of the planner's process at present."""
        return self._planner.pid

    def close(self) -> None:
        """End the planner's process. Setpoints are answered as before, from what is held."""
        if self._over is None:
            self._over = Phase.STOPPED, "", ResourceError
        self._watchdog.join()
        self._planner.end()

    def _take(self) -> None:
        """Take in the plans that have come, and tell the planner what became of them."""
        channel = self._planner.channel
        for _, message in channel.plans.since(self._next_plan):
            self._held.offer(unpack_plan(message))
        self._next_plan = channel.plans.written
        channel.answers.write(pack_answer(self._held.answer))

    def _watch(self) -> None:
        """Look after the planner's process until all is over."""
        try:
            while self._over is None:
                time.sleep(_LOOKS)
                self._look()
        except Exception as error:
            self._over = Phase.FAILED, f"no planner can be kept: {type(error).__name__}: {error}", ResourceError

    def _look(self) -> None:
        """Hear what the planner says, and see whether it lives."""
        for number, report in self._planner.reports_since(self._next_report):
            self._next_report = number + 1
            if report.get("cycle") is not None:
                self._cycles.append(cycle_from_json(report["cycle"]))
        if self.now() - self._asked > _UNASKED:
            with self._lock:
                self._take()
        if self._planner.ready:
            self._in_a_row = 0
        trouble = self._planner.trouble(self.config)
        if trouble and self._over is None:
            self._recover(trouble)

    def _recover(self, trouble: str) -> None:
        """Start another process, unless that does not help."""
        refused = self._planner.refused
        self._planner.kill()
        if refused is not None:
            self._over = Phase.FAILED, trouble, refused
        elif self._in_a_row >= self.config.most_restarts:
            why = f"{trouble}; given up after {self._in_a_row} restarts in a row"
            self._over = Phase.FAILED, why, ResourceError
        else:
            self._why, self._restarts, self._in_a_row = trouble, self._restarts + 1, self._in_a_row + 1
            with self._lock:
                self._take()
                self._planner, self._next_plan, self._next_report = self._next_process(), 0, 0
            self._planner.start()

    def _next_process(self) -> PlannerProcess:
        """One that goes on from what is held, seen and changed so far; not started yet."""
        newest = self._held.newest
        task = Task(self._build, self.config, newest.plan, self._held.answer, tuple(self._changes))
        return PlannerProcess(task, self._epoch, self._samples)


def _instant(name: str, value: Any) -> float:
    """One number, which may be anything but none."""
    array = as_numbers(name, value)
    if array.shape != ():
        raise InputError(f"{name} is {value!r}, want one number")
    return float(array)


def _three(name: str, values: Any) -> Float[np.ndarray, "3"]:
    """Three finite numbers."""
    array = as_numbers(name, values)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(f"{name} is {values!r}, want three finite numbers")
    return np.asarray(array)
