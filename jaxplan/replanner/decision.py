"""What a cycle chooses: a better interception, the committed plan made sooner, an approach, or a stop.

Plans are compared by the paper's eq. 9, or, where a predictor knows the target's possible motions as a whole, by how
soon they are expected to capture it (``jaxplan.planner.capture``). In both cases the committed plan is a rival like the
others, what is chosen is made sooner where there is time, and nothing is chosen that the last look refuses.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxplan.batching import meanwhile
from jaxplan.planner import (
    Approaches,
    Planner,
    Plans,
    Prospect,
    Refined,
    Seed,
    Timer,
    capture_time,
    capture_times,
    expected_goals,
)
from jaxplan.replanner.choice import (
    Chosen,
    Flights,
    Known,
    Outcome,
    chosen_from,
    chosen_refined,
    seed_of_committed,
    seed_of_plan,
    seed_towards,
)
from jaxplan.replanner.governor import slower
from jaxplan.replanner.incumbent import NO_INCUMBENT, Incumbent, incumbent_among
from jaxplan.replanner.pace import Pace
from jaxplan.replanner.records import ReplannerConfig
from jaxplan.replanner.stopping import stop_for
from jaxplan.replanner.vain import TWICE, Vain
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.status import PlanStatus, Reason

LOOKED_AT = 4
"""Plans of a kind that a cycle takes a last look at (arbitrary: more than one is hardly ever refused)."""
APPROACHED = (0.5, 0.9, 1.4, 2.0)
"""Seconds from the start after which the target is expected where it is approached (arbitrary)."""

STANDING = 0.3
"""m/s; what is slower than that is not corrected where plans pass: of 153 such cycles the corrections of 5 were sooner,
by 0.01 to 0.09 s (docs/decisions/0063). On the way to a place to look from it is: half of them are sooner (0064)."""


class _Rival(NamedTuple):
    """What may be committed, before the last look at it."""

    score: float
    """What it is worth [s]."""
    status: PlanStatus
    chosen: Chosen
    seed: Callable[[], Seed]
    """From which a refinement begins."""


class Memory(NamedTuple):
    """What cycles leave behind for the next ones."""

    pace: Pace
    vain: Vain


class Decision:
    """One cycle's choice, and what it cost."""

    def __init__(
        self, planner: Planner, config: ReplannerConfig, memory: Memory, latency: float, known: Known, timer: Timer
    ) -> None:
        self._planner, self._config, self._known, self._timer = planner, config, known, timer
        self._pace, self._vain, self._latency = memory.pace, memory.vain, 1e3 * latency
        self.incumbent = self._incumbent()
        self._vain.against(known.committed, known.start.takeover - self.incumbent.score)
        self.refused = 0
        """Plans that passed every check but the last look."""
        self._cut_off = False
        """Whether something was left out that would have been late."""

    @property
    def above(self) -> float:
        """What candidates must be worth more than [s] to be looked at; inf where they were by capture, in vain."""
        in_vain = self._known.prospect is not None and not self._vain.is_worth("plan")
        return np.inf if in_vain else self.incumbent.score

    def among(self, plans: Plans) -> Outcome:
        """The choice among a cycle's plans and what there is beside them."""
        prospect = self._known.prospect
        if (plans.trajectory >= 0).any():
            self._vain.remember("plan")
        outcome = self._by_score(plans) if prospect is None else self._by_capture(plans, prospect)
        nothing = outcome[0] in (PlanStatus.KEPT_COMMITTED, PlanStatus.NO_CANDIDATE)
        return (PlanStatus.LATE, None) if nothing and self._cut_off else outcome

    def stop(self, status: PlanStatus) -> Outcome:
        """What ``stop_for`` takes."""
        return stop_for(self._planner, self._known, status)

    def governed(self, outcome: Outcome) -> Outcome:
        """What is committed, slower, where the vehicle has fallen behind it and no other interception is found."""
        known, (status, chosen) = self._known, outcome
        if known.lag is None or (chosen is not None and status is PlanStatus.INTERCEPT):
            return outcome
        committed = known.committed
        for spline, slowdown in slower(committed.spline, known.lag):
            flown = None if known.ahead is None else known.ahead.along(spline, known.start.takeover)
            clear = flown is None or (flown.clear[0] and known.is_passed_by(flown))
            if clear and self._is_valid(spline, None, 0.0):
                arrival = slowdown * (committed.arrival_time - committed.start_time - known.lag.since)
                return PlanStatus.SLOWED, Chosen(spline, committed.goal, arrival, slowdown, np.nan, anew=True)
        return outcome

    def _incumbent(self) -> Incumbent:
        """What the committed plan is worth; nothing where it is not clear, or the vehicle not on it."""
        known, config = self._known, self._planner.config
        if not known.certain:
            return NO_INCUMBENT
        if known.prospect is None:
            takeover, weight = known.start.takeover, config.likelihood_weight
            return incumbent_among(known.committed, known.candidates, takeover, weight, self._config)
        time = capture_time(known.prospect, known.committed.spline, known.since)
        return Incumbent(-time, known.prospect.mean_at(time), np.nan)

    def _by_score(self, plans: Plans) -> Outcome:
        """The ladder: a better interception, the committed one, an approach, a stop if need be, what is committed."""
        incumbent = self.incumbent
        better = self._ranked(plans, plans.score, PlanStatus.INTERCEPT, incumbent.score)
        if outcome := self._first(better):
            return outcome
        if np.isfinite(incumbent.score):
            if not self._vain.is_worth("refine", TWICE):
                return PlanStatus.KEPT_COMMITTED, None
            seed = seed_of_committed(self._known.committed, incumbent, self._known.start.takeover)
            refined = self._refined(seed, incumbent.score)
            return (PlanStatus.INTERCEPT, refined) if refined else (PlanStatus.KEPT_COMMITTED, None)
        return self._without_meeting(bool((plans.reasons == 0).any()))

    def _without_meeting(self, usable: bool) -> Outcome:
        """An approach, a stop if need be, or what is committed, though it meets nothing; ``usable``: some plans are."""
        if self._in_time():
            approaches = self._approaches()
            if outcome := self._first(self._ranked(approaches, -approaches.lateness, PlanStatus.APPROACH)):
                return outcome
            usable |= len(approaches.reasons) > 0
        if not self._known.certain:
            return self.stop(PlanStatus.BRAKE)
        if (np.asarray(self._known.candidates.reasons) & np.uint32(Reason.TARGET_LOST)).all():
            return PlanStatus.TARGET_LOST, None
        return (PlanStatus.KEPT_COMMITTED if usable else PlanStatus.NO_CANDIDATE), None

    def _by_capture(self, plans: Plans, prospect: Prospect) -> Outcome:
        """The ladder: what is expected to capture soonest, be it a plan, a correction or the committed one; a stop.

        Where no flight, though it went straight on, would be enough sooner than what is committed, only that counts.
        """
        least = self.incumbent.score + self._planner.config.capture.gain
        if not -np.inf < plans.promise <= least and (outcome := self._soonest(least, plans, prospect)):
            return outcome
        if not np.isfinite(self.incumbent.score):
            return self.stop(PlanStatus.BRAKE)
        if not self._vain.is_worth("refine"):
            return PlanStatus.KEPT_COMMITTED, None
        seed = seed_towards(prospect, self._known.committed.spline, self._known.since, self._config.reach)
        refined = self._refined(seed, least)
        return (self._status(refined), refined) if refined else (PlanStatus.KEPT_COMMITTED, None)

    def _soonest(self, least: float, plans: Plans, prospect: Prospect) -> Outcome | None:
        """The best of plans and corrections, where it is worth more than ``least`` [s].

        Where none of them passes approaches are looked at, and then stops, which keep the ways open.
        """
        start, rivals = self._known.start.state, self._ranked(plans, plans.score, PlanStatus.INTERCEPT, least)
        passes = bool((plans.reasons == 0).any())
        wanted = not passes or self._known.is_searching or np.linalg.norm(start.vel) > STANDING
        if wanted and self._may_correct(passes):
            before, corrections = self._timer.total, self._planner.correct(start, prospect)
            self._timer.lap("correct")
            self._pace.corrected(self._timer.total - before)
            rivals += self._ranked(corrections, _worth(prospect, corrections), PlanStatus.INTERCEPT, least)
            passes |= bool((corrections.reasons == 0).any())
        if passes:
            return self._first(sorted(rivals, key=lambda rival: -rival.score)[:LOOKED_AT])
        if self._vain.is_worth("approach") and self._in_time():
            approaches = self._approaches()
            ways = self._ranked(approaches, _worth(prospect, approaches), PlanStatus.APPROACH, least)
            if outcome := self._first(ways):
                return outcome
        if not np.isfinite(self.incumbent.score) or not self._vain.is_worth("stop") or not self._in_time():
            return None
        self._vain.remember("stop")
        stops = self._planner.brake(start, self._known.committed.spline, self._known.since)
        self._timer.lap("stop")
        return self._first(self._ranked(stops, _worth(prospect, stops), PlanStatus.APPROACH, least))

    def _ranked(
        self, among: Flights, score: Float[np.ndarray, "k"], status: PlanStatus, least: float = -np.inf
    ) -> list[_Rival]:
        """The usable trajectories of the largest scores above ``least``, so many as a cycle looks at."""
        usable: Int[np.ndarray, "n"] = np.flatnonzero((among.reasons == 0) & np.isfinite(score) & (score > least))
        rivals = []
        for index in usable[np.argsort(-score[usable], kind="stable")][:LOOKED_AT].tolist():
            slowdown = float(among.alpha[index]) if isinstance(among, Plans | Approaches) else np.nan
            chosen = chosen_from(among, index, slowdown, index if isinstance(among, Plans) else -1)
            rivals.append(_Rival(float(score[index]), status, chosen, functools.partial(self._seed, among, index)))
        return rivals

    def _seed(self, among: Flights, index: int) -> Seed:
        """One of the trajectories, to be made sooner; by capture where the target is expected, not for its own goal."""
        if self._known.prospect is None:
            return seed_of_plan(among, index, self._known.candidates)
        return seed_towards(self._known.prospect, among.spline(index), 0.0, self._config.reach)

    def _first(self, rivals: list[_Rival]) -> Outcome | None:
        """The first of them that passes the last look, or what refining it gives.

        The first is looked at while it is refined: one is hardly ever refused.
        """
        for number, rival in enumerate(rivals):
            look = meanwhile(functools.partial(self._passes, rival.chosen.spline))
            if number > 0 and not look():
                self.refused += 1
                continue
            refined = self._refined(rival.seed(), rival.score, new=self._known.prospect is not None)
            if refined is not None:
                return self._status(refined), refined
            if look():
                return rival.status, rival.chosen
            self.refused += 1
        return None

    def _approaches(self) -> Approaches:
        """Of the latest candidates, or, where the futures are known, of where the target is expected soon."""
        prospect, candidates = self._known.prospect, self._known.candidates
        if prospect is not None:
            candidates = expected_goals(prospect, np.asarray(candidates.target), APPROACHED)
        self._vain.remember("approach")
        approaches = self._planner.approach(self._known.start.state, candidates)
        self._timer.lap("approach")
        return approaches

    @property
    def _left(self) -> float:
        """Of the latency [ms]; inf, where late plans are flown all the same."""
        return self._latency - self._timer.total if self._config.drop_late else np.inf

    def _in_time(self) -> bool:
        """Whether what is looked for now may still be committed; where not, it is left out, and the cycle late."""
        in_time = self._left > 0.0
        self._cut_off |= not in_time
        return in_time

    def _may_correct(self, passes: bool) -> bool:
        """Whether there is time: where a plan ``passes`` already, corrections must not make it late."""
        return self._pace.corrects(self._left, self._latency) if passes else self._in_time()

    def _refined(self, seed: Seed, score: float, new: bool = False) -> Chosen | None:
        """An interception that is enough sooner than ``seed``, which is worth ``score``; None where there is none.

        A ``new`` plan is not committed yet; from a slow start it is tried once more when it is.
        """
        steps = self._steps()
        if steps == 0:
            return None
        before, start = self._timer.total, self._known.start
        refined = self._planner.refine(start.state, self._known.candidates, seed, steps)
        self._timer.lap("refine")
        if refined is not None and steps is not None:
            self._pace.took(self._timer.total - before, refined.steps)
        if (not new or self._planner.config.is_fast(start.state)) and not self._is_promising(refined, seed):
            self._vain.remember("refine", new)
        if refined is None or refined.reasons or not self._is_better(refined, seed, score):
            return None
        if not self._passes(refined.spline):
            self.refused += 1
            return None
        self._vain.forget("refine")
        return chosen_refined(refined, seed)

    def _is_promising(self, refined: Refined | None, seed: Seed) -> bool:
        """Whether to try it again by eq. 9: what was found is soon enough, though it may not be flown."""
        if refined is None or self._known.prospect is not None:
            return False
        return refined.promise <= seed.meeting - self._planner.config.least_gain

    def _status(self, refined: Chosen) -> PlanStatus:
        """What a refined plan is: an approach, where it meets the target after all that is predicted."""
        latest = float(np.max(self._known.candidates.arrival_times))
        return PlanStatus.INTERCEPT if refined.arrival_time <= latest else PlanStatus.APPROACH

    def _is_better(self, refined: Refined, seed: Seed, score: float) -> bool:
        """Whether a refined plan is worth more than what it began from, and enough so."""
        if seed.late:
            return refined.arrival_time <= seed.meeting - self._planner.config.least_gain
        if self._known.prospect is None:
            return refined.score >= score + self._planner.config.least_gain
        return -capture_time(self._known.prospect, refined.spline) > score

    def _steps(self) -> int | None:
        """Of a refinement, for which there is time; None, which means all, where late plans are flown all the same."""
        planned = self._planner.config.refinement
        if not self._config.drop_late or planned is None:
            return None
        return min(self._pace.steps(self._left, self._latency), planned.iterations)

    def _passes(self, spline: PiecewisePolynomial) -> bool:
        """The last look at a plan, and its flight in the model."""
        start, ahead = self._known.start, self._known.ahead
        if not self._is_valid(spline, start.state, start.wider):
            return False
        if ahead is None:
            return True
        flown = ahead.along(spline, start.takeover)
        return bool(flown.clear[0] and flown.followed[0]) and self._known.is_passed_by(flown)

    def _is_valid(self, spline: PiecewisePolynomial, state: FlatState | None, wider: float) -> bool:
        """The last look at a plan, which begins in ``state`` where that is given, and at what moves."""
        if self._planner.validate(spline, 0.0, state, wider).faults:
            return False
        passing, takeover = self._known.passing, self._known.start.takeover
        return passing is None or bool(passing.along(spline, takeover)[0] >= passing.wanted(takeover))


def _worth(prospect: Prospect, among: Flights) -> Float[np.ndarray, "k"]:
    """What those that pass are worth by how soon they are expected to capture the target [s]; NaN for the others."""
    return -capture_times(prospect, among.splines, np.flatnonzero(among.reasons == 0))
