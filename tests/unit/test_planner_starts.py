"""From where refinements begin: the seed's own places and times, or those of a placing policy, whichever is better."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.compilation import compilations
from jaxplan.errors import InputError
from jaxplan.minsnap.single import minimum_snap
from jaxplan.planner import PlannerConfig, RefinementConfig, Seed, build_planner
from jaxplan.planner.starts import MEETINGS, Expected, placed_start, seed_start
from jaxplan.planner.validator import Room
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.policy.placing import SEGMENTS, VEHICLE_NUMBERS, Placed
from jaxplan.prediction.candidates import candidates_from
from jaxplan.search.kernels.solids import solids_of
from jaxplan.spline import hover
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World, make_obstacles
from oracles.planner_cases import START
from tolerances import assert_close

WAY = np.array([[0.0, 0.0, 0.0], [2.8, 0.4, 0.1], [5.6, 0.4, 0.2], [7.0, 0.3, 0.2]])
SPLINE = minimum_snap(START + WAY, [1.0, 0.8, 0.8])
SEED = Seed(SPLINE, 0.0, 1.8, START + WAY[2], 1.0)
MOVING = Expected(0.1, SEED.goal + 0.5 * (0.1 * np.arange(40) - 1.8)[:, None] * [0.0, 1.0, 0.0], np.zeros(40), 3.9)


def test_a_seed_s_start_goes_through_its_places_at_its_times():
    start = seed_start(SEED, SEED.goal, 0.3, SEGMENTS)
    durations = np.exp(start.log_durations)[:, 0]
    assert_close(durations, [0.36] * 5 + [0.8], "formula")
    passed = SPLINE.evaluate(0.36 * np.arange(1, 5))[:, :3]
    assert_close(start.inner[..., 0], passed, "formula")
    assert_close(start.offset[:, 0], np.zeros(3), "formula")
    assert_close(start.stop[:, 0], WAY[3] - WAY[2], "formula")


def test_it_is_moved_on_to_a_target_elsewhere():
    away = np.array([0.0, 0.5, 0.0])
    start, base = seed_start(SEED, SEED.goal + away, 0.3, SEGMENTS), seed_start(SEED, SEED.goal, 0.3, SEGMENTS)
    assert np.linalg.norm(start.offset) <= 0.9 + 1e-9
    missed = away + 0.3 * start.offset[:, 0]
    moved = (start.inner - base.inner)[..., 0]
    assert_close(moved, (np.arange(1, 5) / 5.0)[:, None] ** 2 * missed, "formula")


def room() -> Room:
    world = load_world("env1")
    return Room(tuple(solids_of(world)), np.asarray(world.bounds, dtype=np.float64))


@pytest.mark.parametrize("time", [1.0, 1.5])
def test_of_the_policy_s_plans_the_soonest_that_is_in_time_counts(time):
    """A policy that always takes as long, and goes along its courses."""
    seen = []

    def place(courses, initial):
        seen.append(courses)
        width = courses.meet_radius.shape[0]
        return Placed(jnp.full((SEGMENTS, width), time / (SEGMENTS - 1)), jnp.asarray(courses.points))

    numbers = np.zeros(VEHICLE_NUMBERS)
    start = placed_start(place, numbers, room(), hover(START), SEED, MOVING, np.zeros(3), 0.3)
    meeting = MEETINGS[MEETINGS * SEED.meeting >= time - 1e-9][0] * SEED.meeting
    assert_close(np.exp(start.log_durations)[:-1].sum(), time, "formula", np.float32)
    assert np.abs(start.offset).max() < 1e-6
    courses = seen[0]
    lane = int(np.argmin(np.abs(MEETINGS * SEED.meeting - meeting)))
    assert_close(courses.points[-2, :, lane], MOVING.at(meeting), "formula")
    assert_close(courses.points[0], np.repeat(START[:, None], len(MEETINGS), axis=1), "formula")
    assert_close(start.inner[..., 0], courses.points[1:-2, :, lane], "formula", np.float32)
    steps = np.linalg.norm(np.diff(courses.points[:-1], axis=0), axis=1)
    assert (steps.max(axis=0) < 1.6 * steps.min(axis=0)).all(), "cut evenly"


OPEN = World(
    name="open",
    bounds=START + np.array([[-4.0, -4.0, -3.0], [12.0, 4.0, 3.0]]),
    obstacles=make_obstacles(),
    keep_in=np.array(0.2),
)


def planner(placing=None, iterations=3):
    config = PlannerConfig(width=16, refinement=RefinementConfig(iterations=iterations))
    return build_planner(config, world=OPEN, vehicle=load_vehicle(), policy=constant_speed_policy(), placing=placing)


def constant(durations, points):
    """A policy that gives the same plan whatever it is asked."""

    def place(courses, initial):
        width = courses.meet_radius.shape[0]
        repeated = jnp.repeat(jnp.asarray(points)[..., None], width, axis=-1)
        return Placed(jnp.repeat(jnp.asarray(durations)[:, None], width, axis=1), repeated)

    return place


def test_a_refinement_goes_on_from_the_better_start():
    times = np.linspace(0.3, 3.0, 28)
    goals = np.repeat(SEED.goal[None], 28, axis=0)
    standing = candidates_from(SEED.goal, goals, times, np.zeros(28))
    long, short = planner(iterations=60), planner()
    for one in (long, short):
        one.warmup(hover(START))
    best = long.refine(hover(START), standing, SEED)
    alone = short.refine(hover(START), standing, SEED)
    assert best is not None
    assert alone is not None
    assert not best.reasons
    knots = np.concatenate([[0.0], np.cumsum(best.spline.durations)])
    good = constant(np.asarray(best.spline.durations), best.spline.evaluate(knots)[:, :3])
    bad = constant(np.full(SEGMENTS, 4.0), best.spline.evaluate(knots)[:, :3])
    helped, misled = planner(good), planner(bad)
    for one in (helped, misled):
        one.warmup(hover(START))
    counted = compilations()
    from_good, from_bad = (one.refine(hover(START), standing, SEED) for one in (helped, misled))
    assert compilations() == counted
    assert from_good is not None
    assert from_bad is not None
    assert from_good.arrival_time < alone.arrival_time - 0.02
    assert_close(from_bad.arrival_time, alone.arrival_time, "solve")


def test_a_placing_policy_wants_its_own_number_of_segments():
    config = PlannerConfig(refinement=RefinementConfig(segments=5))
    place = constant(np.ones(SEGMENTS), np.zeros((SEGMENTS + 1, 3)))
    with pytest.raises(InputError, match="segments"):
        build_planner(
            config, world=load_world("env1"), vehicle=load_vehicle(), policy=constant_speed_policy(), placing=place
        )
