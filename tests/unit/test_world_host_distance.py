"""The distance to the nearest obstacle or face of the room: of any number of points, as one at a time."""

import jax
import numpy as np
import pytest

from jaxplan.compilation import compilations
from jaxplan.records import replace
from jaxplan.world.clearance import free_distance
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.load import load_world
from tolerances import assert_close


@pytest.mark.parametrize("shape", [(0,), (1,), (8,), (9,), (3, 5), ()])
def test_any_number_of_points_in_any_shape(shape):
    world = load_world("env1")
    lower, upper = np.asarray(world.bounds)
    points = np.random.default_rng(0).uniform(lower - 1.0, upper + 1.0, (*shape, 3))
    with jax.enable_x64(True):
        alone = [float(free_distance(world, p)) for p in points.reshape(-1, 3)]
    found = host_free_distance(world, points, width=8)
    assert found.dtype == np.float64
    assert_close(found, np.reshape(alone, shape), "exact")
    assert shape != (9,) or (found < 0.0).any()


def test_nothing_compiles_twice_and_nan_stays_nan(compilations):
    world = load_world("env1")
    host_free_distance(world, np.ones((3, 3)), width=32)
    compilations.count = 0
    found = host_free_distance(world, np.vstack([np.ones((70, 3)), [[np.nan, 0.0, 0.0]]]), width=32)
    assert compilations.count == 0
    assert np.isfinite(found[:-1]).all()
    assert np.isnan(found[-1])


def test_worlds_that_differ_in_their_names_share_what_is_compiled() -> None:
    """Otherwise a process that flies in many rooms grew by 35 MB with each."""
    world = load_world("env1")
    points = np.zeros((3, 3))
    want, counted = host_free_distance(world, points, 32), compilations()
    for number in range(3):
        named = replace(world, name=f"room {number}", provenance=str(number))
        np.testing.assert_array_equal(host_free_distance(named, points, 32), want)
    assert compilations() == counted
    assert world.nameless().nameless().name == ""
    assert world.name == "env1"
