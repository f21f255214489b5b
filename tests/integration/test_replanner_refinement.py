"""Refinements in the loop, and what else it does where there is time, and never a late plan for their sake."""

import numpy as np
import pytest

from jaxplan.compilation import compilations
from jaxplan.planner import PlannerConfig, RefinementConfig, build_planner
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.prediction.futures import Futures
from jaxplan.prediction.observations import first_observation
from jaxplan.records import replace
from jaxplan.replanner import Measured, Replanner, ReplannerConfig
from jaxplan.replanner.committed import hold
from jaxplan.replanner.pace import FIRST, REMEMBERED, Pace
from jaxplan.replanner.vain import TWICE, WORSE, Vain
from jaxplan.spline import hover
from jaxplan.status import PlanStatus, Reason
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from oracles.planner_cases import START

STEPS = 12


@pytest.fixture(scope="module")
def planner():
    config = PlannerConfig(width=16, refinement=RefinementConfig(iterations=STEPS))
    built = build_planner(config, world=load_world("env1"), vehicle=load_vehicle(), policy=constant_speed_policy())
    built.warmup(hover(START))
    return built


class Watch:
    """A clock that only goes on while the target is predicted."""

    def __init__(self, seconds):
        self.seconds, self.now = seconds, 0.0

    def __call__(self, *observed):
        if not observed:
            return self.now
        self.now += self.seconds
        times = 0.1 * np.arange(1, 31) - 0.1 * observed[1]
        goals = START + np.array([1.6, 0.3, 0.2]) + (times + 0.1 * observed[1])[:, None] * np.array([0.4, 0.1, 0.0])
        return candidates_from(goals[0], goals, times, np.zeros(30))


@pytest.mark.parametrize(("taken", "refined"), [(0.0, True), (0.03, True), (0.0395, False), (0.045, False)])
def test_a_cycle_refines_in_the_time_that_is_left(planner, taken, refined):
    watch, counted = Watch(taken), compilations()
    replanner = Replanner(planner, watch, hover(START), ReplannerConfig(drop_late=True), watch)
    cycle = replanner.step(0.0, first_observation(0.0, START))
    assert compilations() == counted
    assert cycle.status is PlanStatus.INTERCEPT
    assert ("refine" in cycle.stage_ms) == refined
    assert cycle.sooner > 0.0 or taken > 0.0


def test_without_a_deadline_all_steps_are_taken_whatever_the_time(planner):
    found = []
    for taken in (0.0, 5.0):
        watch = Watch(taken)
        replanner = Replanner(planner, watch, hover(START), ReplannerConfig(), watch)
        found.append(replanner.step(0.0, first_observation(0.0, START)))
    assert found[0].sooner == found[1].sooner > 0.0


def test_steps_follow_the_slowest_of_the_last_refinements():
    pace = Pace()
    assert pace.steps(left=100.0, latency=100.0) == int(80.0 / FIRST)
    pace.took(120.0, STEPS)
    assert pace.steps(left=100.0, latency=100.0) == 8
    for _ in range(REMEMBERED):
        pace.took(24.0, STEPS)
    assert pace.steps(left=100.0, latency=100.0) == 40
    assert pace.steps(left=20.0, latency=100.0) == pace.steps(left=-5.0, latency=100.0) == 0


def test_corrections_that_are_left_out_are_expected_to_take_less_until_they_are_tried_again():
    pace = Pace()
    assert pace.corrects(left=np.inf, latency=50.0)
    assert pace.corrects(left=1.0, latency=4.0)
    assert not pace.corrects(left=0.8, latency=4.0), "all of it is spare"
    pace.corrected(30.0)
    assert [pace.corrects(left=36.0, latency=50.0) for _ in range(3)] == [False, False, True]
    pace.corrected(1.0)
    assert not pace.corrects(left=30.0, latency=50.0), "once they took longer"


@pytest.mark.parametrize(
    ("taken", "drop", "tried"), [(0.045, True, "YYY"), (0.055, True, "nnn"), (0.055, False, "YYY")]
)
def test_a_cycle_approaches_only_where_it_is_not_late_already(planner, taken, drop, tried):
    watch, asked = Watch(0.0), []

    def approach(state, candidates):
        asked.append("Y")
        return planner.approach(state, candidates)

    def nowhere(observations, cycle):
        watch.now += taken
        return candidates_from(START, START[None] + 3.0, np.array([0.1]), np.zeros(1))

    settings = ReplannerConfig(drop_late=drop)
    replanner = Replanner(planner._replace(approach=approach), nowhere, hover(START), settings, watch)
    statuses = []
    for cycle in range(len(tried)):
        asked.append("n")
        statuses.append(replanner.step(0.1 * cycle, first_observation(0.1 * cycle, START)).status)
    assert "".join(asked).replace("nY", "Y") == tried
    assert statuses.count(PlanStatus.LATE) == tried.count("n")


@pytest.mark.parametrize(("taken", "corrected"), [(0.0, True), (0.045, False)])
def test_corrections_make_no_plan_late_that_passes(planner, taken, corrected):
    """The vehicle moves, off its reference, and 45 of the 50 ms are over."""
    watch, asked = Watch(taken), []

    def correct(state, prospect):
        asked.append(state)
        return planner.correct(state, prospect)

    def predicted(observations, cycle):
        found = watch(observations, cycle)
        positions = np.concatenate([[found.target], found.goals])[None]
        futures = Futures(times=0.1 * np.arange(31), positions=positions, weights=np.ones(1))
        return replace(found, futures=futures)

    def hasty(state, candidates, timer, above):
        return planner.plan_batch(state, candidates, None, above)

    moving = planner._replace(correct=correct, plan_batch=hasty)
    settings = ReplannerConfig(drop_late=True)
    replanner = Replanner(moving, predicted, hover(START), settings, watch)
    off = Measured(START - np.array([0.0, 0.0, 0.55]), np.array([0.4, 0.0, 0.0]), np.zeros(3))
    cycle = replanner.step(0.0, first_observation(0.0, START), off)
    assert (cycle.plans.reasons == 0).any()
    assert bool(asked) == corrected
    assert cycle.status is PlanStatus.INTERCEPT


