"""A start for worlds that name none."""

import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.search.lattice import build_lattices
from jaxplan.search.multi_resolution import find_paths
from jaxplan.search.start_place import reachable_place
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World, aligned_boxes, make_obstacles


@pytest.mark.parametrize("name", ["env1", "env2"])
def test_place_is_free_connected_and_neither_near_nor_far(name: str) -> None:
    world = load_world(name)
    lattices = build_lattices(world)
    target = -np.asarray(world.start) + [0.0, 0.0, 2 * world.start[2]]
    place = reachable_place(lattices, world, target)
    paths = find_paths(lattices, world, place, target[None], 0.0)
    assert paths.reasons[0] == 0
    assert not paths.notes.any()
    assert 0.2 * world.diagonal < paths.length[0] < 0.4 * world.diagonal
    np.testing.assert_array_equal(place, reachable_place(lattices, world, target))


def test_place_lies_on_the_target_s_side_of_a_closed_wall() -> None:
    boxes = aligned_boxes(np.array([[4.9, 0.0, 0.0]]), np.array([[5.1, 10.0, 2.0]]))
    bounds = np.array([[0.0, 0.0, 0.0], [10.0, 10.0, 2.0]])
    world = World(name="halves", bounds=bounds, obstacles=make_obstacles(boxes=boxes), keep_in=np.float64(0.2))
    lattices = build_lattices(world)
    assert reachable_place(lattices, world, np.array([8.0, 5.0, 1.0]))[0] > 5.0
    assert reachable_place(lattices, world, np.array([2.0, 5.0, 1.0]))[0] < 5.0


def test_no_place_is_an_error_that_says_what_to_do() -> None:
    bounds = np.array([[0.0, 0.0, 0.0], [4.0, 4.0, 2.0]])
    boxes = aligned_boxes(np.array([[0.0, 0.0, 0.0]]), np.array([[4.0, 4.0, 2.0]]))
    world = World(name="full", bounds=bounds, obstacles=make_obstacles(boxes=boxes), keep_in=np.float64(0.2))
    with pytest.raises(InputError, match="--start"):
        reachable_place(build_lattices(world), world, np.array([2.0, 2.0, 1.0]))
