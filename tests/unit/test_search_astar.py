"""The multi-goal search against SciPy's Dijkstra and a published optimum."""

import re

import numpy as np
import pytest
from scipy import ndimage

from jaxplan.search.kernels import astar
from jaxplan.search.kernels.graph import NO_ENTRY, NO_STEP, STEPS, Graph, make_frame, onward_steps, permitted_moves
from jaxplan.search.kernels.workspace import workspace
from oracles.search_dijkstra import STEPS as ORACLE_STEPS
from oracles.search_dijkstra import grid_edges, number, shortest
from oracles.search_sight import crossed_cells
from tolerances import assert_close, tolerance


def make_graph(occupied: np.ndarray, fine: np.ndarray | None = None, h: float = 1.0) -> Graph:
    fine = occupied if fine is None else fine
    factor = fine.shape[0] // occupied.shape[0]
    return Graph(
        moves=permitted_moves(occupied),
        components=ndimage.label(~occupied)[0].astype(np.int32).reshape(-1),
        frame=make_frame(occupied.shape, np.zeros(3), h),
        fine=fine,
        fine_frame=make_frame(fine.shape, np.zeros(3), h / factor),
    )


def sees(fine: np.ndarray, a: np.ndarray, b: np.ndarray, h: float) -> bool:
    """Every cell that the segment crosses is free; the goal's own cell does not count."""
    cells = crossed_cells(a, b, np.zeros(3), h)
    counted = (cells != np.floor(b / h).astype(int)).any(axis=1)
    return not fine[tuple(cells[counted].T)].any()


