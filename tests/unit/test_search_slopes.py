"""Where distances grow: against differences of the distance itself, for everything that is solid."""

import numpy as np
import pytest

from jaxplan.native import entry_point
from jaxplan.search.kernels.slopes import clearance_slope
from jaxplan.search.kernels.solids import REACH, clearance_at, solids_of
from oracles.solid_rooms import WORLDS
from tolerances import assert_close

COUNT, STEP = 4000, 1e-5
STRAIGHT = 1e-4
"""Where differences to both sides agree so well neither an edge nor a change of what is nearest lies between them."""


@entry_point
def distances(solids, points, found):
    for k in range(len(points)):
        found[k] = clearance_at(solids, points[k, 0], points[k, 1], points[k, 2])


@entry_point
def slopes(solids, points, found, slope):
    for k in range(len(points)):
        found[k], row = clearance_slope(solids, points[k, 0], points[k, 1], points[k, 2])
        slope[k, 0], slope[k, 1], slope[k, 2] = row


def distance(solids, points):
    found = np.empty(len(points))
    distances(solids, points, found)
    return found


@pytest.mark.parametrize("name", WORLDS)
def test_slopes_are_those_of_the_distances(name):
    """Inside of what is solid, too, and beyond the reach, where nothing pushes."""
    world = WORLDS[name]()
    solids, (lower, upper) = tuple(solids_of(world)), np.asarray(world.bounds, float)
    points = np.random.default_rng(0).uniform(lower - 0.2, upper + 0.2, (COUNT, 3))
    found, slope = np.empty(COUNT), np.empty((COUNT, 3))
    slopes(solids, points, found, slope)
    here = distance(solids, points)
    np.testing.assert_array_equal(found, here)
    assert (slope[here >= REACH] == 0.0).all()
    straight = np.abs(here - REACH) > 1e-3
    numeric = np.empty((COUNT, 3))
    for axis, step in enumerate(STEP * np.eye(3)):
        ahead, behind = distance(solids, points + step) - here, here - distance(solids, points - step)
        straight &= np.abs(ahead - behind) < STRAIGHT * STEP
        numeric[:, axis] = (ahead + behind) / (2.0 * STEP)
    assert straight.mean() > 0.5
    assert ((here < 0.0) & straight).sum() > 10 or name == "grids"  # which know no distance below 0
    assert_close(slope[straight], numeric[straight], "gradient")
