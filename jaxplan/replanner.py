"""The host loop around the planner: one committed plan, replaced only by better ones and never with a jump.

A cycle at time t plans from where the committed plan will be at t + latency, with all derivatives to snap, so the
switch is smooth. Every plan ends at rest, so whatever happens to later cycles the vehicle comes to a stop.

In order of preference a cycle commits the best plan that meets the target; keeps the committed one while that
still does, and sooner; approaches the target; keeps what is committed. The paper's fallback (take the latest
candidate although it cannot be flown in time) is not one of them: see ``docs/decisions/0004-selection.md``.

After a change of the world the committed plan counts only where it is clear; where not, and no other plan is found, the
vehicle stops.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxplan.errors import InputError
from jaxplan.planner import Approaches, Planner, Plans, Stops, Timer, select, select_approach, select_stop
from jaxplan.prediction.candidates import Candidates
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.protocol import Predictor
from jaxplan.records import replace
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.status import Note, PlanStatus, Reason, count_reasons
from jaxplan.validation import require_positive
from jaxplan.world.update import Change


@dataclasses.dataclass(frozen=True)
class ReplannerConfig:
    """Timing of the loop."""

    period: float = 0.1
    """Seconds between two cycles (paper: about 10 Hz)."""
    latency: float = 0.1
    """Seconds from a cycle's observations until its plan takes over; a longer computation counts as late."""
    drop_late: bool = False
    """Whether a plan that took longer than the latency to compute is dropped: with a real vehicle it would be spliced
    into the past. Off in simulation, whose results are not to depend on the machine."""
    keep_radius: float = 0.2
    """A committed interception stays one while the target is still predicted this close [m] to its goal."""

    def __post_init__(self) -> None:
        require_positive("replanner", self, "period", "latency", "keep_radius")


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


class Cycle(NamedTuple):
    """What one replan cycle did."""

    time: float
    status: PlanStatus
    plans: Plans
    """Every candidate of the cycle with its reasons."""
    chosen: int
    """Index in ``plans`` of what was committed; -1 when the old plan was kept, or an approach was committed."""
    stage_ms: dict[str, float]
    generated: int
    rejected: dict[str, int]
    """Candidates per reason; one candidate may have several."""
    jump: Float[np.ndarray, "5"] | None
    """Discontinuity of position to jerk [SI] and of snap (relative) at the switch; None without a new plan."""
    note: Note = Note(0)
    """What deserves mention about the prediction."""


class _Chosen(NamedTuple):
    """What a cycle commits."""

    among: Plans | Approaches | Stops
    place: int
    slowdown: float
    """Multiple of the least time that the trajectory takes."""


