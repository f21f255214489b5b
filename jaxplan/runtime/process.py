"""One planner's process and the memory shared with it: started, looked at, ended."""

import contextlib
import multiprocessing
import os
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from jaxplan.errors import FileError, InputError, JaxplanError, ResourceError
from jaxplan.runtime.channel import CHANNEL_BYTES, Channel
from jaxplan.runtime.messages import unpack_json
from jaxplan.runtime.records import RuntimeConfig
from jaxplan.runtime.worker import EXIT_REFUSED, Task, work

_TO_END = 2.0
"""Seconds that a process is given to end by itself (arbitrary)."""


class PlannerProcess:
    """Spawned, never forked: a fork hangs once JAX has started its threads."""

    def __init__(self, task: Task, epoch: float, samples: Iterable[bytes]) -> None:
        """``samples`` of the target are there from the beginning."""
        context = multiprocessing.get_context("spawn")
        block = context.RawArray("B", CHANNEL_BYTES)
        self.channel = Channel(block)
        self.channel.epoch = epoch
        for sample in samples:
            self.channel.samples.write(sample)
        self._process = context.Process(target=work, args=(task, block), name="jaxplan-planner", daemon=True)
        self._began = time.monotonic()

    def start(self) -> None:
        """Returns at once. Whoever asks keeps its real-time priority, where it has one; the process gets none.

        Raises ``InputError`` where ``build`` cannot be sent, ``ResourceError`` for no process.
        """
        self._began = time.monotonic()
        try:
            with ThreadPoolExecutor(1, initializer=_keep_priority) as starter:
                starter.submit(self._process.start).result()
        except OSError as error:
            raise ResourceError(f"runtime: no process can be started: {error}") from error
        except Exception as error:  # whatever pickling meets
            raise InputError(
                f"runtime: build cannot be sent to another process ({error}); want a function at the top of a module"
            ) from error

    @property
    def pid(self) -> int | None:
        """Of the process; None before it is started."""
        return self._process.pid

    @property
    def ready(self) -> bool:
        """Whether it has given a sign of life after its warm-up."""
        return self.channel.beat > 0.0

    @property
    def silence(self) -> float:
        """Seconds since its last sign of life; infinite before the first."""
        beat = self.channel.beat
        return time.monotonic() - beat if beat > 0.0 else np.inf

    @property
    def refused(self) -> type[JaxplanError] | None:
        """The kind of error with which ``build`` said that it will never work; None where it did not."""
        if self._process.pid is None or self._process.exitcode != EXIT_REFUSED:
            return None
        kinds = {kind.__name__: kind for kind in (InputError, FileError, ResourceError)}
        return kinds.get(self.report().get("error", ""), InputError)

    def report(self) -> dict[str, Any]:
        """What it has said last; empty before it has said anything."""
        newest = self.channel.reports.newest()
        return {} if newest is None else unpack_json(newest)

    def reports_since(self, number: int) -> Iterator[tuple[int, dict[str, Any]]]:
        """What it has said from report ``number`` on, as far as that is still there."""
        for each, message in self.channel.reports.since(number):
            yield each, unpack_json(message)

    def trouble(self, config: RuntimeConfig) -> str:
        """Why another process is wanted; empty where none is."""
        if self._process.exitcode is not None:
            reason = self.report().get("reason", "")
            if self.refused is not None:
                return reason
            return f"the planner's process ended with code {self._process.exitcode}" + (reason and f": {reason}")
        waited = time.monotonic() - self._began
        if not self.ready and waited > config.start_within:
            return f"the planner is not ready after {waited:.0f} s"
        if self.ready and self.silence > config.restart_after:
            return f"nothing was heard of the planner for {self.silence:.1f} s"
        return ""

    def end(self) -> None:
        """Let it end by itself, and kill it where it does not."""
        self.channel.stop = True
        if self._process.pid is not None:
            self._process.join(_TO_END)
        self.kill()

    def kill(self) -> None:
        """At once."""
        if self._process.pid is not None and self._process.is_alive():
            self._process.kill()
            self._process.join()


def _keep_priority() -> None:
    """Let no process that this thread starts have its real-time priority (Linux: ``sched(7)``)."""
    if hasattr(os, "SCHED_RESET_ON_FORK"):
        policy = os.sched_getscheduler(0)
        if policy in (os.SCHED_FIFO, os.SCHED_RR):
            with contextlib.suppress(OSError):
                os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, os.sched_getparam(0))
