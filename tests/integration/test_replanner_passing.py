"""Boxes that move, told with the instants at which they will be where."""

import numpy as np
import pytest

from jaxplan.compilation import compilations
from jaxplan.errors import InputError
from jaxplan.planner import HITS, Fault, Rollout, Rollouts, build_planner
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.prediction.observations import first_observation
from jaxplan.records import replace
from jaxplan.replanner import Measured, Replanner, Ways, stopping
from jaxplan.replanner.committed import CommittedPlans, hold
from jaxplan.replanner.passing import Passing
from jaxplan.spline import FlatState, hover
from jaxplan.status import PlanStatus
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from jaxplan.world.update import update_world, with_spare_boxes
from oracles.planner_cases import CONFIG, START
from tolerances import tolerance

HALF, KEEP = np.array([0.3, 0.2, 0.4]), 0.33
HERE = Measured(START, np.zeros(3), np.zeros(3))


@pytest.fixture(scope="module")
def planner():
    world = with_spare_boxes(load_world("env1"), 2)
    built = build_planner(CONFIG, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    built.warmup(hover(START))
    return built


def nowhere(observations, cycle):
    """A goal that cannot be reached in time."""
    return candidates_from(START, START[None] + 3.0, np.array([0.1]), np.zeros(1))


def sliding(begin, velocity, now=0.0, seconds=1.8):
    """A box that flies straight on."""
    times = now + np.arange(0.0, seconds, 0.025)
    centres = begin + times[:, None] * velocity
    return Ways(times, (centres - HALF)[None], (centres + HALF)[None], KEEP)


def apart(ways, position):
    """From one place at each instant to the nearest box, one by one; negative where it is inside, to the next face."""
    least = np.inf
    for lower, upper in zip(ways.lower, ways.upper, strict=True):
        for n in range(len(ways.times)):
            nearest = np.minimum(np.maximum(position[n], lower[n]), upper[n])
            depth = np.minimum(position[n] - lower[n], upper[n] - position[n]).min()
            least = min(least, -float(depth) if depth > 0.0 else float(np.linalg.norm(position[n] - nearest)))
    return least


@pytest.mark.parametrize("seed", range(4))
def test_distances_are_those_of_the_flight_at_each_instant(planner, seed):
    """What is committed until a plan takes over, that plan from then on; two boxes at once."""
    rng = np.random.default_rng(seed)
    one, other = (sliding(START + rng.normal(size=3), rng.normal(size=3)) for _ in range(2))
    ways = one._replace(lower=np.concatenate([one.lower, other.lower]), upper=np.concatenate([one.upper, other.upper]))
    stops = planner.brake(
        FlatState(derivatives=np.vstack([START, rng.normal(size=3), np.zeros((3, 3))]), yaw=np.zeros(3))
    )
    passing = Passing(ways, CommittedPlans(hold(hover(START))), 0.0)
    found, takeover = passing.along(stops.splines, 0.4), 0.4
    for index in rng.integers(0, len(found), 5):
        spline = stops.spline(index)
        flown = [
            START if time < takeover else np.asarray(spline.evaluate(min(time - takeover, float(spline.duration))))[:3]
            for time in ways.times
        ]
        np.testing.assert_allclose(found[index], apart(ways, flown), **tolerance("formula"))
        np.testing.assert_allclose(passing.along(spline, takeover)[0], found[index], **tolerance("formula"))
    np.testing.assert_allclose(passing.nearest, apart(ways, [START] * len(ways.times)), **tolerance("formula"))


@pytest.mark.parametrize("course", [0.0, 1.0, 2.5, 4.0])
def test_a_hover_that_will_be_hit_is_left_in_time(planner, course):
    velocity = 2.0 * np.array([np.cos(course), np.sin(course), 0.0])
    replanner, counted = Replanner(planner, nowhere, hover(START)), compilations()
    begin = START - 1.5 * velocity
    status = []
    for cycle in range(30):
        replanner.expect(sliding(begin, velocity, 0.1 * cycle))
        status.append(replanner.step(0.1 * cycle, first_observation(0.1 * cycle, START)).status)
    times = np.arange(0.0, 4.0, 0.01)
    box = begin + times[:, None] * velocity
    ways = Ways(times, (box - HALF)[None], (box + HALF)[None], KEEP)
    assert apart(ways, np.tile(START, (len(times), 1))) < 0.0
    assert apart(ways, replanner.reference(times).pos) >= KEEP - 0.02  # between the instants that are looked at
    assert PlanStatus.BRAKE in status
    assert PlanStatus.BLOCKED not in status
    assert compilations() == counted


@pytest.mark.parametrize("axis", [0, 1])
def test_who_is_inside_what_a_box_may_fill_makes_way(planner, axis):
    """A box is expected to stray: one may be within what it may fill, and all ways with it, and still leave it."""
    times, off = np.arange(0.0, 1.8, 0.025), np.eye(3)[axis]
    around = START + (0.3 * times[:, None] - 1.15) * off
    replanner = Replanner(planner, nowhere, hover(START))
    replanner.expect(Ways(times, (around - 1.2)[None], (around + 1.2)[None], KEEP))
    assert replanner.step(0.0, first_observation(0.0, START), HERE).status is PlanStatus.BLOCKED
    assert (replanner.committed.goal - START) @ off > 0.2


def test_who_is_not_in_the_way_stays(planner):
    replanner = Replanner(planner, nowhere, hover(START))
    replanner.expect(sliding(START + np.array([0.0, 1.2, 0.0]), np.array([1.0, 0.0, 0.0])))
    assert replanner.step(0.0, first_observation(0.0, START)).status is not PlanStatus.BRAKE
    assert len(replanner.plans) == 1


def test_boxes_that_stand_for_what_moves_are_kept_out_of_by_searches_alone(planner):
    """Others stay what they are; and one that is told as a still box again is solid again."""
    world = with_spare_boxes(load_world("env1"), 2)
    first = len(world.boxes.center) - 2
    middle = START + np.array([1.5, 0.0, 0.0])
    corners, goal = (middle - 0.5, middle + 0.5), candidates_from(START, middle[None], np.array([2.0]), np.zeros(1))
    stop = next(planner.brake(hover(START), aside=True).spline(n) for n in range(45, 150) if reaches(planner, n))
    moved = update_world(world, move_box=(first, corners))
    soft, hard = planner.update(moved, moving=True), planner.update(moved)
    assert not soft.validate(stop).faults & Fault.CLEARANCE
    assert hard.validate(stop).faults & Fault.CLEARANCE
    for one in (soft, hard):
        assert one.plan_batch(hover(START), goal).reasons[0] != planner.plan_batch(hover(START), goal).reasons[0]
    elsewhere = update_world(moved.world, move_box=(first + 1, (START + 3.0, START + 3.2)))
    assert not soft.update(elsewhere).validate(stop).faults & Fault.CLEARANCE
    still = update_world(moved.world, move_box=(first, (corners[0], corners[1] + 0.01)))
    assert soft.update(still).validate(stop).faults & Fault.CLEARANCE


def reaches(planner, number):
    """Whether a step aside leads 1.5 m along x."""
    found = planner.brake(hover(START), aside=True).goals[number] - START
    return bool(np.allclose(found, [1.5, 0.0, 0.0], **tolerance("solve")))


def test_slow_vehicles_step_aside_and_fast_ones_do_not(planner):
    usual, more = planner.brake(hover(START)), planner.brake(hover(START), aside=True)
    steps = np.linalg.norm(more.goals[len(usual.goals) :] - START, axis=1)
    assert {0.4, 0.8, 1.5, 2.5} == set(np.round(steps, 6))
    assert (more.reasons[len(usual.goals) :] == 0).any()
    fast = FlatState(derivatives=np.vstack([START, [5.0, 0.0, 0.0], np.zeros((3, 3))]), yaw=np.zeros(3))
    assert len(planner.brake(fast).goals) == len(planner.brake(fast, aside=True).goals)


def resting(gap, velocity=0.0, now=0.0):
    """A large box beside the hover, so far away [m] now, that comes nearer along x [m/s]."""
    times = now + np.arange(0.0, 1.8, 0.025)
    lower = START + np.array([gap, -3.0, -3.0]) - times[:, None] * np.array([velocity, 0.0, 0.0])
    return Ways(times, lower[None], (lower + np.array([1.0, 6.0, 6.0]))[None], KEEP)


def test_who_let_something_pass_nearer_than_plans_keep_leaves_when_more_comes(planner):
    """What is committed may be 0.1 m nearer than new plans are to be; stops from there are clear all the same."""
    replanner = Replanner(planner, nowhere, hover(START))
    replanner.expect(resting(0.28))
    assert replanner.step(0.0, first_observation(0.0, START)).status not in (PlanStatus.BRAKE, PlanStatus.BLOCKED)
    replanner.expect(resting(0.28, 0.05))
    assert replanner.step(0.0, first_observation(0.0, START)).status is PlanStatus.BRAKE
    times = np.arange(0.0, 3.0, 0.01)
    assert replanner.reference(times).pos[-1, 0] < START[0]


@pytest.mark.parametrize(("gap", "taken"), [(0.4, True), (0.28, True), (0.2, False)])
def test_plans_begin_where_the_vehicle_is_nearer_than_they_are_to_keep(planner, gap, taken):
    def along(observations, cycle):
        goal = START + np.array([0.0, 1.5, 0.0])
        return candidates_from(goal, goal[None], np.array([2.0]), np.zeros(1))

    assert planner.plan_batch(hover(START), along(None, 0)).reasons[0] == 0
    replanner = Replanner(planner, along, hover(START))
    replanner.expect(resting(gap))
    assert (replanner.step(0.0, first_observation(0.0, START)).status is PlanStatus.INTERCEPT) == taken


class Model(Rollout):
    """A model that comes to given places [m from the start], and follows some of many plans."""

    config = CONFIG.rollouts

    def __init__(self, committed, others, followed=None):
        self._committed, self._others, self._followed = committed, others, followed

    def along(self, references, since=0):
        count = len(references.yaw)
        place, alone = (self._committed, True) if count == 1 else (self._others, False)
        positions = np.tile(START + place, (count, 75, 1))
        same = dict.fromkeys(("clearance", "error", "twist"), np.full(count, 0.5))
        followed = np.full(count, True) if alone or self._followed is None else np.arange(count) == self._followed
        return Rollouts(positions=positions, clear=np.full(count, True), followed=followed, **same)

    def after(self, references):
        return FlatState(derivatives=references.derivatives[-1], yaw=references.yaw[-1])


@pytest.mark.parametrize(("place", "status"), [(-0.5, PlanStatus.BRAKE), (0.5, PlanStatus.BLOCKED)])
def test_stops_are_clear_where_the_vehicle_comes_along_them(planner, place, status):
    """Plans keep away from a box; the model of the vehicle does, or strays into it."""
    model = Model(np.zeros(3), np.array([place, 0.0, 0.0]))
    replanner = Replanner(planner._replace(roll_out=lambda *_: model), nowhere, hover(START))
    replanner.expect(resting(0.5, 0.25))
    assert replanner.step(0.0, first_observation(0.0, START), HERE).status is status


@pytest.mark.parametrize(("astray", "taken"), [(0.05, 3), (0.4, 5), (0.7, 5)])
def test_a_stop_that_is_hardly_followed_is_not_taken_for_keeping_a_little_more(planner, astray, taken):
    """Of two that are followed, or of which one is not, the first keeps the larger distance."""
    stops = planner.brake(hover(START), hold(hover(START)).spline, 0.0, aside=True)
    order = np.arange(len(stops.reasons))
    error = np.where(order == 3, astray, 0.0)
    flown = Rollouts(
        positions=np.tile(START, (len(order), 75, 1)),
        clearance=np.ones(len(order)),
        error=error,
        twist=np.zeros(len(order)),
        clear=np.full(len(order), True),
        followed=error < 0.6,
    )
    held = [
        (replace(stops, reasons=np.where(np.isin(order, only), np.uint32(0), np.uint32(HITS))), flown)
        for only in ([3], [3, 5])
    ]
    held[1] = (replace(held[1][0], arrival_times=np.where(order == 5, 9.0, 1.0)), flown)
    assert stopping._clear(held)[2] == taken


def test_where_all_are_hit_one_that_is_followed_is_taken(planner):
    stops = planner.brake(hover(START), hold(hover(START)).spline, 0.0, aside=True)
    away = (stops.goals[:, 0] < START[0] - 0.1) & ((stops.reasons & np.uint32(HITS)) == 0)
    only = int(np.flatnonzero(away)[-1])
    model = Model(np.array([0.3, 0.0, 0.0]), np.zeros(3), only)
    replanner = Replanner(planner._replace(roll_out=lambda *_: model), nowhere, hover(START))
    replanner.expect(resting(0.2))
    assert replanner.step(0.0, first_observation(0.0, START), HERE).status is PlanStatus.BLOCKED
    np.testing.assert_allclose(replanner.committed.goal, stops.goals[only], **tolerance("formula"))


def test_flown_places_are_compared_with_boxes_at_their_own_instants(planner):
    rng, times = np.random.default_rng(0), 0.01 * np.arange(1, 151)
    ways = sliding(START + rng.normal(size=3), rng.normal(size=3))
    velocity = rng.normal(size=(4, 1, 3))
    same, masks = dict.fromkeys(("clearance", "error", "twist"), np.zeros(4)), np.ones(4, bool)
    flown = Rollouts(positions=START + times[:, None] * velocity, clear=masks, followed=masks, **same)
    until = ways.times <= times[-1]
    shown = Ways(ways.times[until], ways.lower[:, until], ways.upper[:, until], KEEP)
    found = Passing(ways, CommittedPlans(hold(hover(START))), 0.0).flown(flown)
    for one, speed in zip(found, velocity, strict=True):
        later = shown._replace(times=shown.times[1:], lower=shown.lower[:, 1:], upper=shown.upper[:, 1:])
        np.testing.assert_allclose(one, apart(later, START + later.times[:, None] * speed), **tolerance("solve"))


@pytest.mark.parametrize(
    "changed",
    [
        {"times": np.array([0.0, 0.0])},
        {"lower": np.full((1, 2, 3), 5.0)},
        {"lower": np.zeros((2, 3))},
        {"upper": np.full((1, 2, 3), np.nan)},
        {"keep": -0.1},
        {"keep": np.nan},
    ],
    ids=str,
)
def test_what_are_no_ways_is_refused_and_changes_nothing(planner, changed):
    replanner = Replanner(planner, nowhere, hover(START))
    good = Ways(np.array([0.0, 0.1]), np.zeros((1, 2, 3)), np.ones((1, 2, 3)), KEEP)
    replanner.expect(good)
    with pytest.raises(InputError, match="ways"):
        replanner.expect(good._replace(**changed))
    replanner.expect(None)
