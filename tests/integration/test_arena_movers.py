"""Boxes that move: what a planner of still ones is told, and that plans keep clear of it and of them."""

import numpy as np
import pytest

from experiments.arena.movers import MOST, Mover, Traffic, Warned
from jaxplan.errors import InputError
from jaxplan.planner import build_planner
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.prediction.observations import first_observation
from jaxplan.replanner import MovingBoxes, Replanner, Ways
from jaxplan.spline import hover
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from jaxplan.world.update import with_spare_boxes
from oracles.planner_cases import CONFIG, START

GOAL = np.array([-4.0, 3.0, 1.0])


@pytest.fixture(scope="module")
def world():
    return with_spare_boxes(load_world("env1"), MOST)


@pytest.fixture(scope="module")
def planner(world):
    built = build_planner(CONFIG, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    built.warmup(hover(START))
    return built


def towards_goal(observations, cycle):
    """One goal, met a while after each cycle."""
    return candidates_from(GOAL, GOAL[None], np.array([max(3.6 - 0.1 * cycle, 0.5)]), np.zeros(1))


def nowhere(observations, cycle):
    """A goal that cannot be reached in time."""
    return candidates_from(GOAL, GOAL[None], np.array([0.1]), np.zeros(1))


def flown(planner, world, traffic, cycles=36):
    """Where the reference has been, and how often the planner was told something."""
    replanner = Replanner(planner, towards_goal, hover(START))
    guide = Warned(replanner, traffic, world, float(load_vehicle().radius))
    for cycle in range(cycles):
        guide.step(0.1 * cycle, first_observation(0.1 * cycle, GOAL))
    times = np.arange(0.0, 0.1 * cycles, 0.01)
    return times, guide.reference(times).pos, guide.boxes.changes


def crossing(phase):
    """A box that crosses the straight way to the goal."""
    middle = START + 0.5 * (GOAL - START)
    across = np.cross(GOAL - START, [0.0, 0.0, 1.0])
    return Mover(np.array([0.3, 0.3, 0.6]), middle, 1.2 * across / np.linalg.norm(across), 1.2, phase)


def test_plans_keep_clear_of_what_crosses_their_way(planner, world):
    """Whether its way is known or only seen; who is told nothing is hit."""
    radius, phases = float(load_vehicle().radius), (0.0, 1.6, 3.2, 4.7)
    touched = {"known": 0, "seen": 0, "nothing": 0}
    for phase in phases:
        real = Traffic((crossing(phase),), True)
        far = Traffic((crossing(phase)._replace(middle=START + np.array([0.0, 0.0, 50.0])),), True)
        for name, told in (("known", real), ("seen", real._replace(known=False)), ("nothing", far)):
            times, way, changes = flown(planner, world, told)
            touched[name] += real.distances(times, way).min() < radius
            assert (changes > 0) == (name != "nothing")
            assert np.linalg.norm(way[-1] - START) > 0.5
    assert touched["known"] == touched["seen"] == 0 < touched["nothing"]


@pytest.mark.slow
def test_who_stands_in_the_way_of_a_box_leaves_in_time(planner, world):
    """Nothing can be met; boxes come across the place where the vehicle hovers, from all sides."""
    radius, hovering = float(load_vehicle().radius), np.array([0.0, 0.0, 1.2])
    for course in np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False):
        way = np.array([np.cos(course), np.sin(course), 0.0])
        box = Mover(np.array([0.3, 0.3, 0.5]), hovering, 2.0 * way, 0.9, -0.5 * np.pi)
        for known in (True, False):
            traffic, times = Traffic((box,), known), np.arange(0.0, 4.0, 0.01)
            guide = Warned(Replanner(planner, nowhere, hover(hovering)), traffic, world, radius)
            for cycle in range(40):
                guide.step(0.1 * cycle, first_observation(0.1 * cycle, GOAL))
            assert traffic.distances(times, np.tile(hovering, (len(times), 1))).min() == 0.0
            assert traffic.distances(times, guide.reference(times).pos).min() > radius


def test_what_is_far_away_is_not_told(planner, world):
    far = crossing(0.0)._replace(middle=START + np.array([0.0, 0.0, 50.0]))
    assert flown(planner, world, Traffic((far,), True), cycles=3)[2] == 0


def test_boxes_that_are_not_known_of_are_told_once_they_are(planner, world):
    replanner = Replanner(planner, nowhere, hover(START))
    boxes, times = MovingBoxes(replanner, world, 2), np.arange(0.0, 1.8, 0.025)
    lower = np.full((2, len(times), 3), [2.0, 2.0, 0.5])
    lower[1] = np.nan
    ways = Ways(times, lower, lower + 0.5, 0.3)
    boxes.tell(ways, START)
    assert boxes.changes == 1
    boxes.tell(ways, START)  # nothing new
    assert boxes.changes == 1
    lower[1] = [-2.0, 2.0, 0.5]
    boxes.tell(Ways(times, lower, lower + 0.5, 0.3), START)
    assert boxes.changes == 2
    with pytest.raises(InputError, match="moving boxes: have ways of 1, want those of 2"):
        boxes.tell(Ways(times, lower[:1], lower[:1] + 0.5, 0.3), START)
    with pytest.raises(InputError, match="moving boxes"):
        MovingBoxes(replanner, world, len(world.boxes.center) + 1)
