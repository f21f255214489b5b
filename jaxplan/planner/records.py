"""What the planner is told and what it returns."""

import dataclasses
import operator
from typing import NamedTuple, Protocol, SupportsIndex

import numpy as np
from jaxtyping import Float, Int, UInt32

from jaxplan.arrival import ArrivalConfig
from jaxplan.config import (
    ALLOCATIONS,
    HEADINGS,
    MEETINGS,
    PLACINGS,
    SELECTIONS,
    Allocate,
    Heading,
    Meet,
    PlaceFor,
    Selection,
)
from jaxplan.errors import InputError
from jaxplan.knots import KnotConfig
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.planner.border import usual_futures
from jaxplan.planner.capture import CaptureConfig, Prospect, prospect_of
from jaxplan.planner.fallbacks import Approaches, Corrections, Stops
from jaxplan.planner.refined import Refine, RefinementConfig
from jaxplan.planner.rollouts import RollOut, RolloutConfig
from jaxplan.planner.timer import Timer
from jaxplan.planner.validator import ValidatorConfig, Verdict
from jaxplan.prediction.candidates import Candidates
from jaxplan.prediction.futures import Futures
from jaxplan.records import record
from jaxplan.search.lattice import METHODS, MOST_ALTERNATIVES
from jaxplan.selection import CheckConfig, Margins
from jaxplan.selection import select as select_best
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.validation import (
    checks_itself,
    require_at_least,
    require_kinds,
    require_one_of,
    require_positive,
    require_within,
)
from jaxplan.world.obstacles import World
from jaxplan.world.update import Change


@checks_itself
@dataclasses.dataclass(frozen=True)
class PlannerConfig:
    """Every setting of the planner, in SI units."""

    padding: float = 0.5
    """Clearance of goals and searched paths from obstacles [m] (paper, Sec. IV)."""
    search: str = "roadmap"
    """How paths are searched: "roadmap", or "multi-resolution" as the paper does."""
    resolution: float = 0.1
    """Side of the finest cells [m] by which paths are searched; coarser where a room is too large."""
    narrow_passages: bool = True
    """Where no path keeps the padding, take one that keeps the vehicle's radius and the tracking margin (roadmap)."""
    fallback_budget: int = 300_000
    """Cells settled at most in a replan for goals that no road leads to, about 0.15 s (``SearchConfig``)."""
    alternatives: int = 1
    """Up to so many clearly different routes to each goal, of which the one is taken that is flown soonest (roadmap);
    decision 27 has what that takes and gives."""
    meet: Meet = "pass"
    """How a target is met: "pass" flies through the goal to a stop point behind it, "match" does so at the velocity
    that the target is expected to have there, "rest" stops at the goal (paper)."""
    meet_radius: float = 0.0
    """How far from the predicted target [m] it may be met: paths end so much before their goals, on their last leg."""
    heading: Heading = "hold"
    """Where the vehicle looks: "hold" keeps its yaw, "path" turns it along the path, "target" to the target."""
    max_yaw_rate: float = 1.5
    """Average yaw rate [rad/s] that a segment may ask for (docs/decisions/0010-yaw-rate.md)."""
    allocate: Allocate = "both"
    """Who allots the times: the "policy" (the paper), the "profile" of speeds along the path, or "both" in turn."""
    place: PlaceFor = "chosen"
    """For whom a placing policy, where there is one, places waypoints and times: for the "chosen" plan, whose
    refinement then has a second start, or besides for "all" candidates of a cycle's first round, before anybody allots
    times alone (docs/decisions/0052)."""
    policy_speed: float = 4.0
    """Fastest start [m/s] from which the policy is asked where the profile is there too (docs/decisions/0022)."""
    profile_probability: float = 0.8
    """As ``CheckConfig.least_probability``, of plans with the profile's times: the classifier knows the policy's."""
    likelihood_weight: float = 1.0
    """Seconds that a likelihood of 1 is worth in the selection (paper eq. 9 leaves the unit open)."""
    selection: Selection = "capture"
    """What plans are compared by: "capture" is the expected time until one captures the target, where it is passed and
    a predictor knows its possible motions as a whole; "paper" is eq. 9, and what all others are compared by."""
    capture: CaptureConfig = CaptureConfig()
    path_capacity: int = 32
    """Corners of the longest taut path; longer ones are planned as prefixes."""
    width: int = 32
    """Candidates that the compiled stations take at a time; on a GPU, as many as there are (decision 0014)."""
    exhaustive: bool = False
    """Match and check every candidate (the paper) instead of the best ones until one passes: the same winner by
    eq. 9."""
    knots: KnotConfig = KnotConfig()
    arrival: ArrivalConfig = ArrivalConfig(least_alpha=0.75, tolerance=1e-2)
    checks: CheckConfig = CheckConfig()
    validator: ValidatorConfig = ValidatorConfig()
    refinement: RefinementConfig | None = None
    """How chosen plans are made sooner; None: they are left as the policy has them (the paper)."""
    rollouts: RolloutConfig | None = RolloutConfig()
    """How plans are flown in the model before they are committed, where the vehicle is measured; None: they are not."""

    @property
    def captures(self) -> bool:
        """Whether plans are compared by capture where futures are known: what stops or matches is not after that."""
        return self.selection == "capture" and self.meet == "pass"

    def is_fast(self, state: FlatState) -> bool:
        """Whether a start is so fast that the policy is not asked (``policy_speed``)."""
        return float(np.linalg.norm(np.asarray(state.vel))) > self.policy_speed

    @property
    def least_gain(self) -> float:
        """By how much a refined plan must be sooner [s] to be taken."""
        return 0.0 if self.refinement is None else self.refinement.gain

    def __post_init__(self) -> None:
        require_kinds("planner", self)
        require_positive("planner", self, "max_yaw_rate", "resolution")
        require_at_least("planner", self, 0, "padding", "policy_speed", "meet_radius")
        require_within("planner", self, 1, 65536, "width")
        require_at_least("planner", self, 1, "fallback_budget")
        require_within("planner", self, 1, MOST_ALTERNATIVES if self.search == "roadmap" else 1, "alternatives")
        require_within("planner", self, 0, 1, "profile_probability")
        require_one_of("planner", self, METHODS, "search")
        require_one_of("planner", self, MEETINGS, "meet")
        require_one_of("planner", self, HEADINGS, "heading")
        require_one_of("planner", self, ALLOCATIONS, "allocate")
        require_one_of("planner", self, PLACINGS, "place")
        require_one_of("planner", self, SELECTIONS, "selection")
        have = f"meet {self.meet!r} and heading {self.heading!r}"
        if self.refinement is not None and (self.meet, self.heading) != ("pass", "hold"):
            raise InputError(f"planner: refinement needs meet 'pass' and heading 'hold', have {have}; want None")
        if self.place == "all" and (self.meet, self.heading) != ("pass", "hold"):
            raise InputError(f"planner: place 'all' needs meet 'pass' and heading 'hold', have {have}; want 'chosen'")
        if self.meet != "rest" and self.search != "roadmap":
            raise InputError(f"planner: meet {self.meet!r} needs search 'roadmap', have {self.search!r}; want 'rest'")


