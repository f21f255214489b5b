"""The planner in a process of its own: what it offers is flown, and nothing that befalls it moves the setpoint."""

import dataclasses
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from jaxplan.errors import FileError, InputError, ResourceError
from jaxplan.replanner import Measured, ReplannerConfig
from jaxplan.replanner.committed import hold
from jaxplan.runtime import Phase, Runtime, RuntimeConfig
from jaxplan.runtime.channel import CHANNEL_BYTES, Channel
from jaxplan.runtime.held import HeldPlans
from jaxplan.runtime.messages import (
    Answer,
    Odometry,
    pack_answer,
    pack_odometry,
    pack_sample,
    unpack_odometry,
    unpack_plan,
)
from jaxplan.runtime.worker import Task, Worker, carried_to
from jaxplan.spline import FlatState, hover
from jaxplan.status import PlanStatus
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.load import load_world
from oracles import runtime_builds
from oracles.planner_cases import START
from oracles.runtime_builds import GOAL
from tolerances import assert_close

PATIENT = RuntimeConfig(replanning=ReplannerConfig(latency=0.3, most_latency=2.0, drop_late=True))
"""For a machine on which other tests run too."""
READY = 300.0
"""s"""
TURNED = np.array([np.cos(0.6), 0.0, 0.0, np.sin(0.6)])
"""Level, by 1.2 rad about the vertical; quaternion w x y z."""


@pytest.fixture(scope="module")
def built():
    return runtime_builds.planner()


def worker_for(built, config=PATIENT, changes=()):
    channel = Channel(bytearray(CHANNEL_BYTES))
    channel.epoch = time.monotonic()
    return Worker(built, Task(runtime_builds.planner, config, hold(hover(START)), Answer(0, 0), changes), channel)


def tables(worker):
    return [unpack_plan(message) for _, message in worker.channel.plans.since(0)]


def seen_by(worker, position=GOAL):
    worker.channel.samples.write(pack_sample(worker.now, position))


def warm(built):
    """Compile what a round calls."""
    slow = dataclasses.replace(PATIENT, replanning=ReplannerConfig(latency=1.0))
    worker = worker_for(built, slow)
    seen_by(worker)
    worker.tick()


def test_a_round_offers_a_plan_that_goes_on_from_the_last(built):
    warm(built)
    worker = worker_for(built)
    assert worker.tick() is None
    seen_by(worker)
    assert worker.tick().status is PlanStatus.INTERCEPT
    (first,) = tables(worker)
    assert (first.head.number, first.head.predecessor) == (1, 0)
    held = HeldPlans(hold(hover(START)), 10)
    held.offer(first)
    assert held.answer == (1, 1), held.refused
    assert_close(first.plan.goal, GOAL, "exact")
    time.sleep(0.3)
    seen_by(worker, GOAL + np.array([0.0, 0.5, 0.0]))
    worker.channel.answers.write(pack_answer(held.answer))
    worker.tick()
    second = tables(worker)[-1]
    held.offer(second)
    assert (second.head.number, second.head.predecessor) == (2, 1)
    assert held.answer == (2, 2), held.refused


def test_what_the_pilot_refuses_is_taken_back(built):
    warm(built)
    worker = worker_for(built)
    seen_by(worker)
    worker.tick()
    worker.channel.answers.write(pack_answer(Answer(seen=1, accepted=0)))
    cycle = worker.tick()
    assert cycle.status is PlanStatus.INTERCEPT, "the refused plan is no rival"
    assert worker.late == 1
    head = tables(worker)[-1].head
    assert (head.number, head.predecessor) == (2, 0)


def test_a_plan_that_comes_too_late_is_not_offered(built):
    warm(built)
    hasty = dataclasses.replace(PATIENT, replanning=ReplannerConfig(latency=1e-3))
    worker = worker_for(built, hasty)
    seen_by(worker)
    worker.tick()
    assert worker.late == 1
    assert not tables(worker)