def oracle_costs(occupied: np.ndarray, fine: np.ndarray, h: float, start: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """Dijkstra over cells, start and goals; a goal is no thoroughfare."""
    factor = fine.shape[0] // occupied.shape[0]
    edges = [(a, b, cost * h) for a, b, cost in grid_edges(occupied, corner_cutting=False)]
    cells, source = occupied.size, occupied.size
    home = np.floor(start / h).astype(int)
    for cell in np.ndindex(*occupied.shape):
        centre = (np.array(cell) + 0.5) * h
        if occupied[cell]:
            continue
        if np.abs(np.array(cell) - home).max() <= 1 and sees(fine, start, centre, h / factor):
            edges.append((source, number(cell, occupied.shape), np.linalg.norm(centre - start)))
        for k, goal in enumerate(goals):
            near = np.abs(np.array(cell) - np.floor(goal / h)).max() <= 1
            if near and sees(fine, centre, goal, h / factor):
                edges.append((number(cell, occupied.shape), cells + 1 + k, np.linalg.norm(centre - goal)))
    for k, goal in enumerate(goals):
        if np.abs(np.floor(goal / h) - home).max() <= 1 and sees(fine, start, goal, h / factor):
            edges.append((source, cells + 1 + k, np.linalg.norm(goal - start)))
    return shortest(edges, cells + 1 + len(goals), source)[cells + 1 :]


def free_points(rng: np.random.Generator, occupied: np.ndarray, count: int, h: float) -> np.ndarray:
    cells = np.argwhere(~occupied)
    return (cells[rng.integers(len(cells), size=count)] + rng.uniform(0.02, 0.98, (count, 3))) * h


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("factor", [1, 2])
def test_costs_equal_dijkstra_on_random_maps(seed: int, factor: int) -> None:
    rng = np.random.default_rng(seed)
    fine = rng.random((8 * factor, 7 * factor, 4 * factor)) < (0.3 if factor == 1 else 0.06)
    occupied = fine.reshape(8, factor, 7, factor, 4, factor).any(axis=(1, 3, 5))
    start, goals = free_points(rng, fine, 1, 1.0 / factor)[0], free_points(rng, fine, 12, 1.0 / factor)
    found = astar.search(make_graph(occupied, fine), start, goals, np.ones(12, bool), 10_000)
    assert_close(found.cost, oracle_costs(occupied, fine, 1.0, start, goals), "formula")
    np.testing.assert_array_equal(found.entry == NO_ENTRY, ~np.isfinite(found.cost))


@pytest.mark.parametrize("seed", range(4))
def test_costs_equal_dijkstra_where_most_cells_have_free_surroundings(seed: int) -> None:
    """Where a cell offers itself to few neighbours only; also with any share of the cells settled."""
    rng = np.random.default_rng(seed)
    occupied = rng.random((13, 12, 9)) < 0.01
    graph = make_graph(occupied)
    assert (graph.moves == 2**26 - 1).mean() > 0.3
    start, goals = free_points(rng, occupied, 1, 1.0)[0], free_points(rng, occupied, 30, 1.0)
    expected = oracle_costs(occupied, occupied, 1.0, start, goals)
    for budget in (10_000, 600, 200):
        found = astar.search(graph, start, goals, np.ones(30, bool), budget)
        reached = found.entry != NO_ENTRY
        assert_close(found.cost[reached], expected[reached], "formula")
        assert budget < 10_000 or reached.all()


def test_onward_steps_are_the_natural_neighbours() -> None:
    """1 after a straight step, 3 after a diagonal one, 7 after a space diagonal, all at the start; always ahead."""
    steps, counts = onward_steps()
    np.testing.assert_array_equal(counts, [*(np.array([0, 1, 3, 7])[np.abs(STEPS).sum(axis=1)]), 26])
    for d in range(26):
        kept = STEPS[steps[d, : counts[d]]]
        assert (np.abs(kept) <= np.abs(STEPS[d])).all()
        assert (kept * STEPS[d] >= 0).all()
    np.testing.assert_array_equal(steps[NO_STEP], range(26))


def test_arrays_over_all_cells_are_left_clean() -> None:
    """A search in a smaller room after one that was cut short in a larger one, and the arrays themselves."""
    rng = np.random.default_rng(5)
    rooms = [rng.random(shape) < 0.1 for shape in ((20, 20, 8), (6, 5, 4))]
    queries = [(make_graph(room), *free_points(rng, room, 2, 1.0)) for room in rooms]
    alone = astar.search(queries[1][0], queries[1][1], queries[1][2][None], np.ones(1, bool), 10_000)
    for graph, start, goal in (*queries, queries[1]):
        found = astar.search(graph, start, np.stack([goal, goal]), np.ones(2, bool), 25)
    assert (found.cost == alone.cost).all()
    np.testing.assert_array_equal(found.cells[: found.first[1]], alone.cells)
    space = workspace(1)
    assert space.cost.size >= 20 * 20 * 8
    assert not space.heap.place.any()
    assert not space.head.any()
    assert not space.nearby.any()


@pytest.mark.slow
def test_costs_equal_dijkstra_on_a_thousand_maps() -> None:
    for seed in range(1000):
        rng = np.random.default_rng(seed)
        occupied = rng.random((5, 5, 3)) < rng.uniform(0.05, 0.4)
        if (~occupied).sum() < 3:
            continue
        start, goals = free_points(rng, occupied, 1, 1.0)[0], free_points(rng, occupied, 4, 1.0)
        found = astar.search(make_graph(occupied), start, goals, np.ones(4, bool), 10_000)
        expected = oracle_costs(occupied, occupied, 1.0, start, goals)
        np.testing.assert_allclose(found.cost, expected, **tolerance("formula"))


def read_maze(text: str) -> np.ndarray:
    data = re.sub(r"#.*", "", text).split("data: [")[1].split("]")[0]
    return (
        np.array([int(value) for value in data.split(",") if value.strip()], bool).reshape(5, 5, 5).transpose(2, 1, 0)
    )


def moves_from_edges(edges: list[tuple[int, int, float]], shape: tuple[int, ...]) -> np.ndarray:
    bits = {step: bit for bit, step in enumerate(map(tuple, STEPS.tolist()))}
    moves = np.zeros(np.prod(shape), np.uint32)
    for a, b, _ in edges:
        step = tuple(np.subtract(np.unravel_index(b, shape), np.unravel_index(a, shape)).tolist())
        moves[a] |= np.uint32(1) << np.uint32(bits[step])
    return moves


def test_published_maze(examples) -> None:  # type: ignore[no-untyped-def]
    """The published optimum cuts corners; the library's rule, which does not, finds the maze closed."""
    occupied = read_maze((examples / "maps" / "jps_simple3d.yaml").read_text())
    assert not occupied[0, 0, 0]
    assert not occupied[4, 4, 4]
    start, goals = np.full(3, 0.5), np.full((1, 3), 4.5)
    strict = make_graph(occupied)
    assert astar.search(strict, start, goals, np.ones(1, bool), 1000).entry[0] == NO_ENTRY
    cutting = strict._replace(
        moves=moves_from_edges(grid_edges(occupied, corner_cutting=True), occupied.shape),
        components=(~occupied).astype(np.int32).reshape(-1),
    )
    found = astar.search(cutting, start, goals, np.ones(1, bool), 1000)
    np.testing.assert_allclose(found.cost[0], 21.17084392, atol=5e-9)  # the published digits


@pytest.mark.parametrize("corner_cutting", [False, True])
def test_published_corridor(examples, corner_cutting: bool) -> None:  # type: ignore[no-untyped-def]
    """A plane lattice with 8 neighbours; the published length is optimal with and without cut corners."""
    text = (examples / "maps" / "jps_corridor.yaml").read_text()
    numbers = {
        name: np.array([float(value) for value in re.search(rf"- {name}: \[?([^\]\n]*)", text)[1].split(",")])
        for name in ("start", "goal", "origin", "dim", "resolution", "data")
    }
    nx, ny = numbers["dim"].astype(int)
    h = float(numbers["resolution"][0])
    occupied = (numbers["data"].reshape(ny, nx).T > 0)[:, :, None]
    graph = make_graph(occupied, h=h)
    if corner_cutting:
        graph = graph._replace(moves=moves_with_cut_corners(occupied))
    start, goal = (
        np.append((np.floor((numbers[name] - numbers["origin"]) / h) + 0.5) * h, 0.5 * h) for name in ("start", "goal")
    )
    found = astar.search(graph, start, goal[None], np.ones(1, bool), 1_000_000)
    np.testing.assert_allclose(found.cost[0], 35.109545, atol=5e-7)  # the published digits


def moves_with_cut_corners(occupied: np.ndarray) -> np.ndarray:
    """Every step between free cells."""
    free, moves = np.pad(~occupied, 1), np.zeros(occupied.shape, np.uint32)
    for bit, step in enumerate(STEPS.tolist()):
        both = free & np.roll(free, [-s for s in step], (0, 1, 2))
        moves |= both[1:-1, 1:-1, 1:-1].astype(np.uint32) << np.uint32(bit)
    return moves.reshape(-1)


def test_moves_are_the_oracle_edges() -> None:
    occupied = np.random.default_rng(3).random((6, 5, 4)) < 0.3
    expected = moves_from_edges(grid_edges(occupied, corner_cutting=False), occupied.shape)
    np.testing.assert_array_equal(permitted_moves(occupied), expected)
    assert len(ORACLE_STEPS) == len(STEPS) == 26


def test_duplicate_goals_cost_no_more_and_agree() -> None:
    rng = np.random.default_rng(0)
    occupied = rng.random((10, 10, 4)) < 0.15
    start, goal = free_points(rng, occupied, 2, 1.0)
    graph = make_graph(occupied)
    one = astar.search(graph, start, goal[None], np.ones(1, bool), 10_000)
    many = astar.search(graph, start, np.repeat(goal[None], 400, axis=0), np.ones(400, bool), 10_000)
    assert many.expanded == one.expanded
    assert (many.cost == one.cost[0]).all()
    assert (many.entry == one.entry[0]).all()


def test_budget_leaves_only_proven_paths() -> None:
    rng = np.random.default_rng(1)
    occupied = rng.random((12, 12, 4)) < 0.2
    start, goals = free_points(rng, occupied, 1, 1.0)[0], free_points(rng, occupied, 40, 1.0)
    graph = make_graph(occupied)
    full = astar.search(graph, start, goals, np.ones(40, bool), 10_000)
    short = astar.search(graph, start, goals, np.ones(40, bool), full.expanded // 2)
    reached = short.entry != NO_ENTRY
    assert short.expanded <= full.expanded // 2
    assert reached.sum() < (full.entry != NO_ENTRY).sum()
    assert_close(short.cost[reached], full.cost[reached], "exact")


def test_unreachable_goals_cost_no_search() -> None:
    occupied = np.zeros((20, 20, 5), bool)
    occupied[10] = True
    goals = np.array([[15.5, 5.5, 2.5], [18.2, 3.3, 1.1]])
    found = astar.search(make_graph(occupied), np.array([3.3, 3.3, 3.3]), goals, np.ones(2, bool), 10_000)
    assert found.expanded == 0
    assert (found.entry == NO_ENTRY).all()
