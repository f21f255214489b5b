"""Routes over the roadmap: near the shortest, clear of obstacles, complete, the same in threads, without compiling."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.precision import in_float64
from jaxplan.search import routes as routes_module
from jaxplan.search.kernels import follow, places, roads, sight, ways
from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices
from jaxplan.search.routes import find_routes, warmup
from jaxplan.status import Note, Reason
from jaxplan.world.load import ENVIRONMENTS, load_world
from jaxplan.world.obstacles import Capsules, Cylinders, Planes, Spheres, World, aligned_boxes, make_obstacles
from jaxplan.world.occupancy import exact_clearance
from oracles.search_rooms import free_points, room
from tolerances import relative, tolerance

UNLIMITED = SearchConfig(
    method="multi-resolution", resolutions=(0.1,), distance_fractions=(), first_budget=10**8, last_budget=10**8
)
"""The reference: the finest lattice, whatever it costs."""


@pytest.fixture(scope="module", params=ENVIRONMENTS)
def world(request: pytest.FixtureRequest) -> World:
    return load_world(request.param)


@pytest.fixture(scope="module")
def lattices(world: World) -> Lattices:
    return build_lattices(world)


def least_clearance(world: World, points: np.ndarray, count: int) -> float:
    """Along one path, every 5 mm or so."""
    legs = [np.linspace(a, b, 400) for a, b in itertools.pairwise(points[:count])]
    return float(exact_clearance(world.obstacles, np.concatenate(legs)).min())


@in_float64
def excess(world: World, lattices: Lattices, reference: Lattices, starts: int, goals: int, seed: int) -> np.ndarray:
    """By how much paths are longer than the reference, as a share of it, for pairs that do not see each other."""
    found = []
    for start in free_points(world, starts, seed):
        ends = free_points(world, goals, seed + 1)
        seed += 2
        ours = find_routes(lattices, world, start, ends, 1.0, capacity=64)
        best = find_routes(reference, world, start, ends, 1.0, capacity=64)
        reached = best.reasons == 0
        assert (ours.reasons[reached] == 0).all()
        bent = reached & (best.length > np.linalg.norm(ends - start, axis=1) + 1e-9)
        found.append(ours.length[bent] / best.length[bent] - 1.0)
    return np.concatenate(found)


def test_paths_are_hardly_longer_than_the_shortest_known(world: World, lattices: Lattices) -> None:
    share = excess(world, lattices, build_lattices(world, UNLIMITED), starts=3, goals=60, seed=0)
    assert len(share) > 60
    assert share.mean() <= 0.03
    assert np.quantile(share, 0.99) <= 0.10


@pytest.mark.slow
def test_paths_are_hardly_longer_than_the_shortest_known_for_thousands_of_pairs(
    world: World, lattices: Lattices
) -> None:
    share = excess(world, lattices, build_lattices(world, UNLIMITED), starts=15, goals=200, seed=100)
    assert len(share) > 2000
    assert share.mean() <= 0.03
    assert np.quantile(share, 0.99) <= 0.10


def test_paths_keep_the_padding_to_a_millimetre(world: World, lattices: Lattices) -> None:
    for seed, start in enumerate(free_points(world, 3, seed=50)):
        goals = free_points(world, 60, seed=60 + seed)
        routes = find_routes(lattices, world, start, goals, 5.0)
        assert (routes.reasons == 0).all()
        for points, count, goal, length in zip(routes.points, routes.count, goals, routes.length, strict=True):
            np.testing.assert_array_equal(points[0], start)
            assert (points[count - 1 :] == goal).all()
            assert length == pytest.approx(np.linalg.norm(np.diff(points, axis=0), axis=1).sum(), **relative("exact"))
            assert least_clearance(world, points, count) >= 0.5 - 1e-3
        bent = np.flatnonzero(routes.count > 2)
        touched = [least_clearance(world, routes.points[row], int(routes.count[row])) for row in bent]
        assert np.median(touched) < 0.51


def test_a_bend_touches_the_padding_at_the_height_that_it_has_on_the_way() -> None:
    """Around an upright edge: the shortest path has its corner at the height that the unrolled line has there."""
    world = room([[4.0, 0.0, 0.0], [6.0, 5.0, 2.0]])
    start, goal = np.array([3.0, 3.0, 0.3]), np.array([[7.0, 3.0, 1.7]])
    routes = find_routes(build_lattices(world), world, start, goal, 5.0)
    away = math.hypot(1.0, 2.0)  # from start and goal to the edges
    turn = math.atan2(2.0, 1.0) + math.asin(0.5 / away)
    level = 2.0 * math.sqrt(away**2 - 0.5**2) + 2.0 * 0.5 * turn + 2.0
    shortest = math.hypot(level, 1.4)
    assert shortest * 0.999 <= routes.length[0] <= shortest * 1.02
    assert least_clearance(world, routes.points[0], int(routes.count[0])) == pytest.approx(0.5, abs=1e-3)


def test_goals_in_sight_cost_no_search() -> None:
    world = room([[4.0, 4.0, 0.0], [4.5, 4.5, 2.0]])
    goals = np.array([[9.0, 1.0, 1.0], [1.0, 9.0, 0.5]])
    routes = find_routes(build_lattices(world), world, np.array([1.0, 1.0, 1.0]), goals, 9.0)
    assert routes.expanded == 0
    np.testing.assert_array_equal(routes.count, [2, 2])
    np.testing.assert_array_equal(routes.notes, [0, 0])


def test_goals_behind_a_closed_wall_have_no_path_and_cost_nothing() -> None:
    world = room([[4.9, 0.0, 0.0], [5.1, 10.0, 2.0]])
    routes = find_routes(build_lattices(world), world, np.array([2.5, 2.5, 1.0]), np.array([[8.0, 5.0, 1.0]]), 2.0)
    assert routes.reasons[0] == Reason.NO_PATH
    assert routes.expanded == 0
    assert np.isnan(routes.resolution[0])
    assert np.isinf(routes.length[0])


@pytest.mark.parametrize("width", [1.02, 1.1, 1.2, 1.5])
def test_narrow_passages_are_found(width: float) -> None:
    """Through a gap in a wall as wide as twice the padding and a little more."""
    world = room([[4.9, 0.0, 0.0], [5.1, 5.0 - width / 2, 2.0]], [[4.9, 5.0 + width / 2, 0.0], [5.1, 10.0, 2.0]])
    start, goal = np.array([2.5, 1.5, 1.0]), np.array([[8.0, 8.0, 1.0]])
    routes = find_routes(build_lattices(world), world, start, goal, 9.0)
    assert routes.reasons[0] == 0
    assert routes.notes[0] == 0
    assert least_clearance(world, routes.points[0], int(routes.count[0])) >= 0.5 - 1e-3


def test_a_narrower_passage_is_a_second_choice_that_says_so() -> None:
    world = room([[4.9, 0.0, 0.0], [5.1, 4.6, 2.0]], [[4.9, 5.4, 0.0], [5.1, 10.0, 2.0]])
    start, goals = np.array([2.5, 1.5, 1.0]), np.array([[8.0, 8.0, 1.0], [2.0, 8.0, 1.0]])
    closed = find_routes(build_lattices(world), world, start, goals, 9.0)
    np.testing.assert_array_equal(closed.reasons, [Reason.NO_PATH, 0])
    opened = find_routes(build_lattices(world, SearchConfig(least_padding=0.3)), world, start, goals, 9.0)
    np.testing.assert_array_equal(opened.reasons, [0, 0])
    np.testing.assert_array_equal(opened.notes, [Note.LESS_PADDING, 0])
    assert 0.3 - 1e-3 <= least_clearance(world, opened.points[0], int(opened.count[0])) < 0.5
    np.testing.assert_array_equal(opened.points[1], closed.points[1])


@pytest.mark.parametrize("change", [{"method": "magic"}, {"least_padding": -0.1}, {"least_padding": 0.6}])
def test_unusable_configurations_are_refused(change: dict) -> None:
    with pytest.raises(InputError, match=next(iter(change))):
        SearchConfig(**change)


def test_a_search_that_ends_by_its_budget_says_so_and_gives_what_it_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if no road led anywhere. Paths that are given are clear, at whatever budget, and reach what others reach."""
    monkeypatch.setattr(routes_module, "_follow_roads", lambda *arguments: 0)
    world, start = room([[4.5, 3.0, 0.0], [5.5, 7.0, 2.0]]), np.array([1.5, 5.0, 1.0])
    goals = free_points(world, 40, seed=1)
    whole = find_routes(build_lattices(world), world, start, goals, 5.0)
    assert (whole.reasons == 0).all()
    reached = []
    for budget in (20_000, 3_000, 1):
        found = find_routes(build_lattices(world, SearchConfig(fallback_budget=budget)), world, start, goals, 5.0)
        there, short = found.reasons == 0, found.reasons == Reason.PREFIX_ONLY
        assert (there | short).all()
        assert (found.notes[short] & Note.SEARCH_ENDED != 0).all()
        assert found.expanded <= budget
        proven = there & (found.notes & Note.SEARCH_ENDED == 0)
        np.testing.assert_allclose(found.length[proven], whole.length[proven], **tolerance("formula"))
        ends = found.points[np.arange(40), found.count - 1]
        np.testing.assert_array_equal(ends[there], goals[there])
        gained = np.linalg.norm(start - goals, axis=1) - np.linalg.norm(ends - goals, axis=1)
        assert (gained[short] > -0.2).all(), "no farther from the goal than the start"
        for row in range(40):
            assert least_clearance(world, found.points[row], int(found.count[row])) >= 0.4
        reached.append(int(there.sum()))
    assert reached[0] > reached[1] > reached[2] == 0


