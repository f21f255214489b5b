"""A world changed in flight equals the same world built anew, and costs no compilation."""

import jax
import numpy as np
import pytest
from scipy import ndimage

from jaxplan.errors import InputError
from jaxplan.precision import in_float64
from jaxplan.records import replace
from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices
from jaxplan.search.routes import find_routes, warmup
from jaxplan.search.update import update_lattices
from jaxplan.status import Reason
from jaxplan.world.clearance import free_distance
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World, make_obstacles
from jaxplan.world.update import update_world, with_spare_boxes
from jaxplan.world.voxels import distance_grid
from tolerances import tolerance

WITH_NARROW = SearchConfig(least_padding=0.3)


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
    assert_same_roads(changed, anew)


def assert_same_roads(changed: Lattices, anew: Lattices) -> None:
    """All places and roads in the same order, bit for bit."""
    assert changed.roadmap is not None
    assert anew.roadmap is not None
    np.testing.assert_array_equal(changed.roadmap.field.values, anew.roadmap.field.values)
    for one, other in zip(changed.roadmap.levels, anew.roadmap.levels, strict=True):
        np.testing.assert_array_equal(one.tiles, other.tiles)
        for name in other.roads._fields:
            np.testing.assert_array_equal(getattr(one.roads, name), getattr(other.roads, name), err_msg=name)
        np.testing.assert_array_equal(one.components > 0, other.components > 0)
        for label in range(1, other.components.max(initial=0) + 1):
            assert len(np.unique(one.components[other.components == label])) <= 1


