"""Splines against SciPy's piecewise polynomials, in NumPy and in JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import PPoly

from jaxplan.errors import InputError
from jaxplan.spline import FlatState, FlatStateBatch, PiecewisePolynomial, hover
from tolerances import tolerance


@pytest.fixture
def spline():
    rng = np.random.default_rng(0)
    return PiecewisePolynomial(
        durations=np.array([0.5, 2.0, 0.1]), position=rng.normal(size=(3, 10, 3)), yaw=rng.normal(size=(3, 6))
    )


def as_ppoly(coefficients, durations):
    """SciPy's form: descending powers of the time since the segment's start."""
    n = coefficients.shape[1]
    scaled = coefficients / (durations[:, None] ** np.arange(n))[(...,) + (None,) * (coefficients.ndim - 2)]
    return PPoly(np.moveaxis(scaled[:, ::-1], 0, 1), np.concatenate([[0.0], np.cumsum(durations)]))


@pytest.mark.parametrize("derivative", range(6))
def test_derivatives_equal_scipy(spline, derivative):
    times = np.random.default_rng(1).uniform(0, 2.6, (7, 5))
    ours = spline.evaluate(times, derivative)
    position = as_ppoly(spline.position, spline.durations)(times, nu=derivative)
    yaw = as_ppoly(spline.yaw, spline.durations)(times, nu=derivative)
    expected = np.concatenate([position, yaw[..., None]], axis=-1)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(ours / scale, expected / scale, **tolerance("formula"))


def test_numpy_and_jax_agree(spline):
    times = np.linspace(-0.5, 3.0, 40)
    with jax.enable_x64(True):
        traced = jax.jit(lambda s, t: s.evaluate(t, 2))(jax.tree.map(jnp.asarray, spline), times)
    np.testing.assert_allclose(spline.evaluate(times, 2), traced, **tolerance("exact"))
    assert isinstance(spline.evaluate(times), np.ndarray)


def test_time_is_clamped_to_the_ends(spline):
    np.testing.assert_array_equal(spline.evaluate(-1.0), spline.evaluate(0.0))
    np.testing.assert_array_equal(spline.evaluate(99.0), spline.evaluate(float(spline.duration)))


def test_padding_is_never_evaluated(spline):
    padded = PiecewisePolynomial(
        durations=np.concatenate([spline.durations, np.zeros(2)]),
        position=np.concatenate([spline.position, np.full((2, 10, 3), np.nan)]),
        yaw=np.concatenate([spline.yaw, np.full((2, 6), np.nan)]),
    )
    times = np.linspace(0.0, 4.0, 30)
    np.testing.assert_array_equal(padded.evaluate(times), spline.evaluate(times))


def test_dilation_keeps_the_path_and_slows_it(spline):
    times, alpha = np.linspace(0.0, 2.6, 20), 1.7
    slow = spline.dilate(alpha)
    for derivative in range(5):
        expected = spline.evaluate(times, derivative) / alpha**derivative
        np.testing.assert_allclose(slow.evaluate(alpha * times, derivative), expected, **tolerance("formula"))


def test_states_hold_position_to_snap_and_yaw_to_acceleration(spline):
    state = spline.state(np.array([0.3, 1.1]))
    np.testing.assert_array_equal(state.snap, spline.evaluate(np.array([0.3, 1.1]), 4)[:, :3])
    np.testing.assert_array_equal(state.yaw[:, 2], spline.evaluate(np.array([0.3, 1.1]), 2)[:, 3])
    np.testing.assert_array_equal(hover(np.array([1.0, 2, 3]), 0.5).pos, [1.0, 2, 3])


def test_a_state_of_a_batch_is_the_state() -> None:
    """Batch axes last: the properties and ``at`` index the right axes, and one state can be repeated."""
    rng = np.random.default_rng(0)
    one = FlatState(derivatives=rng.normal(size=(5, 3)), yaw=rng.normal(size=3))
    batch = one.repeated(4)
    assert batch.derivatives.shape == (5, 3, 4)
    for name in ("pos", "vel", "acc", "jerk", "snap"):
        np.testing.assert_array_equal(getattr(batch, name)[:, 2], getattr(one, name).astype(batch.pos.dtype))
    flights = FlatStateBatch(derivatives=rng.normal(size=(5, 3, 7, 5)), yaw=rng.normal(size=(3, 7, 5)))
    assert flights.pos.shape == (3, 7, 5)
    np.testing.assert_array_equal(flights.at(6, 4).acc, flights.derivatives[2, :, 6, 4])
    np.testing.assert_array_equal(flights.at(6, 4).yaw, flights.yaw[:, 6, 4])


def test_there_is_no_derivative_of_a_negative_order(spline):
    with pytest.raises(InputError, match="^spline: derivative: have -1"):
        spline.evaluate(np.zeros(1), -1)
