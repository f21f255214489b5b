"""The batched solver: every lane equals the single solver, derivatives equal the exact ones, bad lanes stay alone."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplan
from jaxplan.batching import THREAD_WIDTH
from jaxplan.errors import InputError
from jaxplan.minsnap.status import SolveStatus
from oracles.minsnap_dense import cost_gradient
from tolerances import relative, tolerance

SEGMENTS = 6
LENGTHS = (SEGMENTS, 1, 3)
"""Numbers of segments that take turns in a batch: few, because every length is compiled anew by the single solver."""


def random_batch(seed=0, width=7, segments=SEGMENTS):
    """Problems of mixed length with arbitrary initial derivatives; NaN waypoints on padding."""
    rng = np.random.default_rng(seed)
    waypoints = rng.uniform(0, 1, (segments + 1, 3, width)) * np.array([10.0, 10, 2])[:, None]
    durations = rng.uniform(0.3, 2.0, (segments, width))
    for lane in range(width):
        count = min(LENGTHS[lane % len(LENGTHS)], segments)
        durations[count:, lane] = 0.0
        waypoints[count + 1 :, :, lane] = np.nan
    return waypoints, durations, rng.normal(size=(4, 3, width))


@pytest.mark.parametrize(
    ("terminal", "fixed_order"),
    [*(pytest.param(*ends, marks=pytest.mark.slow) for ends in (("rest", 4), ("free", 3))), ("moving", 4)],
)
def test_every_lane_equals_the_single_solver(terminal, fixed_order):
    waypoints, durations, initial = random_batch(width=4)
    goal = np.random.default_rng(9).normal(size=(4, 3, 4)) if terminal == "moving" else terminal
    yaw = np.random.default_rng(8).normal(size=(SEGMENTS + 1, 4))
    solved = jaxplan.minimum_snap_batch(
        waypoints, durations, initial=initial, terminal=goal, fixed_order=fixed_order, yaw=yaw
    )
    assert (solved.status == 0).all()
    assert (solved.residual < 1e-9).all()
    for lane in range(4):
        count = int((durations[:, lane] > 0).sum())
        alone = jaxplan.minimum_snap(
            waypoints[: count + 1, :, lane],
            durations[:count, lane],
            initial=initial[..., lane],
            terminal=goal if isinstance(goal, str) else goal[..., lane],
            fixed_order=fixed_order,
            yaw=yaw[: count + 1, lane],
        )
        spline = solved.splines.spline(lane)
        scale = np.abs(alone.position).max()
        np.testing.assert_allclose(spline.position, alone.position, atol=1e-8 * scale)
        np.testing.assert_allclose(spline.yaw, alone.yaw, atol=1e-8 * np.abs(alone.yaw).max())


def test_states_of_a_batch_are_those_of_each_spline_from_start_to_end():
    waypoints, durations, initial = random_batch(width=4)
    solved = jaxplan.minimum_snap_batch(
        waypoints, durations, initial=initial, yaw=np.random.default_rng(8).normal(size=(SEGMENTS + 1, 4))
    )
    with jax.enable_x64(True):
        states = solved.splines.states(23)
    for lane in range(4):
        spline = solved.splines.spline(lane)
        alone = spline.state(np.linspace(0.0, 1.0, 23) * spline.duration)
        for order in range(5):
            scale = np.abs(alone.derivatives[:, order]).max()
            np.testing.assert_allclose(
                states.derivatives[order, ..., lane].T, alone.derivatives[:, order], atol=1e-9 * scale
            )
        np.testing.assert_allclose(states.yaw[..., lane].T, alone.yaw, atol=1e-9 * np.abs(alone.yaw).max())


def test_gradient_of_the_cost_equals_the_exact_one(x64):
    rng = np.random.default_rng(1)
    waypoints, durations = rng.uniform(0, 5, (4, 3)), np.array([0.7, 1.3, 0.9])
    initial = rng.normal(size=(4, 3))
    by_time, by_point = cost_gradient(waypoints, durations, initial, np.zeros((4, 3)), digits=50)

    def total(points, times):
        return jaxplan.minimum_snap_batch(points[..., None], times[:, None], initial=jnp.asarray(initial)).cost[0]

    ours = jax.jit(jax.grad(total, (0, 1)))(jnp.asarray(waypoints), jnp.asarray(durations))
    np.testing.assert_allclose(ours[1], by_time, **tolerance("formula"))
    np.testing.assert_allclose(ours[0], by_point, atol=1e-9 * np.abs(by_point).max())


@pytest.mark.slow
def test_gradients_of_free_ends_initial_values_and_splines_equal_differences(x64):
    waypoints, durations, initial = random_batch(width=3)
    arguments = tuple(jnp.asarray(np.nan_to_num(a)) for a in (waypoints, durations, initial))
    for fixed, terminal in ((3, "free"), (4, jnp.ones((4, 3)))):

        def total(points, times, start, fixed=fixed, terminal=terminal):
            solved = jaxplan.minimum_snap_batch(points, times, initial=start, terminal=terminal, fixed_order=fixed)
            return jnp.sum(solved.cost) / 1e6 + jnp.sum(jnp.sin(0.01 * solved.splines.position))

        direction = tuple(jnp.asarray(np.random.default_rng(k).normal(size=a.shape)) for k, a in enumerate(arguments))
        direction = (direction[0], jnp.where(arguments[1] > 0, direction[1], 0.0), direction[2])
        value = jax.jit(lambda s: total(*(a + s * d for a, d in zip(arguments, direction, strict=True))))  # noqa: B023
        slope = (value(1e-6) - value(-1e-6)) / 2e-6
        backward, forward = jax.jit(lambda s: (jax.grad(value)(s), jax.jvp(value, (s,), (jnp.ones_like(s),))[1]))(0.0)  # noqa: B023
        assert backward == pytest.approx(float(slope), **relative("solve"))
        assert forward == pytest.approx(float(slope), **relative("solve"))


@pytest.mark.slow
def test_curvature_of_the_cost_includes_how_the_knots_move(x64):
    waypoints, durations = (a[..., :1] for a in random_batch(5, 3, 3)[:2])

    def total(times):
        return jaxplan.minimum_snap_batch(jnp.asarray(waypoints), times[:, None]).cost[0]

    times = jnp.asarray(durations[:, 0])
    step = 1e-5
    rows = [
        (jax.grad(total)(times.at[i].add(step)) - jax.grad(total)(times.at[i].add(-step))) / (2 * step)
        for i in range(3)
    ]
    expected = np.array(rows)
    for order in (jax.hessian(total), jax.jacrev(jax.grad(total))):
        np.testing.assert_allclose(order(times), expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("spoil", "bit"),
    [
        (lambda w, d, i: w.__setitem__((1, 0, 3), np.nan), SolveStatus.NONFINITE),
        (lambda w, d, i: d.__setitem__((0, 3), np.inf), SolveStatus.NONFINITE),
        (lambda w, d, i: i.__setitem__((2, 1, 3), np.nan), SolveStatus.NONFINITE),
        (lambda w, d, i: d.__setitem__((1, 3), -1.0), SolveStatus.DURATIONS),
        (lambda w, d, i: d.__setitem__((0, 3), 0.0), SolveStatus.DURATIONS),
        (lambda w, d, i: d.__setitem__((slice(None), 3), 0.0), SolveStatus.DURATIONS),
        (lambda w, d, i: w.__setitem__((slice(None), slice(None), 3), 1.0), SolveStatus.COINCIDENT),
    ],
)
def test_a_bad_lane_has_a_status_and_leaves_its_neighbours_alone(spoil, bit):
    arrays = random_batch()
    good = jaxplan.minimum_snap_batch(arrays[0], arrays[1], initial=arrays[2])
    spoil(*arrays)
    solved = jaxplan.minimum_snap_batch(arrays[0], arrays[1], initial=arrays[2])
    assert solved.status[3] == bit
    assert np.isfinite(solved.splines.position).all()
    assert np.isfinite(solved.cost[3]) == (bit == SolveStatus.COINCIDENT)
    others = np.arange(7) != 3
    assert (solved.status[others] == 0).all()
    for ours, theirs in zip(jax.tree.leaves(solved), jax.tree.leaves(good), strict=True):
        np.testing.assert_array_equal(ours[..., others], theirs[..., others])


def test_gradients_of_a_bad_lane_are_zero_and_of_its_neighbours_right(x64):
    waypoints, durations, _ = random_batch()
    waypoints = np.nan_to_num(waypoints)

    def total(times):
        costs = jaxplan.minimum_snap_batch(jnp.asarray(waypoints), times).cost
        return jnp.sum(jnp.where(jnp.isfinite(costs), costs, 0.0))

    expected = jax.grad(total)(jnp.asarray(durations))
    durations[0, 3] = np.nan
    slopes = jax.grad(total)(jnp.asarray(durations))
    np.testing.assert_array_equal(slopes[:, 3], 0.0)
    np.testing.assert_array_equal(np.delete(slopes, 3, axis=1), np.delete(expected, 3, axis=1))


@pytest.mark.slow
def test_inside_transformations_it_equals_the_host_call(x64):
    waypoints, durations, initial = random_batch()
    host = jaxplan.minimum_snap_batch(waypoints, durations, initial=initial)
    assert isinstance(host.cost, np.ndarray)
    arrays = tuple(jnp.asarray(a) for a in (waypoints, durations, initial))

    def solve(points, times, start):
        return jaxplan.minimum_snap_batch(points, times, initial=start).cost

    lane = jax.vmap(lambda p, t, s: solve(p[..., None], t[:, None], s[..., None])[0], in_axes=-1)
    for function in (solve, jax.jit(solve), lane, jax.jit(lane)):
        np.testing.assert_allclose(function(*arrays), host.cost, **tolerance("formula"))


WITHOUT_64_BITS = """
import warnings; warnings.simplefilter("error")
import jax, jax.numpy as jnp, numpy as np, jaxplan
assert not jax.config.jax_enable_x64
rng = np.random.default_rng(0)
w, d = rng.uniform(0, 5, (5, 3, 3)), rng.uniform(0.3, 2, (4, 3))
exact = jaxplan.minimum_snap_batch(w, d)
assert exact.cost.dtype == np.float64
total = lambda w, d: jaxplan.minimum_snap_batch(w, d).cost.sum()
narrow = jnp.asarray(w), jnp.asarray(d)
for f in (total, jax.jit(total)):
    assert f(*narrow).dtype == jnp.float32
    np.testing.assert_allclose(f(*narrow), exact.cost.sum(), rtol=1e-5)
