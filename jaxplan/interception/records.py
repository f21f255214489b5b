"""What an episode is told, and what comes of it."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxplan.prediction.observations import Observations
from jaxplan.prediction.stream import ObservationStream
from jaxplan.replanner import CommittedPlan, Cycle, Measured
from jaxplan.runtime import RuntimeStatus
from jaxplan.scenario import Scenario
from jaxplan.spline import FlatState

FLYING = "flying"
"""The outcome of an episode that is not over."""


@runtime_checkable
class Progress(Protocol):
    """Told how far an episode is."""

    def __call__(self, text: str, share: float, /) -> None:
        """What is being done, and the share of the longest possible episode that is over."""


@runtime_checkable
class Guide(Protocol):
    """What commands the defender: a ``Replanner``, or a baseline that stands in its place."""

    @property
    def ever_planned(self) -> bool:
        """Whether anything but the initial hover was commanded."""

    @property
    def plans(self) -> Sequence[CommittedPlan]:
        """The initial hover and every plan that was committed, in order; none at all where nothing is planned."""

    def reference(self, times: Float[np.ndarray, "n"]) -> FlatState:
        """The commanded flat state at ``times`` [s]."""

    def step(self, now: float, observations: Observations, measured: Measured | None = None) -> Cycle | None:
        """Decide at time ``now`` [s] from the newest observations; None where nothing is planned."""


@runtime_checkable
class Watch(Protocol):
    """What a sensor makes of the target."""

    def __call__(self, stream: ObservationStream, now: float, position: Float[np.ndarray, "3"], /) -> None:
        """Add to the stream what is seen at ``now`` [s] of a target that is there [m]."""


@runtime_checkable
class React(Protocol):
    """What a target makes of the defender."""

    def __call__(self, now: float, position: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"], /) -> None:
        """Decide how it flies from ``now`` [s] until the next cycle; the defender is there [m], at a velocity [m/s]."""


@runtime_checkable
class Follow(Protocol):
    """Shown an episode while it is flown."""

    def __call__(self, so_far: "Episode", /) -> None:
        """The episode as it is after a period; its outcome is ``FLYING`` until it is decided."""


class Flight(NamedTuple):
    """What was flown: one row per control step (200 Hz), at the end of the step."""

    times: Float[np.ndarray, "n"]
    """Seconds."""
    position: Float[np.ndarray, "n 3"]
    """Metres, world."""
    velocity: Float[np.ndarray, "n 3"]
    """Metres per second, world."""
    quat_wxyz: Float[np.ndarray, "n 4"]
    """Body to world."""
    reference: Float[np.ndarray, "n 3"]
    """The commanded position [m, world]."""
    target: Float[np.ndarray, "n 3"]
    """The target's position [m, world]."""
    target_velocity: Float[np.ndarray, "n 3"]
    """Metres per second, world."""
    position_error: Float[np.ndarray, "n"]
    """Metres from the reference."""
    yaw_error: Float[np.ndarray, "n"]
    """Radians between the heading of body x and the reference's yaw, 0 to pi; says nothing near 90 degrees of tilt."""
    twist_error: Float[np.ndarray, "n"]
    """Radians about body z from the attitude that the reference demands, 0 to pi."""
    clearance: Float[np.ndarray, "n"]
    """Metres from the vehicle's centre to the nearest obstacle or face of the room."""


class RealTime(NamedTuple):
    """How an episode that was flown against the clock kept its times."""

    setpoint_us: Float[np.ndarray, "n"]
    """How long each answer took [microseconds]."""
    behind_ms: Float[np.ndarray, "n"]
    """How late each control step was asked for [ms]: what the simulated vehicle itself takes is in it."""
    status: RuntimeStatus
    """Of the planner's process, at the end."""


class Episode(NamedTuple):
    """The result of one interception."""

    outcome: str
    """intercepted, collision, tracking_lost, target_ended or no_plan; ``FLYING`` before one of these."""
    flight: Flight
    replans: int
    """How many times the guide decided."""
    cycles: tuple[Cycle, ...]
    """What it did each time, where it plans."""
    plans: tuple[CommittedPlan, ...]
    """Every plan that was committed, in order."""
    scenario: Scenario
    warmup_s: float
    """Wall time of building and compiling."""
    wall_s: float
    """Wall time of the episode itself."""
    compilations_after_warmup: int
    real_time: RealTime | None = None
    """None where time stood still for the planner."""
    observations: tuple[Observations | None, ...] = ()
    """What each cycle decided from, None where the target was never seen; empty where nobody kept it."""

    @property
    def success(self) -> bool:
        """Whether the target was intercepted."""
        return self.outcome == "intercepted"


def tell_nobody(text: str, share: float, /) -> None:
    """Progress that nobody asked for."""
