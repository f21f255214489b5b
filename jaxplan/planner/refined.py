"""What a refinement begins from, what it gives, and its settings."""

import dataclasses
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from jaxplan.prediction.candidates import Candidates
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.status import Reason
from jaxplan.validation import require_at_least, require_positive, require_within


@dataclasses.dataclass(frozen=True)
class RefinementConfig:
    """How plans are made sooner that were chosen already (docs/decisions/0028)."""

    iterations: int = 12
    """Steps of the descent: more are sooner and take longer."""
    segments: int = 6
    """Of a refined plan, the one to its stop included."""
    meet_radius: float = 0.3
    """How far from the predicted target [m] it may be met, where its motion is known."""
    caution: float = 1.0
    """How much nearer [m] for each metre that the predicted positions are spread by then."""
    least_radius: float = 0.02
    """m; not nearer than this (arbitrary: the optimiser wants some room)."""
    spare: float = 0.05
    """Clearance [m] beyond what the checks ask for: what lies between samples."""
    max_pitch: float = 70.0
    """Of body x from the horizontal [degrees]: its heading, by which flights are judged, turns the faster the steeper
    it is."""
    max_body_rate: float = 7.0
    """Fastest turn of the thrust [rad/s], against drag."""
    max_lag: float = 0.14
    """And how far it may turn within the motors' time constant [rad]: a vehicle is that much behind all the time."""
    dilation: float = 1.0
    """The body must be able to fly a plan so many times as fast as it is flown."""
    most_excess: float = 0.1
    """Longest time [s] that any rotor may be out of its range: the optimiser looks at single instants."""
    soonest: float = 0.7
    """Meetings that are nearer than this [s] are left as they are (docs/decisions/0061)."""
    gain: float = 0.02
    """By how much a committed plan must become sooner [s] to be replaced (arbitrary)."""

    def __post_init__(self) -> None:
        require_within("refinement", self, 1, 1000, "iterations")
        require_within("refinement", self, 3, 16, "segments")
        require_positive(
            "refinement", self, "meet_radius", "least_radius", "soonest", "max_pitch", "max_body_rate", "max_lag"
        )
        require_at_least("refinement", self, 0.0, "spare", "gain", "most_excess", "caution")
        require_at_least("refinement", self, 1.0, "dilation")


class Seed(NamedTuple):
    """A plan that is to be made sooner, and which of the target's motions it is for."""

    spline: PiecewisePolynomial
    since: float
    """Time of its own [s] at which the refined plan begins."""
    meeting: float
    """Seconds from there until it meets the target."""
    goal: Float[np.ndarray, "3"]
    """Where the target is then [m, world]."""
    likelihood: float
    """Of that motion, as candidates have it."""
    late: bool = False
    """Whether that is later than the target is there, as of an approach, or after all that is predicted: then it is
    taken to wait where it is expected last."""


class Refined(NamedTuple):
    """What became of a seed."""

    spline: PiecewisePolynomial
    goal: Float[np.ndarray, "3"]
    """Where the target is met [m, world]; the vehicle passes within ``RefinementConfig.meet_radius``."""
    arrival_time: float
    """When [s from the start state]."""
    score: float
    """As that of candidates [s]."""
    reasons: Reason
    """0 means usable."""
    clearance: float
    """Lower bound [m] along the whole trajectory."""
    promise: float
    """The soonest arrival of all that was tried [s], though the vehicle could not fly that."""
    steps: int
    """Of the last descent."""


class Refine(Protocol):
    """Plans that meet the target sooner, from those that were chosen."""

    def __call__(
        self, state: FlatState, candidates: Candidates, seed: Seed, iterations: int | None = None
    ) -> Refined | None:
        """As ``PlanBatch``; nothing where the planner does not refine, or where nothing is to be gained.

        ``iterations``: in the place of ``RefinementConfig.iterations``, where there is less time; compiles nothing.
        """
