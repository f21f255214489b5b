"""One cycle after another: predict, plan and decide; one committed plan, replaced only by better ones.

A cycle at time t plans from where the committed plan will be at t + latency, with all derivatives to snap, so the
switch is smooth. Every plan ends at rest, so whatever happens to later cycles the vehicle comes to a stop.

In order of preference a cycle commits the best plan that meets the target; keeps the committed one while that
still does, and sooner; approaches the target; keeps what is committed. The paper's fallback (take the latest
candidate although it cannot be flown in time) is not one of them: see ``docs/decisions/0004-selection.md``. Nothing is
committed that ``jaxplan.planner.validator`` refuses.

After a change of the world the committed plan counts only where it is clear; where not, and no other plan is found, the
vehicle stops. A vehicle that is measured off its reference plans from where it is; far off, it stops there first.
"""

import time
from collections import deque

import numpy as np
from jaxtyping import Float

from jaxplan.batching import meanwhile
from jaxplan.errors import InputError
from jaxplan.planner import Fault, Planner, Timer, prospect_for
from jaxplan.planner.timer import Clock
from jaxplan.prediction.candidates import Candidates, later
from jaxplan.prediction.observations import Observations, usual_observations
from jaxplan.prediction.protocol import Predictor, Searcher
from jaxplan.replanner.ahead import Ahead, look_ahead
from jaxplan.replanner.choice import Chosen, Known, Start
from jaxplan.replanner.committed import CommittedPlans, hold
from jaxplan.replanner.decision import Decision, Memory
from jaxplan.replanner.governor import BEHIND, Lag, lag_behind
from jaxplan.replanner.measured import carried_on, usual_measured
from jaxplan.replanner.pace import Pace
from jaxplan.replanner.passing import Passing, Ways, usual_ways
from jaxplan.replanner.records import CommittedPlan, Cycle, Measured, ReplannerConfig
from jaxplan.replanner.vain import Vain
from jaxplan.spline import FlatState
from jaxplan.status import Note, PlanStatus, count_reasons
from jaxplan.validation import as_number
from jaxplan.vehicle.heading import heading_near, turn_from
from jaxplan.world.update import Change

REMEMBERED = 100
"""Cycles whose computing times say what the latency is to be (arbitrary)."""
RESERVE = 1.2
"""By how much the latency is longer than 99 of 100 of them (arbitrary)."""
PLANNED = 0.6
"""Share of the latency after which no more candidates are tried, where late plans are dropped: what has passed by then
is chosen from, and the rest is for looking at it (arbitrary). Where nothing has, what was done until then counts as
this share of what a cycle takes, so that the latency grows until there is time for another round."""


