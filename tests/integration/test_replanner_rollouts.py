"""What the model of the vehicle says about plans counts where the vehicle is measured."""

import numpy as np
import pytest

from jaxplan.compilation import compilations
from jaxplan.planner import Rollout, Rollouts, build_planner, select_stop
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.prediction.observations import first_observation
from jaxplan.records import replace
from jaxplan.replanner import Measured, Replanner
from jaxplan.replanner.ahead import look_ahead
from jaxplan.spline import FlatState, hover
from jaxplan.status import PlanStatus, Reason
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from oracles.planner_cases import CONFIG, GOAL, START, nowhere
from tolerances import tolerance

SEEN = first_observation(0.0, START)


@pytest.fixture(scope="module")
def planner():
    built = build_planner(CONFIG, world=load_world("env1"), vehicle=load_vehicle(), policy=constant_speed_policy())
    built.warmup(hover(START))
    return built


def once(observations, cycle):
    """One goal, met 3 s after the first cycle."""
    return candidates_from(GOAL, GOAL[None], np.array([3.0 - 0.1 * cycle]), np.zeros(1))


def on(replanner, now, aside=0.0):
    """The vehicle as it should be, or beside that [m]."""
    state = replanner.committed.spline.state(max(now - replanner.committed.start_time, 0.0))
    return Measured(np.asarray(state.pos) + np.array([aside, 0.0, 0.0]), np.asarray(state.vel), np.asarray(state.acc))


class Sceptic(Rollout):
    """A model in which every plan goes one way: what is committed already (the first that it flies), and all others."""

    config = CONFIG.rollouts

    def __init__(self, committed, others):
        self._answers, self._others = [committed], others

    def along(self, references, since=0):
        clear, followed = self._answers.pop() if self._answers else self._others
        count = len(references.yaw)
        same = dict.fromkeys(("clearance", "error", "twist"), np.full(count, self.error))
        masks = {"clear": np.full(count, clear), "followed": np.full(count, followed)}
        return Rollouts(positions=np.zeros((count, 1, 3)), **masks, **same)

    error = 0.5

    def after(self, references):
        return FlatState(derivatives=references.derivatives[-1], yaw=references.yaw[-1])


def believing(planner, committed, others):
    return planner._replace(roll_out=lambda *_: Sceptic(committed, others))


FINE, HITS, ASTRAY = (True, True), (False, True), (True, False)


@pytest.mark.parametrize(("others", "taken"), [(FINE, True), (HITS, False), (ASTRAY, False)])
def test_what_the_model_does_not_follow_or_hits_with_is_not_committed(planner, others, taken):
    replanner = Replanner(believing(planner, FINE, others), once, hover(START))
    cycle = replanner.step(0.0, SEEN, on(replanner, 0.0))
    assert (cycle.status is PlanStatus.INTERCEPT) == taken
    assert (cycle.refused == 0) == taken
    assert len(replanner.plans) == 1 + taken


def test_an_unmeasured_vehicle_is_taken_to_be_on_its_reference(planner):
    replanner = Replanner(believing(planner, HITS, HITS), once, hover(START))
    assert replanner.step(0.0, SEEN).status is PlanStatus.INTERCEPT


def test_the_vehicle_stops_where_the_model_hits_something_along_what_is_committed(planner):
    replanner = Replanner(planner, once, hover(START))
    for cycle in range(8):
        replanner.step(0.1 * cycle, SEEN, on(replanner, 0.1 * cycle))
    assert replanner.committed.status is PlanStatus.INTERCEPT
    replanner.planner = believing(planner, HITS, FINE)
    gone = Replanner(replanner.planner, nowhere, replanner.committed)
    assert gone.step(0.8, SEEN, on(replanner, 0.8)).status is PlanStatus.BRAKE


class Lost(Sceptic):
    """One that is lost along all plans."""

    error = 2.0


@pytest.mark.parametrize(("kind", "status"), [(Sceptic, PlanStatus.BRAKE), (Lost, PlanStatus.BLOCKED)])
def test_a_stop_along_which_the_vehicle_is_lost_is_none(planner, kind, status):
    """Where one is nearly followed it is taken."""
    replanner = Replanner(planner._replace(roll_out=lambda *_: kind(HITS, ASTRAY)), nowhere, hover(START))
    assert replanner.step(0.0, SEEN, on(replanner, 0.0)).status is status


class Tumbling(Sceptic):
    """One that stays far away along stops, since it tumbles; along what is committed it comes too near."""

    def along(self, references, since=0):
        committed, found = bool(self._answers), super().along(references, since)
        astray = np.zeros_like(found.error) if committed else np.full_like(found.error, 2.0)
        return replace(found, error=astray, clearance=found.clearance + astray)


