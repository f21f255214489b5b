"""The memory that a pilot shares with one planner's process: six rings and three words."""

from typing import Any

from jaxplan.runtime.messages import (
    ANSWER_BYTES,
    CHANGE_BYTES,
    ODOMETRY_BYTES,
    PLAN_BYTES,
    REPORT_BYTES,
    SAMPLE_BYTES,
)
from jaxplan.runtime.ring import Ring, ring_bytes

_RINGS = {
    "plans": (8, PLAN_BYTES),
    "reports": (64, REPORT_BYTES),
    "answers": (4, ANSWER_BYTES),
    "samples": (512, SAMPLE_BYTES),
    "odometry": (8, ODOMETRY_BYTES),
    "changes": (64, CHANGE_BYTES),
}
"""How many messages of how many bytes are kept."""
SAMPLES_KEPT = _RINGS["samples"][0]
CHANGES_KEPT = _RINGS["changes"][0]
_WORDS = ("epoch", "beat", "stop")
CHANNEL_BYTES = 8 * len(_WORDS) + sum(ring_bytes(*shape) for shape in _RINGS.values())


class Channel:
    """Rings in both directions over one block of memory, zeros at first, which both processes map."""

    plans: Ring
    """Planner to pilot: ``NumberedPlan``."""
    reports: Ring
    """Planner to pilot: what it is doing, as JSON."""
    answers: Ring
    """Pilot to planner: ``Answer``."""
    samples: Ring
    """Pilot to planner: where the target was seen."""
    odometry: Ring
    """Pilot to planner: where the vehicle is."""
    changes: Ring
    """Pilot to planner: what changes in the world, as JSON."""

    def __init__(self, block: Any) -> None:
        """``block`` is a ``multiprocessing`` ``RawArray`` of ``CHANNEL_BYTES`` bytes."""
        memory = memoryview(block).cast("B")
        self._words = memory[: 8 * len(_WORDS)].cast("d")
        place = 8 * len(_WORDS)
        for name, shape in _RINGS.items():
            size = ring_bytes(*shape)
            setattr(self, name, Ring(memory[place : place + size], *shape))
            place += size

    @property
    def epoch(self) -> float:
        """The instant of ``time.monotonic`` that is 0 on the clock of both [s]."""
        return self._words[0]

    @epoch.setter
    def epoch(self, value: float) -> None:
        self._words[0] = value

    @property
    def beat(self) -> float:
        """The instant of ``time.monotonic`` at which the planner was last alive [s]; 0 before it was ready."""
        return self._words[1]

    @beat.setter
    def beat(self, value: float) -> None:
        self._words[1] = value

    @property
    def stop(self) -> bool:
        """Whether the planner is to end."""
        return self._words[2] != 0.0

    @stop.setter
    def stop(self, value: bool) -> None:
        self._words[2] = float(value)
