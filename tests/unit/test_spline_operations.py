"""Splitting, joining, bounding and exporting splines."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.spline import PiecewisePolynomial, concatenate
from tolerances import tolerance


@pytest.fixture(params=[True, False], ids=["with yaw", "without yaw"])
def spline(request):
    rng = np.random.default_rng(0)
    yaw = rng.normal(size=(3, 6)) if request.param else None
    return PiecewisePolynomial(durations=np.array([0.5, 2.0, 0.1]), position=rng.normal(size=(3, 10, 3)), yaw=yaw)


@pytest.mark.parametrize("cut", [0.2, 0.5, 1.7, 2.55])
def test_the_parts_of_a_split_are_the_whole(spline, cut):
    first, second = spline.split(cut)
    assert float(first.duration) == pytest.approx(cut)
    assert float(first.duration + second.duration) == pytest.approx(2.6)
    for derivative in range(5):
        times = np.linspace(0.0, 0.999 * cut, 20)
        scale = np.abs(spline.evaluate(np.linspace(0, 2.6, 99), derivative)).max()
        whole = spline.evaluate(times, derivative)
        np.testing.assert_allclose(first.evaluate(times, derivative), whole, atol=1e-9 * scale)
        times = np.linspace(1e-6, 2.6 - cut, 20)
        whole = spline.evaluate(cut + times, derivative)
        np.testing.assert_allclose(second.evaluate(times, derivative), whole, atol=1e-9 * scale)


def test_joined_parts_are_the_whole(spline):
    joined = concatenate(spline.split(1.1))
    times = np.linspace(0.0, 2.6, 50)
    np.testing.assert_allclose(joined.evaluate(times), spline.evaluate(times), **tolerance("exact"))


@pytest.mark.parametrize("cut", [0.0, -1.0, 2.6, 3.0, np.nan])
def test_a_split_outside_is_refused(spline, cut):
    with pytest.raises(InputError, match="strictly between"):
        spline.split(cut)


def test_nothing_and_mixtures_are_not_joined(spline):
    bare = PiecewisePolynomial(durations=np.ones(1), position=np.ones((1, 10, 3)))
    turning = PiecewisePolynomial(durations=np.ones(1), position=np.ones((1, 10, 3)), yaw=np.ones((1, 6)))
    for splines in ([], [bare, turning]):
        with pytest.raises(InputError, match="concatenate"):
            concatenate(splines)


@pytest.mark.parametrize("derivative", [0, 1, 2, 4])
def test_bounds_hold_everywhere_and_tighten(spline, derivative):
    table = np.concatenate([np.linspace(a, b, 2000, endpoint=False) for a, b in ((0, 0.5), (0.5, 2.5), (2.5, 2.6))])
    norms = np.linalg.norm(spline.evaluate(table, derivative)[:, :3], axis=1).reshape(3, -1).max(axis=1)
    for pieces, excess in ((1, np.inf), (8, 1.3), (64, 1.01)):
        bound = spline.bound(derivative, pieces)
        assert (bound >= norms * (1 - 1e-12)).all()
        assert (bound <= norms * excess).all()


def test_monomials_evaluate_in_seconds(spline):
    coefficients = spline.monomials()
    times = np.array([0.1, 0.9, 0.03])
    values = np.einsum("mk,mkd->md", times[:, None] ** np.arange(10), coefficients)
    np.testing.assert_allclose(values, spline.evaluate(np.array([0.1, 1.4, 2.53]))[:, :3], **tolerance("formula"))


def test_samples_run_from_start_to_end(spline):
    times, values = spline.sample(11)
    np.testing.assert_allclose(times, np.linspace(0, 2.6, 11))
    np.testing.assert_array_equal(values, spline.evaluate(times))
    assert values.shape == (11, 3 if spline.yaw is None else 4)


def test_the_traced_operations_agree_with_numpy(spline, x64):
    traced = jax.tree.map(jnp.asarray, spline)
    for operation in (lambda s: s.bound(2), lambda s: s.monomials(), lambda s: s.sample(5)[1]):
        np.testing.assert_allclose(jax.jit(operation)(traced), operation(spline), **tolerance("formula"))
