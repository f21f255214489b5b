"""The loop around the planner, in environment 1: what is committed, and that it never jumps."""

import dataclasses
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxplan.errors import InputError
from jaxplan.knots import KnotConfig
from jaxplan.planner import PlannerConfig, build_planner
from jaxplan.planner.validator import ValidatorConfig
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.prediction.observations import first_observation
from jaxplan.replanner import Measured, Replanner, ReplannerConfig
from jaxplan.replanner.committed import CommittedPlans, hold
from jaxplan.replanner.incumbent import incumbent_among
from jaxplan.spline import hover
from jaxplan.status import PlanStatus
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from tolerances import assert_close, relative, tolerance

LATENCY = ReplannerConfig().latency
START = np.array([-4.3, -4.3, 1.0])
CONFIG = PlannerConfig(width=16, knots=KnotConfig(distance_per_knot=1.0))


@pytest.fixture(scope="module")
def planner():
    return build_planner(CONFIG, world=load_world("env1"), vehicle=load_vehicle(), policy=constant_speed_policy())


class Script:
    """A predictor that plays one answer after another."""

    def __init__(self, *answers):
        self.answers = list(answers)

    def __call__(self, observations, cycle):
        return self.answers[min(cycle, len(self.answers) - 1)]


class Slow(Script):
    """The same, after a while."""

    def __call__(self, observations, cycle):
        time.sleep(0.15)
        return super().__call__(observations, cycle)


@pytest.mark.parametrize("drop", [False, True])
def test_a_plan_that_is_ready_too_late_is_dropped_where_that_is_wanted(planner, drop):
    config = ReplannerConfig(latency=0.1, drop_late=drop)
    answer = near(np.array([-4.0, -1.0, 1.0]), 3.0)
    seen = first_observation(0.0, START)
    Replanner(planner, Script(answer), hover(START)).step(0.0, seen)  # compiles
    replanner = Replanner(planner, Slow(answer), hover(START), config)
    cycle = replanner.step(0.0, seen)
    assert cycle.status is (PlanStatus.LATE if drop else PlanStatus.INTERCEPT)
    assert len(replanner.plans) == (1 if drop else 2)
    assert (cycle.jump is None) == drop
    patient = Replanner(planner, Script(answer), hover(START), ReplannerConfig(latency=20.0, drop_late=True))
    assert patient.step(0.0, seen).status is not PlanStatus.LATE


@pytest.mark.parametrize("drop", [False, True])
def test_time_is_up_for_further_candidates_where_late_plans_are_dropped(planner, drop):
    """0.15 s for the prediction are more than 60 % of 0.2 s; elsewhere results do not depend on the clock."""
    timers, answer = [], near(np.array([-4.0, -1.0, 1.0]), 3.0)

    def watched(state, candidates, timer, above):
        timers.append(timer)
        return planner.plan_batch(state, candidates, timer, above)

    config = ReplannerConfig(latency=0.2, drop_late=drop)
    replanner = Replanner(planner._replace(plan_batch=watched), Slow(answer), hover(START), config)
    replanner.step(0.0, first_observation(0.0, START))
    assert [timer.is_up for timer in timers] == [drop]


def near(goal, time, likelihood=0.0):
    return candidates_from(goal, np.array([goal]), np.array([time]), np.array([likelihood]))


def run(planner, predictor, cycles):
    replanner = Replanner(planner, predictor, hover(START))
    seen = first_observation(0.0, START)
    return replanner, [replanner.step(0.1 * k, seen) for k in range(cycles)]


def test_commands_never_jump_and_end_at_rest(planner):
    goal = np.array([-4.0, -1.0, 1.0])
    answers = [near(goal + np.array([0.0, 0.1 * k, 0.0]), 3.0) for k in range(8)]
    replanner, cycles = run(planner, Script(*answers), 8)
    jumps = np.array([cycle.jump for cycle in cycles if cycle.jump is not None])
    assert len(jumps) >= 2
    assert jumps[:, :4].max() <= 1e-6
    assert jumps[:, 4].max() <= 1e-6
    late = replanner.reference(np.array([100.0]))
    np.testing.assert_allclose(late.derivatives[0, 1:], 0.0, atol=1e-4)
    times = np.linspace(0, 5, 5001)
    speed = np.linalg.norm(replanner.reference(times).vel, axis=1)
    steps = np.linalg.norm(np.diff(replanner.reference(times).pos, axis=0), axis=1)
    assert (steps <= 0.001 * np.maximum(speed[:-1], speed[1:]) + 1e-4).all()