class Replanner:
    """Holds the committed plans and adds to them, one ``step`` at a time."""

    def __init__(
        self, planner: Planner, predictor: Predictor, start: FlatState, config: ReplannerConfig = ReplannerConfig()
    ) -> None:
        self.config = config
        self.planner = planner
        self._predictor = predictor
        self.plans: list[CommittedPlan] = [_hold(start)]
        self._cycles = 0
        self._last = -np.inf
        self._certain = True

    @property
    def ever_planned(self) -> bool:
        """Whether any plan was committed after the initial hover."""
        return len(self.plans) > 1

    @property
    def committed(self) -> CommittedPlan:
        """The newest plan, which may not have taken over yet."""
        return self.plans[-1]

    def reference(self, times: Float[np.ndarray, "n"]) -> FlatState:
        """The commanded flat state at ``times`` [s], each from the plan in force then."""
        times = np.asarray(times, dtype=float)
        starts = np.array([plan.start_time for plan in self.plans])
        active = np.searchsorted(starts, times, side="right") - 1
        derivatives, yaw = np.empty((len(times), 5, 3)), np.empty((len(times), 3))
        for index in np.unique(active):
            plan, mine = self.plans[index], active == index
            state = plan.spline.state(times[mine] - plan.start_time)
            derivatives[mine], yaw[mine] = state.derivatives, state.yaw
        return FlatState(derivatives=derivatives, yaw=yaw)

    def _reference_at(self, time: float) -> FlatState:
        """The commanded flat state at one instant [s]."""
        states = self.reference(np.array([time]))
        return FlatState(derivatives=states.derivatives[0], yaw=states.yaw[0])

    def update(self, change: Change) -> None:
        """Plan in a changed world from the next cycle on, and look there whether the committed plan is still clear.

        Where it is not it is no rival any more, and where no other plan is found the vehicle stops.
        """
        self.planner = self.planner.update(change)
        self._certain = False

    def step(self, now: float, observations: Observations) -> Cycle:
        """Predict, plan and decide at time ``now`` [s] from the newest observations.

        Raises:
            InputError: ``now`` is not finite or before the last cycle; nothing is decided then.
        """
        if not np.isfinite(now) or now < self._last:
            raise InputError(f"replanner: now is {now} s, want a finite time from {self._last} s on, the last cycle's")
        timer, self._last = Timer(), now
        takeover = now + self.config.latency
        state = self._reference_at(takeover)
        predicted = self._predictor(observations, self._cycles)
        self._cycles += 1
        candidates = replace(predicted, arrival_times=np.asarray(predicted.arrival_times) - self.config.latency)
        timer.lap("predict", predicted)
        self._certain = self._certain or self.planner.is_clear(self.committed.spline, now - self.committed.start_time)
        incumbent = self._incumbent_score(candidates, takeover) if self._certain else -np.inf
        plans = self.planner.plan_batch(state, candidates, timer, incumbent)
        status, chosen = self._decide(state, candidates, plans, incumbent, timer)
        timer.lap("select")
        if chosen is not None and self.config.drop_late and timer.total > 1e3 * self.config.latency:
            status, chosen = PlanStatus.LATE, None
        jump = None if chosen is None else self._commit(chosen, takeover, status, state)
        timer.lap("select")
        return Cycle(
            time=now,
            status=status,
            plans=plans,
            chosen=chosen.place if chosen is not None and chosen.among is plans else -1,
            stage_ms=timer.stages,
            generated=len(plans.reasons),
            rejected=count_reasons(plans.reasons),
            jump=jump,
            note=Note(candidates.note),
        )

    def _decide(
        self, state: FlatState, candidates: Candidates, plans: Plans, incumbent: float, timer: Timer
    ) -> tuple[PlanStatus, _Chosen | None]:
        """The ladder: a better interception, the committed one, an approach, whatever is committed."""
        best = select(plans)
        if best >= 0 and plans.score[best] > incumbent:
            return PlanStatus.INTERCEPT, _Chosen(plans, best, float(plans.alpha[best]))
        if np.isfinite(incumbent):
            return PlanStatus.KEPT_COMMITTED, None
        approaches = self.planner.approach(state, candidates)
        timer.lap("approach")
        best = select_approach(approaches)
        if best >= 0:
            return PlanStatus.APPROACH, _Chosen(approaches, best, float(approaches.alpha[best]))
        if not self._certain:
            stops = self.planner.brake(state)
            best = select_stop(stops)
            return (PlanStatus.BRAKE, _Chosen(stops, best, np.nan)) if best >= 0 else (PlanStatus.BLOCKED, None)
        if (np.asarray(candidates.reasons) & np.uint32(Reason.TARGET_LOST)).all():
            return PlanStatus.TARGET_LOST, None
        usable = bool((plans.reasons == 0).any()) or len(approaches.reasons) > 0
        return (PlanStatus.KEPT_COMMITTED if usable else PlanStatus.NO_CANDIDATE), None

    def _incumbent_score(self, candidates: Candidates, takeover: float) -> float:
        """Score of the committed interception among today's candidates; -inf when it no longer meets the target."""
        plan = self.committed
        remaining = plan.arrival_time - takeover
        if plan.status is not PlanStatus.INTERCEPT or remaining <= 0.0:
            return -np.inf
        apart, simultaneous = _expected_then(candidates, remaining, plan.goal, 0.5 * self.config.period)
        same = simultaneous & (apart <= self.config.keep_radius)
        if not same.any():
            return -np.inf
        nearest = int(np.argmin(np.where(same, apart, np.inf)))
        return self.planner.config.likelihood_weight * float(candidates.likelihood[nearest]) - remaining

    def _commit(self, chosen: _Chosen, takeover: float, status: PlanStatus, state: FlatState) -> Float[np.ndarray, "5"]:
        """Add a plan that takes over then; returns its discontinuity from ``state``, as ``Cycle.jump``."""
        among, index = chosen.among, chosen.place
        spline = among.spline(index)
        plan = CommittedPlan(
            start_time=takeover,
            spline=spline,
            goal=among.goals[index],
            arrival_time=takeover + float(among.arrival_times[index]),
            alpha=chosen.slowdown,
            status=status,
            probability=among.probability(index),
        )
        self.plans.append(plan)
        self._certain = True
        jump = np.abs(spline.state(0.0).derivatives - state.derivatives).max(axis=-1)
        jump[4] /= max(float(np.abs(state.snap).max()), 1.0)
        return jump


def _expected_then(
    candidates: Candidates, time: float, goal: Float[np.ndarray, "3"], tolerance: float
) -> tuple[Float[np.ndarray, "k"], Bool[np.ndarray, "k"]]:
    """How far [m] the target would be from ``goal`` at ``time`` if each candidate were true, and which are of then.

    Predictions may be farther apart than replans. A candidate of a neighbouring step is moved along the mean of the
    predicted positions, step by step.
    """
    times, goals = np.asarray(candidates.arrival_times), np.asarray(candidates.goals)
    finite = np.isfinite(times) & np.isfinite(goals).all(axis=-1)
    steps, member = np.unique(np.round(times[finite], 6), return_inverse=True)
    if len(steps) == 0:
        return np.full(len(times), np.inf), np.zeros(len(times), bool)
    size = np.bincount(member)
    means = np.stack([np.bincount(member, weights=goals[finite, axis]) / size for axis in range(3)], axis=1)
    spacing = np.diff(steps).min() if len(steps) > 1 else 0.0
    simultaneous = finite & (np.abs(times - time) <= max(tolerance, 0.5 * spacing) + 1e-6)
    moved = [np.interp(time, steps, means[:, axis]) - np.interp(times, steps, means[:, axis]) for axis in range(3)]
    return np.linalg.norm(goals + np.stack(moved, axis=1) - goal, axis=-1), simultaneous


def _hold(state: FlatState) -> CommittedPlan:
    """Stay at rest where ``state`` is, from the beginning of time."""
    position, yaw = np.zeros((1, 10, 3)), np.zeros((1, 6))
    position[0, 0], yaw[0, 0] = state.pos, state.yaw[0]
    spline = PiecewisePolynomial(durations=np.ones(1), position=position, yaw=yaw)
    return CommittedPlan(-np.inf, spline, np.asarray(state.pos), np.inf, np.nan, PlanStatus.NOT_SET)