slope = jax.jit(jax.grad(total, 1))(*narrow)
lanes = jax.vmap(jax.grad(lambda w, d: total(w[..., None], d[:, None]), 1), in_axes=-1, out_axes=-1)(*narrow)
up, down = d.copy(), d.copy(); up[1] += 1e-5; down[1] -= 1e-5
fd = (jaxplan.minimum_snap_batch(w, up).cost - jaxplan.minimum_snap_batch(w, down).cost) / 2e-5
np.testing.assert_allclose(slope[1], fd, rtol=1e-4)
np.testing.assert_allclose(lanes, slope, rtol=1e-4)
"""


@pytest.mark.slow
def test_works_in_a_process_without_64_bit_types():
    run = subprocess.run([sys.executable, "-c", WITHOUT_64_BITS], capture_output=True, text=True, timeout=200)
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize(
    ("waypoints", "durations", "options", "said"),
    [
        (np.zeros((3, 3)), np.ones((2, 1)), {}, "batch last"),
        (np.zeros((1, 3, 4)), np.ones((0, 4)), {}, "batch last"),
        (np.zeros((3, 3, 4)), np.ones((2, 5)), {}, "durations have shape"),
        (np.zeros((3, 3, 4)), np.ones((2, 4)), {"initial": np.zeros((2, 3))}, "initial has shape"),
        (np.zeros((3, 3, 4)), np.ones((2, 4)), {"terminal": "stop"}, "want 'rest', 'free'"),
        (np.zeros((3, 3, 4)), np.ones((2, 4)), {"fixed_order": 2}, "fixed_order is 2"),
        (np.zeros((3, 3, 4)).astype("U3"), np.ones((2, 4)), {}, "waypoints: have ndarray that is no array of numbers"),
        (np.zeros((3, 3, 4)), np.ones((2, 4)), {"yaw": ["north"] * 3}, "yaw: have list"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(waypoints, durations, options, said):
    with pytest.raises(InputError, match=said):
        jaxplan.minimum_snap_batch(waypoints, durations, **options)


def test_chunks_of_a_large_batch_equal_small_batches():
    waypoints, durations, _ = random_batch(width=500, segments=3)
    whole = jaxplan.minimum_snap_batch(waypoints, durations)
    part = jaxplan.minimum_snap_batch(waypoints[..., 300:], durations[:, 300:])
    assert whole.cost.shape == (500,)
    np.testing.assert_allclose(whole.cost[300:], part.cost, **tolerance("exact"))
    np.testing.assert_allclose(whole.splines.position[..., 300:], part.splines.position, **tolerance("formula"))


@pytest.mark.slow
def test_parts_of_a_huge_batch_equal_small_batches():
    """Each of the parts that share the cores, the last one overlapping, arrays of one lane for all, and a bad lane."""
    width = 2 * THREAD_WIDTH + 100
    waypoints, durations, _ = random_batch(width=width, segments=3)
    durations[0, 700] = np.nan
    velocity = np.concatenate([np.ones((1, 3)), np.zeros((3, 3))])
    whole = jaxplan.minimum_snap_batch(waypoints, durations, initial=velocity)
    assert np.flatnonzero(whole.status).tolist() == [700]
    for first in (500, 1100, width - 200):
        lane = slice(first, first + 200)
        part = jaxplan.minimum_snap_batch(waypoints[..., lane], durations[:, lane], initial=velocity)
        np.testing.assert_allclose(whole.cost[lane], part.cost, **tolerance("exact"))
        np.testing.assert_array_equal(whole.status[lane], part.status)
        np.testing.assert_array_equal(whole.splines.durations[:, lane], part.splines.durations)
        np.testing.assert_allclose(whole.splines.position[..., lane], part.splines.position, **tolerance("formula"))