def test_changes_are_patched_in_and_bad_ones_named(built):
    box = {"add_box": [[3.0, 3.0, 0.0], [3.4, 3.4, 1.0]]}
    worker = worker_for(built, changes=(box,))
    assert worker.reason == ""
    for _ in range(4):
        worker._change(box)
    assert "no spare box left" in worker.reason


def test_a_measurement_is_carried_on_to_now_and_an_old_one_left():
    measured = Measured(np.array([1.0, 2.0, 3.0]), np.array([2.0, 0.0, 0.0]), np.array([0.0, 4.0, 0.0]))
    then = carried_to(Odometry(1.0, measured), 1.05, 0.1)
    assert_close(then.position, [1.1, 2.005, 3.0], "exact")
    assert_close(then.velocity, [2.0, 0.2, 0.0], "exact")
    assert carried_to(Odometry(1.0, measured), 1.2, 0.1) is None
    assert carried_to(Odometry(1.0, measured._replace(position=np.full(3, np.nan))), 1.0, 0.1) is None
    assert then.attitude is None
    for told in (measured, measured._replace(acceleration=None, attitude=TURNED)):
        heard = unpack_odometry(pack_odometry(Odometry(1.0, told))).measured
        assert_same(heard, told)
        assert_same(carried_to(Odometry(1.0, heard), 1.0, 0.1), told)


def test_a_vehicle_on_a_reference_that_turns_sharply_is_on_it_also_when_it_was_heard_of_late():
    """Its acceleration then says little about where it is now; what it is off goes on."""
    times = np.array([1.0, 1.1])
    derivatives = np.zeros((2, 5, 3))
    for n, power in enumerate((3, 2, 1)):  # 100 t^3 along x: a jerk of 600 m/s^3
        derivatives[:, n, 0] = (100.0, 300.0, 600.0)[n] * (times - 1.0) ** power
    flown = FlatState(derivatives=derivatives, yaw=np.zeros((2, 3)))
    on = Measured(*derivatives[0, :3])
    then = carried_to(Odometry(1.0, on), 1.1, 0.2, flown)
    assert_same(then, Measured(*derivatives[1, :3]))
    beside = carried_to(Odometry(1.0, on._replace(position=on.position + np.array([0.0, 0.3, 0.0]))), 1.1, 0.2, flown)
    assert_close(beside.position - then.position, [0.0, 0.3, 0.0], "exact")
    drifting = carried_to(Odometry(1.0, on._replace(velocity=on.velocity + np.array([0.0, 2.0, 0.0]))), 1.1, 0.2, flown)
    assert_close(drifting.position - then.position, [0.0, 0.2, 0.0], "exact")
    assert np.linalg.norm(carried_to(Odometry(1.0, on), 1.1, 0.2).position - then.position) > 0.09


def test_what_was_heard_before_the_reference_jumped_is_not_taken_for_a_deviation_from_it(built):
    worker = worker_for(built)
    plan = worker._replanner.committed
    worker._replanner._committed.add(plan._replace(start_time=5.0, from_measured=True))
    assert worker._flown(4.95, 5.05) is None
    assert worker._flown(5.01, 5.05) is not None


def assert_same(one: Measured, other: Measured) -> None:
    for mine, theirs in zip(one, other, strict=True):
        assert (mine is None) == (theirs is None)
        if mine is not None:
            assert_close(mine, theirs, "exact")


def test_a_vehicle_that_is_turned_keeps_its_heading_and_what_is_refused_of_that_is_taken_back(built):
    """However many plans the replanner holds for it, the pilot hears of one."""
    worker = worker_for(built, dataclasses.replace(PATIENT, replanning=ReplannerConfig(latency=5.0)))
    turned = Measured(START, np.zeros(3), attitude=TURNED)
    worker.channel.odometry.write(pack_odometry(Odometry(worker.now, turned)))
    seen_by(worker)
    held = len(worker._replanner.plans)
    worker.tick()
    (plan,) = tables(worker)
    assert_close(plan.row(plan.start_time)[15], 1.2, "exact")
    assert len(worker._replanner.plans) > held
    worker.channel.answers.write(pack_answer(Answer(seen=1, accepted=0)))
    worker._hear_answers()
    assert len(worker._replanner.plans) == held
    assert worker.late == 1


