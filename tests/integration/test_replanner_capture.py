"""Deciding by the target's possible futures: corrections in flight, and the loop, in environment 1."""

import dataclasses

import numpy as np
import pytest

from jaxplan.compilation import compilations
from jaxplan.errors import InputError
from jaxplan.minsnap.single import minimum_snap
from jaxplan.planner import RefinementConfig, build_planner, prospect_for, select
from jaxplan.planner.capture import STEP, CaptureConfig, prospect_of
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import Candidates
from jaxplan.prediction.futures import Futures
from jaxplan.prediction.observations import first_observation
from jaxplan.records import replace
from jaxplan.replanner import Replanner
from jaxplan.replanner.choice import FAR, MOVED, seed_towards
from jaxplan.spline import FlatState, hover
from jaxplan.status import PlanStatus, Reason
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from oracles.expectations import Always, Passing, predicted
from oracles.planner_cases import CONFIG, START
from tolerances import tolerance


@pytest.fixture(scope="module")
def planner():
    built = build_planner(CONFIG, world=load_world("env1"), vehicle=load_vehicle(), policy=constant_speed_policy())
    built.warmup(hover(START))
    return built


def flying(speed: float) -> FlatState:
    """Northwards along the western wall."""
    derivatives = np.zeros((5, 3))
    derivatives[0], derivatives[1] = [-4.2, -3.5, 1.0], [0.0, speed, 0.0]
    return FlatState(derivatives=derivatives, yaw=np.zeros(3))


@pytest.mark.parametrize("speed", [0.0, 3.0, 6.0])
def test_corrections_are_plans_like_others(planner, speed):
    """They begin where the vehicle is, with all derivatives, come to rest, and pass the last look."""
    state, candidates = flying(speed), predicted((0.0, 2.0, 0.0))
    prospect = prospect_for(planner.config, candidates)
    found = planner.correct(state, prospect)
    usable = np.flatnonzero(found.reasons == 0)
    assert len(usable) >= 5
    for index in usable:
        spline = found.spline(index)
        np.testing.assert_allclose(spline.state(0.0).derivatives, state.derivatives, **tolerance("solve"))
        end = spline.state(float(spline.duration)).derivatives
        np.testing.assert_allclose(end[1:4], np.zeros((3, 3)), **tolerance("solve"))
        passed = spline.evaluate(found.arrival_times[index])[:3]
        np.testing.assert_allclose(passed, found.goals[index], **tolerance("solve"))
        assert not planner.validate(spline, 0.0, state).faults
    assert not (found.reasons & np.uint32(Reason.DEVIATION)).any()


def test_a_correction_meets_what_is_expected_soon(planner):
    """3 m ahead of a flight at 6 m/s, and no route is asked for."""
    state, candidates = flying(6.0), predicted((0.0, 1.0, 0.0))
    prospect = prospect_for(planner.config, candidates)
    found = planner.correct(state, prospect)
    there = np.stack([prospect.mean_at(time) for time in found.arrival_times])
    met = (np.linalg.norm(found.goals - there, axis=1) < 0.05) & (found.reasons == 0)  # but for the prospect's grid
    assert met.any()
    assert found.arrival_times[met].min() < 0.8


def test_the_loop_goes_for_what_most_futures_have_in_common(planner):
    """Eight of nine futures stay in the north; the ninth, to the paper worth as much, is met sooner."""
    north = (-4.2, -1.5, 1.0)
    candidates = predicted(*[(0.0, 0.01 * k, 0.0) for k in range(8)], (0.0, -2.5, 0.0), place=north)
    paper = planner.plan_batch(hover(START), replace(candidates, futures=None))
    capture = planner.plan_batch(hover(START), candidates)
    assert paper.goals[select(paper)][1] < -2.0
    assert capture.goals[select(capture)][1] > -1.6


