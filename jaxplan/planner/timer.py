"""How a replan measures itself."""

import math
import time
from typing import Any, Protocol, runtime_checkable

import jax


@runtime_checkable
class Clock(Protocol):
    """Says how late it is."""

    def __call__(self) -> float:
        """Seconds from some instant on."""


class Timer:
    """Wall time of the stations [ms]; waits for compiled results, so that each station pays for itself."""

    def __init__(self, clock: Clock = time.perf_counter, budget: float = math.inf) -> None:
        """``budget`` [ms]: beyond it nothing is begun that can be left out."""
        self.stages: dict[str, float] = {}
        self._budget = budget
        self._clock = clock
        self._last = clock()

    @property
    def total(self) -> float:
        """All laps together [ms]."""
        return sum(self.stages.values())

    @property
    def is_up(self) -> bool:
        """Whether the budget is used up."""
        return self.total > self._budget

    def lap(self, stage: str, result: Any = None) -> None:
        """Add the time since the last lap to ``stage``, once ``result`` has been computed."""
        jax.block_until_ready(result)
        now = self._clock()
        self.stages[stage] = self.stages.get(stage, 0.0) + 1e3 * (now - self._last)
        self._last = now
