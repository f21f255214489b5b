"""A world changed in flight equals the same world built anew, and costs no compilation."""

import numpy as np
import pytest
from scipy import ndimage

from jaxplan.errors import InputError
from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices
from jaxplan.search.routes import find_routes, warmup
from jaxplan.search.update import update_lattices
from jaxplan.status import Reason
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World, make_obstacles
from jaxplan.world.update import update_world, with_spare_boxes
from jaxplan.world.voxels import distance_grid


def changed(world: World, lattices: Lattices, **change: object) -> tuple[World, Lattices]:
    moved = update_world(world, **change)
    return moved.world, update_lattices(lattices, moved)


def assert_same(changed: Lattices, anew: Lattices) -> None:
    """All arrays, and labels that never separate what is connected."""
    for one, other in zip(changed.levels, anew.levels, strict=True):
        np.testing.assert_array_equal(one.grid.occupied, other.grid.occupied)
        np.testing.assert_array_equal(one.grid.near_obstacle, other.grid.near_obstacle)
        np.testing.assert_array_equal(one.moves, other.moves)
        np.testing.assert_array_equal(one.components > 0, other.components > 0)
        for label in range(1, other.components.max(initial=0) + 1):
            assert len(np.unique(one.components[other.components == label])) <= 1


@pytest.mark.parametrize("seed", range(5))
def test_boxes_come_and_go(seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = with_spare_boxes(load_world("env1"), 4)
    lattices = build_lattices(world)
    for _ in range(3):
        lower = rng.uniform([-5.5, -5.5, -0.5], [4.5, 4.5, 1.5])
        world, lattices = changed(world, lattices, add_box=(lower, lower + rng.uniform(0.1, 2.0, 3)))
        assert_same(lattices, build_lattices(world))
    for index in (1, 3, 4):
        world, lattices = changed(world, lattices, remove_box=index)
        assert_same(lattices, build_lattices(world))


def test_a_closed_door_closes_and_opens_again() -> None:
    world = with_spare_boxes(load_world("env2"))
    lattices = build_lattices(world)
    start, goal = np.array([-6.5, -6.5, 1.0]), np.array([[-9.0, -4.2, 1.0]])
    open_way = find_routes(lattices, world, start, goal, 3.0).length[0]
    world, lattices = changed(world, lattices, add_box=([-7.6, -5.6, 0.0], [-7.4, -2.9, 3.0]))
    around = find_routes(lattices, world, start, goal, 3.0).length[0]
    assert around > open_way + 5.0
    world, lattices = changed(world, lattices, remove_box=18)
    assert find_routes(lattices, world, start, goal, 3.0).length[0] == pytest.approx(open_way)


def test_what_a_new_box_encloses_is_never_reached() -> None:
    """The labels still say connected; the search finds out."""
    world = with_spare_boxes(load_world("env1"), 1)
    lattices = build_lattices(world, SearchConfig())
    world, lattices = changed(world, lattices, add_box=([-5.0, -0.1, 0.0], [5.0, 0.1, 2.0]))
    routes = find_routes(lattices, world, np.array([-4.3, -4.3, 1.0]), np.array([[4.3, 4.3, 1.0]]), 5.0)
    assert routes.reasons[0] == Reason.NO_PATH


@pytest.mark.parametrize("seed", range(4))
def test_cells_come_and_go(seed: int) -> None:
    rng = np.random.default_rng(seed)
    occupied = ndimage.binary_dilation(rng.random((60, 50, 20)) < 2e-4, iterations=2)
    obstacles = make_obstacles(voxels=distance_grid(occupied, np.zeros(3), 0.1))
    bounds = np.array([[0.0, 0.0, 0.0], [6.0, 5.0, 2.0]])
    world = World(name="cells", bounds=bounds, obstacles=obstacles, keep_in=np.float64(0.2))
    lattices = build_lattices(world)
    for value in (True, False, True):
        lower = rng.uniform([-0.5, -0.5, -0.5], [5.5, 4.5, 1.5])
        upper = lower + rng.uniform(0.05, 1.5, 3)
        world, lattices = changed(world, lattices, **{"occupy" if value else "free": (lower, upper)})
        anew = distance_grid(np.asarray(world.voxels.occupied), np.zeros(3), 0.1)
        np.testing.assert_allclose(world.voxels.squared, anew.squared, atol=1e-12)
        assert_same(lattices, build_lattices(world))
    assert (np.asarray(world.voxels.occupied) != occupied).any()


def test_nothing_compiles(compilations) -> None:  # type: ignore[no-untyped-def]
    world = with_spare_boxes(load_world("env3"), 2)
    lattices = build_lattices(world)
    warmup(lattices, world)
    compilations.count = 0
    denser, lattices = changed(world, lattices, add_box=([0.0, 0.0, 0.0], [1.0, 1.0, 3.0]))
    find_routes(lattices, denser, denser.start, np.array([[5.0, 5.0, 1.0]]), 10.0)
    assert compilations.count == 0


def test_the_world_before_stays_as_it_was() -> None:
    world = with_spare_boxes(load_world("env1"), 1)
    centers = world.boxes.center.copy()
    change = update_world(world, add_box=([0, 0, 0], [1, 1, 1]))
    np.testing.assert_array_equal(world.boxes.center, centers)
    np.testing.assert_array_equal(change.world.boxes.center[-1], [0.5, 0.5, 0.5])
    np.testing.assert_array_equal([change.lower, change.upper], [[0, 0, 0], [1, 1, 1]])


def test_bad_changes_are_refused() -> None:
    world = load_world("env1")
    spare = with_spare_boxes(world)
    with pytest.raises(InputError, match="spare"):
        update_world(world, add_box=([0, 0, 0], [1, 1, 1]))
    with pytest.raises(InputError, match="lower < upper"):
        update_world(spare, add_box=([0, 0, 0], [1, -1, 1]))
    with pytest.raises(InputError, match="finite"):
        update_world(spare, add_box=([0, np.nan, 0], [1, 1, 1]))
    for number in (-1, 99, len(spare.boxes.center) - 1):
        with pytest.raises(InputError, match="no box"):
            update_world(spare, remove_box=number)
    with pytest.raises(InputError, match="no cells"):
        update_world(world, occupy=([0, 0, 0], [1, 1, 1]))
    for several in ({}, {"remove_box": 0, "free": ([0, 0, 0], [1, 1, 1])}):
        with pytest.raises(InputError, match="one change"):
            update_world(world, **several)
