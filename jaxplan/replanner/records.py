"""What the loop around the planner is told, holds and reports."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.planner import Plans
from jaxplan.spline import PiecewisePolynomial
from jaxplan.status import Note, PlanStatus
from jaxplan.validation import require_at_least, require_positive


@dataclasses.dataclass(frozen=True)
class ReplannerConfig:
    """Timing of the loop, and what it does when the vehicle is off its reference."""

    period: float = 0.1
    """Seconds between two cycles (paper: about 10 Hz)."""
    latency: float = 0.05
    """Seconds from a cycle's observations until its plan takes over; a longer computation counts as late
    (docs/decisions/0057)."""
    most_latency: float | None = None
    """Where given, the latency follows what cycles take, from ``latency`` up to this [s]."""
    drop_late: bool = False
    """Whether a plan that took longer than the latency to compute is dropped: with a real vehicle it would be spliced
    into the past. Off in simulation, whose results are not to depend on the machine."""
    keep_radius: float = 0.2
    """A committed interception stays one while the target is still predicted this close [m] to its goal."""
    reach: float = 0.36
    """And while the vehicle passes it no farther [m] than this: what counts as met is 0.4 m, and it strays."""
    replan_beyond: float = 0.5
    """Farther [m] than this from its reference, now or, as it moves, when the next plan takes over, that plan begins
    where the vehicle is measured, unless it is coming nearer and the committed one is clear by as much more: then it
    finds back to it."""
    stop_beyond: float = 0.8
    """Farther [m] than this, it stops from there first."""
    most_turn: float = 0.8
    """Turned farther [rad] than this about body z from its reference, the vehicle keeps the heading that it has: where
    it lacks the thrust to hold one, nothing else of the plan depends on it."""
    wider_margin: float = 0.05
    """What plans from a measured state keep from obstacles [m] beyond the usual (arbitrary)."""

    def __post_init__(self) -> None:
        require_positive("replanner", self, "period", "latency", "keep_radius", "reach", "replan_beyond", "most_turn")
        require_at_least("replanner", self, 0.0, "wider_margin")
        require_at_least("replanner", self, self.replan_beyond, "stop_beyond")
        if self.most_latency is not None and not self.most_latency >= self.latency:
            raise InputError(f"replanner: most_latency is {self.most_latency} s, want at least {self.latency} s")


class Measured(NamedTuple):
    """The vehicle as its estimator sees it at the time of a cycle; world frame."""

    position: Float[np.ndarray, "3"]
    """[m]"""
    velocity: Float[np.ndarray, "3"]
    """[m/s]"""
    acceleration: Float[np.ndarray, "3"] | None = None
    """[m/s^2]; None: the reference's."""
    attitude: Float[np.ndarray, "4"] | None = None
    """Unit quaternion w x y z, body FLU to world; None: the reference's, or in the model of the vehicle its own."""


class CommittedPlan(NamedTuple):
    """A trajectory that the vehicle follows from ``start_time`` until the next one takes over."""

    start_time: float
    """Seconds on the episode's clock."""
    spline: PiecewisePolynomial
    goal: Float[np.ndarray, "3"]
    arrival_time: float
    """When the target is expected at the goal [s]; for an approach the vehicle arrives later."""
    alpha: float
    """How many times slower than at its least time the plan is flown; NaN for a hover."""
    status: PlanStatus
    probability: float = np.nan
    """Of being tracked, by the classifier; NaN where the rotor limits decided."""
    from_measured: bool = False
    """Whether it begins where the vehicle was measured, off the plan before."""


class Cycle(NamedTuple):
    """What one replan cycle did."""

    time: float
    status: PlanStatus
    plans: Plans | None
    """Every candidate of the cycle with its reasons; None where they stayed in another process."""
    chosen: int
    """Index in ``plans`` of what was committed; -1 when the old plan was kept, or another one than these committed."""
    stage_ms: dict[str, float]
    generated: int
    rejected: dict[str, int]
    """Candidates per reason; one candidate may have several."""
    jump: Float[np.ndarray, "5"] | None
    """Discontinuity of position to jerk [SI] and of snap (relative) at the switch, from where the plan should begin;
    None without a new plan."""
    note: Note = Note(0)
    """What deserves mention about the prediction."""
    refused: int = 0
    """Plans that passed every check but the last look."""
    deviation: float = 0.0
    """Of the measured vehicle from its reference [m]; 0 where it is not measured."""
    latency: float = np.nan
    """Seconds until a plan of this cycle takes over."""
    sooner: float = 0.0
    """By how much a refinement made the meeting sooner [s]; 0 where none was taken."""
