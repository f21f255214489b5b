"""A vehicle that falls behind its reference takes it along, and does not lose it."""

import numpy as np
import pytest

from jaxplan.planner import Fault, build_planner
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.prediction.observations import first_observation
from jaxplan.replanner import Measured, Replanner, ReplannerConfig
from jaxplan.spline import hover
from jaxplan.status import PlanStatus
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from oracles.planner_cases import CONFIG, GOAL, START, nowhere
from tolerances import assert_close

SEEN = first_observation(0.0, START)
NOW, BEHIND, SHARE = 1.1, 0.3, 0.8
"""When the vehicle is so far behind [m], and how fast it is by what is planned where it is."""


@pytest.fixture(scope="module")
def planner():
    built = build_planner(CONFIG, world=load_world("env1"), vehicle=load_vehicle(), policy=constant_speed_policy())
    built.warmup(hover(START))
    return built


def once(observations, cycle):
    """One goal, met 2.5 s after the first cycle."""
    return candidates_from(GOAL, GOAL[None], np.array([2.5]), np.zeros(1))


def flying(planner):
    """A replanner that flies to the goal, and will see no other."""
    replanner = Replanner(planner, once, hover(START))
    assert replanner.step(0.0, SEEN).status is PlanStatus.INTERCEPT
    return Replanner(planner, nowhere, replanner.committed)


def measured(plan, now, behind, share):
    """So far [m] behind along the plan."""
    since = now - plan.start_time
    times = np.linspace(0.0, since, 2000)
    way = np.asarray(plan.spline.evaluate(times))[:, :3]
    left = np.cumsum(np.linalg.norm(np.diff(way[::-1], axis=0), axis=1))
    there = plan.spline.state(since - times[int(np.searchsorted(left, behind))] if behind else since)
    return Measured(np.asarray(there.pos), share * np.asarray(there.vel), np.asarray(there.acc))


def test_it_flies_the_same_path_from_where_it_is_and_as_fast_as_it_is(planner):
    replanner = flying(planner)
    before = replanner.committed
    vehicle = measured(before, NOW, BEHIND, SHARE)
    cycle = replanner.step(NOW, SEEN, vehicle)
    after = replanner.committed
    assert cycle.status is PlanStatus.SLOWED
    assert after.from_measured
    assert (cycle.jump == 0.0).all()
    first = after.spline.state(0.0)
    expected = vehicle.position + cycle.latency * vehicle.velocity
    assert np.linalg.norm(first.pos - expected) < 0.05
    faster = vehicle.velocity + cycle.latency * vehicle.acceleration
    assert np.linalg.norm(first.vel) == pytest.approx(np.linalg.norm(faster), rel=0.15)
    path = np.asarray(before.spline.sample(4000)[1])[:, :3]
    flown = np.asarray(after.spline.sample(50)[1])[:, :3]
    assert np.linalg.norm(flown[:, None] - path, axis=2).min(axis=1).max() < 0.01
    assert_close(flown[-1], path[-1], "formula")
    assert after.arrival_time > before.arrival_time
    assert not replanner.planner.validate(after.spline, 0.0, None, 0.0).faults & Fault.CLEARANCE


def test_one_that_keeps_up_flies_on_as_planned(planner):
    replanner = flying(planner)
    cycle = replanner.step(NOW, SEEN, measured(replanner.committed, NOW, 0.0, 1.0))
    assert cycle.status is PlanStatus.NO_CANDIDATE
    assert len(replanner.plans) == 1


@pytest.mark.parametrize("latency", [0.3, 0.6, 1.0])
def test_one_that_keeps_up_is_not_taken_to_stay_behind_when_the_plan_speeds_up_before_its_takeover(planner, latency):
    """However late that is: it is taken to stay beside its reference, and not to fly straight on."""
    committed = flying(planner).committed
    for now in (0.2, 0.5, NOW):
        replanner = Replanner(planner, nowhere, committed, ReplannerConfig(latency=latency))
        assert replanner.step(now, SEEN, measured(committed, now, 0.0, 1.0)).status is PlanStatus.NO_CANDIDATE


def test_one_that_is_not_measured_is_taken_to_keep_up(planner):
    assert flying(planner).step(NOW, SEEN).status is PlanStatus.NO_CANDIDATE


def test_an_interception_comes_first(planner):
    replanner = flying(planner)
    vehicle = measured(replanner.committed, NOW, BEHIND, SHARE)
    blind = planner._replace(roll_out=lambda *_: None)
    again = Replanner(blind, once, replanner.committed._replace(goal=GOAL + 3.0))
    assert again.step(NOW, SEEN, vehicle).status is PlanStatus.INTERCEPT
    alone = Replanner(blind, nowhere, replanner.committed)
    assert alone.step(NOW, SEEN, vehicle).status is PlanStatus.SLOWED


def test_the_cycle_at_its_takeover_looks_at_the_slower_plan(planner):
    replanner = flying(planner)
    replanner.step(NOW, SEEN, measured(replanner.committed, NOW, BEHIND, SHARE))
    slowed = replanner.committed
    assert slowed.status is PlanStatus.SLOWED
    early = slowed.start_time - 1e-12
    assert_close(replanner.reference(np.array([early])).pos[0], slowed.spline.state(0.0).pos, "formula")
