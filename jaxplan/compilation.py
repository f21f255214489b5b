"""What XLA and numba compile in this process.

How many programs, so that "none after warm-up" can be measured instead of hoped for; and which ones just now, so that a
person who waits sees what for.
"""

import contextlib
import ctypes
import gc
import threading
from collections import Counter
from collections.abc import Iterator
from types import TracebackType

import jax

from jaxplan.native import specialisations

_EVENT = "/jax/core/compile/backend_compile_duration"
_BEFORE = "/jax/core/compile/jaxpr_to_mlir_module_duration"
"""Comes when a program is ready for XLA, just before it is compiled."""
_counts = {"compilations": 0, "listening": 0}


def compilations() -> int:
    """What XLA has compiled in this process since the first call of this function, and what numba has ever made ready.

    That is compiled or, for the first time in this process, loaded: neither is to happen in flight.
    """
    if not _counts["listening"]:
        _counts["listening"] = 1
        jax.monitoring.register_event_duration_secs_listener(_listen)
    return _counts["compilations"] + specialisations()


def _listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
    if event == _EVENT:
        _counts["compilations"] += 1


def give_back_memory() -> None:
    """Hand what compiling has freed back to the system: half of a process's memory, where the C library keeps it."""
    with contextlib.suppress(OSError, AttributeError):  # another C library than glibc
        ctypes.CDLL(None).malloc_trim(0)


@contextlib.contextmanager
def uncollected() -> Iterator[None]:
    """No garbage collection while things are traced and compiled, in any thread; may be nested and overlap.

    Both keep nearly all that they make: looking through it again and again takes a tenth of the time. Behind them it
    counts as old: as young it would be looked through by the first collection in flight, for 0.15 s.
    """
    with _collecting:
        if not _uncollected["depth"]:
            _uncollected["before"] = gc.isenabled()
            gc.disable()
        _uncollected["depth"] += 1
    try:
        yield
    finally:
        with _collecting:
            _uncollected["depth"] -= 1
            if not _uncollected["depth"] and _uncollected["before"]:
                _age()
                gc.enable()


def _age() -> None:
    """Move all objects to the oldest generation, unless somebody has set some aside, who would find them there."""
    if not gc.get_freeze_count():
        gc.freeze()
        gc.unfreeze()


_collecting = threading.Lock()
_uncollected = {"depth": 0, "before": 0}


class Watch:
    """A context manager that knows which programs are being compiled, and which have been, by any thread."""

    def __init__(self) -> None:
        self._begun: Counter[str] = Counter()
        self._ended: Counter[str] = Counter()
        self._seconds: dict[str, float] = {}
        self._lock = threading.Lock()

    def __enter__(self) -> "Watch":
        jax.monitoring.register_event_duration_secs_listener(self._hear)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        jax.monitoring.unregister_event_duration_listener(self._hear)

    def running(self) -> list[str]:
        """Names of the functions that are being compiled."""
        with self._lock:
            return sorted(self._begun - self._ended)

    def ended(self) -> dict[str, int]:
        """How many programs of each function have been compiled."""
        with self._lock:
            return dict(self._ended)

    def seconds(self) -> dict[str, float]:
        """How long XLA took for all programs of each function; more than the wall says where several run at once."""
        with self._lock:
            return dict(self._seconds)

    def _hear(self, event: str, duration_secs: float, **kwargs: str | int) -> None:
        name = str(kwargs.get("fun_name", "")).removeprefix("jit(").removesuffix(")")
        with self._lock:
            if event == _BEFORE:
                self._begun[name] += 1
            elif event == _EVENT:
                self._ended[name] += 1
                self._seconds[name] = self._seconds.get(name, 0.0) + duration_secs
