"""How exact the solution is, against a dense solver in 50 digits: the promised numbers."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplan
from jaxplan.minsnap.quadratic_program import Passage
from jaxplan.minsnap.spline_batch import fit
from jaxplan.polynomials import derivative_table
from jaxplan.precision import in_float64
from jaxplan.records import replace
from oracles.minsnap_dense import minimum_derivative
from tolerances import relative, tolerance

ROOMS = {"small": np.array([10.0, 10, 2]), "large": np.array([30.0, 15, 3])}


def solved(seed, durations, room="small", fixed_order=4, terminal="rest", waypoints=None):
    """Our spline and cost, and the exact coefficients and cost."""
    rng = np.random.default_rng(seed)
    drawn = rng.uniform(0, 1, (len(durations) + 1, 3)) * ROOMS[room]
    waypoints = drawn if waypoints is None else waypoints(drawn)
    initial, start, goal = rng.normal(size=(4, 3)), np.zeros((4, 3)), np.zeros((4, 3))
    start[:] = initial
    start[fixed_order:] = goal[fixed_order:] = np.nan
    if terminal == "free":
        goal[:] = np.nan
    durations = np.array(durations, dtype=float)
    options = {"initial": initial, "terminal": terminal, "fixed_order": fixed_order}
    spline = jaxplan.minimum_snap(waypoints, durations, **options)
    batch = jaxplan.minimum_snap_batch(waypoints[..., None], durations[:, None], **options)
    exact, cost = minimum_derivative(waypoints, durations, start, goal, digits=50)
    return spline, batch.cost[0], exact, cost


@in_float64
def test_a_waypoint_is_passed_at_a_prescribed_velocity():
    """Lanes that pass one, lanes that do not, and padded ones, side by side."""
    rng = np.random.default_rng(3)
    lengths, knots = [4, 4, 3, 2, 3], [2, 0, 2, 1, 3]  # 3 of 3 segments: the goal, where the vehicle rests
    durations, waypoints = np.zeros((4, 5)), rng.uniform(-3.0, 3.0, (5, 3, 5))
    for lane, length in enumerate(lengths):
        durations[:length, lane] = rng.uniform(0.3, 2.0, length)
        waypoints[length:, :, lane] = waypoints[length, :, lane]
    start = jaxplan.hover(np.zeros(3))
    initial = rng.normal(size=(4, 3))
    start = replace(start, derivatives=np.concatenate([np.zeros((1, 3)), initial]))
    waypoints[0] = 0.0
    velocity = rng.normal(scale=3.0, size=(3, 5))
    passage = Passage(jnp.asarray(knots), jnp.asarray(velocity))
    splines = jax.jit(lambda w, d: fit(start, w, d, 3.0, passage=passage))(waypoints, durations)
    for lane, (length, knot) in enumerate(zip(lengths, knots, strict=True)):
        spline, points = splines.spline(lane), waypoints[: length + 1, :, lane]
        inside = (knot, velocity[:, lane]) if 0 < knot < length else None
        exact, _ = minimum_derivative(
            points, durations[:length, lane], initial, np.zeros((4, 3)), digits=50, passage=inside
        )
        powers = np.linspace(0, 1, 40)[:, None] ** np.arange(10)
        np.testing.assert_allclose(powers @ spline.position, powers @ exact, **tolerance("formula"))
        for derivative in range(1, 5):
            assert largest_jump(spline, derivative) < 1e-9
        if inside is not None:
            found = spline.evaluate(durations[:knot, lane].sum(), 1)
            np.testing.assert_allclose(found[:3], velocity[:, lane], **tolerance("formula"))


def energy(spline):
    """The integral of the squared snap, from the coefficients alone."""
    total = 0.0
    for a in range(4, 10):
        for b in range(4, 10):
            weight = math.perm(a, 4) * math.perm(b, 4) / (a + b - 7)
            total += weight * np.sum(spline.position[:, a] * spline.position[:, b] * (spline.durations**-7.0)[:, None])
    return total


def largest_jump(spline, derivative):
    """At the interior knots, relative to the largest value on the whole spline."""
    table = derivative_table(10, np.linspace(0, 1, 50), derivative)
    samples = np.einsum("sk,mkd->msd", table, spline.position) / spline.durations[:, None, None] ** derivative
    return np.abs(samples[:-1, -1] - samples[1:, 0]).max() / np.abs(samples).max()


@pytest.mark.parametrize("room", ["small", "large"])
@pytest.mark.parametrize(("fixed_order", "terminal"), [(4, "rest"), (3, "rest"), (4, "free"), (3, "free")])
def test_energy_positions_and_continuity_at_ordinary_durations(room, fixed_order, terminal):
    spline, cost, exact, expected = solved(fixed_order, [0.4, 2.1, 1.0], room, fixed_order, terminal)
    assert cost == pytest.approx(expected, **relative("exact"))
    assert energy(spline) == pytest.approx(expected, **relative("formula"))
    powers = np.linspace(0, 1, 40)[:, None] ** np.arange(10)
    np.testing.assert_allclose(powers @ spline.position, powers @ exact, **tolerance("formula"))
    for derivative in range(1, 5):
        assert largest_jump(spline, derivative) < 1e-9


def test_free_snap_at_the_ends_gives_degree_seven():
    spline, _, _, _ = solved(3, [0.7, 1.1, 1.9], fixed_order=3, terminal="free")
    assert np.abs(spline.position[:, 8:]).max() < 1e-9 * np.abs(spline.position).max()


@pytest.mark.parametrize(
    "durations", [[0.05, 5.0, 0.05], [5.0, 0.05, 5.0], [200.0, 2.0, 200.0], [200.0, 150.0, 120.0], [0.3, 3.0, 0.3]]
)
@pytest.mark.parametrize("terminal", ["rest", "free"])
def test_energy_at_extreme_durations(durations, terminal):
    spline, cost, _, expected = solved(1, durations, "large", 4, terminal)
    assert cost == pytest.approx(expected, **relative("formula"))
    assert energy(spline) == pytest.approx(expected, **relative("exact", np.float32))


@pytest.mark.parametrize("gap", [1e-3, 0.0])
@pytest.mark.parametrize("duration", [1.0, 0.01])
def test_coincident_waypoints(gap, duration):
    def close(points):
        points[2] = points[1] + [gap, 0, 0]
        return points

    spline, cost, exact, expected = solved(2, [1.0, duration, 1.0], waypoints=close)
    assert cost == pytest.approx(expected, **relative("formula"))
    powers = np.linspace(0, 1, 40)[:, None] ** np.arange(10)
    np.testing.assert_allclose(powers @ spline.position, powers @ exact, **tolerance("solve"))
