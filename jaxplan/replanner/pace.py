"""What a cycle still has time for: how long refinements and corrections took, and what is left of the latency."""

from collections import deque

FIRST = 1.0
"""ms per step of a refinement, as long as none was measured (arbitrary: four times what a core takes)."""
REMEMBERED = 30
"""Refinements whose slowest says how long the next one takes (arbitrary)."""
SPARE = 0.2
"""Share of the latency that is left for what comes after it (arbitrary)."""
FADES = 0.9
"""Of what corrections took is expected the next time, unless they take longer (arbitrary)."""


class Pace:
    """What they took. A refinement can stop after any step, and is only ever better; corrections are whole or not."""

    def __init__(self) -> None:
        self._per_step: deque[float] = deque([FIRST], maxlen=REMEMBERED)
        self._corrections = 0.0

    def steps(self, left: float, latency: float) -> int:
        """For how many steps there is time, where ``left`` of ``latency`` is not used up yet [ms]; 0: for none."""
        return int(max(left - SPARE * latency, 0.0) / max(*self._per_step, 1e-3))

    def took(self, milliseconds: float, steps: int) -> None:
        """Remember a refinement, the last descent of which took so many steps."""
        self._per_step.append(milliseconds / steps)

    def corrects(self, left: float, latency: float) -> bool:
        """Whether there is time for corrections; left out, they are expected to take less, until they are tried."""
        if self._corrections < max(left - SPARE * latency, 0.0):
            return True
        self._corrections *= FADES
        return False

    def corrected(self, milliseconds: float) -> None:
        """Remember what corrections took."""
        self._corrections = max(milliseconds, FADES * self._corrections)