def prospect_for(config: PlannerConfig, candidates: Candidates) -> Prospect | None:
    """The target's futures from the start on, where plans are compared by them; None: by the paper's eq. 9.

    Raises ``InputError`` for futures whose arrays do not fit together; numbers that mean nothing count as none.
    """
    if not config.captures or candidates.futures is None:
        return None
    futures, capture, prospect = _latest[0]
    if futures is not candidates.futures or capture is not config.capture:
        usual = usual_futures(candidates.futures)
        prospect = None if usual is None else prospect_of(usual, config.capture)
        _latest[0] = candidates.futures, config.capture, prospect
    return prospect


_latest: list[tuple[Futures | None, CaptureConfig | None, Prospect | None]] = [(None, None, None)]
"""What was asked for last: a cycle asks for the same twice."""


@record
class Plans:
    """What became of every candidate, in the order they were given."""

    goals: Float[np.ndarray, "k 3"]
    """Positions [m, world]."""
    arrival_times: Float[np.ndarray, "k"]
    """When each target is there [s from the start state]."""
    reasons: UInt32[np.ndarray, "k"]
    """0 means usable."""
    score: Float[np.ndarray, "k"]
    """What the selection maximises [s]."""
    promise: float = np.inf
    """The best score of all that could be reached in time, before anything was searched [s]."""
    alpha: Float[np.ndarray, "k"]
    """Scale factor of the time allocation; NaN where none was computed."""
    trajectory: Int[np.ndarray, "k"]
    """Place of each candidate's trajectory in ``splines`` and ``margins``; -1 for those without one."""
    splines: SplineBatch
    margins: Margins

    def spline(self, index: SupportsIndex) -> PiecewisePolynomial:
        """The trajectory to candidate ``index`` (host, NumPy).

        Raises ``InputError`` where there is no such candidate, as for the -1 of ``select``, or it has no trajectory.
        """
        return self.splines.spline(self._place(index))

    def probability(self, index: SupportsIndex) -> float:
        """Of candidate ``index`` being tracked, by the classifier; NaN where the rotor limits decided.

        Raises as ``spline`` does.
        """
        return float(np.asarray(self.margins.probability)[self._place(index)])

    def _place(self, index: SupportsIndex) -> int:
        """Of a candidate's trajectory among all of them; never the last one by accident."""
        number, count = operator.index(index), len(self.trajectory)
        if not 0 <= number < count:
            raise InputError(f"plans: have candidate {number}, want 0 to {count - 1}; -1 says that nothing is usable")
        if self.trajectory[number] < 0:
            raise InputError(f"plans: candidate {number} has no trajectory; its reasons say why")
        return int(self.trajectory[number])


