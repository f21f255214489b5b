"""Refined plans are flown in the vehicle's model, and made more slowly where it does not follow them."""

import dataclasses

import numpy as np
import pytest

from jaxplan.minsnap.single import minimum_snap
from jaxplan.planner import PlannerConfig, RefinementConfig, Seed, build_planner
from jaxplan.planner.rollouts import RolloutConfig
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.spline import hover
from jaxplan.status import Reason
from jaxplan.tracking.result import held_error
from jaxplan.tracking.track import track
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from oracles.planner_cases import START
from tolerances import tolerance

WAY = START + np.array([[0.0, 0.0, 0.0], [2.8, 0.4, 0.1], [5.6, 0.4, 0.2], [7.0, 0.3, 0.2]])
SEED = Seed(minimum_snap(WAY, [1.0, 0.8, 0.8]), 0.0, 1.8, WAY[2], 1.0)
TIMES = np.linspace(0.0, 6.0, 41)
STANDING = candidates_from(SEED.goal, np.repeat(SEED.goal[None], 41, axis=0), TIMES, np.zeros(41))
CREDULOUS = RolloutConfig(whole_share=100.0, whole_twist=10.0)
IMPOSSIBLE = RolloutConfig(whole_share=1e-3)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """140 g with motors that are slow for it: what its rotors can give it does not follow."""
    path = tmp_path_factory.mktemp("vehicle") / "small.toml"
    path.write_text("mass = 0.14\narm = 0.06\nthrust_to_weight = 4.0\nmotor_time_constant = 0.029\n")
    return load_vehicle(path)


def refined(vehicle, rollouts, iterations=None, refinement=None):
    config = PlannerConfig(refinement=refinement or RefinementConfig(), rollouts=rollouts)
    planner = build_planner(config, world=load_world("env1"), vehicle=vehicle, policy=constant_speed_policy())
    found = planner.refine(hover(START), STANDING, SEED, iterations)
    assert found is not None
    return found


def share(vehicle, spline):
    """The largest error in the plant with its noise, over what counts as held."""
    return float(track([spline], vehicle=vehicle).max_position_error[0]) / held_error(vehicle)


def test_a_plan_that_is_not_followed_is_made_again_more_slowly(small):
    hasty, steady = refined(small, CREDULOUS), refined(small, RolloutConfig())
    assert not hasty.reasons
    assert not steady.reasons
    assert hasty.arrival_time < steady.arrival_time < SEED.meeting
    assert share(small, hasty.spline) > 1.0
    assert share(small, steady.spline) < 0.9


def test_a_meeting_after_all_that_is_predicted_is_made_sooner_where_the_seed_says_so():
    """Whose target is predicted for 0.8 s is met later; then it is where it was expected last."""
    config, times = PlannerConfig(refinement=RefinementConfig()), np.linspace(0.0, 0.8, 9)
    world, vehicle, policy = load_world("env1"), load_vehicle(), constant_speed_policy()
    planner = build_planner(config, world=world, vehicle=vehicle, policy=policy)
    goals = SEED.goal + (times - 0.8)[:, None] * [0.0, 0.4, 0.0]
    soon = candidates_from(goals[0], goals, times, np.zeros(9))
    refused = planner.refine(hover(START), soon, SEED)
    found = planner.refine(hover(START), soon, SEED._replace(late=True))
    assert refused is not None
    assert found is not None
    assert refused.reasons & Reason.ALPHA_LT_1
    assert not found.reasons
    assert 0.8 < found.arrival_time < SEED.meeting - RefinementConfig().gain
    there = found.spline.evaluate(found.arrival_time)[:3]
    assert np.linalg.norm(there - SEED.goal) <= RefinementConfig().meet_radius + tolerance("solve")["atol"]


def test_where_there_is_no_time_for_another_try_it_is_refused(small):
    few = RefinementConfig().iterations - 1
    found = refined(small, RolloutConfig(), few)
    assert found.reasons == Reason.UNTRACKABLE
    assert not refined(small, CREDULOUS, few).reasons


def test_a_plan_beyond_the_rotors_between_the_instants_that_were_looked_at_is_made_again():
    """As nothing allows a rotor to be out of its range, the first try is refused, and a more cautious one is not."""
    vehicle, strict = load_vehicle(), RefinementConfig(most_excess=0.001)
    assert not refined(vehicle, None).reasons
    assert refined(vehicle, None, strict.iterations - 1, strict).reasons == Reason.LIMITS
    again = refined(vehicle, None, None, strict)
    assert not again.reasons
    assert again.arrival_time < SEED.meeting


def test_a_plan_that_no_try_makes_good_is_refused(small):
    assert refined(small, IMPOSSIBLE).reasons == Reason.UNTRACKABLE


def test_a_plan_that_is_followed_is_what_it_was():
    vehicle = load_vehicle()
    with_it, without = refined(vehicle, RolloutConfig()), refined(vehicle, None)
    assert with_it.arrival_time == without.arrival_time
    np.testing.assert_array_equal(with_it.spline.position, without.spline.position)
    assert dataclasses.astuple(PlannerConfig(rollouts=None))  # a configuration like any
    assert share(vehicle, with_it.spline) < 0.9
