"""A plan whose derivatives are multiplied out, so that one small product gives all that is demanded at an instant."""

from bisect import bisect_right
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.replanner import CommittedPlan
from jaxplan.spline import PiecewisePolynomial
from jaxplan.status import PlanStatus

COLUMNS = 18
"""Position to snap, three each, and yaw to yaw acceleration."""
DEGREES = 10
"""Coefficients of each, ascending in normalised time."""
YAW_DEGREES = 6
"""Of these, those that yaw may have."""


class PlanHead(NamedTuple):
    """What is known of a plan beside its trajectory; see ``CommittedPlan``."""

    number: int
    predecessor: int
    """The number of the plan that it goes on from."""
    status: int
    from_measured: int
    start_time: float
    arrival_time: float
    alpha: float
    probability: float
    goal: tuple[float, float, float]


class PlanTable:
    """A plan as it is flown."""

    def __init__(self, head: PlanHead, durations: Float[np.ndarray, "m"], table: Float[np.ndarray, "m 10 18"]) -> None:
        """``table`` has the coefficients of each derivative in normalised time, as ``tabulate`` writes them."""
        self.head, self.durations, self.table = head, durations, table
        self.start_time = head.start_time
        self._durations, self._pieces = durations.tolist(), list(table)
        self._begins = [0.0, *np.cumsum(durations).tolist()]
        self._duration = self._begins.pop()
        self._end = table[-1].sum(axis=0)
        self._end[3:15] = self._end[16:] = 0.0

    def row(self, time: float) -> Float[np.ndarray, "18"]:
        """Position to snap and yaw to yaw acceleration at ``time`` [s]; from its end on it stays there."""
        t = time - self.start_time
        if not t < self._duration:
            return self._end.copy()
        piece = bisect_right(self._begins, t) - 1 if t > 0.0 else 0
        s = (max(t, 0.0) - self._begins[piece]) / self._durations[piece]
        s2 = s * s
        s4 = s2 * s2
        s8 = s4 * s4
        powers = np.array((1.0, s, s2, s2 * s, s4, s4 * s, s4 * s2, s4 * s2 * s, s8, s8 * s))
        return powers.dot(self._pieces[piece])

    @property
    def plan(self) -> CommittedPlan:
        """The same as the planner knows it."""
        head, yaw = self.head, self.table[:, :YAW_DEGREES, 15]
        spline = PiecewisePolynomial(durations=self.durations, position=self.table[..., :3], yaw=yaw)
        return CommittedPlan(
            start_time=head.start_time,
            spline=spline,
            goal=np.array(head.goal),
            arrival_time=head.arrival_time,
            alpha=head.alpha,
            status=PlanStatus(head.status),
            probability=head.probability,
            from_measured=bool(head.from_measured),
        )


def tabulate(number: int, predecessor: int, plan: CommittedPlan) -> PlanTable:
    """The table of a plan; position has at most 10 coefficients, yaw 6."""
    x, y, z = np.asarray(plan.goal, dtype=float).tolist()
    head = PlanHead(
        number=number,
        predecessor=predecessor,
        status=int(plan.status),
        from_measured=int(plan.from_measured),
        start_time=float(plan.start_time),
        arrival_time=float(plan.arrival_time),
        alpha=float(plan.alpha),
        probability=float(plan.probability),
        goal=(x, y, z),
    )
    durations = np.asarray(plan.spline.durations, dtype=float)
    table = np.zeros((len(durations), DEGREES, COLUMNS))
    for order in range(5):
        _write(table[..., 3 * order : 3 * order + 3], np.asarray(plan.spline.position, float), durations, order)
    if plan.spline.yaw is not None:
        for order in range(3):
            _write(table[..., 15 + order : 16 + order], np.asarray(plan.spline.yaw, float)[..., None], durations, order)
    return PlanTable(head, durations, table)


def _write(
    columns: Float[np.ndarray, "m n c"],
    coefficients: Float[np.ndarray, "m k c"],
    durations: Float[np.ndarray, "m"],
    order: int,
) -> None:
    """Into the columns, the coefficients of a derivative by time."""
    count = coefficients.shape[1]
    factors = np.ones(count - order)
    for step in range(order):
        factors = factors * (np.arange(order, count) - step)
    columns[:, : count - order] = coefficients[:, order:] * factors[None, :, None] / durations[:, None, None] ** order
