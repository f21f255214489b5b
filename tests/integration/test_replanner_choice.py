"""What a cycle looks at before it decides, and what it commits, where plans are compared by capture."""

import numpy as np
import pytest

from jaxplan.planner import Fault, build_planner
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.observations import first_observation
from jaxplan.records import replace
from jaxplan.replanner import Replanner
from jaxplan.replanner.decision import LOOKED_AT
from jaxplan.spline import hover
from jaxplan.status import Note, PlanStatus, Reason
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from jaxplan.world.update import update_world, with_spare_boxes
from oracles.expectations import Always, Passing, predicted
from oracles.planner_cases import CONFIG, START


@pytest.fixture(scope="module")
def planner():
    built = build_planner(CONFIG, world=load_world("env1"), vehicle=load_vehicle(), policy=constant_speed_policy())
    built.warmup(hover(START))
    return built


@pytest.mark.parametrize(
    ("receding", "changing", "fewest", "most"), [(0.0, False, 1, 3), (0.2, False, 4, 6), (0.0, True, 6, 6)]
)
def test_candidates_are_looked_at_again_only_where_something_has_become_worse(
    planner, receding, changing, fewest, most
):
    """They come to nothing. The target flies as predicted, or it is farther away in each prediction, or the world
    changes."""
    looked_at = []

    def plan_batch(*given):
        plans, (*_, above) = planner.plan_batch(*given), given
        looked_at.append(above < np.inf)
        if len(looked_at) == 1:
            return plans
        none = np.full_like(plans.reasons, Reason.LIMITS)
        return replace(plans, reasons=none, trajectory=np.full(len(none), 0 if looked_at[-1] else -1))

    def predict(observations, cycle):
        return predicted((0.0, 0.5, 0.0), place=(-4.2, (0.05 + receding) * cycle, 1.0))

    asked = planner._replace(plan_batch=plan_batch, update=lambda change, moving=False: asked)
    change = update_world(with_spare_boxes(load_world("env1"), 1), add_box=([4.0, 4.0, 0.0], [4.5, 4.5, 1.0]))
    replanner = Replanner(asked, predict, hover(START))
    seen, cycles = first_observation(0.0, np.array([-4.2, 0.0, 1.0])), []
    for cycle in range(6):
        if changing:
            replanner.update(change)
        cycles.append(replanner.step(0.1 * cycle, seen))
    assert cycles[0].status is PlanStatus.INTERCEPT
    assert fewest <= sum(looked_at) <= most


@pytest.mark.parametrize(("promise", "asked"), [(-np.inf, True), (-9.0, False), (0.0, True)])
def test_nothing_else_is_looked_for_where_no_straight_flight_would_be_sooner(planner, promise, asked):
    """Beside a committed plan; -inf says that nothing is known of any."""
    corrected = []

    def plan_batch(*given):
        return replace(planner.plan_batch(*given), promise=promise)

    def correct(*given):
        corrected.append(given)
        return planner.correct(*given)

    replanner = Replanner(planner, Passing(predicted((0.0, 0.5, 0.0)), 0.0), hover(START))
    seen = first_observation(0.0, np.array([-4.2, 0.0, 1.0]))
    assert replanner.step(0.0, seen).status is PlanStatus.INTERCEPT
    replanner.planner = planner._replace(plan_batch=plan_batch, correct=correct)
    cycle = replanner.step(0.1, seen)
    assert bool(corrected) == asked
    assert asked or cycle.status is PlanStatus.KEPT_COMMITTED


def test_a_flight_is_corrected_but_not_a_vehicle_that_stands_where_plans_pass(planner):
    """Unless it goes looking for a target that nobody sees."""
    corrected, passing = [], True

    def plan_batch(*given):
        plans = replace(planner.plan_batch(*given[:-1], -np.inf), promise=np.inf)
        return plans if passing else replace(plans, reasons=np.full_like(plans.reasons, Reason.LIMITS))

    def correct(*given):
        corrected.append(given)
        return planner.correct(*given)

    asked = planner._replace(plan_batch=plan_batch, correct=correct)
    replanner = Replanner(asked, Passing(predicted((0.0, 0.5, 0.0)), 0.0), hover(START))
    seen = first_observation(0.0, np.array([-4.2, 0.0, 1.0]))
    assert replanner.step(0.0, seen).status is PlanStatus.INTERCEPT
    assert not corrected
    replanner.step(0.4, seen)
    assert np.linalg.norm(replanner.reference(np.array([0.45])).vel) > 1.0
    assert len(corrected) == 1
    passing = False
    Replanner(asked, Passing(predicted((0.0, 0.5, 0.0)), 0.0), hover(START)).step(0.0, seen)
    assert len(corrected) == 2
    passing, searching = True, replace(predicted((0.0, 0.5, 0.0)), note=int(Note.SEARCHING))
    Replanner(asked, Passing(searching, 0.0), hover(START)).step(0.0, seen)
    assert len(corrected) == 3


@pytest.mark.parametrize("refusing", [1, 2, 9])
def test_what_the_last_look_refuses_is_not_committed_but_the_next_best(planner, refusing):
    """So many plans in turn; of a cycle's plans no more than four are looked at."""
    looked_at = []

    def validate(spline, since=0.0, start=None, wider=0.0):
        verdict = planner.validate(spline, since, start, wider)
        if start is None:
            return verdict
        looked_at.append(spline)
        return verdict._replace(faults=Fault.CLEARANCE) if len(looked_at) <= refusing else verdict

    given, seen = predicted((0.0, 0.5, 0.0), (0.1, 0.5, 0.0)), first_observation(0.0, np.array([-4.2, 0.0, 1.0]))
    best = Replanner(planner, Always(given), hover(START)).step(0.0, seen)
    found = Replanner(planner._replace(validate=validate), Always(given), hover(START)).step(0.0, seen)
    assert best.status is PlanStatus.INTERCEPT
    assert best.refused == 0
    if refusing < LOOKED_AT:
        assert found.status is PlanStatus.INTERCEPT
        assert found.refused == refusing
        assert found.plans.score[found.chosen] <= best.plans.score[best.chosen]
    else:
        assert found.status is not PlanStatus.INTERCEPT
        assert found.refused == len(looked_at) == LOOKED_AT
