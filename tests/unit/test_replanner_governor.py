"""Where a vehicle is along the plan that it falls behind, and what is left of that, slower."""

import numpy as np
import pytest

from jaxplan.replanner.governor import BEHIND, MOST_SLOWDOWN, SLOWDOWNS, lag_behind, slower
from jaxplan.spline import PiecewisePolynomial
from tolerances import assert_close, relative

SPEED = 5.0


def straight(speed=SPEED):
    """Evenly along x, for 2 s in two pieces, from the origin on."""
    position = np.zeros((2, 10, 3))
    position[1, 0, 0] = position[:, 1, 0] = speed
    return PiecewisePolynomial(durations=np.ones(2), position=position, yaw=np.zeros((2, 6)))


def at(x, y=0.0):
    return np.array([x, y, 0.0])


def test_a_vehicle_on_its_plan_beside_it_or_ahead_of_it_is_not_behind():
    for where in (at(7.5), at(7.5, 1.0), at(8.0), at(7.5 - 0.9 * BEHIND)):
        assert lag_behind(straight(), 1.5, where, at(SPEED)) is None


@pytest.mark.parametrize("since", [1.5, 2.0, 7.0])
def test_it_is_found_along_the_path_and_the_plan_made_as_fast_as_it(since):
    end = SPEED * min(since, 2.0)
    lag = lag_behind(straight(), since, at(end - 0.8, 0.3), at(0.8 * SPEED, 1.0))
    assert lag is not None
    assert lag.since == pytest.approx((end - 0.8) / SPEED, abs=0.006)
    assert lag.slowdown == pytest.approx(1.25, **relative("formula"))


def test_a_faster_vehicle_does_not_make_a_plan_faster_and_a_backward_one_not_endless():
    assert lag_behind(straight(), 1.5, at(6.0), at(2.0 * SPEED)).slowdown == 1.0
    assert lag_behind(straight(), 1.5, at(6.0), at(-SPEED)).slowdown == MOST_SLOWDOWN


def test_nothing_is_slower_than_slow_nor_before_a_plan_begins():
    assert lag_behind(straight(0.5), 2.0, at(0.4), at(0.1)) is None
    assert lag_behind(straight(), 0.0, at(-1.0), at(SPEED)) is None
    assert lag_behind(straight(), 0.5, at(-1.0), at(SPEED)) is None


def test_what_is_left_keeps_its_path_and_asks_for_less_by_the_square():
    position = np.zeros((1, 10, 3))
    position[0, 1, 0], position[0, 2, 1], position[0, 3, 2] = 10.0, 2.0, 1.0
    plan = PiecewisePolynomial(durations=np.array([2.0]), position=position, yaw=np.zeros((1, 6)))
    state = plan.state(1.0)
    lag = lag_behind(plan, 1.3, np.asarray(state.pos), 0.5 * np.asarray(state.vel))
    slowed = list(slower(plan, lag))
    assert [slowdown / lag.slowdown for _, slowdown in slowed] == pytest.approx(SLOWDOWNS, **relative("formula"))
    for spline, slowdown in slowed:
        assert float(spline.duration) == pytest.approx(slowdown * (2.0 - lag.since), **relative("formula"))
        times = np.linspace(0.0, 2.0 - lag.since, 9)
        for derivative in range(5):
            now = np.asarray(plan.evaluate(lag.since + times, derivative))
            assert_close(spline.evaluate(slowdown * times, derivative), now / slowdown**derivative, "formula")
