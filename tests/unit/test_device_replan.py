"""One replan as one program: what it chooses is a plan that the last look of the planner on the host passes, too."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.device.replan import Decision, Replan, ReplanConfig, build_replan
from jaxplan.device.room import room_of
from jaxplan.device.stations import Goals
from jaxplan.errors import InputError
from jaxplan.feasibility.checkpoint import load_classifier
from jaxplan.io.targets import load_target
from jaxplan.planner import PlannerConfig
from jaxplan.planner.kernels.pieces import body_of
from jaxplan.planner.validator import Keep, Room, ValidatorConfig, validate
from jaxplan.policy.checkpoint import load_policy
from jaxplan.search.kernels.solids import solids_of
from jaxplan.spline import FlatState, PiecewisePolynomial, hover
from jaxplan.status import Reason
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from tolerances import assert_close

WORLD, VEHICLE = load_world("env1"), load_vehicle()
CONFIG = ReplanConfig(planner=PlannerConfig(selection="paper", allocate="policy"), width=16)
START = hover(np.asarray(WORLD.start))
COUNT = 20
Compiled = jax.stages.Wrapped


def goals_at(now: float) -> Goals:
    """Where a target will be in steps of 0.1 s, all as likely."""
    times = 0.1 * np.arange(1, COUNT + 1)
    return Goals(load_target(None, world="env1", speed=2.0).position(now + times), times, np.ones(COUNT))


@pytest.fixture(scope="module")
def replan() -> Replan:
    """Compiled once for all tests of this file."""
    traced = jax.jit(build_replan(CONFIG, VEHICLE, load_policy("mfrl"), load_classifier("mfrl")))
    room = room_of(WORLD, CONFIG.planner.padding, 0.28)

    def call(state: FlatState, goals: Goals, above: float = -np.inf) -> Decision:
        with jax.enable_x64(True):
            return jax.tree.map(np.asarray, traced(room, state, goals, jnp.asarray(above)))

    return call


@pytest.fixture(scope="module")
def decision(replan: Replan) -> Decision:
    return replan(START, goals_at(1.0))


def plan_of(decision: Decision) -> PiecewisePolynomial:
    return decision.spline.spline(0)


def test_the_plan_begins_at_the_state_and_meets_its_goal_in_time(decision: Decision) -> None:
    assert decision.found
    assert not decision.approaches
    plan, goal = plan_of(decision), goals_at(1.0).positions[decision.candidate]
    assert_close(plan.state(0.0).derivatives, START.derivatives, "solve")
    met = np.asarray(plan.evaluate(decision.arrival_time))[:3]
    assert np.linalg.norm(met - goal) < 1e-5  # ways are searched in float32
    end = plan.state(float(plan.duration))
    assert_close(end.vel, np.zeros(3), "solve")
    assert decision.score == pytest.approx(1.0 - decision.arrival_time)


def test_the_plan_passes_the_last_look(decision: Decision) -> None:
    checks = CONFIG.planner.checks
    radius = float(VEHICLE.radius)
    keep = Keep(radius + checks.tracking_margin, checks.slow, checks.margin_per_speed, radius + checks.most_margin)
    room = Room(tuple(solids_of(WORLD)), np.asarray(WORLD.bounds, dtype=np.float64))
    verdict = validate(plan_of(decision), room, body_of(VEHICLE), keep, ValidatorConfig(), start=START)
    assert not verdict.faults


def test_nothing_that_scores_better_was_passed_over(decision: Decision) -> None:
    score = 1.0 - goals_at(1.0).times
    better = decision.reasons[score > decision.score]
    assert (better != 0).all()
    assert not (better & np.uint32(Reason.OUTRANKED)).any()
    assert decision.reasons[decision.candidate] == 0


def test_nothing_is_found_that_is_no_better_than_what_there_is(replan: Replan, decision: Decision) -> None:
    again = replan(START, goals_at(1.0), above=float(decision.score))
    assert not again.found


def test_what_cannot_be_met_is_approached(replan: Replan) -> None:
    goals = goals_at(1.0)
    soon = goals._replace(times=goals.times * 1e-2)
    found = replan(START, soon)
    assert not found.found
    assert found.approaches
    assert found.arrival_time > soon.times[found.candidate]
    assert (found.reasons & np.uint32(Reason.OUT_OF_REACH | Reason.ALPHA_LT_1) != 0).all()


def test_goals_that_are_no_places_are_rejected_and_harm_nothing(replan: Replan, decision: Decision) -> None:
    goals = goals_at(1.0)
    positions = goals.positions.copy()
    last = decision.candidate + 1
    positions[last:] = np.nan
    found = replan(START, goals._replace(positions=positions))
    assert found.found
    assert found.candidate == decision.candidate
    assert (found.reasons[last:] & np.uint32(Reason.NONFINITE) != 0).all()
    nowhere = replan(START, goals._replace(positions=np.full((COUNT, 3), np.nan)))
    assert not nowhere.found
    assert not nowhere.approaches


def test_other_vehicles_and_ways_to_meet_are_refused() -> None:
    with pytest.raises(InputError, match="made for"):
        build_replan(CONFIG, load_vehicle("x500"), load_policy("mfrl"))
    with pytest.raises(InputError, match="match"):
        ReplanConfig(planner=PlannerConfig(meet="match"))
    with pytest.raises(InputError, match="width"):
        ReplanConfig(width=0)
