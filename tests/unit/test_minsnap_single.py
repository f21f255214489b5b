"""Minimum snap against a dense high-precision twin, published numbers and invariants."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.minsnap import hermite
from jaxplan.minsnap.single import interpolate, minimum_snap
from oracles.minsnap_dense import minimum_derivative
from tolerances import relative, tolerance


def random_problem(seed, segments):
    rng = np.random.default_rng(seed)
    return rng.uniform(-5, 5, (segments + 1, 3)), rng.uniform(0.3, 2.0, segments), rng.normal(size=(4, 3))


@pytest.mark.parametrize("segments", [1, 2, 5])
def test_equals_dense_solution_in_high_precision(segments):
    waypoints, durations, initial = random_problem(segments, segments)
    spline = minimum_snap(waypoints, durations, initial=initial)
    expected, cost = minimum_derivative(waypoints, durations, initial, np.zeros((4, 3)), digits=40)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(spline.position, expected, atol=1e-11 * scale)
    gram = hermite.energy(4)
    values = np.linalg.solve(hermite.coefficients(4), spline.position)
    energy = np.einsum("mid,ij,mjd,m->", values, gram, values, durations**-7.0)
    assert energy == pytest.approx(cost, **relative("formula"))


def test_yaw_equals_dense_solution():
    rng = np.random.default_rng(3)
    waypoints, durations, _ = random_problem(3, 4)
    yaw, initial = rng.uniform(-3, 3, 5), rng.normal(size=2)
    spline = minimum_snap(waypoints, durations, yaw=yaw, initial_yaw=initial)
    expected, _ = minimum_derivative(yaw[:, None], durations, initial[:, None], np.zeros((2, 1)), order=2, digits=40)
    np.testing.assert_allclose(spline.yaw, expected[..., 0], atol=1e-11 * np.abs(expected).max())


def test_published_degree_nine_coefficients(examples):
    case = json.loads((examples / "minsnap" / "ethz_two_vertices_expected.json").read_text())
    spline = minimum_snap(np.array([[0.0, 0, 0], [5.0, 0, 0]]), np.array([5.0]))
    ours = spline.position[0, :, 0] / 5.0 ** np.arange(10)
    np.testing.assert_allclose(ours, case["expected_coeffs_ascending"], **tolerance("formula"))


def test_rest_to_rest_passes_through_waypoints_and_stops():
    waypoints, durations, _ = random_problem(7, 6)
    spline = minimum_snap(waypoints, durations)
    knots = np.concatenate([[0.0], np.cumsum(durations)])
    np.testing.assert_allclose(spline.evaluate(knots)[:, :3], waypoints, **tolerance("formula"))
    for derivative in range(1, 5):
        np.testing.assert_allclose(spline.evaluate(spline.duration, derivative), 0.0, **tolerance("solve"))


def test_scaling_time_keeps_the_path_and_divides_the_cost():
    """chi(alpha x, p, D / alpha) has the same shape (paper, Sec. III-B)."""
    waypoints, durations, initial = random_problem(11, 5)
    alpha = 1.7
    powers = alpha ** -np.arange(1.0, 5.0)[:, None]
    slow = minimum_snap(waypoints, alpha * durations, initial=powers * initial)
    np.testing.assert_allclose(
        slow.position, minimum_snap(waypoints, durations, initial=initial).position, **tolerance("formula")
    )


def test_padding_and_neighbours_do_not_change_a_lane():
    waypoints, durations, initial = random_problem(5, 4)
    alone = minimum_snap(waypoints, durations, initial=initial)
    rng = np.random.default_rng(0)
    times = np.zeros((9, 3))
    times[:4, 0], times[:, 1], times[:2, 2] = durations, rng.uniform(0.1, 1, 9), np.nan
    points = rng.normal(size=(10, 3, 3))
    points[:5, :, 0] = waypoints
    with jax.enable_x64(True):
        start = jnp.asarray(np.repeat(initial[..., None], 3, axis=-1))
        coefficients, _ = jax.jit(interpolate)(jnp.asarray(times), jnp.asarray(points), start)
    np.testing.assert_allclose(coefficients[:4, ..., 0], alone.position, **tolerance("formula"))
    assert np.isfinite(coefficients[..., 1]).all()


@pytest.mark.parametrize(
    ("waypoints", "durations", "said"),
    [
        (np.zeros((1, 3)), np.zeros(0), "at least 2"),
        (np.zeros((3, 2)), np.ones(2), "shape"),
        (np.eye(3), np.ones(3), "durations has shape"),
        (np.eye(3), np.array([1.0, -1.0]), "positive"),
        (np.eye(3), np.array([1.0, np.nan]), "finite"),
        (np.full((3, 3), np.inf), np.ones(2), "finite"),
        (np.ones((3, 3)), np.ones(2), "same point"),
        ("abc", np.ones(2), "no array of numbers"),
        (np.eye(3) * 1j, np.ones(2), "no array of numbers"),
        (np.eye(3), [1.0, "soon"], "no array of numbers"),
        (1e308 * np.array([[1.0, 0, 0], [-1.0, 0, 0], [1.0, 0, 0]]), np.ones(2), "beyond double precision"),
        (np.eye(3), np.array([1.0, 1e-80]), "beyond double precision"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(waypoints, durations, said):
    with pytest.raises(InputError, match=said):
        minimum_snap(waypoints, durations)
