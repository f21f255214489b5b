"""The alpha iteration against synthetic allocations whose answer is known, and allocations that defeat the paper's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.arrival import ArrivalConfig, first_slope, match_arrival, sped_up
from jaxplan.errors import InputError
from jaxplan.spline import FlatState
from jaxplan.status import Reason
from tolerances import tolerance

CONFIG = ArrivalConfig()


def moving_state():
    """A speed of 1 along x, so that alpha can be read off it."""
    derivatives = np.zeros((5, 3))
    derivatives[1, 0] = 1.0
    return FlatState(derivatives=derivatives, yaw=np.zeros(3))


@pytest.mark.parametrize("least", [0.0, 1.5, float("nan")])
def test_a_least_scale_factor_that_makes_no_sense_is_refused(least):
    with pytest.raises(InputError, match="least_alpha"):
        ArrivalConfig(least_alpha=least)


def solve(elasticity, least, arrival_times, config=CONFIG):
    """One lane per entry: total time least * alpha^elasticity before slowing, split over two segments."""
    elasticity, least = jnp.asarray(elasticity), jnp.asarray(least)

    def decode(initial):
        alpha = initial.derivatives[1, 0]
        return _split(least * alpha**elasticity)

    initial = moving_state()
    with jax.enable_x64(True):
        return jax.jit(lambda d, t: match_arrival(decode, d, t, config))(
            initial, np.asarray(arrival_times, dtype=float)
        )


def _split(total):
    return jnp.stack([0.25 * total, 0.75 * total])


@pytest.mark.parametrize("elasticity", [-0.95, -0.9, -0.5, 0.0, 0.5, 2.0])
def test_meets_the_arrival_time_whatever_the_elasticity(elasticity):
    """T(alpha) = least * alpha^(1 + elasticity); the paper's iteration crawls near -1 and diverges beyond 1."""
    goals = np.array([1.0, 1.001, 1.5, 2.0])
    with jax.enable_x64(True):
        result = solve(np.full(4, elasticity), np.ones(4), goals)
    flagged = np.asarray(result.reasons) & int(Reason.ALPHA_NOT_CONVERGED) > 0
    met = np.abs(np.asarray(result.durations).sum(axis=0) / goals - 1.0) < 1e-12
    assert (met | flagged).all()
    if elasticity >= -0.5:
        np.testing.assert_allclose(result.alpha, goals ** (1.0 / (1.0 + elasticity)), rtol=5e-3)
        assert met.all()
    assert int(np.max(result.calls)) <= CONFIG.max_calls


def test_allocation_that_ignores_the_state_needs_two_steps():
    """The first has the slope that flights have, the second the right one."""
    with jax.enable_x64(True):
        result = solve(np.zeros(3), np.array([1.0, 2.0, 0.1]), [1.0, 5.0, 3.0])
    np.testing.assert_allclose(result.alpha, [1.0, 2.5, 30.0], **tolerance("exact"))
    assert list(result.calls) == [1, 3, 3]
    assert not np.asarray(result.reasons).any()


def test_from_rest_one_step_leads_there():
    """No derivative changes with alpha, so the slope is 1; in flight it is larger."""
    state = FlatState(derivatives=np.zeros((5, 3)), yaw=np.zeros(3))
    with jax.enable_x64(True):
        found = match_arrival(lambda _: _split(jnp.array([1.0, 2.0])), state, jnp.array([1.5, 9.0]), CONFIG)
    np.testing.assert_allclose(found.alpha, [1.5, 4.5], **tolerance("exact"))
    assert list(found.calls) == [2, 2]
    assert first_slope(0.0) == 1.0 < first_slope(4.0) < first_slope(100.0) < 1.7


