"""Occupancy lattices: conservative where they promise it, consistent between resolutions, bounded."""

import numpy as np
import pytest
from scipy import ndimage

from jaxplan.errors import InputError
from jaxplan.world.clearance import clearance
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World, make_obstacles
from jaxplan.world.occupancy import RESOLUTIONS, cell_centres, occupancy_lattices


@pytest.fixture(scope="module")
def world() -> World:
    return load_world("env1")


def test_finest_cells_follow_the_clearance_of_their_centres(world: World) -> None:
    finest = occupancy_lattices(world, (0.2,))[0]
    centres = np.stack(np.meshgrid(*cell_centres(finest.origin, 0.2, finest.shape), indexing="ij"), axis=-1)
    distance = np.asarray(clearance(world, centres))
    decided = np.abs(distance - 0.5) > 1e-5  # the test computes in float32
    np.testing.assert_array_equal(finest.near_obstacle[decided], (distance < 0.5)[decided])


def test_coarse_cells_are_occupied_if_any_fine_cell_in_them_is(world: World) -> None:
    fine, *coarse = occupancy_lattices(world)
    for lattice in coarse:
        factor = round(lattice.resolution / fine.resolution)
        blown_up = lattice.near_obstacle.repeat(factor, 0).repeat(factor, 1).repeat(factor, 2)
        assert blown_up[fine.near_obstacle].all()
        assert lattice.near_obstacle.sum() * factor**3 < 3 * fine.near_obstacle.sum()


def test_keep_in_is_judged_per_lattice(world: World) -> None:
    for lattice in occupancy_lattices(world):
        for axis, centres in enumerate(cell_centres(lattice.origin, lattice.resolution, lattice.shape)):
            outside = (centres < world.bounds[0, axis] + 0.2) | (centres > world.bounds[1, axis] - 0.2)
            assert np.moveaxis(lattice.occupied, axis, 0)[outside].all()
        assert not lattice.occupied.all()


def test_env1_is_connected_at_every_resolution(world: World) -> None:
    for lattice in occupancy_lattices(world, RESOLUTIONS):
        _, components = ndimage.label(~lattice.occupied)
        assert components == 1
        index = np.floor((world.start - lattice.origin) / lattice.resolution).astype(int)
        assert not lattice.occupied[tuple(index)]


def test_huge_rooms_are_refused_before_allocation() -> None:
    """I23"""
    bounds = np.array([[0.0] * 3, [1e4] * 3])
    huge = World(name="huge", bounds=bounds, obstacles=make_obstacles(), keep_in=np.float64(0.2))
    with pytest.raises(InputError, match="cells"):
        occupancy_lattices(huge)


@pytest.mark.parametrize(
    "resolutions", [(), (0.0, 0.1), (-0.1,), (0.1, 0.25), (0.2, 0.1), (0.1, 0.1), (np.nan,), (np.inf,)]
)
def test_bad_resolutions_are_refused(world: World, resolutions: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="resolutions"):
        occupancy_lattices(world, resolutions)