@pytest.mark.parametrize("seed", range(5))
def test_boxes_come_and_go(seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = with_spare_boxes(load_world("env1"), 4)
    lattices = build_lattices(world, WITH_NARROW)
    for _ in range(3):
        lower = rng.uniform([-5.5, -5.5, -0.5], [4.5, 4.5, 1.5])
        world, lattices = changed(world, lattices, add_box=(lower, lower + rng.uniform(0.1, 2.0, 3)))
        assert_same(lattices, build_lattices(world, WITH_NARROW))
    for index in (1, 3, 4):
        world, lattices = changed(world, lattices, remove_box=index)
        assert_same(lattices, build_lattices(world, WITH_NARROW))


@pytest.mark.parametrize("name", ["env1", "env3"])
def test_a_box_moves_in_one_change(name: str) -> None:
    """One that was not there, one that was, and one of the room's own; bit for bit as when it goes and comes."""
    rng, world = np.random.default_rng(7), with_spare_boxes(load_world(name), 2)
    lattices, last = build_lattices(world, WITH_NARROW), len(world.boxes.center) - 1
    for index in (last, last, 1, last):
        lower = rng.uniform([-4.5, -4.5, 0.0], [3.5, 3.5, 0.5])
        world, lattices = changed(world, lattices, move_box=(index, (lower, lower + rng.uniform(0.3, 1.0, 3))))
        np.testing.assert_allclose(world.boxes.center[index] - world.boxes.half[index], lower, **tolerance("exact"))
        assert_same(lattices, build_lattices(world, WITH_NARROW))


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


def cells(rng: np.random.Generator, side: float, blobs: float = 2e-4) -> World:
    """A room of 6 x 5 x 2 m with blobs of occupied cells of the given side [m]."""
    shape = np.round(np.array([6.0, 5.0, 2.0]) / side).astype(int)
    occupied = ndimage.binary_dilation(rng.random(shape) < blobs, iterations=2)
    obstacles = make_obstacles(voxels=distance_grid(occupied, np.zeros(3), side))
    return World(name="cells", bounds=np.stack([np.zeros(3), shape * side]), obstacles=obstacles, keep_in=0.2)


@pytest.mark.parametrize(("seed", "side"), [(0, 0.1), (1, 0.1), (2, 0.1), (3, 0.1), (4, 0.4), (5, 0.4), (6, 0.4)])
def test_cells_come_and_go(seed: int, side: float) -> None:
    """Small cells and large ones, whose clearance falls short of the distance by more."""
    rng = np.random.default_rng(seed)
    world = cells(rng, side, blobs=2e-4 if side < 0.2 else 5e-3)
    before = np.array(world.voxels.occupied)
    configs = SearchConfig(), SearchConfig(resolutions=(0.1,), distance_fractions=())
    lattices, alone = (build_lattices(world, config) for config in configs)
    for value in (True, False, True):
        lower = rng.uniform([-0.5, -0.5, -0.5], [5.5, 4.5, 1.5])
        upper = lower + rng.uniform(0.05, 1.5, 3)
        moved = update_world(world, **{"occupy" if value else "free": (lower, upper)})
        world, lattices, alone = moved.world, update_lattices(lattices, moved), update_lattices(alone, moved)
        anew = distance_grid(np.asarray(world.voxels.occupied), np.zeros(3), side)
        np.testing.assert_allclose(world.voxels.squared, anew.squared, **tolerance("exact"))
        for updated in (lattices, alone):
            assert_same(updated, build_lattices(world, updated.config))
    assert (np.asarray(world.voxels.occupied) != before).any()


@pytest.mark.parametrize("seed", range(3))
def test_lattices_whose_cells_do_not_divide_each_other(seed: int) -> None:
    """0.5 m is no multiple of 0.2 m: the cells that are looked at again begin where cells of both begin."""
    rng = np.random.default_rng(seed)
    world = with_spare_boxes(load_world("env1"), 3)
    lattices = build_lattices(world, SearchConfig(resolutions=(0.1, 0.2, 0.5), distance_fractions=(0.1, 0.2)))
    for _ in range(3):
        lower = rng.uniform([-5.5, -5.5, -0.5], [4.5, 4.5, 1.5])
        world, lattices = changed(world, lattices, add_box=(lower, lower + rng.uniform(0.1, 1.0, 3)))
        assert_same(lattices, build_lattices(world, lattices.config))


@pytest.mark.parametrize("seed", range(3))
def test_many_parts_are_joined_and_named_apart(seed: int) -> None:
    """Scattered cells without padding leave many pockets: freeing joins some of them, and new ones get new labels."""
    rng = np.random.default_rng(seed)
    config = SearchConfig(padding=0.06, resolutions=(0.1,), distance_fractions=())
    world = replace(cells(rng, 0.1, blobs=0.02), keep_in=0.0)
    lattices = build_lattices(world, config)
    assert lattices.levels[0].components.max() > 10
    for number in range(6):
        lower = rng.uniform([0.5, 0.5, 0.2], [4.0, 3.0, 1.0])
        world, lattices = changed(
            world, lattices, **{"free" if number % 2 else "occupy": (lower, lower + rng.uniform(0.3, 1.2, 3))}
        )
        assert_same(lattices, build_lattices(world, config))
    assert lattices.levels[0].components.max() < 1000


CHANGES = {
    "env3": [
        {"add_box": ([0.0, 0.0, 0.0], [1.0, 1.0, 3.0])},
        {"move_box": (0, ([1.0, 0.0, 0.0], [2.0, 1.0, 3.0]))},
        {"remove_box": 0},
    ],
    "cells": [{"occupy": ([2.0, 2.0, 0.0], [3.0, 3.0, 1.0])}, {"free": ([2.0, 2.0, 0.0], [3.0, 3.0, 1.0])}],
}


@pytest.mark.parametrize("name", CHANGES)
@pytest.mark.parametrize("on_device", [False, True])
def test_nothing_compiles(name: str, on_device: bool, compilations) -> None:  # type: ignore[no-untyped-def]
    """Neither in the search nor where the world is an argument: what is static, shapes and dtypes stay."""
    world = cells(np.random.default_rng(0), 0.1) if name == "cells" else with_spare_boxes(load_world(name), 2)
    world = in_float64(jax.device_put)(world) if on_device else world
    start, goals = np.asarray(world.bounds).mean(axis=0), np.array([[5.0, 4.0, 1.0]])
    lattices, compiled = build_lattices(world), in_float64(jax.jit(free_distance))
    warmup(lattices, world)
    compiled(world, start)
    compilations.count = 0
    for change in CHANGES[name]:
        moved, lattices = changed(world, lattices, **change)
        assert jax.tree.structure(moved) == jax.tree.structure(world)
        for one, other in zip(jax.tree.leaves(moved), jax.tree.leaves(world), strict=True):
            assert (np.shape(one), np.asarray(one).dtype) == (np.shape(other), np.asarray(other).dtype)
        find_routes(lattices, moved, start, goals, 10.0)
        compiled(moved, start)
        compiled(in_float64(jax.device_put)(moved), start)
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
    for number in (-1, 99):
        with pytest.raises(InputError, match="no box"):
            update_world(spare, move_box=(number, ([0, 0, 0], [1, 1, 1])))
    with pytest.raises(InputError, match="lower < upper"):
        update_world(spare, move_box=(0, ([0, 0, 0], [1, -1, 1])))
    with pytest.raises(InputError, match="no cells"):
        update_world(world, occupy=([0, 0, 0], [1, 1, 1]))
    for several in ({}, {"remove_box": 0, "free": ([0, 0, 0], [1, 1, 1])}):
        with pytest.raises(InputError, match="one change"):
            update_world(world, **several)
