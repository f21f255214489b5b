"""The plans that the pilot flies, and what they demand at an instant; one that does not fit is refused."""

from collections import deque
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.replanner import CommittedPlan
from jaxplan.runtime.messages import Answer
from jaxplan.runtime.table import COLUMNS, PlanTable, tabulate
from jaxplan.spline import FlatState

_LARGEST_JUMP = np.repeat([1e-6, 1e-6, 1e-5, 1e-4], 3)
"""Of position to jerk [SI] from one plan to the next; the planner's own are below 1e-9."""


class Setpoint(NamedTuple):
    """What the vehicle is to do at one instant; world frame, z up."""

    time: float
    """[s]"""
    derivatives: Float[np.ndarray, "5 3"]
    """Position [m] and its first four derivatives: velocity, acceleration, jerk, snap."""
    yaw: Float[np.ndarray, "3"]
    """Yaw [rad, unwrapped], its rate [rad/s] and acceleration [rad/s^2]."""

    @property
    def position(self) -> Float[np.ndarray, "3"]:
        """In metres."""
        return self.derivatives[0]

    @property
    def velocity(self) -> Float[np.ndarray, "3"]:
        """In metres per second."""
        return self.derivatives[1]

    @property
    def acceleration(self) -> Float[np.ndarray, "3"]:
        """In metres per second squared."""
        return self.derivatives[2]


class HeldPlans:
    """What is flown now, and what is going to be."""

    def __init__(self, first: CommittedPlan, remembered: int) -> None:
        self._held: deque[PlanTable] = deque([tabulate(0, -1, first)], maxlen=remembered)
        self._seen = 0
        self._answered = -np.inf
        self.refused: dict[str, int] = {}
        """Plans that were not taken, by reason."""

    @property
    def newest(self) -> PlanTable:
        """Which may not have taken over yet."""
        return self._held[-1]

    @property
    def plans(self) -> list[CommittedPlan]:
        """Those remembered, oldest first."""
        return [held.plan for held in list(self._held)]

    @property
    def answer(self) -> Answer:
        """What the planner is to know."""
        return Answer(self._seen, self.newest.head.number)

    def offer(self, table: PlanTable) -> None:
        """Take a plan over, or refuse it."""
        self._seen = max(self._seen, table.head.number)
        reason = self._objection(table)
        if reason:
            self.refused[reason] = self.refused.get(reason, 0) + 1
        else:
            self._held.append(table)

    def at(self, time: float, promised: float = np.inf) -> Setpoint:
        """The setpoint at ``time`` [s]; no plan that is offered later changes what was said up to ``promised`` [s]."""
        self._answered = max(self._answered, min(time, promised))
        rows = self._row(time).reshape(6, 3)
        return Setpoint(time, rows[:5], rows[5])

    def preview(self, times: Float[np.ndarray, "n"]) -> FlatState:
        """What will be demanded at ``times`` [s] unless better plans come."""
        rows = np.array([self._row(time) for time in np.asarray(times, dtype=float).tolist()]).reshape(-1, COLUMNS)
        return FlatState(derivatives=rows[:, :15].reshape(-1, 5, 3), yaw=rows[:, 15:])

    def _objection(self, table: PlanTable) -> str:
        """Why a plan cannot be flown; empty where it can."""
        head, newest = table.head, self.newest
        if head.predecessor != newest.head.number:
            return "goes on from another plan"
        if not np.isfinite(table.table).all() or not np.isfinite(head.start_time):
            return "not finite"
        if not head.start_time >= max(self._answered, newest.start_time):
            return "late"
        jump = np.abs(table.row(head.start_time) - newest.row(head.start_time))[:12]
        return "" if head.from_measured or (jump <= _LARGEST_JUMP).all() else "jumps"

    def _row(self, time: float) -> Float[np.ndarray, "18"]:
        for held in reversed(self._held):
            if held.start_time <= time:
                return held.row(time)
        return self._held[0].row(time)