def test_what_was_tried_in_vain_is_tried_again_only_against_another_plan_or_a_worse_one():
    vain, plan, other = Vain(), hold(hover(START)), hold(hover(START))
    vain.against(plan, 3.0)
    assert vain.is_worth("refine")
    vain.remember("refine")
    assert not vain.is_worth("refine")
    assert vain.is_worth("stop")
    for meeting, worth in ((2.5, False), (3.0 + 0.9 * WORSE, False), (3.0 + 1.1 * WORSE, True), (np.inf, True)):
        vain.against(plan, meeting)
        assert vain.is_worth("refine") == worth
    vain.against(other, 3.0)
    assert vain.is_worth("refine")


def test_what_may_be_tried_twice_is_counted_anew_where_the_plan_has_become_worse():
    vain, plan = Vain(), hold(hover(START))
    vain.against(plan, 3.0)
    vain.remember("refine")
    assert vain.is_worth("refine", TWICE)
    vain.remember("refine")
    assert not vain.is_worth("refine", TWICE)
    vain.against(plan, 3.0 + 1.1 * WORSE)
    assert vain.is_worth("refine", TWICE)
    vain.remember("refine")
    assert vain.is_worth("refine", TWICE)
    vain.remember("refine")
    assert not vain.is_worth("refine", TWICE)


def test_what_came_to_nothing_for_a_new_plan_is_not_tried_again_once_that_is_committed():
    vain, plan, other, third = Vain(), hold(hover(START)), hold(hover(START)), hold(hover(START))
    vain.against(plan, 3.0)
    vain.remember("refine", new=True)
    vain.against(other, 2.5)
    assert not vain.is_worth("refine")
    assert vain.is_worth("stop")
    vain.remember("refine", new=True)
    vain.forget("refine")
    vain.against(third, 2.0)
    assert vain.is_worth("refine")


def test_what_was_tried_in_vain_may_be_tried_again_in_a_changed_world():
    vain, plan = Vain(), hold(hover(START))
    vain.against(plan, 3.0)
    vain.remember("plan")
    vain.remember("stop")
    assert not vain.is_worth("plan")
    vain.again("plan")
    assert vain.is_worth("plan")
    assert not vain.is_worth("stop")


@pytest.mark.parametrize(("receding", "least", "most"), [(0.0, 1, 3), (0.2, 4, 6)])
def test_a_committed_plan_is_refined_again_where_it_has_become_worse(planner, receding, least, most):
    """The target flies as predicted, or each prediction has it farther away than the one before."""
    asked = []

    def refine(state, candidates, seed, iterations=None):
        asked.append(state)
        return planner.refine(state, candidates, seed, iterations)

    def predicted(observations, cycle):
        times = 0.1 * np.arange(0, 31)
        flown = (times + 0.1 * cycle)[:, None] * np.array([0.4, 0.1, 0.0])
        ahead = np.array([1.6 + receding * cycle, 0.3, 0.2]) + flown
        found = candidates_from(START + ahead[0], START + ahead[1:], times[1:], np.zeros(30))
        return replace(found, futures=Futures(times=times, positions=(START + ahead)[None], weights=np.ones(1)))

    replanner = Replanner(planner._replace(refine=refine), predicted, hover(START))
    cycles = [replanner.step(0.1 * cycle, first_observation(0.1 * cycle, START)) for cycle in range(6)]
    assert [cycle.status for cycle in cycles].count(PlanStatus.KEPT_COMMITTED) >= 3
    assert least <= len(asked) <= most


@pytest.mark.parametrize(("promise", "tried"), [(0.0, TWICE), (1.0, 6)])
def test_by_eq_9_a_committed_plan_is_refined_as_long_as_that_promises_enough(planner, promise, tried):
    """Refinements that may not be flown, though they would be so much sooner [s], or that find nothing sooner."""
    asked, found = [], []

    def refine(state, candidates, seed, iterations=None):
        asked.append(seed)
        found.extend([] if found else [planner.refine(state, candidates, seed, iterations)])
        return found[0]._replace(reasons=Reason.UNTRACKABLE, promise=seed.meeting - promise)

    def predicted(observations, cycle):
        times = 0.1 * np.arange(1, 31)
        goals = START + np.array([1.6, 0.3, 0.2]) + (times + 0.1 * cycle)[:, None] * np.array([0.4, 0.1, 0.0])
        return candidates_from(goals[0], goals, times, np.zeros(30))

    watched = planner._replace(refine=refine)
    replanner = Replanner(watched, predicted, hover(START))
    first = replanner.step(0.0, first_observation(0.0, START))
    assert first.status is PlanStatus.INTERCEPT
    assert replanner.committed.arrival_time > 0.9, "long enough for six more cycles"
    asked.clear()
    cycles = [replanner.step(0.1 * cycle, first_observation(0.1 * cycle, START)) for cycle in range(1, 7)]
    assert {cycle.status for cycle in cycles} == {PlanStatus.KEPT_COMMITTED}
    assert len(asked) == tried
