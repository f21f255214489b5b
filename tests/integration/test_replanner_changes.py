"""Boxes that appear on the committed path: the vehicle flies another way, or stops before them."""

import jax
import numpy as np
import pytest

from jaxplan.compilation import compilations
from jaxplan.planner import build_planner
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.prediction.observations import first_observation
from jaxplan.replanner import Replanner
from jaxplan.spline import hover
from jaxplan.status import PlanStatus
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.clearance import free_distance
from jaxplan.world.load import load_world
from jaxplan.world.update import update_world, with_spare_boxes
from oracles.planner_cases import CONFIG, START
from tolerances import tolerance

GOALS = np.array([[-4.0, 3.0, 1.0], [-4.2, 4.0, 1.2], [-3.9, 2.5, 0.8]])
"""Along the wall from the start on."""


@pytest.fixture(scope="module")
def planner():
    world = with_spare_boxes(load_world("env1"), 1)
    built = build_planner(CONFIG, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    built.warmup(hover(START))
    return built


class Later:
    """One goal, met a while after each cycle, until it is given up."""

    def __init__(self, goal):
        self.goal = goal

    def __call__(self, observations, cycle):
        return candidates_from(self.goal, self.goal[None], np.array([max(2.4 - 0.1 * cycle, 0.3)]), np.zeros(1))


def box_ahead(replanner, now):
    """Half a metre of box on the committed path, beyond a stop at 9 m/s^2 that begins when the next plan could."""
    plan = replanner.committed
    times = np.arange(now, plan.start_time + float(plan.spline.duration), 0.01)
    states = replanner.reference(times)
    begin = min(25, len(times) - 1)
    speed = np.linalg.norm(states.vel[begin])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(states.pos, axis=0), axis=1))])
    place = states.pos[np.argmax(way > way[begin] + speed**2 / 18.0 + 0.75)]
    return np.array([place - 0.25, place + 0.25]), speed


def flown_clearance(world, replanner, since, until):
    with jax.enable_x64(True):
        return float(np.min(free_distance(world, replanner.reference(np.arange(since, until, 0.005)).pos)))


@pytest.mark.parametrize("goal", GOALS, ids=str)
@pytest.mark.parametrize("given_up", [False, True])
def test_a_box_on_the_committed_path_is_not_flown_through(planner, goal, given_up):
    predictor = Later(goal)
    replanner, seen = Replanner(planner, predictor, hover(START)), first_observation(0.0, START)
    for cycle in range(8):
        replanner.step(0.1 * cycle, seen)
    corners, speed = box_ahead(replanner, 0.8)
    assert speed > 1.5
    world = update_world(with_spare_boxes(load_world("env1"), 1), add_box=tuple(corners))
    assert flown_clearance(world.world, replanner, 0.8, 4.0) < 0.0
    counted = compilations()
    replanner.update(world)
    if given_up:
        predictor.goal = corners.mean(axis=0)
    after = [replanner.step(0.1 * cycle, seen) for cycle in range(8, 40)]
    assert compilations() == counted
    assert flown_clearance(world.world, replanner, 0.8, 8.0) >= load_vehicle().radius
    safe = {PlanStatus.BRAKE} if given_up else {PlanStatus.BRAKE, PlanStatus.APPROACH, PlanStatus.INTERCEPT}
    assert after[0].status in safe
    jumps = np.array([cycle.jump for cycle in after if cycle.jump is not None])
    assert jumps.max() <= 1e-6


def test_a_change_elsewhere_changes_nothing(planner):
    seen, ways = first_observation(0.0, START), []
    change = update_world(with_spare_boxes(load_world("env1"), 1), add_box=([4.0, 4.0, 0.0], [4.5, 4.5, 1.0]))
    for changed in (False, True):
        replanner = Replanner(planner, Later(GOALS[0]), hover(START))
        for cycle in range(12):
            if changed and cycle == 6:
                replanner.update(change)
            replanner.step(0.1 * cycle, seen)
        ways.append(replanner.reference(np.arange(0.0, 4.0, 0.05)).pos)
    np.testing.assert_allclose(ways[0], ways[1], **tolerance("formula"))


def test_a_hover_where_a_box_appears_is_left_or_said_to_be_blocked(planner):
    """Nothing to brake: no stop from inside an obstacle is clear."""
    replanner = Replanner(planner, Later(START + np.array([0.0, 0.0, 99.0])), hover(START))
    change = update_world(with_spare_boxes(load_world("env1"), 1), add_box=(START - 0.5, START + 0.5))
    replanner.update(change)
    assert replanner.step(0.0, first_observation(0.0, START)).status is PlanStatus.BLOCKED
