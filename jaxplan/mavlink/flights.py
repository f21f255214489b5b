"""What is streamed: a flight that was planned before, or what a planner beside the vehicle says."""

from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from jaxplan.errors import InputError, ResourceError
from jaxplan.io.plans import commanded, read_plans
from jaxplan.mavlink.autopilot import Seen
from jaxplan.replanner import CommittedPlan
from jaxplan.runtime import Phase, Runtime, Setpoint
from jaxplan.runtime.held import HeldPlans
from jaxplan.spline import PiecewisePolynomial
from jaxplan.status import PlanStatus

_AT_REST = 0.01
"""m/s and m/s^2 at the start of a flight, beyond which it does not begin in a hover (arbitrary)."""
MET = 0.4
"""Distance [m] that counts as an interception (paper, Sec. IV)."""


@runtime_checkable
class Flight(Protocol):
    """What a vehicle is to do. It waits in a hover until ``begin``. All times are seconds on the streamer's clock."""

    def is_ready(self) -> bool:
        """Whether it can begin. Raises an error of the library where it never will."""

    def begin(self, now: float) -> None:
        """The vehicle is at the start, and obeys."""

    def setpoint(self, now: float) -> Setpoint:
        """What the vehicle is to do. Never waits."""

    def over(self, now: float) -> bool:
        """Whether nothing but the rest at its end is left."""

    def tell(self, now: float, vehicle: Seen | None, target: Seen | None) -> None:
        """What was heard since; None where nothing was."""


class PlannedFlight:
    """A trajectory with yaw, from rest to rest."""

    def __init__(self, spline: PiecewisePolynomial) -> None:
        """Raises ``InputError`` for a trajectory that does not begin at rest."""
        state, self._began, goal = spline.state(0.0), np.inf, np.full(3, np.nan)
        moving = float(max(np.linalg.norm(state.vel), np.linalg.norm(state.acc)))
        if not moving <= _AT_REST:
            raise InputError(f"stream: the flight begins at {moving:.2g} m/s (m/s^2), want one that begins at rest")
        plan = CommittedPlan(0.0, spline, goal, np.nan, np.nan, PlanStatus.INTERCEPT)
        self._duration, self._held = float(spline.duration), HeldPlans(plan, 1)

    def is_ready(self) -> bool:
        """It is."""
        return True

    def begin(self, now: float) -> None:
        """Its time 0 is now."""
        self._began = now

    def setpoint(self, now: float) -> Setpoint:
        """At the start before it has begun, at the end after it is over."""
        return self._held.at(max(now - self._began, 0.0))

    def over(self, now: float) -> bool:
        """Whether it has come to rest."""
        return now - self._began >= self._duration

    def tell(self, now: float, vehicle: Seen | None, target: Seen | None) -> None:
        """It changes nothing."""


def saved_flight(source: Path) -> PlannedFlight:
    """All that was commanded in a flight of ``jaxplan intercept``.

    Raises:
        FileError: no plans are there. InputError: nothing was committed in that flight.
    """
    plans = read_plans(source)
    if not plans:
        raise InputError(f"{source}: holds no plan, nothing was committed in that flight; choose another one")
    return PlannedFlight(commanded(plans).spline)


class LiveFlight:
    """What a planner in a process of its own says, told where the vehicle and the target are."""

    def __init__(self, runtime: Runtime) -> None:
        self._runtime, self._begun = runtime, False
        self._met, self._vehicle, self._target = False, np.full(3, np.nan), np.full(3, np.nan)
        self.closest = np.inf
        """Smallest distance [m] between vehicle and target, as they were heard."""

    def is_ready(self) -> bool:
        """Whether the planner has compiled. Raises ``ResourceError`` where it cannot be built."""
        status = self._runtime.status()
        if status.phase is Phase.FAILED:
            raise ResourceError(f"planner: {status.reason}")
        return status.phase in (Phase.WAITING, Phase.PLANNING)

    def begin(self, now: float) -> None:
        """From now on it is told of the target."""
        self._begun = True

    def setpoint(self, now: float) -> Setpoint:
        """The hover at the start until it plans."""
        return self._runtime.setpoint()

    def over(self, now: float) -> bool:
        """Whether the target was met and the plan that was committed then has come to rest."""
        return self._met and not self._runtime.setpoint().velocity.any()

    def tell(self, now: float, vehicle: Seen | None, target: Seen | None) -> None:
        """Where they are, in the instant at which it was heard."""
        ahead = self._runtime.now() - now
        if vehicle is not None:
            self._vehicle = vehicle.position
            self._runtime.odometry(vehicle.time + ahead, vehicle.position, vehicle.velocity)
        if target is not None and self._begun:
            self._target = target.position
            if not self._met:
                self._runtime.observe(target.time + ahead, target.position)
        apart = float(np.linalg.norm(self._vehicle - self._target))
        self.closest = float(np.fmin(self.closest, apart))
        self._met = self._met or apart <= MET
