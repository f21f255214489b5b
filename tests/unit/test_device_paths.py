"""Shortest ways read off all-pairs distances: against the host's search, and against a graph solved by hand."""

import jax
import numpy as np
import pytest

from jaxplan.device.paths import SLACK, shortest_ways
from jaxplan.device.room import Room, alike, all_pairs, room_of
from jaxplan.device.stops import stop_points
from jaxplan.errors import InputError
from jaxplan.search.kernels.roads import Roads
from jaxplan.search.lattice import SearchConfig, build_lattices
from jaxplan.search.routes import find_routes
from jaxplan.search.stops import DISTANCES
from jaxplan.world.clearance import clearance, clearance_at_once
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World, make_obstacles
from jaxplan.world.voxels import distance_grid
from tolerances import assert_close

PADDING, FACES = 0.5, 0.28
ways_of = jax.jit(shortest_ways, static_argnames="at_once")


@pytest.fixture(scope="module")
def rooms() -> dict[str, Room]:
    return {name: room_of(load_world(name), PADDING, FACES) for name in ("env1", "env2")}


def free_points(world: World, count: int, seed: int = 0) -> np.ndarray:
    lower, upper = np.asarray(world.bounds) + np.array([[0.5], [-0.5]])
    points = np.random.default_rng(seed).uniform(lower, upper, (20 * count, 3))
    return points[np.asarray(host_free_distance(world, points)) > PADDING + 0.05][:count]


def test_all_pairs_of_a_square_with_a_diagonal() -> None:
    # 0 - 1 - 2 - 3 - 0 with sides 1, 1, 1, 5: from 0 to 3 the way over 1 and 2 is shorter than the road
    pairs = {(0, 1): 1.0, (1, 2): 1.0, (2, 3): 1.0, (0, 3): 5.0}
    both = sorted([(a, b, w) for (a, b), w in pairs.items()] + [(b, a, w) for (a, b), w in pairs.items()])
    first = np.searchsorted([a for a, _, _ in both], np.arange(6)).astype(np.int32)  # a fifth place without roads
    roads = Roads(
        points=np.zeros((5, 3)),
        normals=np.zeros((5, 3)),
        first=first,
        ends=np.array([b for _, b, _ in both], np.int32),
        lengths=np.array([w for _, _, w in both], np.float32),
    )
    lengths, onward = all_pairs(roads)
    assert lengths[0].tolist() == [0.0, 1.0, 2.0, 3.0, np.inf]
    assert [onward[0, 3], onward[1, 3], onward[2, 3]] == [1, 2, 3]
    assert (onward[:4, :4].diagonal() == np.arange(4)).all()


@pytest.mark.parametrize("name", ["env1", "env2"])
def test_ways_are_about_as_short_as_the_hosts(rooms: dict[str, Room], name: str) -> None:
    world = load_world(name)
    config = SearchConfig(resolutions=(0.1,), distance_fractions=(), padding=PADDING, from_faces=FACES)
    points = free_points(world, 101)
    start, goals = points[0], points[1:]
    found = ways_of(rooms[name], start, goals)
    host = find_routes(build_lattices(world, config), world, start, goals, 5.0, 32, 1)
    assert np.asarray(found.found).all()
    assert (host.reasons == 0).all()
    ratio = np.asarray(found.length) / host.length
    assert np.median(ratio) < 1.01
    assert np.quantile(ratio, 0.9) < 1.1
    assert ratio.max() < 1.6
    corners = np.asarray(found.points)
    np.testing.assert_allclose(corners[:, 0], np.broadcast_to(start, goals.shape), rtol=0.0, atol=1e-5)  # float32
    np.testing.assert_allclose(corners[:, -1], goals, rtol=0.0, atol=1e-5)  # float32
    assert_close(np.linalg.norm(np.diff(corners, axis=1), axis=2).sum(axis=1), found.length, "exact", np.float32)


