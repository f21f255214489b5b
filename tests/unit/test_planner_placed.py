"""Waypoints and times of all candidates by a placing policy: courses, arrivals, and the planner that asks it."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.arrival import ArrivalConfig
from jaxplan.compilation import compilations
from jaxplan.errors import InputError
from jaxplan.feasibility.checkpoint import load_classifier
from jaxplan.planner import PlannerConfig, build_planner
from jaxplan.planner.placed import build_match_placed, courses_along, meet_radii
from jaxplan.planner.refined import RefinementConfig
from jaxplan.planner.stations import Routes
from jaxplan.planner.validator import Room
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.policy.placing import SEGMENTS, Courses, Placed
from jaxplan.policy.placing_checkpoint import load_placing
from jaxplan.precision import in_float64
from jaxplan.prediction.candidates import candidates_from
from jaxplan.spline import hover
from jaxplan.status import Reason
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from oracles.planner_cases import START
from tolerances import assert_close

NUMBERS = np.zeros(6)


class Slab(Room):
    """Everything below the floor at 0 m is solid."""

    def free_distance(self, points):
        return points[..., 2]


EMPTY = Slab((), np.array([[-50.0, -50.0, 0.0], [50.0, 50.0, 20.0]]))
WAY = np.array([[0.0, 0.0, 2.0], [3.0, 0.0, 2.0], [3.0, 2.0, 2.0]])


def routes(stops):
    """One path around a corner, 5 m long, and on to each stop."""
    width, samples = len(stops), []
    for stop in stops:
        corners = np.concatenate([WAY, [stop]])
        travelled = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))]
        along = np.linspace(0.0, travelled[-1], 256)
        samples.append(np.stack([np.interp(along, travelled, corners[:, axis]) for axis in range(3)], axis=1))
    waypoints = np.concatenate([np.repeat(WAY[..., None], width, axis=2), np.asarray(stops, float).T[None]])
    return Routes(
        waypoints=waypoints,
        count=np.full(width, 4, np.int32),
        meet=np.full(width, 2, np.int32),
        samples=np.stack(samples, axis=-1),
        reasons=np.zeros(width, np.uint32),
        velocity=np.full((3, width), np.nan),
    )


def test_courses_go_along_the_path_in_even_steps_and_on_to_the_stop():
    stops = [[3.0, 5.0, 2.0], [6.0, 2.0, 2.0]]
    courses, placed = courses_along(routes(stops), EMPTY, np.array([0.3, 0.1]), NUMBERS)
    assert courses.points.shape == (SEGMENTS + 1, 3, 2)
    even = [[0, 0, 2], [1, 0, 2], [2, 0, 2], [3, 0, 2], [3, 1, 2], [3, 2, 2]]
    for lane in range(2):
        np.testing.assert_allclose(courses.points[:-1, :, lane], even, atol=0.03)
    np.testing.assert_array_equal(courses.points[-1].T, stops)
    assert_close(courses.room[:, 0], np.full((12, 2), 2.0), "formula")
    assert_close(courses.room[:, 1:], np.broadcast_to([[[0.0], [0.0], [1.0]]], (12, 3, 2)), "solve")
    np.testing.assert_array_equal(placed.count, SEGMENTS + 1)
    np.testing.assert_array_equal(placed.meet, SEGMENTS - 1)
    assert placed.waypoints is courses.points


def slower_when_slow(courses, initial):
    """1 s to the meeting from rest, less from speed; it moves its second point by the speed along x."""
    speed = jnp.asarray(initial.derivatives)[1, 0]
    durations = jnp.full((SEGMENTS, speed.shape[0]), 0.2) / (1.0 + 0.1 * jnp.abs(speed))[None]
    return Placed(durations, jnp.asarray(courses.points).at[1, 0].add(0.1 * speed))


def courses(width):
    points = np.repeat(np.linspace([0.0, 0.0, 2.0], [6.0, 0.0, 2.0], SEGMENTS + 1)[..., None], width, axis=2)
    return Courses(points, np.zeros((12, 4, width)), np.full(width, 0.3), np.zeros((6, width)))


@in_float64
def matched(state, times):
    match = build_match_placed(slower_when_slow, ArrivalConfig(tolerance=1e-4))
    return match(state, courses(len(times)), np.asarray(times))


def test_each_candidate_arrives_when_its_target_does_with_the_points_of_that_pace():
    resting = hover(np.array([0.0, 0.0, 2.0]))
    moving = np.array(resting.derivatives, float)
    moving[1, 0] = 3.0
    state = dataclasses.replace(resting, derivatives=moving)
    arrival, points = matched(state, [0.5, 1.0, 1.5, 2.0])
    reasons, alpha = np.asarray(arrival.reasons), np.asarray(arrival.alpha)
    assert reasons[0] == Reason.ALPHA_LT_1, "no sooner than the policy has it"
    np.testing.assert_array_equal(reasons[1:], 0)
    assert_close(np.asarray(arrival.durations)[:-1].sum(axis=0)[1:], [1.0, 1.5, 2.0], "formula")
    np.testing.assert_allclose((alpha / (1.0 + 0.3 * alpha))[1:], [1.0, 1.5, 2.0], rtol=1e-3)
    assert_close(np.asarray(points)[1, 0, 1:], 1.0 + 0.3 * alpha[1:], "formula")


def test_targets_are_passed_nearer_where_less_is_known_of_them():
    rng = np.random.default_rng(0)
    times = np.repeat([1.0, 2.0], 200)
    goals = np.array([3.0, 0.0, 2.0]) + rng.normal(size=(400, 3)) * np.repeat([0.01, 0.5], 200)[:, None]
    candidates = candidates_from(goals[0], goals, times, np.zeros(400))
    config = RefinementConfig()
    near, far = meet_radii(candidates, np.array([1.0, 2.0]), config)
    assert 0.25 < near < config.meet_radius
    assert far == config.least_radius


@pytest.fixture(scope="module")
def planners():
    world, vehicle, policy = load_world("env1"), load_vehicle(), constant_speed_policy(1.0)
    made = {}
    for place in ("chosen", "all"):
        config = PlannerConfig(width=16, place=place, allocate="policy")
        made[place] = build_planner(
            config,
            world=world,
            vehicle=vehicle,
            policy=policy,
            classifier=load_classifier("mfrl"),
            placing=load_placing("fleet"),
        )
        made[place].warmup(hover(START))
    return made


@pytest.mark.slow
def test_a_planner_asks_it_for_all_candidates_and_meets_what_it_could_not(planners):
    times = np.linspace(0.95, 1.1, 10)
    goals = np.repeat((START + np.array([2.0, 0.5, 0.2]))[None], 10, axis=0)
    candidates = candidates_from(goals[0], goals, times, np.zeros(10))
    counted = compilations()
    alone, placed = (planners[place].plan_batch(hover(START), candidates) for place in ("chosen", "all"))
    assert compilations() == counted
    assert not (np.asarray(alone.reasons) == 0).any()
    best = int(np.argmax(np.where(placed.reasons == 0, placed.score, -np.inf)))
    assert placed.reasons[best] == 0
    spline = placed.spline(best)
    assert len(spline.durations) >= SEGMENTS
    meeting = np.cumsum(spline.durations)[SEGMENTS - 2]
    assert_close(meeting, times[best], "formula", np.float32)
    apart = np.linalg.norm(np.asarray(spline.evaluate(times[best]))[:3] - goals[best])
    assert apart <= RefinementConfig().meet_radius + 1e-6
    assert not planners["all"].validate(spline, 0.0, hover(START)).faults


def test_all_candidates_want_a_policy_to_be_asked():
    with pytest.raises(InputError, match="placing"):
        build_planner(
            PlannerConfig(place="all"),
            world=load_world("env1"),
            vehicle=load_vehicle(),
            policy=constant_speed_policy(),
        )
    for bad in ({"place": "some"}, {"place": "all", "meet": "rest"}, {"place": "all", "heading": "path"}):
        with pytest.raises(InputError, match="place"):
            PlannerConfig(**bad)
