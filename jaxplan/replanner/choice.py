"""What a cycle knows when it decides, what it chooses, and from what a refinement of that begins."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.planner import Approaches, Corrections, Plans, Prospect, Refined, Rollouts, Seed, Stops
from jaxplan.planner.capture import STEP
from jaxplan.prediction.candidates import Candidates
from jaxplan.replanner.ahead import Ahead
from jaxplan.replanner.governor import Lag
from jaxplan.replanner.incumbent import Incumbent
from jaxplan.replanner.passing import Passing
from jaxplan.replanner.records import CommittedPlan
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.status import Note, PlanStatus

Flights = Plans | Approaches | Corrections | Stops
"""Trajectories that were solved and checked."""

FAR, MOVED = 2.0, 0.5
"""s: plans that come nearest to the target later than that are moved by at most so much [m] to meet it, for a
refinement to begin (docs/decisions/0056)."""


class Start(NamedTuple):
    """Where and how the plans of a cycle begin."""

    state: FlatState
    takeover: float
    """[s]"""
    deviation: float
    """Of the vehicle from its reference [m]; 0 where it is not measured."""
    measured: bool
    """Whether they begin where the vehicle is, off the reference."""
    wider: float
    """What they keep from obstacles beyond the usual [m]."""


class Chosen(NamedTuple):
    """What a cycle commits."""

    spline: PiecewisePolynomial
    goal: Float[np.ndarray, "3"]
    """[m]"""
    arrival_time: float
    """[s from the takeover]"""
    slowdown: float
    """Multiple of the least time that the trajectory takes."""
    probability: float
    """Of being tracked; NaN where no classifier was asked."""
    candidate: int = -1
    """Which one it is for; -1 for what is no candidate's own."""
    sooner: float = 0.0
    """By how much a refinement made it sooner [s]."""
    anew: bool = False
    """Whether it begins where the vehicle will be, elsewhere than the plans of the cycle."""


Outcome = tuple[PlanStatus, Chosen | None]
"""What the cycle came to, and what is committed."""


class Known(NamedTuple):
    """What a cycle knows when it decides."""

    start: Start
    candidates: Candidates
    """Times count from the start."""
    prospect: Prospect | None
    """The target's futures, where plans are compared by them."""
    committed: CommittedPlan
    certain: bool
    """Whether the committed plan is known to be clear, and the vehicle on it."""
    ahead: Ahead | None = None
    """The model of the vehicle, where it is measured."""
    passing: Passing | None = None
    """What moves, where that is known."""
    lag: Lag | None = None
    """Of the vehicle behind the committed plan, where it has fallen behind."""

    @property
    def since(self) -> float:
        """Time of the committed plan's own [s] at the start."""
        return self.start.takeover - self.committed.start_time

    @property
    def is_searching(self) -> bool:
        """Whether the candidates are a place to look for the target from."""
        return bool(int(self.candidates.note) & Note.SEARCHING)

    def is_passed_by(self, flown: Rollouts) -> bool:
        """Whether the model, along a plan, is not hit by what moves."""
        return self.passing is None or bool(self.passing.flown(flown)[0] >= self.passing.least)


def chosen_from(among: Flights, place: int, slowdown: float, candidate: int = -1) -> Chosen:
    """One of the trajectories of a cycle."""
    spline, time = among.spline(place), float(among.arrival_times[place])
    return Chosen(spline, among.goals[place], time, slowdown, among.probability(place), candidate)


def chosen_refined(refined: Refined, seed: Seed) -> Chosen:
    """A refined plan, and by how much it is sooner than what it began from."""
    sooner = seed.meeting - refined.arrival_time
    return Chosen(refined.spline, refined.goal, refined.arrival_time, 1.0, np.nan, sooner=sooner)


def seed_of_plan(among: Flights, place: int, candidates: Candidates) -> Seed:
    """A trajectory just planned; an approach is as late at its goal as it is."""
    late = float(among.lateness[place]) if isinstance(among, Approaches) else 0.0
    likelihood = float(np.asarray(candidates.likelihood)[place]) if isinstance(among, Plans) else 0.0
    return Seed(
        spline=among.spline(place),
        since=0.0,
        meeting=float(among.arrival_times[place]) + late,
        goal=among.goals[place],
        likelihood=likelihood,
        late=isinstance(among, Approaches),
    )


def seed_towards(prospect: Prospect, spline: PiecewisePolynomial, since: float, radius: float) -> Seed:
    """What is left of a plan ``since`` [s of its own time], to meet the expected target where it first comes nearest.

    Within ``radius`` [m] nothing is nearer. Behind the last instant of the prospect the target is taken to wait. Far
    ahead a plan that passes it at a distance is left where it leads: moved there it would lead through obstacles.
    """
    known, latest = len(prospect.times), float(prospect.times[-1])
    left = max(float(spline.duration) - since, latest)
    times = np.concatenate([prospect.times, np.arange(latest + STEP, left, STEP)])
    mean = prospect.mean[np.minimum(np.arange(len(times)), known - 1)]
    way = np.asarray(spline.evaluate(np.minimum(since + times, float(spline.duration))))[:, :3]
    apart = np.linalg.norm(way - mean, axis=1)
    first = int(np.argmax(apart <= max(radius, float(apart.min()) + 0.02)))
    meeting, goal = float(times[first]), mean[first]
    if meeting > FAR:
        goal = way[first] + (goal - way[first]) * min(1.0, MOVED / max(float(apart[first]), 1e-9))
    return Seed(spline, since, meeting, goal, 1.0, late=first >= known)


def seed_of_committed(plan: CommittedPlan, incumbent: Incumbent, takeover: float) -> Seed:
    """What is left of a committed interception, for where the target is expected now."""
    return Seed(
        spline=plan.spline,
        since=takeover - plan.start_time,
        meeting=plan.arrival_time - takeover,
        goal=incumbent.goal,
        likelihood=incumbent.likelihood,
    )
