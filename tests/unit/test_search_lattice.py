"""Lattice choice, paths, and everything that can be wrong with a start or a goal."""

import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.records import replace
from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices, choose_level
from jaxplan.search.multi_resolution import find_paths
from jaxplan.status import Note, Reason
from jaxplan.world.clearance import clearance
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World, aligned_boxes, make_obstacles
from tolerances import tolerance

LEVEL_DISTANCES = [0.0, 2.5, 5.0, 9.0]
"""m; in a room of 14.3 m diagonal these select the four lattices, finest first."""


def room(*corners: list[list[float]], bounds: list[list[float]] | None = None) -> World:
    """A room with axis-aligned boxes."""
    lower, upper = np.array([c[0] for c in corners]), np.array([c[1] for c in corners])
    bounds = [[0.0, 0.0, 0.0], [10.0, 10.0, 2.0]] if bounds is None else bounds
    obstacles = make_obstacles(boxes=aligned_boxes(lower, upper))
    return World(name="room", bounds=np.array(bounds), obstacles=obstacles, keep_in=np.float64(0.2))


@pytest.fixture(scope="module")
def env1() -> World:
    return load_world("env1")


@pytest.fixture(scope="module")
def lattices(env1: World) -> Lattices:
    return build_lattices(env1)


def free_goals(env1: World, lattices: Lattices, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    grid = lattices.levels[0].grid
    cells = np.argwhere(~grid.occupied)
    return grid.origin + (cells[rng.integers(len(cells), size=count)] + rng.uniform(0.0, 1.0, (count, 3))) * 0.1


def test_level_follows_the_paper(env1: World, lattices: Lattices) -> None:
    diagonal = env1.diagonal
    fractions = [0.0, 0.1, 0.1001, 0.2, 0.2001, 0.4, 0.4001, 1.0, np.nan]
    levels = [choose_level(lattices, fraction * diagonal, diagonal) for fraction in fractions]
    assert levels == [0, 0, 1, 1, 2, 2, 3, 3, 3]


@pytest.mark.parametrize("distance", LEVEL_DISTANCES)
def test_paths_are_what_they_claim(env1: World, lattices: Lattices, distance: float) -> None:
    goals = free_goals(env1, lattices, 60, seed=int(distance))
    paths = find_paths(lattices, env1, env1.start, goals, distance)
    assert (paths.reasons == 0).all()
    for row, count, goal, length in zip(paths.points, paths.count, goals, paths.length, strict=True):
        np.testing.assert_array_equal(row[0], env1.start)
        assert (row[count - 1 :] == goal).all()
        np.testing.assert_allclose(np.linalg.norm(np.diff(row, axis=0), axis=1).sum(), length, **tolerance("exact"))


@pytest.mark.parametrize("distance", LEVEL_DISTANCES)
def test_segments_stay_out_of_padded_cells(env1: World, lattices: Lattices, distance: float) -> None:
    """All along: no finest cell that is too close to an obstacle, hence the clearance that occupancy promises."""
    goals = free_goals(env1, lattices, 40, seed=7)
    paths = find_paths(lattices, env1, env1.start, goals, distance)
    finest = lattices.levels[0].grid
    fractions = np.linspace(0.0, 1.0, 60)[:, None, None, None]
    samples = (paths.points[None, :, :-1] * (1.0 - fractions) + paths.points[None, :, 1:] * fractions).reshape(-1, 3)
    cells = (samples - finest.origin) / finest.resolution
    within = (np.abs(cells - np.round(cells)) > 1e-6).all(axis=1)  # faces between cells belong to both
    assert not finest.near_obstacle[tuple(np.floor(cells[within]).astype(int).T)].any()
    assert np.asarray(clearance(env1, samples)).min() > 0.5 - np.sqrt(3.0) * 0.05 - 1e-6


def test_coarse_failure_falls_back_to_a_finer_lattice() -> None:
    """A passage of 1.4 m leaves 0.4 m after padding: open at 0.1 and 0.2 m, closed at 1 m."""
    world = room([[4.9, 0.0, 0.0], [5.1, 4.4, 2.0]], [[4.9, 5.8, 0.0], [5.1, 10.0, 2.0]])
    lattices = build_lattices(world)
    goals = np.array([[8.0, 5.0, 1.0], [2.5, 6.5, 1.0]])
    paths = find_paths(lattices, world, np.array([2.5, 2.5, 1.0]), goals, 9.0)
    assert (paths.reasons == 0).all()
    assert paths.resolution[0] < 1.0
    assert paths.resolution[1] == 1.0
    np.testing.assert_array_equal(paths.notes, [Note.FINER_LATTICE, 0])


def test_closed_room_is_no_path_whatever_the_lattice() -> None:
    world = room([[4.9, 0.0, 0.0], [5.1, 10.0, 2.0]])
    paths = find_paths(build_lattices(world), world, np.array([2.5, 2.5, 1.0]), np.array([[8.0, 5.0, 1.0]]), 9.0)
    assert paths.reasons[0] == Reason.NO_PATH
    assert paths.count[0] == 0
    assert np.isinf(paths.length[0])
    assert np.isnan(paths.resolution[0])


def test_bad_goals_are_masked_and_disturb_nobody(env1: World, lattices: Lattices) -> None:
    good = free_goals(env1, lattices, 5, seed=1)
    specials = [np.nan, np.inf, -np.inf, 2.0**31, -1e300, 5.1, 1e30]
    bad = np.array([[value, 0.0, 1.0] for value in specials] + [[0.0, 0.0, value] for value in specials])
    pillar, padded = np.array([[1.0, 0.0, 1.0]]), np.array([[1.0, 0.8, 1.0]])
    goals = np.concatenate([good[:2], bad, pillar, padded, good[2:]])
    paths = find_paths(lattices, env1, env1.start, goals, 5.0)
    alone = find_paths(lattices, env1, env1.start, good, 5.0)
    usable = paths.reasons == 0
    np.testing.assert_array_equal(usable, [True] * 2 + [False] * (len(bad) + 2) + [True] * 3)
    assert (paths.reasons[~usable] == Reason.NO_PATH).all()
    np.testing.assert_allclose(paths.length[usable], alone.length, **tolerance("exact"))
    assert np.isfinite(paths.points).all()


def test_goal_in_a_rounded_cell_is_reached() -> None:
    """0.52 m from a wall whose face lies so that the cell's centre is only 0.48 m away."""
    world = room([[5.0, 0.0, 0.0], [5.37, 10.0, 2.0]])
    lattices = build_lattices(world)
    goal = np.array([[5.89, 5.02, 1.02]])
    grid = lattices.levels[0].grid
    assert grid.occupied[tuple(np.floor(goal[0] / 0.1).astype(int))]
    for distance in LEVEL_DISTANCES:
        paths = find_paths(lattices, world, np.array([8.0, 5.0, 1.0]), goal, distance)
        assert paths.reasons[0] == 0
        np.testing.assert_array_equal(paths.points[0, -1], goal[0])


@pytest.mark.parametrize("depth", [0.05, 0.2, 0.45])
def test_padded_start_escapes_on_its_own_side_of_a_thin_wall(depth: float) -> None:
    """I3: the wall is 2 cm thick and closed, so a goal on the start's side is reached and the other is not."""
    world = room([[5.0, 0.0, 0.0], [5.02, 10.0, 2.0]])
    lattices = build_lattices(world)
    start, goals = np.array([5.0 - depth, 5.0, 1.0]), np.array([[2.0, 5.0, 1.0], [8.0, 5.0, 1.0]])
    paths = find_paths(lattices, world, start, goals, 5.0)
    np.testing.assert_array_equal(paths.reasons, [0, Reason.NO_PATH])
    assert (paths.notes & Note.START_PADDED).all()
    assert (paths.points[0, :, 0] < 5.0).all()
    np.testing.assert_array_equal(paths.points[0, 0], start)


def test_hopeless_starts_have_no_path() -> None:
    """I4: inside an obstacle, not finite, or far outside the room."""
    world = room([[4.0, 4.0, 0.0], [6.0, 6.0, 2.0]])
    lattices = build_lattices(world)
    goals = np.array([[2.0, 2.0, 1.0]])
    for start in ([5.0, 5.0, 1.0], [np.nan, 1.0, 1.0], [np.inf, 1.0, 1.0], [-50.0, 1.0, 1.0]):
        paths = find_paths(lattices, world, np.array(start), goals, 5.0)
        assert paths.reasons[0] == Reason.NO_PATH


def test_start_on_the_floor_escapes(env1: World, lattices: Lattices) -> None:
    start = np.array([-4.3, -4.3, 0.0])
    paths = find_paths(lattices, env1, start, free_goals(env1, lattices, 5, seed=2), 5.0)
    assert (paths.reasons == 0).all()
    assert (paths.notes & Note.START_PADDED).all()


def test_start_equal_to_goal_is_a_path_of_two_points(env1: World, lattices: Lattices) -> None:
    paths = find_paths(lattices, env1, env1.start, env1.start[None], 0.0)
    assert paths.count[0] == 2
    assert paths.length[0] == 0.0


def test_no_goals(env1: World, lattices: Lattices) -> None:
    paths = find_paths(lattices, env1, env1.start, np.zeros((0, 3)), 1.0)
    assert paths.points.shape[0] == 0


def test_long_paths_give_their_prefix(env1: World, lattices: Lattices) -> None:
    goals = np.array([[4.3, 4.3, 1.0]])
    whole = find_paths(lattices, env1, env1.start, goals, 0.0)
    short = find_paths(lattices, env1, env1.start, goals, 0.0, capacity=20)
    assert whole.count[0] > 20
    assert short.count[0] == 20
    assert short.reasons[0] == Reason.PREFIX_ONLY
    assert short.length[0] == whole.length[0]
    np.testing.assert_array_equal(short.points[0], whole.points[0, :20])


def test_order_of_goals_does_not_matter(env1: World, lattices: Lattices) -> None:
    goals = free_goals(env1, lattices, 30, seed=5)
    forward = find_paths(lattices, env1, env1.start, goals, 5.0)
    backward = find_paths(lattices, env1, env1.start, goals[::-1], 5.0)
    np.testing.assert_allclose(forward.length, backward.length[::-1], **tolerance("exact"))


@pytest.mark.parametrize("seed", range(4))
def test_an_obstacle_more_never_shortens_a_path(seed: int) -> None:
    rng = np.random.default_rng(seed)
    center = rng.uniform([1.0, 1.0, 0.0], [9.0, 9.0, 2.0], (6, 3))
    half = rng.uniform(0.1, 0.5, (6, 3))
    boxes = aligned_boxes(center - half, center + half)
    fewer = aligned_boxes((center - half)[:5], (center + half)[:5])
    many = replace(room([[0, 0, 0], [1, 1, 1]]), obstacles=make_obstacles(boxes=boxes))
    few = replace(many, obstacles=make_obstacles(boxes=fewer))
    goals = rng.uniform([0.3, 0.3, 0.3], [9.7, 9.7, 1.7], (40, 3))
    start = np.array([0.31, 0.32, 1.0])
    config = SearchConfig(resolutions=(0.2,), distance_fractions=())
    before = find_paths(build_lattices(few, config), few, start, goals, 0.0)
    after = find_paths(build_lattices(many, config), many, start, goals, 0.0)
    same_start = (before.notes == after.notes).all()
    assert same_start
    assert (after.length >= before.length - 1e-9).all()


@pytest.mark.parametrize(
    "arguments",
    [
        {"distance_fractions": (0.1,)},
        {"distance_fractions": (0.4, 0.2, 0.1)},
        {"padding": -1.0},
        {"padding": float("nan")},
        {"node_budget": 0},
    ],
)
def test_bad_options_are_refused(arguments: dict) -> None:
    with pytest.raises(InputError, match=next(iter(arguments))):
        SearchConfig(**arguments)


def test_bad_shapes_are_refused(env1: World, lattices: Lattices) -> None:
    with pytest.raises(InputError, match="start"):
        find_paths(lattices, env1, np.zeros(2), np.zeros((1, 3)), 1.0)
    with pytest.raises(InputError, match="goals"):
        find_paths(lattices, env1, np.zeros(3), np.zeros((4, 2)), 1.0)
    with pytest.raises(InputError, match="capacity"):
        find_paths(lattices, env1, np.zeros(3), np.zeros((4, 3)), 1.0, capacity=2)
