"""Paths pulled taut: never longer, never through an occupied cell, ends untouched."""

import itertools

import numpy as np
import pytest

from jaxplan.search.kernels.taut import shorten
from jaxplan.search.lattice import Lattices, build_lattices
from jaxplan.search.multi_resolution import find_paths
from jaxplan.status import Reason
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World
from oracles.search_sight import crossed_cells


@pytest.fixture(scope="module")
def world() -> World:
    return load_world("env1")


@pytest.fixture(scope="module")
def lattices(world: World) -> Lattices:
    return build_lattices(world)


def goals_in(lattices: Lattices, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    grid = lattices.levels[0].grid
    cells = np.argwhere(~grid.occupied)
    return grid.origin + (cells[rng.integers(len(cells), size=count)] + rng.uniform(0.05, 0.95, (count, 3))) * 0.1


def lengths(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1)


@pytest.mark.parametrize("distance", [0.0, 2.5, 5.0, 9.0])
def test_never_longer_and_with_the_same_ends(world: World, lattices: Lattices, distance: float) -> None:
    goals = goals_in(lattices, 60, seed=int(distance))
    paths = find_paths(lattices, world, world.start, goals, distance)
    taut = shorten(paths, lattices)
    assert (lengths(taut.points) <= lengths(paths.points) + 1e-12).all()
    assert (taut.count <= paths.count).all()
    assert taut.count.mean() < 0.6 * paths.count.mean()
    np.testing.assert_array_equal(taut.points[:, 0], paths.points[:, 0])
    np.testing.assert_array_equal(taut.points[:, -1], goals)
    for row, count in zip(taut.points, taut.count, strict=True):
        assert (row[count - 1 :] == row[-1]).all()
    for unchanged in ("length", "resolution", "reasons", "notes"):
        np.testing.assert_array_equal(getattr(taut, unchanged), getattr(paths, unchanged))


def test_every_point_kept_was_a_point_of_the_path(world: World, lattices: Lattices) -> None:
    paths = find_paths(lattices, world, world.start, goals_in(lattices, 20, seed=3), 5.0)
    taut = shorten(paths, lattices)
    for before, after in zip(paths.points, taut.points, strict=True):
        assert {tuple(p) for p in after} <= {tuple(p) for p in before}


def test_no_segment_crosses_an_occupied_cell_however_small_the_corner(world: World, lattices: Lattices) -> None:
    """The oracle cuts each segment at every face between cells and looks at the middle of every piece."""
    grid = lattices.levels[0].grid
    paths = find_paths(lattices, world, world.start, goals_in(lattices, 80, seed=11), 2.5)
    taut = shorten(paths, lattices)
    for row, count in zip(taut.points, taut.count, strict=True):
        for a, b in itertools.pairwise(row[:count]):
            cells = crossed_cells(a, b, grid.origin, grid.resolution)
            last = np.floor((b - grid.origin) / grid.resolution).astype(int)
            counted = cells[(cells != last).any(axis=1)]
            assert not grid.occupied[tuple(counted.T)].any()


def test_a_straight_way_has_no_corner(world: World, lattices: Lattices) -> None:
    start = np.array([-4.3, -4.3, 1.0])
    paths = find_paths(lattices, world, start, np.array([[-4.3, 4.3, 1.0]]), 9.0)
    taut = shorten(paths, lattices)
    assert paths.count[0] > 5
    assert taut.count[0] == 2


def test_rows_without_a_path_stay_as_they_are(world: World, lattices: Lattices) -> None:
    goals = np.array([[np.nan, 0.0, 1.0], [4.3, 4.3, 1.0]])
    taut = shorten(find_paths(lattices, world, world.start, goals, 5.0), lattices)
    assert taut.count[0] == 0
    assert taut.reasons[0] == Reason.NO_PATH
    assert (taut.points[0] == world.start).all()
    assert taut.count[1] >= 2


def test_a_padded_start_keeps_its_escape(world: World, lattices: Lattices) -> None:
    start = np.array([-2.0, 0.05 + 0.3 + 0.3, 1.0])  # 0.3 m from the western pillar
    paths = find_paths(lattices, world, start, np.array([[-2.0, 3.0, 1.0]]), 2.0)
    taut = shorten(paths, lattices)
    np.testing.assert_array_equal(taut.points[0, :2], paths.points[0, :2])