def test_unreachable_and_invalid_lanes_leave_their_neighbours_alone():
    with jax.enable_x64(True):
        alone = solve(np.array([0.5]), np.ones(1), [2.0])
        mixed = solve(np.full(5, 0.5), np.array([1.0, 3.0, 1.0, 1.0, np.nan]), [2.0, 2.0, np.nan, -1.0, 2.0])
    assert mixed.alpha[0] == alone.alpha[0]
    reasons = np.asarray(mixed.reasons)
    assert reasons[0] == 0
    assert (reasons[1:] != 0).all()
    np.testing.assert_allclose(mixed.alpha[1], 2.0 / 3.0)
    assert list(np.asarray(mixed.calls)[1:]) == [1, 1, 1, 1]


def test_faster_than_allotted_where_that_is_looked_at():
    """T(alpha) = alpha^1.5 down to a scale factor of 0.6; what takes less is unreachable."""
    config = ArrivalConfig(least_alpha=0.6)
    goals = np.array([0.4, 0.6**1.5, 0.7, 1.0, 3.0])
    with jax.enable_x64(True):
        found = solve(np.full(5, 0.5), np.ones(5), goals, config)
    assert np.asarray(found.reasons).tolist() == [Reason.ALPHA_LT_1, 0, 0, 0, 0]
    np.testing.assert_allclose(found.alpha[1:], goals[1:] ** (1.0 / 1.5), rtol=5e-3)
    np.testing.assert_allclose(np.asarray(found.durations)[:, 1:].sum(axis=0), goals[1:], rtol=1e-3)
    np.testing.assert_allclose(np.asarray(found.least_durations).sum(axis=0), 0.6**1.5, **tolerance("exact"))
    assert float(found.alpha[0]) == pytest.approx(0.6 * 0.4 / 0.6**1.5)


def test_the_target_is_met_where_its_waypoint_is():
    """The first of two segments takes a quarter of the time: met there, everything is slower by what that asks."""

    def decode(initial):
        return _split(initial.derivatives[1, 0] ** 0.5)

    with jax.enable_x64(True):
        found = match_arrival(decode, moving_state(), jnp.array([1.0, 1.0]), CONFIG, jnp.array([1, 2]))
    durations = np.asarray(found.durations)
    np.testing.assert_allclose(durations[0, 0], 1.0, **tolerance("exact"))
    np.testing.assert_allclose(durations[1, 0], 3.0, **tolerance("exact"))
    np.testing.assert_allclose(durations[:, 1].sum(), 1.0, **tolerance("exact"))


def test_iterations_are_bounded():
    """An allocation that jumps over the goal has no root: flagged after exactly max_calls, never a false success."""

    def decode(initial):
        return jnp.where(initial.derivatives[1, 0] < 2.0, 0.5, 2.0)[None]

    initial = moving_state()
    with jax.enable_x64(True):
        result = match_arrival(decode, initial, jnp.array([2.0]), ArrivalConfig(max_calls=9))
    assert int(result.calls[0]) == 9
    assert int(result.reasons[0]) == Reason.ALPHA_NOT_CONVERGED


def test_scaling_follows_the_order_of_the_derivative():
    state = FlatState(derivatives=np.ones((5, 3)), yaw=np.ones(3))
    with jax.enable_x64(True):
        scaled = sped_up(state, jnp.array([1.0, 2.0]))
    np.testing.assert_allclose(scaled.derivatives[:, 0, 1], [1.0, 2.0, 4.0, 8.0, 16.0])
    np.testing.assert_allclose(scaled.yaw[:, 1], [1.0, 2.0, 4.0])
    np.testing.assert_allclose(scaled.derivatives[..., 0], 1.0)
    with jax.enable_x64(True):
        each = sped_up(scaled, jnp.array([3.0, 0.5]))
    np.testing.assert_allclose(each.derivatives[:, 2, 0], [1.0, 3.0, 9.0, 27.0, 81.0])
    np.testing.assert_allclose(each.derivatives[..., 1], 1.0)
    np.testing.assert_allclose(each.yaw[..., 1], 1.0)


def test_configuration_is_checked():
    with pytest.raises(InputError, match="tolerance"):
        ArrivalConfig(tolerance=0.0)
    with pytest.raises(InputError, match="max_calls"):
        ArrivalConfig(max_calls=1)
