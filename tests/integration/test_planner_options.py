"""What a planner does with each of its options: how it meets, where it looks, who allots the times."""

import dataclasses
import inspect

import numpy as np
import pytest

from jaxplan.arrival import ArrivalConfig
from jaxplan.compilation import Watch, compilations
from jaxplan.errors import InputError
from jaxplan.numerics import wrap_angle
from jaxplan.planner import PlannerConfig, Plans, build_planner, select
from jaxplan.planner.stations import LENGTHS
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.records import replace
from jaxplan.spline import hover
from jaxplan.status import Reason
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World, aligned_boxes, make_obstacles
from jaxplan.world.occupancy import fitting_resolution
from oracles.planner_cases import CONFIG, START, candidates
from tolerances import relative, tolerance


def test_at_rest_at_the_goal_where_that_is_wanted(world, moving):
    """As in the paper: alpha at least 1, the plan ends at its goal when the target is there."""
    config = dataclasses.replace(CONFIG, meet="rest", heading="path", arrival=ArrivalConfig())
    planner = build_planner(config, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    plans = planner.plan_batch(moving, candidates(36))
    usable = np.flatnonzero(plans.reasons == 0)
    assert len(usable) >= 3
    for index in usable:
        spline = plans.spline(index)
        assert float(spline.duration) == pytest.approx(plans.arrival_times[index], **relative("formula"))
        np.testing.assert_allclose(spline.state(float(spline.duration)).pos, plans.goals[index], **tolerance("solve"))
        assert plans.alpha[index] >= 1.0 - 2e-3


def test_met_at_the_targets_own_velocity(world, moving):
    """Goals along a flight at 1.5 m/s: the vehicle is there when the target is, no faster and no slower."""
    config = dataclasses.replace(CONFIG, meet="match")
    planner = build_planner(config, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    times = np.arange(1.0, 7.0, 0.25)
    velocity = np.array([0.3, 1.4, 0.05])
    goals = np.array([-4.2, -4.4, 1.0]) + times[:, None] * velocity
    for state in (hover(START), moving):
        plans = planner.plan_batch(state, candidates_from(goals[0], goals, times, np.zeros(len(times))))
        usable = np.flatnonzero(plans.reasons == 0)
        assert len(usable) >= 3
        for index in usable:
            spline, arrival = plans.spline(index), plans.arrival_times[index]
            met = spline.state(arrival)
            slip = np.abs(arrival - np.cumsum(spline.durations)).min() * np.linalg.norm(velocity)
            assert slip < 0.05
            knot = np.cumsum(spline.durations)[np.argmin(np.abs(arrival - np.cumsum(spline.durations)))]
            np.testing.assert_allclose(spline.state(knot).vel, velocity, **tolerance("solve"))
            assert np.linalg.norm(met.pos - plans.goals[index]) < 0.05
            assert np.linalg.norm(spline.state(float(spline.duration)).vel) < tolerance("solve")["atol"]


def test_no_room_to_stop_behind_a_target_that_flies_into_a_niche():
    """It can be met in passing, but not at its own velocity; one that hovers there can."""
    low = np.array([[5.0, 3.0, 0.0], [3.0, 5.51, 0.0], [3.0, 4.2, 0.0]])
    high = np.array([[5.2, 7.0, 3.0], [5.0, 5.8, 3.0], [5.0, 4.49, 3.0]])
    bounds = np.array([[0.0, 0.0, 0.0], [10.0, 10.0, 3.0]])
    niche = World(name="niche", bounds=bounds, obstacles=make_obstacles(boxes=aligned_boxes(low, high)), keep_in=0.3)
    parts = {"world": niche, "vehicle": load_vehicle(), "policy": constant_speed_policy()}
    planners = {meet: build_planner(dataclasses.replace(CONFIG, meet=meet), **parts) for meet in ("pass", "match")}
    for speed, refused in ((2.0, True), (0.0, False)):
        goals = np.array([[4.49 - 0.5 * speed, 5.0, 1.0], [4.49, 5.0, 1.0]])
        given = candidates_from(goals[0], goals, np.array([3.0, 3.5]), np.zeros(2))
        found = {meet: planner.plan_batch(hover([1.0, 5.0, 1.0]), given).reasons for meet, planner in planners.items()}
        assert bool(found["match"][1] & np.uint32(Reason.NO_STOP)) is refused
        assert not (found["pass"] & np.uint32(Reason.NO_STOP)).any()


def test_a_target_may_be_met_within_a_radius(world):
    """Each plan is at most that far from its goal when the target is there, and as far where its way is straight."""
    planner = build_planner(
        dataclasses.replace(CONFIG, meet_radius=0.25),
        world=world,
        vehicle=load_vehicle(),
        policy=constant_speed_policy(),
    )
    plans = planner.plan_batch(hover(START), candidates(36))
    usable = np.flatnonzero(plans.reasons == 0)
    off = [
        np.linalg.norm(plans.spline(index).state(plans.arrival_times[index]).pos - plans.goals[index])
        for index in usable
    ]
    assert len(usable) >= 3
    assert max(off) == pytest.approx(0.25, **relative("solve"))
    assert np.median(off) > 0.2


def test_of_several_routes_the_one_flown_soonest_is_taken(world, moving):
    """What is in sight has one; to the others a vehicle that flies the other way is no later."""
    others = {"world": world, "vehicle": load_vehicle(), "policy": constant_speed_policy()}
    one, three = (build_planner(dataclasses.replace(CONFIG, alternatives=count), **others) for count in (1, 3))
    before, after = (planner.plan_batch(moving, candidates(300)) for planner in (one, three))
    known = np.isfinite(before.alpha) & (before.trajectory < 0) & (after.trajectory < 0)
    assert known.sum() > 10
    assert (after.alpha[known] >= before.alpha[known] - 1e-9).all(), "alpha is the arrival time over the least one"
    assert (after.alpha[known] > before.alpha[known] + 1e-3).any()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"meet": "crash"}, "meet"),
        ({"heading": "down"}, "heading"),
        ({"allocate": "network"}, "allocate"),
        ({"policy_speed": -1.0}, "policy_speed"),
        ({"meet_radius": -0.1}, "meet_radius"),
        ({"meet": "pass", "search": "multi-resolution"}, "want 'rest'"),
        ({"meet": "match", "search": "multi-resolution"}, "want 'rest'"),
        ({"alternatives": 4}, "alternatives"),
        ({"alternatives": 0}, "alternatives"),
        ({"alternatives": 2, "meet": "rest", "search": "multi-resolution"}, "alternatives"),
        ({"fallback_budget": 0}, "fallback_budget"),
    ],
)
def test_meetings_that_cannot_be_are_refused(options, said):
    with pytest.raises(InputError, match=said):
        PlannerConfig(**options)


