"""What was tried in vain against a committed plan is not tried again as long as that is as good as it was."""

from typing import Literal, NamedTuple

import numpy as np

from jaxplan.replanner.records import CommittedPlan

WORSE = 0.05
"""s by which the committed plan's meeting must have receded before something is tried again (decision 49)."""
TWICE = 2
"""Refinements of a committed plan by eq. 9: the second one still comes to something (decision 61)."""

Attempt = Literal["plan", "approach", "stop", "refine"]


class _Tries(NamedTuple):
    """How often in a row, and how soon the plan was expected to meet the target then [s]."""

    number: int
    meeting: float


class Vain:
    """What was tried against the plan that is committed, and how soon that was expected to meet the target then."""

    def __init__(self) -> None:
        self._plan: CommittedPlan | None = None
        self._meeting = np.inf
        self._tried: dict[Attempt, _Tries] = {}
        self._new: set[Attempt] = set()

    def against(self, plan: CommittedPlan, meeting: float) -> None:
        """From now on against this plan, which meets the target at ``meeting`` [s], inf where it is worth nothing."""
        if plan is not self._plan:
            self._tried = dict.fromkeys(self._new, _Tries(1, meeting))
        self._plan, self._meeting, self._new = plan, meeting, set()

    def is_worth(self, attempt: Attempt, enough: int = 1) -> bool:
        """Whether it was tried less often than ``enough`` against this plan, or the plan has become worse since."""
        tries = self._tried.get(attempt)
        return tries is None or tries.number < enough or self._is_worse(tries)

    def remember(self, attempt: Attempt, new: bool = False) -> None:
        """It is tried now, in vain as far as is known: for what is committed, or for a ``new`` plan that will be."""
        if new:
            self._new.add(attempt)
            return
        tries = self._tried.get(attempt)
        number = 1 if tries is None or self._is_worse(tries) else tries.number + 1
        self._tried[attempt] = _Tries(number, self._meeting)

    def forget(self, attempt: Attempt) -> None:
        """It came to a plan that will be committed, for which it may be tried again."""
        self._new.discard(attempt)

    def again(self, attempt: Attempt) -> None:
        """It may come to something by now, as in a world that has changed."""
        self._tried.pop(attempt, None)

    def _is_worse(self, tries: _Tries) -> bool:
        """Whether the plan is worth nothing, or less by now than when something was tried last."""
        return not np.isfinite(self._meeting) or self._meeting > tries.meeting + WORSE
