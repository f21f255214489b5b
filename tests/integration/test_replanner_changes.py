"""Boxes that appear on the committed path: the vehicle flies another way, or stops before them."""

import jax
import numpy as np
import pytest

from jaxplan.compilation import compilations
from jaxplan.planner import build_planner, select_stop
from jaxplan.planner.brake import DECELERATIONS
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.prediction.observations import first_observation
from jaxplan.records import replace
from jaxplan.replanner import Replanner
from jaxplan.spline import FlatState, hover
from jaxplan.status import PlanStatus, Reason
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


def test_stops_along_a_plan_go_its_way_and_ask_for_no_more_than_they_say(planner):
    replanner, seen = Replanner(planner, Later(GOALS[0]), hover(START)), first_observation(0.0, START)
    for cycle in range(8):
        replanner.step(0.1 * cycle, seen)
    spline, since = replanner.committed.spline, 0.9 - replanner.committed.start_time
    state = spline.state(since)
    straight, both = planner.brake(state), planner.brake(state, spline, since)
    more = range(len(straight.reasons), len(both.reasons))
    assert len(more) == 2 * len(DECELERATIONS)
    assert len(both.reasons) <= CONFIG.width or CONFIG.width < 64, "one call of the stations"
    path = np.asarray(spline.evaluate(np.linspace(since, float(spline.duration), 2000)))[:, :3]
    for index in more:
        stop = both.spline(index)
        times = np.linspace(0.0, float(stop.duration), 100)
        flown, acceleration = (np.asarray(stop.evaluate(times, order))[:, :3] for order in (0, 2))
        assert np.linalg.norm(flown[:, None] - path[None], axis=2).min(axis=1).max() < 0.3
        assert float(np.linalg.norm(stop.state(times[-1]).vel)) < 1e-6
        np.testing.assert_allclose(stop.state(0.0).derivatives[:4], state.derivatives[:4], **tolerance("solve"))
        asked = np.linalg.norm(acceleration + np.array([0.0, 0.0, 9.81]), axis=1).max()
        assert both.thrust[index] == pytest.approx(asked, rel=0.05)
    ends = np.linalg.norm(both.goals[list(more)] - np.asarray(state.pos), axis=1)
    assert ends.max() > 1.5 * ends.min()


def test_every_stop_says_how_hard_it_hits(planner):
    """0.7 m before a wall at 7 m/s: some hit it, and all say of themselves what is found for each alone."""
    derivatives = np.zeros((5, 3))
    derivatives[0], derivatives[1] = START, [-7.0, 0.0, 0.0]
    stops = planner.brake(FlatState(derivatives=derivatives, yaw=np.zeros(3)))
    alone = [planner.impact(stops.spline(index), 0.0) for index in range(len(stops.reasons))]
    np.testing.assert_allclose(stops.impact, alone, **tolerance("formula"))
    assert (stops.impact > 3.0).any()


def test_of_stops_the_gentlest_that_can_be_flown_is_taken(planner):
    """Then one that only turns fast, then the clear one of least thrust, then the softest hit."""
    found = planner.brake(hover(START))
    count = len(found.reasons)

    def of(reasons, thrust):
        kinds = np.full(count, np.uint32(Reason.CLEARANCE))
        kinds[: len(reasons)] = reasons
        order = 1.0 * np.arange(count)
        return replace(found, reasons=kinds, arrival_times=order, thrust=np.resize(thrust, count), impact=order + 1.0)

    clear, turning, lost = 0, np.uint32(Reason.BODY_RATE), np.uint32(Reason.UNTRACKABLE | Reason.BODY_RATE)
    assert select_stop(of([clear, clear, turning, lost], [1.0])) == 1
    assert select_stop(of([turning, turning, lost], [1.0])) == 1
    assert select_stop(of([lost, lost, lost], [30.0, 20.0, 25.0])) == 1
    assert select_stop(of([], [3.0])) == 0
