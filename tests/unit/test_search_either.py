"""What both ways of searching promise, over a roadmap and over lattices of several resolutions."""

import concurrent.futures

import numpy as np
import pytest

from jaxplan.search.lattice import METHODS, Lattices, SearchConfig, build_lattices
from jaxplan.search.routes import find_routes
from jaxplan.status import Reason
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World
from oracles.search_rooms import free_points, room


@pytest.fixture(scope="module", params=METHODS)
def method(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def world() -> World:
    return load_world("env2")


@pytest.fixture(scope="module")
def lattices(world: World, method: str) -> Lattices:
    return build_lattices(world, SearchConfig(method=method))


def test_bad_goals_are_masked_and_disturb_nobody(world: World, lattices: Lattices) -> None:
    good = free_points(world, 8, seed=1)
    specials = [np.nan, np.inf, -np.inf, 2.0**31, -1e300, 15.1, 1e30]
    bad = np.array([[value, 0.0, 1.0] for value in specials] + [[0.0, 0.0, value] for value in specials])
    routes = find_routes(lattices, world, world.start, np.concatenate([bad, good]), 5.0)
    alone = find_routes(lattices, world, world.start, good, 5.0)
    assert (routes.reasons[: len(bad)] == Reason.NO_PATH).all()
    np.testing.assert_array_equal(routes.points[len(bad) :], alone.points)
    assert np.isfinite(routes.points).all()


@pytest.mark.parametrize("start", [[np.nan, 0.0, 1.0], [0.0, 0.0, 50.0]])
def test_hopeless_starts(world: World, lattices: Lattices, start: list[float]) -> None:
    routes = find_routes(lattices, world, np.array(start), free_points(world, 3, seed=0), 5.0)
    assert (routes.reasons == Reason.NO_PATH).all()


def test_more_corners_than_the_capacity_give_a_prefix(method: str) -> None:
    walls = [
        [[1.6 + 2.2 * i, 0.0 if i % 2 else 2.0, 0.0], [1.7 + 2.2 * i, 8.0 if i % 2 else 10.0, 2.0]] for i in range(4)
    ]
    world = room(*walls)
    lattices = build_lattices(world, SearchConfig(method=method))
    start, goal = np.array([0.8, 9.0, 1.0]), np.array([[9.2, 5.0, 1.0]])
    whole = find_routes(lattices, world, start, goal, 9.0)
    short = find_routes(lattices, world, start, goal, 9.0, capacity=3)
    assert whole.count[0] > 4
    assert short.count[0] == 3
    assert short.reasons[0] == Reason.PREFIX_ONLY
    assert short.length[0] == whole.length[0]
    np.testing.assert_array_equal(short.points[0], whole.points[0, :3])


def test_threads_agree_with_one_thread(world: World, lattices: Lattices) -> None:
    queries = [free_points(world, 50, seed) for seed in range(16)]

    def answer(goals: np.ndarray) -> np.ndarray:
        return find_routes(lattices, world, world.start, goals, 3.0).points

    alone = [answer(goals) for goals in queries]
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        together = list(pool.map(answer, queries))
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one, other)