def test_goals_in_a_pocket_of_their_own_are_given_up_early() -> None:
    """A slit that the padding closes joins two halves: cells cannot tell, and no place is tried again and again."""
    slit = room([[4.9, 0.0, 0.0], [5.1, 4.51, 2.0]], [[4.9, 5.49, 0.0], [5.1, 10.0, 2.0]])
    half = room([[4.9, 0.0, 0.0], [5.1, 10.0, 2.0]])
    goals = free_points(slit, 200, seed=3)
    beyond = goals[:, 0] > 5.1
    start = np.array([2.5, 1.5, 1.0])
    for world in (slit, half):
        found = find_routes(build_lattices(world), world, start, goals, 9.0)
        assert (found.reasons[beyond] == Reason.NO_PATH).all()
        assert (found.reasons[~beyond] == 0).all()


def random_room(seed: int, count: int) -> World:
    """``count`` boxes, pillars, spheres and capsules each, at any angle."""
    rng = np.random.default_rng(seed)
    axes = rng.standard_normal((count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    upright = np.tile([[0.0, 0.0, 1.0]], (count, 1))

    def places() -> np.ndarray:
        return rng.uniform([0.0, 0.0, 0.0], [14.0, 10.0, 3.0], (count, 3))

    radius, half = rng.uniform(0.1, 0.4, count), rng.uniform(0.2, 1.0, count)
    obstacles = make_obstacles(
        cylinders=Cylinders(
            center=places() * [1, 1, 0] + [0, 0, 1.5], axis=upright, radius=radius, half_length=half * 3
        ),
        capsules=Capsules(center=places(), axis=axes, radius=radius / 2, half_length=half),
        spheres=Spheres(center=places(), radius=radius),
        boxes=aligned_boxes(low := places(), low + rng.uniform(0.1, 1.5, (count, 3))),
        planes=Planes(normal=np.array([[0.0, 0.0, 1.0]]), offset=np.array([-0.2])),
    )
    bounds = np.array([[0.0, 0.0, 0.0], [14.0, 10.0, 3.0]])
    return World(name="random", bounds=bounds, obstacles=obstacles, keep_in=0.2)


@pytest.mark.parametrize("seed", range(4))
def test_every_goal_in_the_starts_part_of_a_random_room_is_reached(seed: int) -> None:
    """The finest lattice tells what is connected."""
    world = random_room(seed, 12 + 6 * seed)
    lattices, reference = build_lattices(world), build_lattices(world, UNLIMITED)
    for start in free_points(world, 4, seed=seed):
        goals = free_points(world, 100, seed=seed + 10)
        ours, best = (find_routes(one, world, start, goals, 1.0, capacity=64) for one in (lattices, reference))
        assert (ours.reasons[best.reasons == 0] == 0).all()
        for row in np.flatnonzero((ours.reasons == 0) & (ours.notes == 0))[:40]:
            assert least_clearance(world, ours.points[row], int(ours.count[row])) >= 0.5 - 1e-3


@pytest.mark.slow
def test_no_reachable_goal_is_missed(examples: Path) -> None:
    """More than 20,000 goals in the stored rooms, in maps of others and in random rooms of 5 to 35 % clutter."""
    maps = [
        examples / "maps" / name for name in ("rotorpy_grid_forest.json", "rotorpy_double_pillar.json", "kr_skir.stl")
    ]
    worlds = [*(load_world(name) for name in (*ENVIRONMENTS, *maps)), *(random_room(k, 6 + 2 * k) for k in range(20))]
    clutter, reachable, missed = [], 0, 0
    for world in worlds:
        lattices = build_lattices(world)
        grid, labels = lattices.levels[0].grid, lattices.levels[0].components
        clutter.append(float(grid.near_obstacle.mean()))
        free = np.argwhere(~grid.occupied)
        rng = np.random.default_rng(5)
        for _ in range(5):
            cells = free[rng.integers(len(free), size=301)]
            parts = labels[np.ravel_multi_index(tuple(cells.T), grid.shape)]
            points = grid.origin + (cells + 0.5) * grid.resolution
            found = find_routes(lattices, world, points[0], points[1:], 1.0, capacity=64)
            same = parts[1:] == parts[0]
            reachable += int(same.sum())
            missed += int((found.count[same] == 0).sum())
    assert reachable > 20_000
    assert missed == 0
    assert min(clutter) < 0.1
    assert max(clutter) > 0.3


@pytest.mark.parametrize("depth", [0.05, 0.1, 0.25, 0.45])
def test_a_padded_start_leaves_on_its_own_side_and_comes_no_closer(depth: float) -> None:
    world = room([[5.0, 0.0, 0.0], [5.02, 10.0, 2.0]])
    start = np.array([5.0 - depth, 5.0, 1.0])
    routes = find_routes(build_lattices(world), world, start, np.array([[2.0, 5.0, 1.0], [8.0, 5.0, 1.0]]), 5.0)
    np.testing.assert_array_equal(routes.reasons, [0, Reason.NO_PATH])
    assert (routes.notes & Note.START_PADDED).all()
    np.testing.assert_array_equal(routes.points[0, 0], start)
    assert least_clearance(world, routes.points[0], int(routes.count[0])) >= depth - 1e-3
    assert routes.count[0] == 2 + (depth < 0.2)  # from very close the way out comes first


def test_nothing_compiles_after_warm_up(world: World, lattices: Lattices, compilations) -> None:  # type: ignore[no-untyped-def]
    """Padded and blocked starts and goals included."""
    for compiled in (follow._compiled_follow, sight._compiled_clear, sight._compiled_clearances):
        compiled.cache_clear()
    warmup(lattices, world)
    entries = [follow._compiled_follow(), sight._compiled_clear(), sight._compiled_clearances()]
    signatures = [len(entry.signatures) for entry in entries]
    assert signatures == [1, 1, 1]
    compilations.count = 0
    goals = np.concatenate([free_points(world, 5, 0), np.random.default_rng(0).uniform(-5, 5, (395, 3))])
    for start in (world.start, world.start * [1.0, 1.0, 0.0], np.zeros(3)):
        find_routes(lattices, world, start, goals, 3.0)
        find_routes(lattices, world, start, goals[::2], 3.0)
    assert compilations.count == 0
    assert [len(entry.signatures) for entry in entries] == signatures


def test_neighbouring_places_see_each_other() -> None:
    """Around a pillar every place has two others in sight, one to each side."""
    axis, bounds = np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 0.0], [10.0, 10.0, 2.0]])
    centre, one = np.array([[5.0, 5.0, 1.0]]), np.ones(1)
    pillar = make_obstacles(cylinders=Cylinders(center=centre, axis=axis, radius=0.3 * one, half_length=one))
    world = World(name="pillar", bounds=bounds, obstacles=pillar, keep_in=0.2)
    roadmap = build_lattices(world).roadmap
    assert roadmap is not None
    points, normals, first, ends, _ = roadmap.levels[0].roads
    assert len(points) > 20
    np.testing.assert_allclose(np.hypot(*(points[:, :2] - 5.0).T), 0.8 + places.OFF * 0.5, atol=1e-3)
    angle = np.arctan2(*(points[:, :2] - 5.0).T)
    for u in range(len(points)):
        turn = (angle[ends[first[u] : first[u + 1]]] - angle[u] + np.pi) % (2 * np.pi) - np.pi
        assert turn.min() < -0.1
        assert turn.max() > 0.1
    assert roads.TANGENT < 1.0
    assert np.abs(np.linalg.norm(normals, axis=1) - 1.0).max() < 1e-6