def flown(runtime, seconds, watch=None, target=GOAL):
    """Setpoints at 200 Hz, with the vehicle exactly there."""
    setpoints, begin, step = [], runtime.now(), 0
    while runtime.now() < begin + seconds:
        now = runtime.now()
        if step % 20 == 0:
            runtime.observe(now, target)
        setpoints.append(runtime.setpoint(now))
        runtime.odometry(now, setpoints[-1].position, setpoints[-1].velocity, setpoints[-1].acceleration)
        if watch is not None:
            watch(setpoints[-1])
        step += 1
        time.sleep(max(0.0, begin + 0.005 * step - runtime.now()))
    return setpoints


def steps(setpoints):
    """How far it is from one setpoint to the next beyond what the speed explains [m].

    Of those that were asked for one after the other: in a pause a vehicle may go somewhere and be slow at both ends.
    """
    times = np.array([setpoint.time for setpoint in setpoints])
    derivatives = np.array([setpoint.derivatives for setpoint in setpoints])
    apart, speeds = (np.linalg.norm(rows, axis=1) for rows in (np.diff(derivatives[:, 0], axis=0), derivatives[:, 1]))
    beyond, close = apart - np.diff(times) * np.maximum(speeds[1:], speeds[:-1]), np.diff(times) < 0.05
    assert close.sum() > 100
    return beyond[close].max()


def test_a_flight_with_a_box_in_the_way_a_worker_that_is_killed_and_an_end():
    """One process for all: to start one takes a while."""
    world = load_world("env1")
    with Runtime(runtime_builds.planner, hover(START), PATIENT) as runtime:
        assert runtime.status().phase is Phase.STARTING
        assert_close(runtime.setpoint().position, START, "exact")
        runtime.wait_ready(READY)
        assert runtime.status().phase is Phase.WAITING
        runtime.restart_clock()
        setpoints = flown(runtime, 1.5)
        status = runtime.status()
        assert status.phase is Phase.PLANNING
        assert status.cycles > 3
        assert len(runtime.plans) > 1, status
        assert runtime.cycles[0].plans is None
        with pytest.raises(InputError, match="clock"):
            runtime.restart_clock()
        ahead = runtime.preview(np.linspace(runtime.now(), runtime.now() + 20.0, 400))
        assert not np.asarray(ahead.vel)[-1].any()
        box = (np.array([2.5, 2.5, 0.0]), np.array([2.9, 2.9, 1.0]))
        runtime.update_world(add_box=box)
        os.kill(runtime.planner_pid, signal.SIGKILL)
        setpoints += flown(runtime, 1.0)
        assert runtime.status().phase is Phase.RESTARTING
        assert "-9" in runtime.status().reason
        runtime.wait_ready(READY)
        setpoints += flown(runtime, 1.0, target=GOAL + np.array([0.0, 0.5, 0.0]))
        status = runtime.status()
        assert status.restarts == 1
        assert status.cycles > 0
        assert status.compilations_after_warmup == 0
        assert runtime._planner.report()["reason"] == ""
        assert steps(setpoints) < 1e-3
        positions = np.array([setpoint.position for setpoint in setpoints])
        assert host_free_distance(world, positions).min() > 0.25
    assert runtime.status().phase is Phase.STOPPED
    assert runtime.setpoint(1e4).time == 1e4, "answers are given to the last"
    assert not runtime.setpoint(1e4).velocity.any()