def select(plans: Plans) -> int:
    """Index of the candidate to commit; -1 when nothing is usable, never index 0 by accident."""
    return select_best(plans.score, plans.reasons)


class PlanBatch(Protocol):
    """Trajectories from one state timed to meet each candidate (paper, Sec. III-B)."""

    def __call__(
        self, state: FlatState, candidates: Candidates, timer: Timer | None = None, above: float = -np.inf
    ) -> Plans:
        """``state`` is cast to float64; ``timer`` collects the milliseconds of the stations.

        Only candidates with a score ``above`` that of a plan that is committed already are of interest.

        Raises ``InputError`` for a state that is not finite, and for arrays of other shapes.
        """


class Approach(Protocol):
    """Trajectories towards the latest candidates, only late, for when none can be met."""

    def __call__(self, state: FlatState, candidates: Candidates) -> Approaches:
        """As ``PlanBatch``."""


class Correct(Protocol):
    """Short plans straight towards where the target is expected, from flight."""

    def __call__(self, state: FlatState, prospect: Prospect) -> Corrections:
        """As ``PlanBatch``; compiles nothing."""


class Validate(Protocol):
    """The last look at a plan before it is committed, by other means than those that found it."""

    def __call__(
        self, spline: PiecewisePolynomial, since: float = 0.0, start: FlatState | None = None, wider: float = 0.0
    ) -> Verdict:
        """Looks at it from ``since`` [s of its own time] to its end; compiles nothing.

        ``start`` is where it takes over, ``wider`` what it keeps from obstacles beyond the usual [m].
        """


class Impact(Protocol):
    """How hard a trajectory that is not clear hits."""

    def __call__(self, spline: PiecewisePolynomial, since: float) -> float:
        """Speed [m/s] where it first touches something, from ``since`` [s of its own time] on; 0 for nowhere."""


class Brake(Protocol):
    """Stops, for when the committed plan may not be flown any more and there is no other."""

    def __call__(
        self, state: FlatState, along: PiecewisePolynomial | None = None, since: float = 0.0, aside: bool = False
    ) -> Stops:
        """As ``PlanBatch``; some stops go along a plan from ``since`` [s of its own time] on, where there is one.

        With ``aside`` a slow vehicle also steps aside, in all directions.
        """


class Warmup(Protocol):
    """Compile every station."""

    def __call__(self, state: FlatState) -> None:
        """Any state in the world will do; after this call nothing is compiled any more."""


class InWorld(Protocol):
    """The same planner in another world, with all that is compiled without looking at the world."""

    def __call__(self, world: World, resolution: float | None = None) -> "Planner":
        """Prepares the lattices of ``world``, with cells of another ``resolution`` [m] where one is given.

        Raises ``InputError`` where there are too many (``world.occupancy.fitting_resolution`` says what fits).
        """


class Update(Protocol):
    """The same planner after a change of its world (``jaxplan.world.update``)."""

    def __call__(self, change: Change, moving: bool = False) -> "Planner":
        """Patches the lattices around what changed; compiles nothing.

        Boxes that stand for what is ``moving`` are kept out of by searches alone; ``Replanner.expect`` says the rest.
        """


class Planner(NamedTuple):
    """The planner's functions.

    After ``warmup`` none of them compiles anything, but the planner of ``in_world`` for obstacles of other numbers.
    """

    plan_batch: PlanBatch
    approach: Approach
    correct: Correct
    refine: Refine
    validate: Validate
    impact: Impact
    brake: Brake
    roll_out: RollOut
    warmup: Warmup
    in_world: InWorld
    update: Update
    config: PlannerConfig

    def __repr__(self) -> str:
        """What it is for, what it can do, and the settings that are not the usual ones."""
        own = (field.name for field in dataclasses.fields(self.config))
        changed = (name for name in own if getattr(self.config, name) != getattr(PlannerConfig, name))
        settings = ", ".join(f"{name}={getattr(self.config, name)!r}" for name in changed)
        return (
            f"Planner with PlannerConfig({settings})\n"
            "  plan_batch(state, candidates): trajectories timed to meet each candidate; select(plans) is the best\n"
            "  refine(state, candidates, seed): one sooner; if none is, approach(...), correct(...) or brake(state)\n"
            "  validate(spline), impact(spline, since), roll_out(flown, position, velocity): a last look at a plan\n"
            "  warmup(state): compile; in_world(world), update(change): the same planner elsewhere, after a change"
        )