def test_committed_interception_survives_cycles_without_a_candidate(planner):
    goal = np.array([-4.0, -1.0, 1.0])
    nothing = candidates_from(goal, np.full((2, 3), np.nan), np.ones(2), np.zeros(2))
    replanner, cycles = run(planner, Script(near(goal, 3.0), nothing), 5)
    assert cycles[0].status is PlanStatus.INTERCEPT
    assert [cycle.status for cycle in cycles[1:]] == [PlanStatus.NO_CANDIDATE] * 4
    assert len(replanner.plans) == 2
    np.testing.assert_allclose(replanner.reference(np.array([3.0])).pos[0], goal, **tolerance("solve"))


@pytest.mark.parametrize("now", [np.nan, np.inf, 0.05])
def test_a_clock_that_goes_back_or_stops_making_sense_is_refused(planner, now):
    replanner = Replanner(planner, Script(near(np.array([-4.0, -1.0, 1.0]), 3.0)), hover(START))
    seen = first_observation(0.0, START)
    replanner.step(0.1, seen)
    before = len(replanner.plans)
    with pytest.raises(InputError, match="now"):
        replanner.step(now, seen)
    assert len(replanner.plans) == before
    replanner.step(0.1, seen)


@pytest.mark.parametrize("samples", [1, 20])
@pytest.mark.parametrize("offset", [0.0, 0.1])
def test_a_committed_interception_is_recognised_between_two_predicted_steps(planner, samples, offset):
    """In large rooms predictions are 0.2 s apart and replans 0.1 s: every second cycle falls between two steps."""
    replanner = Replanner(planner, Script(), hover(START))
    position, velocity = np.array([0.0, 1.0, 1.0]), np.array([5.0, -1.0, 0.2])
    held = hold(hover(position))
    replanner.plans.append(held._replace(goal=position, arrival_time=2.0 + offset, status=PlanStatus.INTERCEPT))
    steps = np.repeat(0.2 * np.arange(1, 21), samples)
    noise = 0.05 * np.random.default_rng(0).normal(size=(len(steps), 3)) * (samples > 1)
    goals = position + (steps - 2.0 - offset)[:, None] * velocity + noise
    expected = candidates_from(position, goals, steps, np.zeros(len(steps)))
    incumbent = incumbent_among(replanner.committed, expected, 0.0, 1.0, replanner.config)
    assert incumbent.score == pytest.approx(1.0 - 2.0 - offset)
    np.testing.assert_allclose(incumbent.goal, position, atol=0.2)
    elsewhere = candidates_from(position, goals + np.array([0.0, 0.4, 0.0]), steps, np.zeros(len(steps)))
    assert incumbent_among(replanner.committed, elsewhere, 0.0, 1.0, replanner.config).score == -np.inf
    passing = hold(hover(position + np.array([0.0, 0.37, 0.0])))
    replanner.plans.append(passing._replace(goal=position, arrival_time=2.0 + offset, status=PlanStatus.INTERCEPT))
    missed = incumbent_among(replanner.committed, expected, 0.0, 1.0, dataclasses.replace(replanner.config, reach=0.1))
    assert missed.score == -np.inf, "the vehicle passes too far from where the target is expected"


def test_unreachable_target_is_approached(planner):
    far = np.array([4.0, 4.0, 1.0])
    replanner, cycles = run(planner, Script(near(far, 0.5)), 3)
    assert cycles[0].status is PlanStatus.APPROACH
    end = replanner.committed.spline.state(float(replanner.committed.spline.duration))
    assert np.linalg.norm(end.pos - far) < np.linalg.norm(START - far) - 1.0
    np.testing.assert_allclose(end.derivatives[1:], 0.0, atol=1e-4)


def measured_off(replanner, now, off):
    """The vehicle beside its reference [m]."""
    state = replanner.reference(np.array([now]))
    return Measured(state.pos[0] + off, state.vel[0])


def flying(planner, cycles=8):
    """A replanner on its way along the wall, and what it sees."""
    replanner = Replanner(planner, Script(near(np.array([-4.0, 2.0, 1.0]), 3.0)), hover(START))
    seen = first_observation(0.0, START)
    for cycle in range(cycles):
        replanner.step(0.1 * cycle, seen, measured_off(replanner, 0.1 * cycle, np.zeros(3)))
    return replanner, seen


@pytest.mark.parametrize("size", [0.0, 0.2])
def test_a_vehicle_near_its_reference_plans_from_the_reference(planner, size):
    (one, seen), (other, _) = flying(planner), flying(planner)
    off = size * np.array([0.0, 0.6, 0.8])
    cycle = one.step(0.8, seen, measured_off(one, 0.8, off))
    other.step(0.8, seen)
    assert cycle.deviation == pytest.approx(size, **relative("formula"))
    times = np.arange(0.8, 4.0, 0.1)
    np.testing.assert_array_equal(one.reference(times).derivatives, other.reference(times).derivatives)


