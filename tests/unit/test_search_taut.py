"""Paths pulled taut: never longer, never through an occupied cell, ends untouched."""

import itertools
from typing import NamedTuple

import numpy as np
import pytest

from jaxplan.search.kernels import astar
from jaxplan.search.kernels.graph import NO_ENTRY
from jaxplan.search.kernels.paths import write_paths
from jaxplan.search.kernels.taut import write_straight, write_taut
from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices, grid_frame, level_graph
from jaxplan.search.multi_resolution import find_paths
from jaxplan.search.routes import find_routes
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World
from oracles.search_sight import crossed_cells
from tolerances import tolerance

CAPACITY = 256
UNTOUCHED = 7.0
LEVELS = [0, 1, 2, 3]


class Rows(NamedTuple):
    """Paths of one search: points (k, capacity, 3), their number, and the lengths that were written."""

    points: np.ndarray
    count: np.ndarray
    length: np.ndarray


@pytest.fixture(scope="module")
def world() -> World:
    return load_world("env1")


@pytest.fixture(scope="module")
def lattices(world: World) -> Lattices:
    return build_lattices(world, SearchConfig(method="multi-resolution"))


def goals_in(lattices: Lattices, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    grid = lattices.levels[0].grid
    cells = np.argwhere(~grid.occupied)
    return grid.origin + (cells[rng.integers(len(cells), size=count)] + rng.uniform(0.05, 0.95, (count, 3))) * 0.1


def empty(count: int) -> Rows:
    return Rows(np.full((count, CAPACITY, 3), UNTOUCHED), np.zeros(count, np.int64), np.full(count, UNTOUCHED))


def both(lattices: Lattices, level: int, start: np.ndarray, goals: np.ndarray) -> tuple[Rows, Rows]:
    """What one search finds, as it is and pulled taut; goals that are not finite are not searched."""
    graph, wanted = level_graph(lattices, level), np.isfinite(goals).all(axis=1)
    goals = np.where(wanted[:, None], goals, 0.0)
    found = astar.search(graph, start, goals, wanted, 10**6)
    assert (found.entry[wanted] != NO_ENTRY).all()
    path, taut = empty(len(goals)), empty(len(goals))
    write_paths(graph, found, start[None], goals, path.points, path.count)
    write_taut(graph, found, lattices.levels[0].grid.occupied, start[None], goals, *taut)
    return path, taut


def lengths(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1)


@pytest.mark.parametrize("level", LEVELS)
def test_never_longer_and_with_the_same_ends(world: World, lattices: Lattices, level: int) -> None:
    goals = goals_in(lattices, 60, seed=level)
    path, taut = both(lattices, level, world.start, goals)
    assert (taut.length <= lengths(path.points) + 1e-12).all()
    np.testing.assert_allclose(taut.length, lengths(taut.points), **tolerance("exact"))
    assert (taut.count <= path.count).all()
    assert taut.count.mean() < 0.6 * path.count.mean()
    np.testing.assert_array_equal(taut.points[:, 0], np.tile(world.start, (60, 1)))
    np.testing.assert_array_equal(taut.points[:, -1], goals)
    for row, count in zip(taut.points, taut.count, strict=True):
        assert (row[count - 1 :] == row[-1]).all()


@pytest.mark.parametrize("level", LEVELS)
def test_every_point_kept_was_a_point_of_the_path(world: World, lattices: Lattices, level: int) -> None:
    path, taut = both(lattices, level, world.start, goals_in(lattices, 20, seed=3))
    for before, after in zip(path.points, taut.points, strict=True):
        assert {tuple(p) for p in after} <= {tuple(p) for p in before}


@pytest.mark.parametrize("level", LEVELS)
def test_no_segment_crosses_an_occupied_cell_however_small_the_corner(
    world: World, lattices: Lattices, level: int
) -> None:
    """The oracle cuts each segment at every face between cells and looks at the middle of every piece.

    Where two points of the path cannot see each other at all, both stay: there the path's own segment is kept, which
    on coarse lattices may touch cells that are occupied by the keep-in margin alone.
    """
    grid = lattices.levels[0].grid
    path, taut = both(lattices, level, world.start, goals_in(lattices, 80, seed=11))
    for row, count, before in zip(taut.points, taut.count, path.points, strict=True):
        steps = {(tuple(a), tuple(b)) for a, b in itertools.pairwise(before)}
        for a, b in itertools.pairwise(row[:count]):
            if (tuple(a), tuple(b)) not in steps or level == 0:
                assert sees(grid.occupied, a, b, grid.origin, grid.resolution)


def sees(occupied: np.ndarray, a: np.ndarray, b: np.ndarray, origin: np.ndarray, h: float) -> bool:
    """Whether the segment crosses no occupied cell, the last one left out."""
    cells = crossed_cells(a, b, origin, h)
    counted = cells[(cells != np.floor((b - origin) / h).astype(int)).any(axis=1)]
    return not occupied[tuple(counted.T)].any()


def test_a_straight_way_has_no_corner(lattices: Lattices) -> None:
    path, taut = both(lattices, 3, np.array([-4.3, -4.3, 1.0]), np.array([[-4.3, 4.3, 1.0]]))
    assert path.count[0] > 5
    assert taut.count[0] == 2


def test_rows_without_a_path_stay_as_they_are(world: World, lattices: Lattices) -> None:
    _, taut = both(lattices, 2, world.start, np.array([[np.nan, 0.0, 1.0], [4.3, 4.3, 1.0]]))
    assert taut.count[0] == 0
    assert taut.length[0] == UNTOUCHED
    assert (taut.points[0] == UNTOUCHED).all()
    assert taut.count[1] >= 2


def test_a_padded_start_keeps_its_escape(world: World, lattices: Lattices) -> None:
    start = np.array([-2.0, 0.05 + 0.3 + 0.3, 1.0])  # 0.3 m from the western pillar
    goal = np.array([[-2.0, 3.0, 1.0]])
    paths = find_paths(lattices, world, start, goal, 2.0)
    routes = find_routes(lattices, world, start, goal, 2.0)
    np.testing.assert_array_equal(routes.points[0, :2], paths.points[0, :2])


def test_exactly_the_goals_in_sight_get_a_straight_line(world: World, lattices: Lattices) -> None:
    grid, goals = lattices.levels[0].grid, goals_in(lattices, 100, seed=12)
    wanted = np.arange(100) % 3 > 0
    straight = empty(100)
    write_straight(grid.occupied, grid_frame(grid), world.start[None], goals, wanted, *straight)
    seen = [sees(grid.occupied, world.start, goal, grid.origin, grid.resolution) for goal in goals]
    assert 10 < sum(seen) < 90
    np.testing.assert_array_equal(straight.count, np.where(wanted & seen, 2, 0))
    found = straight.count > 0
    np.testing.assert_allclose(
        straight.length[found], np.linalg.norm(goals[found] - world.start, axis=1), **tolerance("exact")
    )
    np.testing.assert_array_equal(straight.points[found, 1:], np.repeat(goals[found, None], CAPACITY - 1, axis=1))
    assert (straight.points[~found] == UNTOUCHED).all()