@pytest.mark.slow
def test_a_planner_that_hangs_is_silent_then_killed_then_replaced():
    config = dataclasses.replace(PATIENT, restart_after=2.0)
    with Runtime(runtime_builds.hanging, hover(START), config) as runtime:
        runtime.wait_ready(READY)
        phases = []
        setpoints = flown(runtime, 6.0, lambda setpoint: phases.append(runtime.status().phase))
        order = [phase for phase, before in zip(phases, [None, *phases], strict=False) if phase is not before]
        assert order[-3:] == [Phase.PLANNING, Phase.SILENT, Phase.RESTARTING]
        assert "nothing was heard" in runtime.status().reason
        assert steps(setpoints) < 1e-3
        assert not runtime.setpoint(runtime.now() + 20.0).velocity.any(), "the certified plan is flown to its end"


@pytest.mark.slow
def test_the_planners_process_does_not_grow():
    """By half a kilobyte a cycle it would grow 18 MB in an hour; three were reference cycles that nobody collected."""
    with Runtime(runtime_builds.planner, hover(START), PATIENT) as runtime:
        runtime.wait_ready(READY)
        flown(runtime, 40.0)
        before = runtime.status()
        flown(runtime, 120.0)
        after = runtime.status()
    cycles = after.cycles - before.cycles
    assert cycles > 800
    assert 1e3 * (after.memory_mb - before.memory_mb) / cycles < 0.5, "kilobytes a cycle"


def test_what_cannot_be_built_is_said_once():
    with Runtime(runtime_builds.refusing, hover(START)) as runtime:
        with pytest.raises(FileError, match=r"nowhere\.stl"):
            runtime.wait_ready(READY)
        assert runtime.status().phase is Phase.FAILED
        assert runtime.status().restarts == 0
        assert_close(runtime.setpoint().position, START, "exact")


def test_a_process_that_dies_again_and_again_is_given_up():
    with Runtime(runtime_builds.dying, hover(START), dataclasses.replace(PATIENT, most_restarts=1)) as runtime:
        with pytest.raises(ResourceError, match="code 7.*1 restarts"):
            runtime.wait_ready(READY)
        assert runtime.status().restarts == 1


@pytest.mark.skipif(not hasattr(os, "SCHED_RESET_ON_FORK"), reason="Linux only")
def test_a_real_time_priority_stays_with_who_asks():
    """Where the planner had it too, it would take from who asks what it needs to be in time."""

    def started():
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        except PermissionError:
            return None
        with Runtime(runtime_builds.refusing, hover(START)) as runtime:
            return os.sched_getscheduler(0), os.sched_getscheduler(runtime.planner_pid)

    with ThreadPoolExecutor(1) as who_asks:
        policies = who_asks.submit(started).result()
    if policies is None:
        pytest.skip("no real-time priority is allowed here")
    assert policies == (os.SCHED_FIFO, os.SCHED_OTHER)


def test_what_cannot_be_sent_or_read_is_refused():
    with pytest.raises(InputError, match="top of a module"):
        Runtime(lambda: runtime_builds.planner(), hover(START))
    with Runtime(runtime_builds.refusing, hover(START)) as runtime:
        with pytest.raises(InputError, match="three finite numbers"):
            runtime.observe(0.0, np.array([1.0, 2.0]))
        with pytest.raises(InputError, match="three finite numbers"):
            runtime.odometry(0.0, START, np.array([np.nan, 0.0, 0.0]))
        for bad in (np.nan, np.inf):
            with pytest.raises(InputError, match="want a finite time"):
                runtime.setpoint(bad)
        with pytest.raises(InputError, match="the time"):
            runtime.observe("noon", START)
        with pytest.raises(InputError, match="remove_box"):
            runtime.update_world(remove_box="the large one")
        with pytest.raises(InputError, match="one at a time"):
            runtime.update_world()
        with pytest.raises(InputError, match="three finite numbers"):
            runtime.update_world(add_box=(START, np.full(3, np.inf)))
    for bad in ({"silent_after": 0.0}, {"restart_after": 0.1}, {"niceness": 20}, {"remembered": 1}):
        with pytest.raises(InputError):
            RuntimeConfig(**bad)
