"""How many candidates a replan looks at, in environment 1: paths, rounds, and what promises too little."""

import dataclasses
import itertools

import numpy as np
import pytest

from jaxplan.batching import meanwhile
from jaxplan.planner import Timer, build_planner, rounds, select
from jaxplan.planner.rounds import PROMISING
from jaxplan.planner.table import search as table_search
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.futures import Futures
from jaxplan.records import replace
from jaxplan.selection import CheckConfig
from jaxplan.spline import hover
from jaxplan.status import Reason
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.update import update_world, with_spare_boxes
from oracles.planner_cases import CONFIG, START, candidates


def test_once_the_time_is_up_no_more_candidates_are_tried(world, moving):
    """None passes, so all are tried; with a clock that says at once that it is too late, those of the first round."""
    config = dataclasses.replace(CONFIG, checks=CheckConfig(max_deviation=1e-9), allocate="policy")
    strict = build_planner(config, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    given, late = candidates(90), itertools.count().__next__
    hasty, whole = strict.plan_batch(moving, given, Timer(late, 1e-3)), strict.plan_batch(moving, given)
    tried, wanted = hasty.trajectory >= 0, whole.trajectory >= 0
    assert tried.sum() == CONFIG.width < wanted.sum()
    assert select(hasty) == select(whole) == -1
    np.testing.assert_array_equal(hasty.reasons[tried], whole.reasons[tried])
    assert (hasty.reasons[wanted & ~tried] == int(Reason.OUTRANKED)).all()
    assert hasty.score[tried].min() >= hasty.score[wanted & ~tried].max()


def test_a_round_that_has_begun_is_waited_for_once_the_time_is_up(world, monkeypatch):
    """The first one comes to nothing, and takes all the time that there is; the next one runs beside it."""
    planner = build_planner(CONFIG, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    given, checked, now = candidates(200), rounds.check, [0.0]
    hasty = planner.plan_batch(hover(START), given, Timer(itertools.count().__next__, 1e-3))
    first = np.flatnonzero(hasty.trajectory >= 0)

    def check(parts, state, table, matched):
        now[0], good = 1.0, checked(parts, state, table, matched)
        return good._replace(reasons=np.where(np.isin(good.rows, first), np.uint32(Reason.LIMITS), good.reasons))

    monkeypatch.setattr(rounds, "check", check)
    monkeypatch.setattr(rounds, "PORTION", 6)
    plans = planner.plan_batch(hover(START), given, Timer(lambda: now[0], 500.0))
    assert select(plans) >= 0
    assert select(plans) not in first
    assert (plans.trajectory >= 0).sum() == 2 * CONFIG.width


def test_no_more_paths_are_searched_than_it_takes(world, moving, monkeypatch):
    """To the goals of the best; to others only where too few of those can be reached in time; to none twice."""
    searched = []

    def search(parts, state, table, rows):
        searched.append(rows)
        return table_search(parts, state, table, rows)

    monkeypatch.setattr(rounds, "search", search)
    planner = build_planner(CONFIG, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    given = candidates(200)
    plans = planner.plan_batch(moving, given)
    assert select(plans) >= 0
    assert [len(rows) for rows in searched] == [rounds.SEARCHED * rounds.PORTION * CONFIG.width]

    searched.clear()
    monkeypatch.setattr(rounds, "SEARCHED", 1)
    given = candidates(400)
    plans = planner.plan_batch(moving, replace(given, arrival_times=0.05 * np.asarray(given.arrival_times)))
    first, second = searched
    assert len(first) == rounds.PORTION * CONFIG.width
    assert not np.isin(first, second).any()
    assert plans.score[first].min() >= plans.score[second].max()


@pytest.mark.parametrize(
    ("captures_in", "fast_from", "most"), [(0.9, 9.0, 1), (1.8, 9.0, 2), (9.0, 9.0, 3), (1.8, 0.0, 2), (9.0, 0.0, 2)]
)
def test_the_sooner_the_committed_plan_captures_the_fewer_others_are_tried(world, moving, captures_in, fast_from, most):
    """Where plans are compared by capture, and none passes; the best are tried, fewer in flight, three at most."""
    config = dataclasses.replace(
        CONFIG, checks=CheckConfig(max_deviation=1e-9), allocate="policy", policy_speed=fast_from
    )
    strict = build_planner(config, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    ahead = np.asarray(moving.pos) + 0.3 * np.asarray(moving.vel)  # every flight captures it soon
    still = Futures(times=np.zeros(1), positions=ahead[None, None], weights=np.ones(1))
    given = replace(candidates(90), futures=still)
    beside, alone = (strict.plan_batch(moving, given, None, above) for above in (-captures_in, -np.inf))
    tried, wanted = beside.trajectory >= 0, alone.trajectory >= 0
    assert tried.sum() == most * config.width < wanted.sum()
    np.testing.assert_array_equal(beside.reasons[tried], alone.reasons[tried])
    assert beside.score[tried].min() >= beside.score[wanted & ~tried].max()
    by_eq_9 = strict.plan_batch(moving, candidates(90), None, -100.0)
    assert (by_eq_9.trajectory >= 0).sum() > most * config.width


@pytest.mark.parametrize(("captures_in", "fast_from", "most"), [(0.9, 9.0, 2), (1.4, 9.0, 3), (1.4, 0.0, 2)])
def test_where_something_moves_more_are_tried_from_slow_starts(world, moving, captures_in, fast_from, most):
    """A round for each half of a second there, and no limit to them; for each second in fast flight."""
    config = dataclasses.replace(
        CONFIG, checks=CheckConfig(max_deviation=1e-9), allocate="policy", policy_speed=fast_from
    )
    roomy, corner = with_spare_boxes(world, 1), np.asarray(world.bounds)[1]
    moved = update_world(roomy, move_box=(len(roomy.boxes.center) - 1, (corner - 0.2, corner - 0.1)))
    still = build_planner(config, world=roomy, vehicle=load_vehicle(), policy=constant_speed_policy())
    strict = still.update(moved, moving=True)
    ahead = np.asarray(moving.pos) + 0.3 * np.asarray(moving.vel)
    given = replace(candidates(90), futures=Futures(times=np.zeros(1), positions=ahead[None, None], weights=np.ones(1)))
    beside, alone, late = (strict.plan_batch(moving, given, None, above) for above in (-captures_in, -np.inf, -9.0))
    assert (beside.trajectory >= 0).sum() == most * config.width
    np.testing.assert_array_equal(late.trajectory >= 0, alone.trajectory >= 0)
    assert (alone.trajectory >= 0).sum() > 3 * config.width


def asked_in(monkeypatch, later):
    """Who allots times in rounds, in turn, and how many of them had when further rounds began; those wait or not."""
    asked, begun, matched = [], [], rounds.match

    def match(parts, allocation, *rest):
        asked.append(allocation.match)
        return matched(parts, allocation, *rest)

    def begin(run):
        begun.append(len(asked))
        return run if later else meanwhile(run)

    monkeypatch.setattr(rounds, "match", match)
    monkeypatch.setattr(rounds, "meanwhile", begin)
    return asked, begun


def test_the_next_round_begins_once_an_allocation_has_failed_and_counts_where_the_one_before_fails(world, monkeypatch):
    """Here the best 120 come to nothing. Whether rounds run beside each other makes no difference."""
    planner = build_planner(CONFIG, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    given, checked, found = candidates(200), rounds.check, []
    best = np.argsort(-planner.plan_batch(hover(START), given).score)[:120]

    def check(parts, state, table, matched):
        good = checked(parts, state, table, matched)
        return good._replace(reasons=np.where(np.isin(good.rows, best), np.uint32(Reason.LIMITS), good.reasons))

    monkeypatch.setattr(rounds, "check", check)
    monkeypatch.setattr(rounds, "PORTION", 6)
    for later in (True, False):
        with monkeypatch.context() as patch:
            _, begun = asked_in(patch, later)
            found.append(planner.plan_batch(hover(START), given))
        assert begun[0] == 1
    one, two = found
    assert select(one) == select(two) >= 0
    np.testing.assert_array_equal(one.reasons, two.reasons)
    np.testing.assert_array_equal(one.trajectory, two.trajectory)


@pytest.mark.parametrize(
    ("captures", "exhaustive", "enough"), [(True, False, True), (False, False, False), (True, True, False)]
)
def test_by_capture_one_allocation_that_has_a_plan_is_enough(world, monkeypatch, captures, exhaustive, enough):
    """By eq. 9, and where all is evaluated, the other one is asked for whatever would be better, or has none."""
    config = dataclasses.replace(CONFIG, exhaustive=exhaustive)
    planner = build_planner(config, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    still = Futures(times=np.zeros(1), positions=START[None, None] + [0.0, 2.0, 0.0], weights=np.ones(1))
    asked, _ = asked_in(monkeypatch, later=True)
    plans = planner.plan_batch(hover(START), replace(candidates(60), futures=still if captures else None))
    assert select(plans) >= 0
    assert len(asked) % 2 == (1 if enough else 0)


@pytest.mark.parametrize("fast_from", [9.0, 0.0])
def test_nothing_is_tried_where_no_straight_flight_promises_enough(world, moving, fast_from):
    """By capture, beside a committed plan, from slow and from fast starts."""
    config = dataclasses.replace(CONFIG, allocate="policy", policy_speed=fast_from)
    planner = build_planner(config, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    still = Futures(times=np.zeros(1), positions=np.array([[[1.0, 1.0, 1.0]]]), weights=np.ones(1))
    given = replace(candidates(90), futures=still)
    untried = planner.plan_batch(moving, given, None, np.inf)
    promise = untried.score[(untried.reasons & ~np.uint32(Reason.OUTRANKED)) == 0].max()
    little, enough = (planner.plan_batch(moving, given, None, promise - share * PROMISING) for share in (0.9, 1.1))
    assert (little.trajectory == -1).all()
    assert (enough.trajectory >= 0).any()
    assert little.promise == enough.promise == untried.promise >= promise