def test_what_is_committed_is_flown_on_rather_than_a_tumble(planner):
    replanner = Replanner(planner._replace(roll_out=lambda *_: Tumbling(HITS, HITS)), nowhere, hover(START))
    assert replanner.step(0.0, SEEN, on(replanner, 0.0)).status is PlanStatus.BLOCKED
    assert len(replanner.plans) == 1


class Beside(Sceptic):
    """A vehicle that will be 0.3 m beside its reference, turned, and follows what begins there."""

    place, heading = START + np.array([0.3, 0.0, 0.0]), np.array([0.4, 0.0, 0.0])

    def along(self, references, since=0):
        found = super().along(references, since)
        begun = np.linalg.norm(references.derivatives[:, since, 0] - self.place, axis=1)
        return replace(found, followed=found.followed | (begun < 0.01))

    def after(self, references):
        derivatives = np.concatenate([self.place[None], np.zeros((4, 3))])
        return FlatState(derivatives=derivatives, yaw=self.heading)


def test_where_no_stop_is_followed_one_begins_where_the_vehicle_will_be(planner):
    replanner = Replanner(planner._replace(roll_out=lambda *_: Beside(HITS, ASTRAY)), nowhere, hover(START))
    cycle = replanner.step(0.0, SEEN, on(replanner, 0.0))
    assert cycle.status is PlanStatus.BRAKE
    assert replanner.committed.from_measured
    assert (cycle.jump == 0.0).all(), "it begins as the vehicle flies"
    begun = replanner.committed.spline.state(0.0)
    np.testing.assert_allclose(begun.pos, Beside.place, **tolerance("formula"))
    assert begun.yaw[0] == pytest.approx(0.4)


def test_plans_are_flown_without_compiling_and_followed_from_where_the_vehicle_should_be(planner):
    replanner, counted = Replanner(planner, once, hover(START)), compilations()
    for cycle in range(10):
        replanner.step(0.1 * cycle, SEEN, on(replanner, 0.1 * cycle))
    ahead = look_ahead(planner, replanner._committed, 1.0, on(replanner, 1.0))
    assert ahead.committed.followed[0]
    assert ahead.committed.error[0] < 0.15
    beside = look_ahead(planner, replanner._committed, 1.0, on(replanner, 1.0, aside=0.4))
    assert beside.committed.error[0] == pytest.approx(0.4, abs=0.05)
    stops = planner.brake(replanner._committed.at(1.1), replanner.committed.spline, 1.1)
    flown = ahead.along(stops.splines, 1.1)
    for index in (0, len(stops.reasons) - 1):
        alone = ahead.along(stops.spline(index), 1.1)
        assert alone.error[0] == pytest.approx(flown.error[index], abs=0.02)
        assert alone.clearance[0] == pytest.approx(flown.clearance[index], abs=0.02)
    assert compilations() == counted


def test_of_flown_stops_the_gentlest_is_taken_that_is_followed_and_clear(planner):
    """Then one that only turns fast, then any clear one; of each kind, of the best followed; then the farthest."""
    found = planner.brake(hover(START))
    count, order = len(found.reasons), np.arange(len(found.reasons))
    hit, fast = np.uint32(Reason.CLEARANCE), np.uint32(Reason.BODY_RATE)
    stops = replace(found, arrival_times=1.0 * order, impact=np.zeros(count), thrust=np.ones(count))

    def of(reasons, clear, followed, error=0.0 * order, clearance=1.0 * order):
        kinds = replace(stops, reasons=np.resize(np.asarray(reasons, np.uint32), count))
        masks = {"clear": np.resize(clear, count), "followed": np.resize(followed, count)}
        where = {"positions": np.zeros((count, 1, 3)), "twist": np.zeros(count)}
        return select_stop(kinds, Rollouts(clearance=clearance, error=error, **where, **masks))

    last = count - 1
    first = np.arange(count) < 5
    assert of([0], [True], [True]) == last
    assert of([0], first, [True]) == 4
    assert of([0], [True], first) == 4
    assert of(np.where(first, fast, hit), [True], [True]) == 4
    assert of(np.where(first, Reason.UNTRACKABLE, hit), [True], [True]) == 4
    for followed in (True, False):
        assert of([0], [True], [followed], error=0.2 * order) == 0, "the others go farther astray each"
        assert of([0], [True], [followed], error=np.where(first, 0.05, 0.0)) == last, "all are nearly as good"
    others = np.where(first, 0, fast)
    assert of(others, [True], [True], error=np.where(first, 0.25, 0.0)) == 4, "the others do not pass"
    assert of([0], [False], [True]) == last, "which stays farthest away"
