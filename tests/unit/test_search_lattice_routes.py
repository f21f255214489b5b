"""Routes on lattices: straight where in sight, bounded in effort, correct under threads and without compiling."""

import itertools
import subprocess
import sys

import numpy as np
import pytest
from scipy import ndimage

from jaxplan.search.kernels import astar, taut
from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices
from jaxplan.search.multi_resolution import find_paths
from jaxplan.search.routes import find_routes, warmup
from jaxplan.status import Note, Reason
from jaxplan.world.clearance import clearance
from jaxplan.world.load import ENVIRONMENTS, load_world
from jaxplan.world.obstacles import World
from oracles.search_rooms import room
from oracles.search_sight import crossed_cells
from tolerances import tolerance

DISTANCES = [0.0, 2.5, 5.0, 9.0]
LATTICES = SearchConfig(method="multi-resolution")


@pytest.fixture(scope="module", params=ENVIRONMENTS)
def world(request: pytest.FixtureRequest) -> World:
    return load_world(request.param)


@pytest.fixture(scope="module")
def lattices(world: World) -> Lattices:
    return build_lattices(world, LATTICES)


def free_goals(lattices: Lattices, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    grid = lattices.levels[0].grid
    cells = np.argwhere(~grid.occupied)
    return grid.origin + (cells[rng.integers(len(cells), size=count)] + rng.uniform(0.05, 0.95, (count, 3))) * 0.1


@pytest.mark.parametrize("distance", DISTANCES)
def test_every_goal_is_reached_through_free_cells(world: World, lattices: Lattices, distance: float) -> None:
    goals = free_goals(lattices, 60, seed=int(distance))
    routes = find_routes(lattices, world, world.start, goals, distance)
    assert (routes.reasons == 0).all()
    grid = lattices.levels[0].grid
    for row, count, goal, length in zip(routes.points, routes.count, goals, routes.length, strict=True):
        np.testing.assert_array_equal(row[0], world.start)
        assert (row[count - 1 :] == goal).all()
        np.testing.assert_allclose(np.linalg.norm(np.diff(row, axis=0), axis=1).sum(), length, **tolerance("exact"))
        for a, b in itertools.pairwise(row[:count]):
            cells = crossed_cells(a, b, grid.origin, grid.resolution)
            assert not grid.occupied[tuple(cells[:-1].T)].any()
    samples = (
        routes.points[:, :-1, None] + np.linspace(0.0, 1.0, 30)[:, None] * np.diff(routes.points, axis=1)[:, :, None]
    )
    assert np.asarray(clearance(world, samples)).min() > 0.5 - np.sqrt(3.0) * 0.05 - 1e-5


@pytest.mark.parametrize("distance", DISTANCES)
def test_no_longer_than_the_optimal_lattice_path(lattices: Lattices, world: World, distance: float) -> None:
    """Where no budget ran out; nowhere much longer, and not shorter than the straight line."""
    goals = free_goals(lattices, 40, seed=20 + int(distance))
    routes = find_routes(lattices, world, world.start, goals, distance)
    paths = find_paths(lattices, world, world.start, goals, distance)
    same = routes.resolution <= np.maximum(paths.resolution, lattices.levels[0].grid.resolution)
    assert same.any()
    assert (routes.length[same] <= paths.length[same] + 1e-9).all()
    assert (routes.length >= np.linalg.norm(goals - world.start, axis=1) - 1e-9).all()
    assert np.median(routes.length / paths.length) < 1.03


def test_goals_in_sight_cost_no_search() -> None:
    world = room([[4.0, 4.0, 0.0], [4.5, 4.5, 2.0]])
    lattices = build_lattices(world, LATTICES)
    goals = np.array([[9.0, 1.0, 1.0], [1.0, 9.0, 0.5]])
    routes = find_routes(lattices, world, np.array([1.0, 1.0, 1.0]), goals, 9.0)
    assert routes.expanded == 0
    np.testing.assert_array_equal(routes.count, [2, 2])
    np.testing.assert_array_equal(routes.notes, [0, 0])


def test_a_small_first_budget_turns_to_coarser_lattices() -> None:
    world = room([[4.9, 0.0, 0.0], [5.1, 8.0, 2.0]])
    goals, start = np.array([[8.0, 1.0, 1.0]]), np.array([2.0, 1.0, 1.0])
    frugal = build_lattices(world, SearchConfig(method="multi-resolution", first_budget=300, last_budget=300))
    generous = build_lattices(world, SearchConfig(method="multi-resolution", first_budget=10**6))
    coarse = find_routes(frugal, world, start, goals, 0.0)
    fine = find_routes(generous, world, start, goals, 0.0)
    assert coarse.resolution[0] > fine.resolution[0] == 0.1
    assert coarse.expanded <= 4 * 300
    assert fine.length[0] <= coarse.length[0] < 1.2 * fine.length[0]


def test_passages_that_only_fine_lattices_have() -> None:
    world = room([[4.9, 0.0, 0.0], [5.1, 4.4, 2.0]], [[4.9, 5.8, 0.0], [5.1, 10.0, 2.0]])
    routes = find_routes(
        build_lattices(world, LATTICES), world, np.array([2.5, 1.5, 1.0]), np.array([[8.0, 8.0, 1.0]]), 9.0
    )
    assert routes.reasons[0] == 0
    assert routes.resolution[0] < 1.0
    assert routes.notes[0] == Note.FINER_LATTICE


def test_goals_behind_a_closed_wall_have_no_path_and_cost_nothing() -> None:
    world = room([[4.9, 0.0, 0.0], [5.1, 10.0, 2.0]])
    routes = find_routes(
        build_lattices(world, LATTICES), world, np.array([2.5, 2.5, 1.0]), np.array([[8.0, 5.0, 1.0]]), 2.0
    )
    assert routes.reasons[0] == Reason.NO_PATH
    assert routes.expanded == 0
    assert np.isnan(routes.resolution[0])
    assert np.isinf(routes.length[0])


def test_a_padded_start_escapes_first() -> None:
    world = room([[5.0, 0.0, 0.0], [5.02, 10.0, 2.0]])
    start = np.array([4.8, 5.0, 1.0])
    routes = find_routes(
        build_lattices(world, LATTICES), world, start, np.array([[2.0, 5.0, 1.0], [8.0, 5.0, 1.0]]), 5.0
    )
    np.testing.assert_array_equal(routes.reasons, [0, Reason.NO_PATH])
    assert (routes.notes & Note.START_PADDED).all()
    np.testing.assert_array_equal(routes.points[0, 0], start)
    assert routes.points[0, 1, 0] < 4.5
    steps = np.linalg.norm(np.diff(routes.points[0], axis=0), axis=1)
    assert routes.length[0] == pytest.approx(steps.sum())


def test_nothing_compiles_after_warm_up(world: World, lattices: Lattices, compilations) -> None:  # type: ignore[no-untyped-def]
    """Padded and blocked starts and goals included, for each world in turn, also where the room's middle is free."""
    for compiled in (astar._compiled_search, taut._compiled_taut):
        compiled.cache_clear()
    warmup(lattices, world)
    entries = [astar._compiled_search(), taut._compiled_taut()]
    signatures = [len(entry.signatures) for entry in entries]
    assert signatures == [1, 1]
    compilations.count = 0
    goals = np.concatenate([free_goals(lattices, 5, 0), np.random.default_rng(0).uniform(-5, 5, (395, 3))])
    for distance in (0.0, 3.0, 6.0, 20.0):
        for start in (world.start, world.start * [1.0, 1.0, 0.0], np.zeros(3)):
            find_routes(lattices, world, start, goals, distance)
            find_routes(lattices, world, start, goals[::2], distance)
    assert compilations.count == 0
    assert [len(entry.signatures) for entry in entries] == signatures


def test_a_million_bad_goals_are_never_reached() -> None:
    """Outside, on the border, not finite: none is treated as free (I5)."""
    world = load_world("env1")
    lattices = build_lattices(world, LATTICES)
    rng = np.random.default_rng(0)
    total = 0
    for _ in range(10):
        goals = rng.uniform(-4.0, 4.0, (100_000, 3)) * [1.0, 1.0, 0.2] + [0.0, 0.0, 1.0]
        rows = np.arange(len(goals))
        axis = rng.integers(3, size=len(goals))
        lower, upper = world.bounds[0, axis], world.bounds[1, axis]
        beyond = 10.0 ** rng.uniform(-12, 30, len(goals))
        choices = [
            lower,
            upper,
            lower - beyond,
            upper + beyond,
            np.full(len(goals), np.nan),
            beyond * np.inf,
            lower + 0.1,
        ]
        goals[rows, axis] = np.choose(rng.integers(len(choices), size=len(goals)), choices)
        routes = find_routes(lattices, world, world.start, goals, 5.0, capacity=3)
        total += int((routes.reasons == 0).sum())
    assert total == 0


@pytest.mark.slow
def test_a_changed_helper_is_compiled_anew_although_its_entry_point_is_cached(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """The same time stamps and sizes: numba alone would run the old code."""
    import os
    import shutil

    from jaxplan.search.kernels import compiled

    package = compiled.Path(compiled.__file__).parents[2]
    shutil.copytree(package, tmp_path / "jaxplan", ignore=shutil.ignore_patterns("__pycache__"))
    code = (
        "import numpy as np\nfrom jaxplan.search.kernels import astar, graph\n"
        "room, start, goals = graph.two_free_cells(), np.full(3, 0.5), np.array([[1.5, 0.5, 0.5]])\n"
        "print(astar.search(room, start, goals, np.ones(1, bool), 9).cost[0])"
    )

    def cost() -> float:
        run = [sys.executable, "-c", code]
        return float(subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, check=True).stdout)

    assert cost() == 1.0
    source = tmp_path / "jaxplan" / "search" / "kernels" / "cells.py"
    stamp = source.stat()
    text = source.read_text().replace("return math.sqrt((p[0]", "return 2*abs(((p[0]").replace("** 2)\n", "** 2))\n")
    source.write_text(text)
    os.utime(source, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert cost() == 2.0


def test_labels_agree_with_what_routes_reach(world: World, lattices: Lattices) -> None:
    """A goal in the start's component of the finest lattice is always reached, others never."""
    grid = lattices.levels[0].grid
    labels, _ = ndimage.label(~grid.occupied)
    goals = free_goals(lattices, 100, seed=9)
    routes = find_routes(lattices, world, world.start, goals, 3.0)
    at = tuple(np.floor((goals - grid.origin) / grid.resolution).astype(int).T)
    home = labels[tuple(np.floor((world.start - grid.origin) / grid.resolution).astype(int))]
    np.testing.assert_array_equal(routes.reasons == 0, labels[at] == home)
