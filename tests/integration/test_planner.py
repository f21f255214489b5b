"""The planner as a whole, in environment 1: invariants that no station can promise alone."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.compilation import compilations
from jaxplan.errors import InputError
from jaxplan.knots import KnotConfig
from jaxplan.planner import PlannerConfig, build_planner, select, select_approach
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.records import replace
from jaxplan.selection import CheckConfig, check_clearance
from jaxplan.spline import FlatState
from jaxplan.status import Reason
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.clearance import free_distance
from jaxplan.world.obstacles import Boxes, make_obstacles
from jaxplan.world.update import update_world, with_spare_boxes
from oracles.planner_cases import CONFIG, START, candidates
from tolerances import tolerance


@pytest.fixture(scope="module")
def planner(world):
    return build_planner(CONFIG, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())


def test_usable_plans_keep_every_promise(planner, world, moving):
    """Start state met to snap, goal passed on time, at rest behind it, clear of everything on dense samples."""
    plans = planner.plan_batch(moving, candidates(36))
    usable, behind = np.flatnonzero(plans.reasons == 0), []
    assert len(usable) >= 3
    for index in usable:
        spline = plans.spline(index)
        met = spline.state(plans.arrival_times[index])
        np.testing.assert_allclose(met.pos, plans.goals[index], **tolerance("solve"))
        assert plans.alpha[index] >= CONFIG.arrival.least_alpha - 2e-3
        start, end = spline.state(0.0), spline.state(float(spline.duration))
        np.testing.assert_allclose(start.derivatives[:4], moving.derivatives[:4], **tolerance("solve"))
        np.testing.assert_allclose(start.snap, moving.snap, **tolerance("solve"))
        np.testing.assert_allclose(start.yaw, moving.yaw, **tolerance("formula"))
        behind.append(np.linalg.norm(end.pos - plans.goals[index]))
        assert (np.linalg.norm(met.vel) > 0.3) == (behind[-1] > 0.4)
        np.testing.assert_allclose(end.derivatives[1:], 0.0, atol=1e-4)
        points = spline.evaluate(np.linspace(0, float(spline.duration), 2000))[:, :3]
        with jax.enable_x64(True):
            free = np.asarray(free_distance(world, points))
        assert free.min() >= load_vehicle().radius + CONFIG.checks.tracking_margin
    assert sum(distance > 0.4 for distance in behind) >= 2


@pytest.mark.slow
def test_the_looseness_of_a_bound_rejects_nobody(world, moving):
    """What a check by few samples doubts is looked at again by four times as many, which decides."""
    vehicle, checks = load_vehicle(), CheckConfig(samples_per_segment=4)
    config = dataclasses.replace(CONFIG, checks=checks, exhaustive=True)
    planner = build_planner(config, world=world, vehicle=vehicle, policy=constant_speed_policy())
    by_few, by_many = (
        jax.jit(functools.partial(check_clearance, world=world, vehicle=vehicle, config=some))
        for some in (checks, dataclasses.replace(checks, samples_per_segment=16))
    )
    changed = 0
    for seed in range(4):
        plans = planner.plan_batch(moving, candidates(36, seed))
        with jax.enable_x64(True):
            loose, tight = (np.asarray(clear(plans.margins, plans.splines).clearance) for clear in (by_few, by_many))
        least = vehicle.radius + checks.tracking_margin
        others = np.asarray(plans.margins.reasons) & ~np.uint32(Reason.CLEARANCE)
        passed = np.asarray(plans.margins.reasons) == 0
        np.testing.assert_array_equal(passed, (others == 0) & (tight >= least))
        changed += int((passed & (loose < least)).sum())
    assert changed >= 1


def test_taking_the_best_first_finds_the_winner_of_an_exhaustive_evaluation(world, moving):
    """Not only where the first round has a winner: most arrival times are made short, so that few are reachable."""
    vehicle, policy = load_vehicle(), constant_speed_policy()
    ordered, exhaustive = (
        build_planner(replace_config(exhaustive), world=world, vehicle=vehicle, policy=policy)
        for exhaustive in (False, True)
    )
    tried, winners = set(), 0
    for seed in range(6):
        given = candidates(90, seed)
        times = np.asarray(given.arrival_times) * (0.25 if seed % 2 else 1.0)
        given = replace(given, arrival_times=times)
        quick, whole = ordered.plan_batch(moving, given), exhaustive.plan_batch(moving, given)
        assert select(quick) == select(whole)
        evaluated = quick.trajectory >= 0
        tried.add(int(evaluated.sum()))
        winners += select(whole) >= 0
        skipped = (quick.reasons & int(Reason.OUTRANKED)) > 0
        assert not (evaluated & skipped).any()
        assert (whole.reasons[quick.reasons == 0] == 0).all()
        if select(whole) >= 0:
            assert quick.score[skipped].max(initial=-np.inf) <= quick.score[select(quick)]
            best, same = quick.spline(select(quick)), whole.spline(select(whole))
            np.testing.assert_allclose(best.position, same.position, **tolerance("formula"))
    assert winners >= 4
    assert max(tried) > 0


def test_what_cannot_beat_a_committed_plan_is_left_out(planner, moving):
    """And nothing else changes: what is above the score is planned as without."""
    given = candidates(36)
    plans = planner.plan_batch(moving, given)
    best = select(plans)
    score = float(plans.score[best])
    assert select(planner.plan_batch(moving, given, None, score)) == -1
    assert select(planner.plan_batch(moving, given, None, score - 1e-6)) == best
    assert (planner.plan_batch(moving, given, None, np.inf).trajectory == -1).all()


def replace_config(exhaustive):
    return PlannerConfig(width=32, knots=KnotConfig(distance_per_knot=1.0), exhaustive=exhaustive)


def test_order_of_candidates_does_not_matter(planner, moving):
    given = candidates(20)
    order = np.random.default_rng(5).permutation(20)
    shuffled = replace(
        given,
        goals=given.goals[order],
        arrival_times=given.arrival_times[order],
        likelihood=given.likelihood[order],
    )
    plans, other = planner.plan_batch(moving, given), planner.plan_batch(moving, shuffled)
    np.testing.assert_array_equal(plans.reasons[order], other.reasons)
    assert select(plans) >= 0
    assert select(plans) == order[select(other)]


def test_bad_candidates_do_not_touch_their_neighbours(planner, moving):
    good = candidates(10, seed=2)
    bad = np.array([[np.nan, 0, 1], [np.inf, 0, 1], [99.0, 0, 1], [1.0, -0.05, 1.0], [0, 0, 2**31]])
    mixed = candidates_from(
        good.goals[0],
        np.concatenate([bad, good.goals]),
        np.concatenate([[1.0, 1.0, 1.0, 1.0, np.nan], good.arrival_times]),
        np.concatenate([np.zeros(5), np.log(good.likelihood)]),
    )
    alone, together = planner.plan_batch(moving, good), planner.plan_batch(moving, mixed)
    np.testing.assert_array_equal(alone.reasons, together.reasons[5:])
    assert (together.reasons[:5] != 0).all()
    assert select(together) == (select(alone) + 5 if select(alone) >= 0 else -1)


def test_no_candidate_means_no_plan(planner, moving):
    nothing = candidates_from(START, np.full((4, 3), np.nan), np.ones(4), np.zeros(4))
    plans = planner.plan_batch(moving, nothing)
    assert select(plans) == -1
    assert (plans.reasons & int(Reason.NONFINITE) > 0).all()
    assert select_approach(planner.approach(moving, nothing)) == -1


def test_removing_the_obstacles_never_turns_an_accept_into_a_clearance_reject(world, moving):
    """Adding obstacles may only reject; here seen from the other side. Stop points would differ."""
    empty = replace(world, obstacles=make_obstacles())
    config = dataclasses.replace(CONFIG, meet="rest", allocate="policy", exhaustive=True)
    full, free = (
        build_planner(config, world=some, vehicle=load_vehicle(), policy=constant_speed_policy())
        for some in (world, empty)
    )
    plans, crowded = (planner.plan_batch(moving, candidates(36)) for planner in (free, full))
    assert not (plans.reasons & int(Reason.GOAL_OCCUPIED)).any()
    accepted = crowded.reasons == 0
    assert accepted.sum() > 3
    assert not (plans.reasons[accepted] & int(Reason.CLEARANCE)).any(), "ways differ, so others may reject"


@pytest.mark.slow
def test_how_many_candidates_a_program_takes_changes_nothing(planner, world, moving):
    """One call for all candidates, or many with a part of them each."""
    wide = build_planner(
        dataclasses.replace(CONFIG, width=90), world=world, vehicle=load_vehicle(), policy=constant_speed_policy()
    )
    some, all_at_once = planner.plan_batch(moving, candidates(83)), wide.plan_batch(moving, candidates(83))
    assert select(some) == select(all_at_once) >= 0
    both = (some.trajectory >= 0) & (all_at_once.trajectory >= 0)
    assert both.sum() > 3
    np.testing.assert_array_equal(some.reasons[both], all_at_once.reasons[both])
    np.testing.assert_allclose(some.alpha[both], all_at_once.alpha[both], **tolerance("formula"))


def test_a_planner_taken_to_another_world_plans_as_one_built_there(planner, world, moving):
    """And compiles only what looks at obstacles, if their numbers differ; nothing if they do not."""
    wall = Boxes(center=np.array([[-1.0, -1.0, 1.0]]), half=np.array([[0.5, 2.0, 1.0]]), rotation=np.eye(3)[None])
    crowded = replace(world, name="crowded", obstacles=make_obstacles(boxes=wall))
    built = build_planner(CONFIG, world=crowded, vehicle=load_vehicle(), policy=constant_speed_policy())
    moved = planner.in_world(crowded)
    given = candidates(30)
    here, there, theirs = (some.plan_batch(moving, given) for some in (planner, moved, built))
    np.testing.assert_array_equal(there.reasons, theirs.reasons)
    np.testing.assert_allclose(there.alpha, theirs.alpha, **tolerance("exact"))
    assert (here.reasons != there.reasons).any()
    before = compilations()
    again = moved.in_world(replace(crowded, name="the same under another name"))
    np.testing.assert_array_equal(again.plan_batch(moving, given).reasons, theirs.reasons)
    assert compilations() == before


def test_a_planner_of_a_changed_world_plans_as_one_built_there_and_compiles_nothing(world, moving):
    """A box that comes and goes: lattices are patched, what is compiled is shared."""
    roomy = with_spare_boxes(world, 1)
    old = build_planner(CONFIG, world=roomy, vehicle=load_vehicle(), policy=constant_speed_policy())
    given = candidates(30)
    old.warmup(moving)
    before = old.plan_batch(moving, given)
    change = update_world(roomy, add_box=([-1.5, -3.0, 0.0], [-0.5, 1.0, 2.0]))
    counted = compilations()
    changed = old.update(change)
    after = changed.plan_batch(moving, given)
    changed.approach(moving, given)
    assert compilations() == counted
    built = build_planner(CONFIG, world=change.world, vehicle=load_vehicle(), policy=constant_speed_policy())
    fresh = built.plan_batch(moving, given)
    np.testing.assert_array_equal(after.reasons, fresh.reasons)
    np.testing.assert_allclose(after.alpha, fresh.alpha, **tolerance("exact"))
    assert (after.reasons != before.reasons).any()
    np.testing.assert_array_equal(old.plan_batch(moving, given).reasons, before.reasons)


def test_no_candidates_at_all(planner, moving):
    none = candidates_from(START, np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    plans, approaches = planner.plan_batch(moving, none), planner.approach(moving, none)
    assert select(plans) == select_approach(approaches) == -1
    assert len(plans.reasons) == len(approaches.reasons) == 0


@pytest.mark.parametrize("width", [0, -3, 10**6])
def test_a_width_that_no_program_can_have_is_refused(width):
    with pytest.raises(InputError, match="width"):
        PlannerConfig(width=width)


def test_other_types_of_numbers_compile_nothing(planner, moving):
    """Single precision, lists and JAX arrays are what they stand for."""
    given = candidates(20)
    planner.warmup(moving)
    usual = planner.plan_batch(moving, given)
    single = FlatState(derivatives=moving.derivatives.astype(np.float32), yaw=jnp.asarray(moving.yaw, jnp.float32))
    given = replace(given, goals=jnp.asarray(given.goals, jnp.float32))
    counted = compilations()
    plans = planner.plan_batch(single, given)
    planner.approach(single, given)
    assert compilations() == counted
    assert plans.splines.position.dtype == np.float64
    both = (plans.trajectory >= 0) & (usual.trajectory >= 0)
    np.testing.assert_allclose(plans.alpha[both], usual.alpha[both], rtol=1e-3)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"derivatives": np.full((5, 3), np.nan)}, "finite"),
        ({"yaw": np.array([0.0, np.inf, 0.0])}, "finite"),
        ({"derivatives": np.zeros((2, 5, 3)), "yaw": np.zeros((2, 3))}, r"shape \(2, 5, 3\), want \(5, 3\)"),
    ],
)
def test_states_that_no_plan_can_start_from_are_refused(planner, moving, change, said):
    state = FlatState(**({"derivatives": moving.derivatives, "yaw": moving.yaw} | change))
    for function in (planner.plan_batch, planner.approach, planner.warmup):
        arguments = (state,) if function is planner.warmup else (state, candidates(3))
        with pytest.raises(InputError, match=said):
            function(*arguments)