class Replanner:
    """Holds the committed plans and adds to them, one ``step`` at a time."""

    def __init__(
        self,
        planner: Planner,
        predictor: Predictor,
        start: FlatState | CommittedPlan,
        config: ReplannerConfig | None = None,
        clock: Clock = time.perf_counter,
    ) -> None:
        """``start`` is where the vehicle hovers, or the plan that it flies already."""
        self.config = config or ReplannerConfig()
        self.planner = planner
        self.latency = self.config.latency
        """Seconds from the next cycle's observations until its plan takes over."""
        self._predictor, self._clock = predictor, clock
        self._committed = CommittedPlans(start if isinstance(start, CommittedPlan) else hold(start))
        self._memory = Memory(Pace(), Vain())
        self._took: deque[float] = deque(maxlen=REMEMBERED)
        self._cycles = 0
        self._last = -np.inf
        self._certain = not isinstance(start, CommittedPlan)
        self._ways: Ways | None = None
        self._ahead: Ahead | None = None

    @property
    def plans(self) -> list[CommittedPlan]:
        """The initial hover and every plan that was committed, in order, but those ``forget`` has dropped."""
        return self._committed.plans

    @property
    def searches(self) -> bool:
        """Whether its predictor looks for a target that was never seen: then it may be asked without observations."""
        return isinstance(self._predictor, Searcher)

    @property
    def ever_planned(self) -> bool:
        """Whether any plan was committed after the initial hover."""
        return len(self.plans) > 1

    @property
    def committed(self) -> CommittedPlan:
        """The newest plan, which may not have taken over yet."""
        return self._committed.newest

    def reference(self, times: Float[np.ndarray, "n"]) -> FlatState:
        """The commanded flat state at ``times`` [s], each from the plan in force then."""
        return self._committed.reference(times)

    def withdraw(self) -> None:
        """Take back the newest plan, because it reached whoever flies it too late.

        Raises ``InputError`` where there is none but the first.
        """
        self._committed.withdraw()
        self._certain = False

    def forget(self, before: float) -> None:
        """Drop the plans that were flown before this instant [s] only: a loop that never ends keeps its size."""
        self._committed.forget(before)

    def update(self, change: Change, moving: bool = False) -> None:
        """Plan in a changed world from the next cycle on, and look there whether the committed plan is still clear.

        Where it is not it is no rival any more, and where no other plan is found the vehicle stops. A box that stands
        for what something ``moving`` will sweep is kept out of by searches only: ``expect`` tells when it is where.
        Candidates that came to nothing before are looked at again.
        """
        self.planner = self.planner.update(change, moving)
        self._certain = self._certain and moving
        self._memory.vain.again("plan")

    def expect(self, ways: Ways | None) -> None:
        """From the next cycle on, keep clear of boxes that move, as far as it is known where they will be when.

        What is committed is no rival any more where one of them hits it. Searches do not see them: ``update`` the map
        with what will be swept soon. None: nothing moves. Raises ``InputError`` for what are no ways.
        """
        self._ways = None if ways is None else usual_ways(ways)

    def step(self, now: float, observations: Observations | None, measured: Measured | None = None) -> Cycle:
        """Predict, plan and decide at time ``now`` [s] from the newest observations.

        Args:
            now: on the clock of all other times.
            observations: of the target; None, where it was never seen, only for a predictor that ``searches``.
            measured: the vehicle at ``now``, where it is known; without it, it is taken to be where it should.

        Raises:
            InputError: ``now`` is not finite or before the last cycle, or ``observations`` or ``measured`` are not;
                nothing is decided.
        """
        now = as_number("replanner: now", now)
        if observations is not None:
            observations = usual_observations(observations)
        elif not self.searches:
            raise InputError("replanner: have no observations, want some, or a predictor that searches (Lookout)")
        if not np.isfinite(now) or now < self._last:
            raise InputError(f"replanner: now is {now} s, want a finite time from {self._last} s on, the last cycle's")
        measured = None if measured is None else usual_measured(measured)
        self._last, latency = now, self.latency
        timer = Timer(self._clock, 1e3 * PLANNED * latency if self.config.drop_late else np.inf)
        self._keep_heading(now, measured)
        # On another core, while the target is predicted.
        flown = meanwhile(lambda: look_ahead(self.planner, self._committed, now, measured, self._ahead))
        predicted = self._predicted(now, observations, measured)
        self._cycles += 1
        timer.lap("predict", predicted)
        ahead = self._ahead = flown()
        start = self._start(now, measured, ahead)
        candidates = later(predicted, start.takeover - now)
        timer.lap("roll out")
        self._certain = not start.measured and (self._certain or self._is_clear(now, 0.0))
        prospect = prospect_for(self.planner.config, candidates)
        passing = None if self._ways is None else Passing(self._ways, self._committed, now)
        certain = self._certain and (ahead is None or _comes_back(ahead, self.config.replan_beyond))
        certain = certain and (passing is None or passing.is_kept)
        lag = self._lag(now, start.takeover, measured)
        known = Known(start, candidates, prospect, self.committed, certain, ahead, passing, lag)
        decision = Decision(self.planner, self.config, self._memory, latency, known, timer)
        lost = start.deviation > self.config.stop_beyond
        above = np.inf if lost else decision.above
        plans = self.planner.plan_batch(start.state, candidates, timer, above)
        wanted = timer.total / PLANNED if timer.is_up and not (plans.reasons == 0).any() else 0.0
        status, chosen = decision.governed(decision.stop(PlanStatus.RECOVER) if lost else decision.among(plans))
        timer.lap("select")
        if chosen is not None and self.config.drop_late and timer.total > 1e3 * latency:
            status, chosen = PlanStatus.LATE, None
        jump = None if chosen is None else self._commit(chosen, start, status)
        timer.lap("select")
        self._adapt(1e-3 * max(timer.total, wanted))
        return Cycle(
            time=now,
            status=status,
            plans=plans,
            chosen=-1 if chosen is None else chosen.candidate,
            stage_ms=timer.stages,
            generated=len(plans.reasons),
            rejected=count_reasons(plans.reasons),
            jump=jump,
            note=Note(candidates.note),
            refused=decision.refused,
            deviation=start.deviation,
            latency=latency,
            sooner=0.0 if chosen is None else chosen.sooner,
        )

    def _predicted(self, now: float, observations: Observations | None, measured: Measured | None) -> Candidates:
        """Where the target may be, or where to look for it."""
        if isinstance(self._predictor, Searcher):
            place = self._committed.at(now).pos if measured is None else measured.position
            self._predictor.look_from(now, np.asarray(place, dtype=float))
            return self._predictor(observations, self._cycles)
        assert observations is not None, "step has refused that"
        return self._predictor(observations, self._cycles)

    def _start(self, now: float, measured: Measured | None, ahead: Ahead | None) -> Start:
        """Where the plans of this cycle begin, never before the newest plan has taken over.

        A vehicle that is near its reference, and still will be then, or that finds back to it, is taken to be on it.
        """
        takeover = max(now + self.latency, self.committed.start_time)
        then = self._committed.at(takeover)
        if measured is None:
            return Start(then, takeover, 0.0, False, 0.0)
        reference = self._committed.at(now)
        deviation = float(np.linalg.norm(measured.position - np.asarray(reference.pos)))
        state = carried_on(measured, reference, then, takeover - now)
        off = max(deviation, float(np.linalg.norm(np.asarray(state.pos) - np.asarray(then.pos))))
        if off <= self.config.replan_beyond:
            return Start(then, takeover, deviation, False, 0.0)
        back = ahead is not None and _comes_back(ahead, self.config.stop_beyond)
        if deviation == off <= self.config.stop_beyond and (back or self._is_clear(now, deviation)):
            return Start(then, takeover, deviation, False, 0.0)
        return Start(state, takeover, deviation, True, self.config.wider_margin)

    def _lag(self, now: float, takeover: float, measured: Measured | None) -> Lag | None:
        """How far the vehicle, if it stays beside its reference as it is now, will be behind what is committed."""
        if measured is None:
            return None
        reference = self._committed.at(takeover)
        then = carried_on(measured, self._committed.at(now), reference, takeover - now)
        if np.linalg.norm(np.asarray(then.pos) - np.asarray(reference.pos)) < BEHIND:
            return None
        return lag_behind(
            self.committed.spline, takeover - self.committed.start_time, np.asarray(then.pos), np.asarray(then.vel)
        )

    def _keep_heading(self, now: float, measured: Measured | None) -> None:
        """Let the reference have the vehicle's heading, where the vehicle cannot hold the reference's."""
        if measured is None or measured.attitude is None:
            return
        yaw = float(self._committed.at(now).yaw[0])
        if abs(turn_from(measured.attitude, yaw)) > self.config.most_turn:
            self._committed.turn(now + self.latency, heading_near(measured.attitude, yaw))

    def _is_clear(self, now: float, wider: float) -> bool:
        """Whether what is left of the committed plan keeps its distance from obstacles, and so much [m] more."""
        verdict = self.planner.validate(self.committed.spline, now - self.committed.start_time, None, wider)
        return not verdict.faults & Fault.CLEARANCE

    def _commit(self, chosen: Chosen, start: Start, status: PlanStatus) -> Float[np.ndarray, "5"]:
        """Add a plan; returns its discontinuity from where it should begin, as ``Cycle.jump``."""
        spline = chosen.spline
        if chosen.anew:
            start = start._replace(state=spline.state(0.0), measured=True)
        plan = CommittedPlan(
            start_time=start.takeover,
            spline=spline,
            goal=chosen.goal,
            arrival_time=start.takeover + chosen.arrival_time,
            alpha=chosen.slowdown,
            status=status,
            probability=chosen.probability,
            from_measured=start.measured,
        )
        self._committed.add(plan)
        self._certain = status is not PlanStatus.BLOCKED
        jump = np.abs(spline.state(0.0).derivatives - start.state.derivatives).max(axis=-1)
        jump[4] /= max(float(np.abs(start.state.snap).max()), 1.0)
        return jump

    def _adapt(self, seconds: float) -> None:
        """Let the latency follow what cycles take, or would have needed, where that is wanted."""
        if self.config.most_latency is not None:
            self._took.append(seconds)
            wanted = RESERVE * float(np.quantile(self._took, 0.99))
            self.latency = float(np.clip(wanted, self.config.latency, self.config.most_latency))


def _comes_back(ahead: Ahead, most: float) -> bool:
    """Whether the model, along what is committed, stays clear and within so much [m] of it."""
    committed, twist = ahead.committed, ahead.most_twist
    return bool(committed.clear[0] and committed.error[0] <= most and committed.twist[0] <= twist)
