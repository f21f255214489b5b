"""What the pilot holds: the same trajectory as the planner's, and none that does not fit."""

import numpy as np
import pytest

from jaxplan.replanner import CommittedPlan
from jaxplan.replanner.committed import hold
from jaxplan.runtime.held import HeldPlans
from jaxplan.runtime.messages import MOST_PIECES, pack_plan, unpack_plan
from jaxplan.runtime.table import tabulate
from jaxplan.spline import FlatState, PiecewisePolynomial, hover
from jaxplan.status import PlanStatus
from tolerances import assert_close

HOVER = hover(np.array([1.0, 2.0, 3.0]), yaw=0.5)


def random_plan(pieces=5, start_time=1.0, seed=0, from_measured=True):
    rng = np.random.default_rng(seed)
    spline = PiecewisePolynomial(
        durations=rng.uniform(0.3, 1.5, pieces),
        position=rng.normal(size=(pieces, 10, 3)),
        yaw=rng.normal(size=(pieces, 6)),
    )
    return CommittedPlan(start_time, spline, np.arange(3.0), 2.5, 1.1, PlanStatus.INTERCEPT, 0.9, from_measured)


def held_with(*plans):
    held = HeldPlans(hold(HOVER), 10)
    for number, plan in enumerate(plans, start=1):
        held.offer(unpack_plan(pack_plan(tabulate(number, number - 1, plan))))
    return held


def test_the_setpoint_is_the_planners_state_to_every_derivative():
    plan = random_plan()
    held = held_with(plan)
    for time in (1.0, 1.2, 2.0, 1.0 + plan.spline.durations[0], 3.3, 1.0 + 0.999 * plan.spline.duration):
        state, found = plan.spline.state(time - 1.0), held.at(time)
        assert found.time == time
        scale = np.maximum(np.abs(state.derivatives), 1.0)
        assert_close(found.derivatives / scale, state.derivatives / scale, "formula")
        assert_close(found.yaw, state.yaw, "formula")
    many = held.preview(np.array([1.2, 2.0]))
    assert_close(many.derivatives[1, :3], plan.spline.state(1.0).derivatives[:3], "formula")


def test_before_the_first_plan_and_behind_the_last_it_stays():
    plan = random_plan()
    held = held_with(plan)
    assert_close(held.at(-5.0).position, HOVER.pos, "exact")
    assert held.at(0.999).yaw[0] == 0.5
    end = plan.spline.state(float(plan.spline.duration))
    late = held.at(1e4)
    assert_close(late.position, end.pos, "formula")
    assert not late.derivatives[1:].any()
    assert not late.yaw[1:].any()


def test_a_plan_comes_back_as_it_was_sent():
    plan = random_plan(3)
    found = unpack_plan(pack_plan(tabulate(4, 2, plan)))
    assert (found.head.number, found.head.predecessor) == (4, 2)
    for mine, theirs in zip(plan, found.plan, strict=True):
        if isinstance(mine, PiecewisePolynomial):
            assert_close(theirs.position, mine.position, "exact")
            assert_close(theirs.yaw, mine.yaw, "exact")
            assert_close(theirs.durations, mine.durations, "exact")
        else:
            np.testing.assert_array_equal(theirs, mine)
    with pytest.raises(ValueError, match="want at most"):
        pack_plan(tabulate(1, 0, random_plan(MOST_PIECES + 1)))


def on_from(state: FlatState, seed=1, start_time=1.0, off=0.0):
    """A plan that begins at ``state``."""
    plan = random_plan(1, start_time, seed, from_measured=False)
    position, duration = np.array(plan.spline.position), plan.spline.durations[0]
    for order, value in enumerate(state.derivatives):
        position[0, order] = value * duration**order / np.prod(np.arange(1, order + 1))
    position[0, 0] += off
    yaw = np.array(plan.spline.yaw)
    yaw[0, 0] = state.yaw[0]
    return plan._replace(spline=PiecewisePolynomial(durations=plan.spline.durations, position=position, yaw=yaw))


def offer(held, number, predecessor, plan):
    held.offer(tabulate(number, predecessor, plan))
    return held.refused


def test_only_what_fits_is_taken():
    held = HeldPlans(hold(HOVER), 10)
    good = on_from(HOVER)
    assert offer(held, 1, 5, good) == {"goes on from another plan": 1}
    assert offer(held, 2, 0, on_from(HOVER, off=1e-3))["jumps"] == 1
    broken = np.array(good.spline.position)
    broken[0, 7, 1] = np.nan
    spline = PiecewisePolynomial(durations=good.spline.durations, position=broken, yaw=good.spline.yaw)
    assert offer(held, 3, 0, good._replace(spline=spline))["not finite"] == 1
    assert offer(held, 4, 0, good._replace(start_time=np.nan))["not finite"] == 2
    held.at(1.5)
    assert offer(held, 5, 0, good)["late"] == 1
    assert held.answer == (5, 0)
    assert len(held.plans) == 1
    assert sum(offer(held, 6, 0, on_from(HOVER, start_time=1.6)).values()) == 5
    assert held.answer == (6, 6)
    assert held.at(1.55).velocity.any() == np.False_


def test_what_was_asked_of_far_ahead_is_no_promise():
    held = HeldPlans(hold(HOVER), 10)
    held.at(1e6, promised=0.9)
    assert not offer(held, 1, 0, on_from(HOVER))
    assert held.answer == (1, 1)
    held.at(1e6)
    assert offer(held, 2, 1, on_from(HOVER, start_time=9.0)) == {"late": 1}


def test_what_was_said_stays_said_and_nothing_jumps():
    """However plans come: the position is continuous over all instants that were asked for."""
    rng = np.random.default_rng(0)
    held, number, before = HeldPlans(hold(HOVER), 10), 0, None
    for step in range(1500):
        now = 0.005 * step
        if rng.random() < 0.1:
            takeover = now + rng.uniform(-0.05, 0.1)
            begins = held.preview(np.array([takeover]))
            state = FlatState(derivatives=begins.derivatives[0], yaw=begins.yaw[0])
            number += 1
            held.offer(tabulate(number, held.newest.head.number, on_from(state, number, takeover)))
        after = held.at(now)
        if before is not None:
            reach = 0.005 * max(np.linalg.norm(before.velocity), np.linalg.norm(after.velocity))
            bend = 0.005**2 * max(np.linalg.norm(before.acceleration), np.linalg.norm(after.acceleration), 1.0)
            ended = not after.derivatives[1:].any()  # these plans do not end at rest
            assert ended or np.linalg.norm(after.position - before.position) <= reach + bend
        before = after
    assert set(held.refused) <= {"late"}
    assert held.refused["late"] > 10
    assert len(held.plans) == 10, "no more than what is remembered"