def test_a_vehicle_farther_than_the_model_follows_keeps_to_what_is_committed(planner):
    replanner, seen = flying(planner)
    committed = replanner.committed
    cycle = replanner.step(0.8, seen, measured_off(replanner, 0.8, np.array([0.0, 0.29, 0.39])))
    assert cycle.deviation == pytest.approx(0.486, abs=1e-3)
    assert cycle.refused > 0
    assert replanner.committed is committed


def test_a_vehicle_off_its_reference_plans_from_where_it_is(planner):
    """Carried on with the error of its velocity to the takeover; it keeps more from obstacles than usual."""
    replanner, seen = flying(planner._replace(roll_out=lambda *_: None))
    off, faster = np.array([0.1, -0.5, 0.2]), np.array([0.3, 0.5, 0.0])
    state = replanner.reference(np.array([0.8, 0.8 + LATENCY]))
    cycle = replanner.step(0.8, seen, Measured(state.pos[0] + off, state.vel[0] + faster))
    assert cycle.status in {PlanStatus.INTERCEPT, PlanStatus.APPROACH}
    plan = replanner.committed
    assert plan.from_measured
    start = plan.spline.state(0.0)
    np.testing.assert_allclose(start.pos, state.pos[1] + off + LATENCY * faster, **tolerance("solve"))
    np.testing.assert_allclose(start.vel, state.vel[1] + faster, **tolerance("solve"))
    np.testing.assert_allclose(start.jerk, state.jerk[1], **tolerance("solve"))
    verdict = planner.validate(plan.spline, 0.0, None, replanner.config.wider_margin)
    assert not verdict.faults
    after = replanner.step(0.9, seen, measured_off(replanner, 0.9, np.zeros(3)))
    assert after.deviation < 1e-9


@pytest.mark.parametrize(("turn", "given_up"), [(0.7, False), (0.9, True), (-2.0, True)])
def test_a_vehicle_that_cannot_hold_its_heading_keeps_the_one_it_has(planner, turn, given_up):
    """From the takeover on, at the very places; also where it hovers, behind the plan's end."""
    replanner, seen = flying(planner)
    for now in (0.8, 30.0):
        times = now + np.array([0.0, 0.5, 0.99, 1.0]) * LATENCY
        before = replanner.reference(times)
        thrust = before.acc[0] + np.array([0.0, 0.0, 9.81])
        heading = before.yaw[0, 0] + turn
        body_z = thrust / np.linalg.norm(thrust)
        body_x = np.cross([-np.sin(heading), np.cos(heading), 0.0], body_z)
        body_x /= np.linalg.norm(body_x)
        body = np.stack([body_x, np.cross(body_z, body_x), body_z], axis=1)
        attitude = Rotation.from_matrix(body).as_quat(scalar_first=True)
        replanner.step(now, seen, Measured(before.pos[0], before.vel[0], before.acc[0], attitude))
        after = replanner.reference(times)
        assert_close(after.derivatives[:, :4], before.derivatives[:, :4], "solve")
        np.testing.assert_array_equal(after.yaw[:3], before.yaw[:3])
        expected = [heading, 0.0, 0.0] if given_up else before.yaw[3]
        assert_close(after.yaw[3], expected, "solve")


def test_of_what_is_turned_nothing_but_the_heading_changes():
    """Before the newest plan's end, in the hover behind it, and in one from the beginning of time."""
    spline = dataclasses.replace(hold(hover(START)).spline, durations=np.array([2.0]))
    spline.position[0, 3:6] = np.outer([10.0, -15.0, 6.0], [2.0, 0.0, 0.5])  # from rest to rest
    plans = CommittedPlans(hold(hover(START, yaw=0.2)))
    plans.turn(1.0, 0.7)
    np.testing.assert_allclose(plans.reference(np.array([0.9, 1.0])).yaw[:, 0], [0.2, 0.7])
    plans.add(plans.newest._replace(start_time=2.0, spline=spline))
    times = np.linspace(2.0, 6.0, 41)
    before = plans.reference(times)
    plans.turn(3.5, -1.0)
    plans.turn(5.0, 1.0)
    after = plans.reference(times)
    assert_close(after.derivatives[:, :3], before.derivatives[:, :3], "formula")
    np.testing.assert_allclose(after.yaw[:, 0], np.select([times < 3.5, times < 5.0], [0.0, -1.0], 1.0))


@pytest.mark.parametrize("faster", [0.0, 8.0])
def test_a_vehicle_that_is_blown_away_is_planned_for_before_it_is_far_off(planner, faster):
    """0.2 m beside its reference, and as much more as it moves until the next plan takes over."""
    replanner, seen = flying(planner._replace(roll_out=lambda *_: None))
    state, away = replanner.reference(np.array([0.8])), np.array([0.0, -1.0, 0.0])
    cycle = replanner.step(0.8, seen, Measured(state.pos[0] + 0.2 * away, state.vel[0] + faster * away))
    assert cycle.deviation == pytest.approx(0.2)
    assert replanner.committed.from_measured == (faster > 0.0)


