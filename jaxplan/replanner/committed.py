"""The committed plans, one after another: the reference that the vehicle flies."""

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.planner import sampled
from jaxplan.records import replace
from jaxplan.replanner.records import CommittedPlan
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.status import PlanStatus

TIE = 1e-9
"""s; a plan is in force so much before its takeover: times are sums, and a cycle that begins then looks at it."""


ASKED = 8
"""Instants whose states are remembered (arbitrary: a cycle asks for two)."""


class CommittedPlans:
    """Begins with one plan; one that is added takes over at its ``start_time``."""

    def __init__(self, first: CommittedPlan) -> None:
        self.plans: list[CommittedPlan] = [first]
        self._asked: dict[float, FlatState] = {}

    @property
    def newest(self) -> CommittedPlan:
        """Which may not have taken over yet."""
        return self.plans[-1]

    def add(self, plan: CommittedPlan) -> None:
        """It takes over no earlier than the newest one."""
        self._asked.clear()
        self.plans.append(plan)

    def turn(self, time: float, heading: float) -> None:
        """Fly what is left of the newest plan from ``time`` [s] on with a heading [rad] that is held."""
        newest, since = self.newest, time - self.newest.start_time
        if since < float(newest.spline.duration):
            rest = newest.spline if since <= 0.0 else newest.spline.split(since)[1]
        else:
            rest = hold(self.at(time)).spline
        yaw = np.zeros((len(rest.durations), 6))
        yaw[:, 0] = heading
        self.add(newest._replace(start_time=max(time, newest.start_time), spline=replace(rest, yaw=yaw)))

    def withdraw(self) -> None:
        """Take back the newest plan, which nobody has flown."""
        if len(self.plans) < 2:
            raise InputError("replanner: there is no plan to withdraw, but the first one; want one that was committed")
        self._asked.clear()
        self.plans.pop()

    def forget(self, before: float) -> None:
        """Drop the plans that were flown before this instant [s] only."""
        self._asked.clear()
        flown = sum(plan.start_time <= before for plan in self.plans) - 1
        del self.plans[: max(flown, 0)]

    def reference(self, times: Float[np.ndarray, "n"]) -> FlatState:
        """The commanded flat state at ``times`` [s], each from the plan in force then."""
        times = np.asarray(times, dtype=float)
        starts = np.array([plan.start_time for plan in self.plans])
        active = np.searchsorted(starts, times + TIE, side="right") - 1
        if len(active) and (active == active[0]).all():
            return _along(self.plans[active[0]], times)
        derivatives, yaw = np.empty((len(times), 5, 3)), np.empty((len(times), 3))
        for index in np.unique(active):
            mine = active == index
            states = _along(self.plans[index], times[mine])
            derivatives[mine], yaw[mine] = states.derivatives, states.yaw
        return FlatState(derivatives=derivatives, yaw=yaw)

    def at(self, time: float) -> FlatState:
        """The commanded flat state at one instant [s]; a cycle asks for the same ones again."""
        found = self._asked.get(time)
        if found is None:
            states = self.reference(np.array([time]))
            found = FlatState(derivatives=states.derivatives[0], yaw=states.yaw[0])
            if len(self._asked) >= ASKED:
                self._asked.clear()
            self._asked[time] = found
        return found


def _along(plan: CommittedPlan, times: Float[np.ndarray, "n"]) -> FlatState:
    """Flat states of one plan at ``times`` [s]."""
    states = sampled(plan.spline, times - plan.start_time)
    return FlatState(derivatives=states.derivatives[0], yaw=states.yaw[0])


def hold(state: FlatState) -> CommittedPlan:
    """Stay at rest where ``state`` is, from the beginning of time."""
    position, yaw = np.zeros((1, 10, 3)), np.zeros((1, 6))
    position[0, 0], yaw[0, 0] = state.pos, state.yaw[0]
    spline = PiecewisePolynomial(durations=np.ones(1), position=position, yaw=yaw)
    return CommittedPlan(-np.inf, spline, np.asarray(state.pos), np.inf, np.nan, PlanStatus.NOT_SET)
