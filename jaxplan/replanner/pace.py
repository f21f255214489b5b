"""How long a refinement may take in what is left of a cycle: it can stop after any step, and is only ever better."""

from collections import deque

FIRST = 1.0
"""ms per step of a refinement, as long as none was measured (arbitrary: four times what a core takes)."""
REMEMBERED = 30
"""Refinements whose slowest says how long the next one takes (arbitrary)."""
SPARE = 0.2
"""Share of the latency that is left for what comes after it (arbitrary)."""


class Pace:
    """What refinements took."""

    def __init__(self) -> None:
        self._per_step: deque[float] = deque([FIRST], maxlen=REMEMBERED)

    def steps(self, left: float, latency: float) -> int:
        """For how many steps there is time, where ``left`` of ``latency`` is not used up yet [ms]; 0: for none."""
        return int(max(left - SPARE * latency, 0.0) / max(*self._per_step, 1e-3))

    def took(self, milliseconds: float, steps: int) -> None:
        """Remember a refinement, the last descent of which took so many steps."""
        self._per_step.append(milliseconds / steps)