def test_a_vehicle_far_off_stops_from_where_it_is_and_goes_on(planner):
    replanner, seen = flying(planner)
    off = np.array([0.0, 0.85, 0.2])
    cycle = replanner.step(0.8, seen, measured_off(replanner, 0.8, off))
    assert cycle.status is PlanStatus.RECOVER
    stop = replanner.committed
    end = stop.spline.state(float(stop.spline.duration))
    np.testing.assert_allclose(end.derivatives[1:], 0.0, atol=1e-4)
    np.testing.assert_allclose(stop.spline.state(0.0).pos, replanner.reference(np.array([0.8 + LATENCY])).pos[0])
    again = [replanner.step(0.1 * k, seen, measured_off(replanner, 0.1 * k, np.zeros(3))) for k in range(9, 14)]
    assert any(one.status in {PlanStatus.INTERCEPT, PlanStatus.APPROACH} for one in again)
    assert max(one.deviation for one in again[1:]) < 1e-9


@pytest.mark.parametrize(
    "measured",
    [
        Measured(np.array([np.nan, 0, 0]), np.zeros(3)),
        Measured(np.zeros(2), np.zeros(3)),
        Measured(np.zeros(3), "fast"),
        Measured(np.zeros(3), np.zeros(3), np.full(3, np.inf)),
        Measured(np.zeros(3), np.zeros(3), attitude=np.zeros(4)),
        Measured(np.zeros(3), np.zeros(3), attitude=np.array([2.0, 0.0, 0.0, 0.0])),
        Measured(
            np.zeros(3), np.zeros(3), attitude=np.array([7.22738016e-207, -0.632141920, 0.562379641, -0.23885469])
        ),
    ],
    ids=["nan", "short", "text", "infinite", "no turn", "no unit quaternion", "no unit quaternion of many digits"],
)
def test_a_measured_state_that_is_none_is_refused_and_nothing_is_decided(planner, measured):
    replanner, seen = flying(planner, 2)
    with pytest.raises(InputError, match="^measured: [^\\n]*$"):
        replanner.step(0.2, seen, measured)
    replanner.step(0.2, seen)


def test_the_latency_follows_what_cycles_take_within_its_bounds(planner):
    config = ReplannerConfig(latency=0.05, most_latency=0.3, drop_late=True)
    answer, seen = near(np.array([-4.0, -1.0, 1.0]), 3.0), first_observation(0.0, START)
    replanner = Replanner(planner, Slow(answer), hover(START), config)
    cycles = [replanner.step(0.4 * k, seen) for k in range(4)]
    assert cycles[0].status is PlanStatus.LATE
    assert cycles[0].latency == 0.05
    assert 0.18 <= cycles[1].latency <= 0.3
    assert cycles[1].status is not PlanStatus.LATE
    assert len(replanner.plans) > 1
    starts = [plan.start_time for plan in replanner.plans]
    assert starts == sorted(starts)


def test_the_latency_grows_until_there_is_time_for_another_round(planner):
    """Nothing passes, and predicting takes 0.15 s, most of the latency: it counts as 60 % of what a cycle takes."""
    config = ReplannerConfig(latency=0.2, most_latency=0.5, drop_late=True)
    nowhere, seen = near(START + 3.0, 0.1), first_observation(0.0, START)
    replanner = Replanner(planner, Slow(nowhere), hover(START), config)
    latencies = [replanner.step(0.4 * k, seen).latency for k in range(3)]
    assert latencies[0] == 0.2
    assert all(1.2 * 0.15 / 0.6 <= latency < 0.45 for latency in latencies[1:])


def test_limits_of_the_latency_are_checked():
    with pytest.raises(InputError, match="most_latency"):
        ReplannerConfig(latency=0.2, most_latency=0.1)
    with pytest.raises(InputError, match="stop_beyond"):
        ReplannerConfig(replan_beyond=0.9, stop_beyond=0.8)


def test_nothing_is_committed_that_the_last_look_refuses():
    """Every plan is too fast in turn; what is committed stays."""
    answer, seen = near(np.array([-4.0, -1.0, 1.0]), 3.0), first_observation(0.0, START)
    slow = dataclasses.replace(CONFIG, validator=ValidatorConfig(max_speed=0.1))
    world, vehicle = load_world("env1"), load_vehicle()
    suspicious = build_planner(slow, world=world, vehicle=vehicle, policy=constant_speed_policy())
    replanner = Replanner(suspicious, Script(answer), hover(START))
    cycle = replanner.step(0.0, seen)
    assert cycle.refused > 0
    assert len(replanner.plans) == 1
    assert cycle.status is PlanStatus.KEPT_COMMITTED
