"""What was tried in vain against a committed plan is not tried again as long as that is as good as it was."""

from typing import Literal

import numpy as np

from jaxplan.replanner.records import CommittedPlan

WORSE = 0.05
"""s by which the committed plan's meeting must have receded before something is tried again (decision 49)."""

Attempt = Literal["approach", "stop", "refine"]


class Vain:
    """What was tried against the plan that is committed, and how soon that was expected to meet the target then."""

    def __init__(self) -> None:
        self._plan: CommittedPlan | None = None
        self._meeting = np.inf
        self._tried: dict[Attempt, float] = {}
        self._new: set[Attempt] = set()

    def against(self, plan: CommittedPlan, meeting: float) -> None:
        """From now on against this plan, which meets the target at ``meeting`` [s], inf where it is worth nothing."""
        if plan is not self._plan:
            self._tried = dict.fromkeys(self._new, meeting)
        self._plan, self._meeting, self._new = plan, meeting, set()

    def is_worth(self, attempt: Attempt) -> bool:
        """Whether it was never tried against this plan, or the plan has become worse since."""
        before = self._tried.get(attempt)
        return before is None or not np.isfinite(self._meeting) or self._meeting > before + WORSE

    def remember(self, attempt: Attempt, new: bool = False) -> None:
        """It is tried now, in vain as far as is known: for what is committed, or for a ``new`` plan that will be."""
        if new:
            self._new.add(attempt)
        else:
            self._tried[attempt] = self._meeting

    def forget(self, attempt: Attempt) -> None:
        """It came to a plan that will be committed, for which it may be tried again."""
        self._new.discard(attempt)
