"""How a replan measures itself."""

import time
from typing import Any

import jax


class Timer:
    """Wall time of the stations [ms]; waits for compiled results, so that each station pays for itself."""

    def __init__(self) -> None:
        self.stages: dict[str, float] = {}
        self._last = time.perf_counter()

    @property
    def total(self) -> float:
        """All laps together [ms]."""
        return sum(self.stages.values())

    def lap(self, stage: str, result: Any = None) -> None:
        """Add the time since the last lap to ``stage``, once ``result`` has been computed."""
        jax.block_until_ready(result)
        now = time.perf_counter()
        self.stages[stage] = self.stages.get(stage, 0.0) + 1e3 * (now - self._last)
        self._last = now