def test_ways_keep_the_padding(rooms: dict[str, Room]) -> None:
    world = load_world("env2")
    points = free_points(world, 61, seed=1)
    corners = np.asarray(ways_of(rooms["env2"], points[0], points[1:]).points, dtype=float)
    shares = np.linspace(0.0, 1.0, 201)[:, None, None, None]
    along = corners[None, :, :-1] * (1.0 - shares) + corners[None, :, 1:] * shares
    free = host_free_distance(world, along.reshape(-1, 3))
    assert free.min() > FACES - 1e-3
    to_obstacles = np.asarray(clearance(world, along.reshape(-1, 3)))
    assert to_obstacles.min() > PADDING - SLACK - 0.1  # between the points that are looked at


def test_trying_several_places_at_a_time_finds_as_much(rooms: dict[str, Room]) -> None:
    points = free_points(load_world("env2"), 81, seed=2)
    one, eight = (ways_of(rooms["env2"], points[0], points[1:], at_once=n) for n in (1, 8))
    assert np.asarray(one.found).all()
    assert np.asarray(eight.found).all()
    np.testing.assert_allclose(eight.length, one.length, rtol=1e-5)  # float32


def test_a_goal_in_an_obstacle_is_not_found(rooms: dict[str, Room]) -> None:
    world = load_world("env1")
    inside = np.asarray(world.cylinders.center)[:1]
    assert not np.asarray(ways_of(rooms["env1"], free_points(world, 1)[0], inside).found).any()


def test_an_empty_room_has_straight_ways_only() -> None:
    world = World(name="empty", bounds=np.array([[0.0] * 3, [5.0, 5.0, 3.0]]), obstacles=make_obstacles(), keep_in=0.2)
    room = room_of(world, PADDING, FACES)
    found = ways_of(room, np.full(3, 1.0), np.array([[4.0, 4.0, 2.0], [1.0, 4.0, 1.5]]))
    assert np.asarray(found.found).all()
    np.testing.assert_allclose(found.length, [np.sqrt(19.0), np.sqrt(9.25)], rtol=1e-6)  # float32


@pytest.mark.slow
def test_rooms_made_alike_stay_what_they_are(rooms: dict[str, Room]) -> None:
    shared = dict(zip(rooms, alike(list(rooms.values())), strict=True))
    shapes = {name: [leaf.shape for leaf in jax.tree.leaves(room)] for name, room in shared.items()}
    assert shapes["env1"] == shapes["env2"]
    points = free_points(load_world("env1"), 41, seed=3)
    before, after = (ways_of(some["env1"], points[0], points[1:]) for some in (rooms, shared))
    assert_close(after.length, before.length, "exact", np.float32)
    where = np.random.default_rng(4).uniform(-6.0, 6.0, (500, 3)).astype(np.float32)
    assert_close(
        clearance_at_once(shared["env1"].world, where), clearance(load_world("env1"), where), "formula", np.float32
    )


def test_rooms_of_grids_are_not_made_alike(rooms: dict[str, Room]) -> None:
    occupied = np.zeros((20, 20, 10), bool)
    occupied[10, 10] = True
    cells = make_obstacles(voxels=distance_grid(occupied, np.zeros(3), 0.3))
    grid = World(name="cells", bounds=np.array([[0.0] * 3, [6.0, 6.0, 3.0]]), obstacles=cells, keep_in=0.2)
    with pytest.raises(InputError, match="meshes or cells"):
        alike([room_of(grid, PADDING, FACES), rooms["env2"]])


def test_stops_are_straight_on_where_there_is_room() -> None:
    world = World(name="empty", bounds=np.array([[0.0] * 3, [9.0, 9.0, 3.0]]), obstacles=make_obstacles(), keep_in=0.2)
    room = room_of(world, PADDING, FACES)
    ways = ways_of(room, np.array([1.0, 4.0, 1.5]), np.array([[4.0, 4.0, 1.5], [8.6, 4.0, 1.5]]))
    stops = np.asarray(stop_points(room, ways.points))
    np.testing.assert_allclose(stops[0], [4.0 + max(DISTANCES), 4.0, 1.5], atol=1e-5)  # float32
    assert stops[1][0] <= 9.0 - FACES + 1e-3  # before the wall it turns
    assert np.linalg.norm(stops[1] - ways.points[1, -1]) > 0.4
