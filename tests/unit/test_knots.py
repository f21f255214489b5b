"""Knots against the paper's formulas written out in plain loops, and degenerate paths."""

import itertools
import math

import jax
import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.knots import MAX_WAYPOINTS, KnotConfig, resample, select_knots, select_routes
from tolerances import tolerance

CONFIG = KnotConfig(distance_per_knot=2.0, turning_per_knot=1.0)


def knots(path, config=CONFIG, capacity=40):
    padded = np.concatenate([path, np.repeat(path[-1:], capacity - len(path), axis=0)])
    with jax.enable_x64(True):
        result = jax.jit(lambda p: select_knots(p, config))(padded)
    return np.asarray(result.waypoints), int(result.count)


def circumradius(a, b, c):
    """Heron, independent of the library's cross product."""
    x, y, z = (math.dist(a, b), math.dist(b, c), math.dist(a, c))
    s = (x + y + z) / 2
    area = math.sqrt(max(s * (s - x) * (s - y) * (s - z), 0.0))
    return x * y * z / (4 * area) if area > 0 else math.inf


def test_parameter_matches_the_paper_on_a_random_path():
    path = np.random.default_rng(0).normal(size=(9, 3)).cumsum(axis=0)
    distance = [0.0]
    for a, b in itertools.pairwise(path):
        distance.append(distance[-1] + math.dist(a, b))
    curvature = [0.0, 0.0]
    for i in range(1, 8):
        curvature.append(curvature[-1] + (distance[i + 1] - distance[i - 1]) / 2 / circumradius(*path[i - 1 : i + 2]))
    expected = min(max(math.ceil(max(distance[-1] / 2.0, curvature[-1] / 1.0)), 2), MAX_WAYPOINTS)
    waypoints, count = knots(path)
    assert count == expected
    k = [(d + c) / 2 for d, c in zip(distance, curvature, strict=True)]
    at = np.linspace(0, k[-1], expected)
    manual = np.stack([np.interp(at, k, path[:, axis]) for axis in range(3)], axis=1)
    np.testing.assert_allclose(waypoints[:count], manual, **tolerance("exact"))
    np.testing.assert_allclose(
        waypoints[count:], np.repeat(path[-1:], MAX_WAYPOINTS - count, axis=0), **tolerance("exact")
    )


def test_straight_path_has_uniform_knots():
    path = np.linspace([0, 0, 0], [7.9, 0, 0], 30)
    waypoints, count = knots(path)
    assert count == 4
    np.testing.assert_allclose(waypoints[:4, 0], np.linspace(0, 7.9, 4), **tolerance("exact"))


@pytest.mark.parametrize(
    "path",
    [
        np.zeros((5, 3)),
        np.array([[0.0, 0, 0], [0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0]]),
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 0], [1, 0, 0]]),
        np.array([[0.0, 0, 0], [1e-12, 0, 0]]),
    ],
    ids=["all equal", "repeated", "reversing", "tiny"],
)
def test_degenerate_paths_give_finite_waypoints(path):
    waypoints, count = knots(path)
    assert np.isfinite(waypoints).all()
    assert 2 <= count <= MAX_WAYPOINTS
    np.testing.assert_allclose(waypoints[0], path[0], **tolerance("exact"))
    np.testing.assert_allclose(waypoints[-1], path[-1], **tolerance("exact"))


def test_long_paths_stop_at_the_longest_sequence():
    path = np.linspace([0, 0, 0], [100.0, 0, 0], 40)
    waypoints, count = knots(path)
    assert count == MAX_WAYPOINTS
    np.testing.assert_allclose(waypoints[-1], path[-1])


def test_resampling_is_uniform_in_arc_length():
    path = np.array([[0.0, 0, 0], [1, 0, 0], [1, 3, 0], [1, 3, 0]])
    with jax.enable_x64(True):
        points = np.asarray(resample(path, 9))
    np.testing.assert_allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), 0.5, **tolerance("exact"))


@pytest.mark.parametrize("longest", [3, 30])
def test_many_paths_are_as_each_alone_and_long_ones_are_cut(longest):
    """Alone, a path of 2 m a knot and no turning wants half its length in waypoints; 14 carry 28 m of it."""
    config, lengths = KnotConfig(turning_per_knot=10.0), np.array([2.0, 5.0, longest])
    paths = np.linspace(0.0, 1.0, 9)[:, None] * lengths[:, None, None] * [1.0, 0.0, 0.0]
    shares = np.array([1.0, 0.5, 1.0])
    with jax.enable_x64(True):
        chosen = jax.jit(lambda p, s: select_routes(p, config, s))
        together = jax.tree.map(np.asarray, chosen(paths, shares))
        alone = [chosen(paths[k : k + 1], shares[k : k + 1]) for k in range(3)]
        even = np.stack([jax.jit(resample, static_argnums=1)(path, config.samples) for path in paths])
    flown = np.array([2.0, 2.5, min(longest, 28.0)])
    np.testing.assert_allclose(together.samples[:, -1, 0], flown, **tolerance("formula"))
    np.testing.assert_allclose(together.knots.waypoints[:, -1, 0], flown, **tolerance("formula"))
    assert together.whole.tolist() == [True, False, longest <= 28.0]
    for k in range(3):
        for mine, theirs in zip(jax.tree.leaves(together), jax.tree.leaves(alone[k]), strict=True):
            np.testing.assert_allclose(mine[k], np.asarray(theirs)[0], **tolerance("exact"))
    np.testing.assert_allclose(together.samples[together.whole], even[together.whole], **tolerance("exact"))


def test_a_stop_point_is_one_more_waypoint_behind_the_goal():
    """Three paths of 5 m: on to 1 m behind the goal, not at all, and one too long to be carried whole."""
    config = KnotConfig(turning_per_knot=10.0)
    paths = np.linspace(0.0, 1.0, 9)[:, None] * np.array([5.0, 5.0, 40.0])[:, None, None] * [1.0, 0.0, 0.0]
    stops = np.array([[5.0, 1.0, 0.0], [5.0, 0.0, 0.0], [41.0, 0.0, 0.0]])
    with jax.enable_x64(True):
        rested = jax.jit(lambda p: select_routes(p, config))(paths)
        passed = jax.jit(lambda p, s: select_routes(p, config, stops=s))(paths, stops)
    goal, count = np.asarray(passed.meet), np.asarray(passed.knots.count)
    assert goal.tolist() == [2, 2, MAX_WAYPOINTS - 2]
    assert count.tolist() == [4, 3, MAX_WAYPOINTS - 1]
    waypoints, before = np.asarray(passed.knots.waypoints), np.asarray(rested.knots.waypoints)
    np.testing.assert_allclose(waypoints[0, :3], before[0, :3], **tolerance("exact"))
    np.testing.assert_allclose(waypoints[0, 3:], np.tile(stops[0], (MAX_WAYPOINTS - 3, 1)), **tolerance("exact"))
    np.testing.assert_allclose(waypoints[1], before[1], **tolerance("exact"))
    np.testing.assert_allclose(passed.samples[0, -1], stops[0], **tolerance("exact"))
    steps = np.linalg.norm(np.diff(np.asarray(passed.samples[0]), axis=0), axis=1)
    assert steps.max() < 6.0 / 63 + 1e-9
    assert np.asarray(passed.whole).tolist() == [True, True, False]
    assert (waypoints[2, :, 1] == 0.0).all()


def test_configuration_is_checked():
    with pytest.raises(InputError, match="distance_per_knot"):
        KnotConfig(distance_per_knot=float("nan"))
