"""Refinements in the loop: as many steps as there is time for, and never a late plan for their sake."""

import numpy as np
import pytest

from jaxplan.compilation import compilations
from jaxplan.planner import PlannerConfig, RefinementConfig, build_planner
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.prediction.observations import first_observation
from jaxplan.replanner import Replanner, ReplannerConfig
from jaxplan.replanner.pace import FIRST, REMEMBERED, Pace
from jaxplan.spline import hover
from jaxplan.status import PlanStatus
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


@pytest.mark.parametrize(("taken", "refined"), [(0.0, True), (0.06, True), (0.0795, False), (0.09, False)])
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
