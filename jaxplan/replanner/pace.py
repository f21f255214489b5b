"""What a cycle still has time for: how long its parts took before, in what is left of the latency."""

from collections import deque
from typing import Literal

FIRST = 1.0
"""ms per step of a refinement, as long as none was measured (arbitrary: four times what a core takes)."""
REMEMBERED = 30
"""Refinements whose slowest says how long the next one takes (arbitrary)."""
SPARE = 0.2
"""Share of the latency that is left for what comes after it (arbitrary)."""
FADES = 0.9
"""Of what a part took is expected the next time, unless it takes longer, or is left out (arbitrary)."""

Part = Literal["correct", "approach", "stop"]
"""What a cycle can leave out, all or nothing."""


class Pace:
    """What the parts took. A refinement can stop after any step, and is only ever better; others are whole or not."""

    def __init__(self) -> None:
        self._per_step: deque[float] = deque([FIRST], maxlen=REMEMBERED)
        self._expected: dict[Part, float] = {}

    def steps(self, left: float, latency: float) -> int:
        """For how many steps there is time, where ``left`` of ``latency`` is not used up yet [ms]; 0: for none."""
        return int(max(left - SPARE * latency, 0.0) / max(*self._per_step, 1e-3))

    def took(self, milliseconds: float, steps: int) -> None:
        """Remember a refinement, the last descent of which took so many steps."""
        self._per_step.append(milliseconds / steps)

    def fits(self, part: Part, left: float, latency: float) -> bool:
        """Whether there is time for a part; what is left out is expected to take less, until it is tried again."""
        expected = self._expected.get(part, 0.0)
        if expected < max(left - SPARE * latency, 0.0):
            return True
        self._expected[part] = FADES * expected
        return False

    def spent(self, part: Part, milliseconds: float) -> None:
        """Remember what a part took."""
        self._expected[part] = max(milliseconds, FADES * self._expected.get(part, 0.0))