def test_what_is_drawn_anew_in_each_cycle_does_not_change_the_plan(planner):
    """The motion that was expected happens, told with 5 cm of noise: one plan, or two, meet it."""
    whole = predicted((0.0, 0.5, 0.0), (0.0, 0.6, 0.0), (0.05, 0.55, 0.0))
    replanner = Replanner(planner, Passing(whole, 0.05), hover(START))
    seen = first_observation(0.0, np.array([-4.2, 0.0, 1.0]))
    cycles = [replanner.step(0.1 * cycle, seen) for cycle in range(10)]
    assert cycles[0].status is PlanStatus.INTERCEPT
    assert sum(cycle.chosen >= 0 or cycle.jump is not None for cycle in cycles) <= 4
    assert all(cycle.jump is None or (cycle.jump[:4] <= 1e-6).all() for cycle in cycles)


class Turning:
    """A target that flies north and turns back after 0.5 s; expected to go on as it does now, more or less."""

    def __call__(self, observations: object, cycle: int) -> Candidates:
        now = self.at(np.array([0.1 * cycle]))[0]
        velocity = 1.5 if cycle < 5 else -1.5
        return predicted(*[(0.1 * k, velocity + 0.1 * k, 0.0) for k in (-1, 0, 1)], place=tuple(now.tolist()))

    def at(self, times: np.ndarray) -> np.ndarray:
        north = 1.5 * np.minimum(times, 0.5) - 1.5 * np.maximum(times - 0.5, 0.0)
        return np.stack([np.full(len(times), -4.2), 1.0 + north, np.ones(len(times))], axis=-1)


def test_a_target_that_turns_back_is_met(planner):
    target, seen = Turning(), first_observation(0.0, np.array([-4.2, 1.0, 1.0]))
    replanner = Replanner(planner, target, hover(START))
    cycles = [replanner.step(0.1 * cycle, seen) for cycle in range(25)]
    times = np.arange(0.0, 2.5, 0.01)
    apart = np.linalg.norm(replanner.reference(times).pos - target.at(times), axis=1)
    assert apart.min() <= 0.36
    assert times[np.argmax(apart <= 0.36)] < 2.0
    assert all(cycle.jump is None or (cycle.jump[:4] <= 1e-6).all() for cycle in cycles)


@pytest.fixture(scope="module")
def refining():
    config = dataclasses.replace(CONFIG, refinement=RefinementConfig())
    built = build_planner(config, world=load_world("env1"), vehicle=load_vehicle(), policy=constant_speed_policy())
    built.warmup(hover(START))
    return built


@pytest.mark.parametrize(
    ("start", "place"), [((4.3, -4.3, 1.0), (-4.3, 4.3, 1.5)), ((0.0, -4.3, 1.0), (0.0, 4.3, 1.5))]
)
def test_a_target_too_far_to_be_met_while_it_is_predicted_is_approached_as_soon_as_may_be(
    planner, refining, start, place
):
    """It is refined like any plan, as if the target waited where it is expected last."""
    soon = predicted((0.0, 0.1, 0.0), place=place)
    shorter = replace(soon.futures, times=0.2 * soon.futures.times)
    soon = replace(soon, arrival_times=0.2 * soon.arrival_times, futures=shorter)
    made = [Replanner(one, Always(soon), hover(np.array(start))) for one in (planner, refining)]
    plain, sooner = (one.step(0.0, first_observation(0.0, np.array(start))) for one in made)
    assert plain.status is sooner.status is PlanStatus.APPROACH
    assert sooner.sooner > 1.0
    late, early = (first_near(one.committed, soon.goals[-1]) for one in made)
    assert early < late - 1.0


def first_near(plan, place):
    times = np.arange(0.0, float(plan.spline.duration), 0.01)
    near = np.linalg.norm(np.asarray(plan.spline.evaluate(times))[:, :3] - place, axis=1) < 0.5
    return times[np.argmax(near)] if near.any() else np.inf