@pytest.mark.parametrize(("heading", "turns"), [("hold", False), pytest.param("path", True, marks=pytest.mark.slow)])
def test_the_heading_is_held_or_follows_the_path(world, heading, turns):
    config = dataclasses.replace(CONFIG, heading=heading)
    planner = build_planner(config, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    plans = planner.plan_batch(hover(START), candidates(36))
    yaw = [plans.spline(index).state(3.0).yaw[0] for index in np.flatnonzero(plans.reasons == 0)]
    assert len(yaw) >= 3
    assert (np.abs(yaw).max() > 0.3) == turns
    assert turns or np.abs(yaw).max() < 1e-9


def test_the_vehicle_looks_at_the_target_until_they_meet(world, moving):
    """As far as the yaw rate allows: a target straight ahead is in view all the time, one behind comes into view."""
    config = dataclasses.replace(CONFIG, heading="target", max_yaw_rate=3.0)
    planner = build_planner(config, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    turned = 0
    for seed in range(2):
        given = candidates(36, seed)
        plans = planner.plan_batch(moving, given)
        for index in np.flatnonzero(plans.reasons == 0):
            spline, meeting = plans.spline(index), plans.arrival_times[index]
            knots = np.concatenate([[0.0], np.cumsum(spline.durations)])
            yaw, knots = spline.state(knots).yaw[:, 0], knots[: np.argmin(np.abs(knots - meeting))]
            np.testing.assert_allclose(yaw[len(knots) :], yaw[len(knots) - 1], **tolerance("solve"))
            share = (knots / meeting)[:, None]
            away = (1.0 - share) * given.target + share * plans.goals[index] - spline.state(knots).pos
            off = np.abs(wrap_angle(np.arctan2(away[:, 1], away[:, 0]) - yaw[: len(knots)]))
            fastest = np.abs(np.diff(yaw)) / spline.durations
            assert fastest.max(initial=0.0) <= 3.0 + 1e-6
            limited = np.concatenate([[True], fastest[: len(knots) - 1] > 3.0 - 1e-6])
            near = np.hypot(away[:, 0], away[:, 1]) < 0.25
            assert (limited | near | (off < 1e-6)).all()
            turned += int((~limited & ~near).sum())
    assert turned >= 3


@pytest.mark.slow
def test_both_allocations_find_what_either_finds(world, moving):
    """The better winner of the two; from a start that is too fast for the policy that of the profile."""
    vehicle, policy = load_vehicle(), constant_speed_policy()
    options = {name: {"allocate": name} for name in ("policy", "profile", "both")}
    options |= {"fast": {"policy_speed": 1.0}, "fast profile": {"policy_speed": 1.0, "allocate": "profile"}}
    planners = {
        name: build_planner(dataclasses.replace(CONFIG, **some), world=world, vehicle=vehicle, policy=policy)
        for name, some in options.items()
    }
    better = set()
    for seed in range(4):
        plans = {name: planner.plan_batch(moving, candidates(40, seed)) for name, planner in planners.items()}
        score = {name: some.score[select(some)] if select(some) >= 0 else -np.inf for name, some in plans.items()}
        assert score["both"] == max(score["policy"], score["profile"])
        assert score["fast"] == score["fast profile"]
        ways = {name: planner.approach(moving, candidates(40, seed)) for name, planner in planners.items()}
        first = "profile" if (ways["profile"].reasons == 0).any() else "policy"
        np.testing.assert_array_equal(ways["both"].reasons, ways[first].reasons)
        better |= {name for name in ("policy", "profile") if score[name] < score["both"]}
    assert better == {"policy", "profile"}


def test_a_planner_shows_what_it_can_do():
    """In five lines; ``planner.plan_batch?`` shows arguments and documentation."""
    config = PlannerConfig(heading="path", width=16)
    shown = build_planner(config, world=load_world("env1"), vehicle=load_vehicle(), policy=constant_speed_policy())
    lines = repr(shown).splitlines()
    assert len(lines) <= 5
    assert lines[0] == "Planner with PlannerConfig(heading='path', width=16)"
    assert max(map(len, lines)) <= 120
    for name in set(shown._fields) - {"config"}:
        assert f"{name}(" in repr(shown), name
        assert len(repr(getattr(shown, name))) < 100, name
        assert inspect.getdoc(getattr(shown, name)), name
    signature = inspect.signature(shown.plan_batch)
    assert list(signature.parameters) == ["state", "candidates", "timer", "above"]
    assert signature.return_annotation in ("Plans", Plans)
    assert "meet each candidate" in inspect.getdoc(shown.plan_batch)
    assert "cast to float64" in inspect.getdoc(shown.plan_batch)


@pytest.mark.slow
@pytest.mark.parametrize("allocate", ["profile", "policy"])
def test_what_cannot_be_asked_for_is_not_compiled(world, moving, allocate):
    """A policy is one program for each length, the profile none; nothing compiles after the warm-up all the same."""
    config = dataclasses.replace(CONFIG, allocate=allocate, width=16)
    planner = build_planner(config, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    with Watch() as watch:
        planner.warmup(hover(START))
    assert watch.ended().get("match", 0) == (len(LENGTHS) if allocate == "policy" else 0)
    before = compilations()
    for start in (hover(START), moving):
        planner.plan_batch(start, candidates(20))
        planner.approach(start, candidates(20))
        planner.brake(start)
    assert compilations() == before


def test_a_planner_is_taken_to_a_world_that_is_too_large_for_its_cells(world, moving):
    """With coarser ones; it keeps them in the next world, and all that is compiled."""
    planner = build_planner(CONFIG, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    planner.warmup(moving)
    assert select(planner.plan_batch(moving, candidates(30))) >= 0
    flat = np.array([[-30.0, -33.0, 0.0], [30.0, 33.0, 7.0]])
    large = replace(world, name="large", bounds=flat)
    with pytest.raises(InputError, match="--resolution"):
        planner.in_world(large)
    fits = fitting_resolution(large)
    counted = compilations()
    moved = planner.in_world(large, fits)
    assert moved.config.resolution == fits > planner.config.resolution
    assert select(moved.plan_batch(moving, candidates(30))) >= 0
    assert compilations() == counted
    assert moved.in_world(large).config.resolution == fits
    with pytest.raises(InputError, match="resolution is -0.1"):
        planner.in_world(large, -0.1)