def test_ways_keep_as_far_from_the_faces_of_a_room_as_asked() -> None:
    """A wall with a gap of 0.6 m beside one face and of 1.2 m beside the other, which is the longer way."""
    obstacles = make_obstacles(boxes=aligned_boxes(np.array([[4.0, 0.6, 0.0]]), np.array([[6.0, 8.8, 2.0]])))
    bounds = np.array([[0.0, 0.0, 0.0], [10.0, 10.0, 2.0]])
    world = World(name="gaps", bounds=bounds, obstacles=obstacles, keep_in=np.float64(0.2))
    start, goal = np.array([2.0, 3.0, 1.0]), np.array([[8.0, 3.0, 1.0]])
    ways = {}
    for distance in (0.0, 0.1, 0.4, 1.0):
        options = SearchConfig(resolutions=(0.1,), distance_fractions=(), padding=0.3, from_faces=distance)
        ways[distance] = find_routes(build_lattices(world, options), world, start, goal, 6.0)
        assert ways[distance].reasons[0] == 0
    np.testing.assert_array_equal(ways[0.0].points, ways[0.1].points)
    assert ways[0.0].points[0, :, 1].min() < 0.4
    assert ways[0.4].points[0, :, 1].max() > 9.0
    apart = np.minimum(ways[0.4].points[0] - bounds[0], bounds[1] - ways[0.4].points[0]).min()
    assert apart >= 0.4 - 1e-6
    np.testing.assert_array_equal(ways[1.0].points, ways[0.0].points, err_msg="2 m are too low for 1 m on both sides")


def test_goals_shared_by_two_cores_have_paths_as_without(monkeypatch: pytest.MonkeyPatch) -> None:
    """But for goals that shared an order of places with one in the other half: up to 1 % (``ways.GAIN``)."""
    world = load_world("env3")
    lattices, goals = build_lattices(world), free_points(world, 160, 11)
    start = free_points(world, 1, 12)[0]
    shared = find_routes(lattices, world, start, goals, 1.0)
    monkeypatch.setattr(follow, "SHARED", len(goals) + 1)
    whole = find_routes(lattices, world, start, goals, 1.0)
    np.testing.assert_array_equal(shared.reasons, whole.reasons)
    assert (whole.count > 2).sum() >= 40
    assert np.abs(shared.length / whole.length - 1.0).max() <= 1.0 - ways.GAIN
    assert (shared.length == whole.length).mean() > 0.8