@pytest.mark.parametrize(("speed", "late"), [(9.0, False), (2.0, True)])
def test_a_refinement_begins_where_a_plan_comes_nearest_be_it_after_all_that_is_predicted(speed, late):
    prospect = prospect_of(predicted((0.0, 0.0, 0.0), place=(8.0, 0.0, 1.0)).futures, CaptureConfig())
    slow = minimum_snap(np.array([[0.0, 0.0, 1.0], [8.0, 0.0, 1.0]]), [8.0 / speed + 1.0])
    seed = seed_towards(prospect, slow, 0.5, 0.1)
    assert seed.late is late
    assert seed.late == (seed.meeting > prospect.times[-1])
    there = np.asarray(slow.evaluate(0.5 + seed.meeting))[:3]
    assert np.linalg.norm(there - seed.goal) <= 0.1
    earlier = np.asarray(slow.evaluate(0.5 + seed.meeting - 2.0 * STEP))[:3]
    assert np.linalg.norm(earlier - seed.goal) > 0.1


@pytest.mark.parametrize("speed", [6.0, 2.0])
def test_a_plan_that_passes_the_target_at_a_distance_is_moved_to_it_but_far_ahead(speed):
    prospect = prospect_of(predicted((0.0, 0.0, 0.0), place=(8.0, 3.0, 1.0)).futures, CaptureConfig())
    beside = minimum_snap(np.array([[0.0, 0.0, 1.0], [8.0, 0.0, 1.0]]), [8.0 / speed + 0.4])
    seed = seed_towards(prospect, beside, 0.0, 0.1)
    passed = np.asarray(beside.evaluate(min(seed.meeting, float(beside.duration))))[:3]
    moved = np.linalg.norm(seed.goal - passed)
    assert (seed.meeting > FAR) == (speed < 4.0)
    assert moved == pytest.approx(MOVED if seed.meeting > FAR else 3.0, rel=0.02)


def test_without_futures_plans_are_compared_as_in_the_paper(planner):
    candidates = replace(predicted((0.0, 1.0, 0.0)), futures=None)
    assert prospect_for(planner.config, candidates) is None
    plans = planner.plan_batch(hover(START), candidates)
    np.testing.assert_allclose(plans.score, candidates.likelihood - candidates.arrival_times, **tolerance("exact"))


@pytest.mark.parametrize(
    "wrong",
    [
        {"positions": np.full((1, 21, 3), np.nan)},
        {"times": np.zeros(21)},
        {"weights": np.zeros(1)},
        {"weights": np.array([-1.0])},
        {"times": np.zeros(0), "positions": np.zeros((1, 0, 3))},
    ],
)
def test_futures_that_mean_nothing_count_as_none(planner, wrong):
    whole = predicted((0.0, 1.0, 0.0))
    candidates = replace(whole, futures=replace(whole.futures, **wrong))
    assert prospect_for(planner.config, candidates) is None
    replanner = Replanner(planner, Always(candidates), hover(START))
    assert replanner.step(0.0, first_observation(0.0, np.array([-4.2, 0.0, 1.0]))).status is PlanStatus.INTERCEPT


@pytest.mark.parametrize(("meet", "selection"), [("match", "capture"), ("rest", "capture"), ("pass", "paper")])
def test_only_what_passes_its_target_is_compared_by_capture(planner, meet, selection):
    config = dataclasses.replace(planner.config, meet=meet, selection=selection)
    assert prospect_for(config, predicted((0.0, 1.0, 0.0))) is None


def test_futures_whose_arrays_do_not_fit_together_are_refused(planner):
    whole = predicted((0.0, 1.0, 0.0))
    wrong = Futures.__new__(Futures)
    for name, value in {"times": np.zeros(4), "positions": whole.futures.positions, "weights": np.ones(1)}.items():
        object.__setattr__(wrong, name, value)
    with pytest.raises(InputError, match="futures: positions"):
        prospect_for(planner.config, replace(whole, futures=wrong))


def test_nothing_compiles_after_the_warm_up(planner):
    """Not even where the futures are other in number."""
    seen, before = first_observation(0.0, np.array([-4.2, 0.0, 1.0])), compilations()
    for velocities in ([(0.0, 1.5, 0.0)], [(0.0, 1.5, 0.0), (0.3, 1.0, 0.0)]):
        replanner = Replanner(planner, Always(predicted(*velocities)), hover(START))
        for cycle in range(5):
            replanner.step(0.1 * cycle, seen)
    assert compilations() == before
