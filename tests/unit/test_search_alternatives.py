"""Clearly different routes to one goal: where there are some, what they keep, what separates them."""

import itertools

import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.precision import in_float64
from jaxplan.search.kernels.alternatives import LONGEST
from jaxplan.search.lattice import Lattices, Paths, SearchConfig, build_lattices
from jaxplan.search.routes import find_routes
from jaxplan.status import Reason
from jaxplan.world.load import ENVIRONMENTS, load_world
from jaxplan.world.obstacles import World
from jaxplan.world.occupancy import exact_clearance
from oracles.search_rooms import free_points, room

START = np.array([1.5, 5.0, 1.0])
PILLAR = [[4.5, 4.0, 0.0], [5.5, 6.0, 2.0]]


def ways(paths: Paths, goal: int, goals: int) -> list[np.ndarray]:
    """The routes to one goal [m]."""
    rows = [row for row in range(goal, len(paths.count), goals) if paths.reasons[row] == 0]
    return [paths.points[row, : paths.count[row]] for row in rows]


def evenly(points: np.ndarray, count: int) -> np.ndarray:
    """Points at equal shares of the length of a path."""
    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, gone[-1], count)
    return np.stack([np.interp(at, gone, points[:, axis]) for axis in range(3)], axis=1)


@in_float64
def between(world: World, first: np.ndarray, second: np.ndarray) -> float:
    """How near the straight lines between two paths come to an obstacle [m]."""
    a, b = evenly(first, 201), evenly(second, 201)
    lines = a + np.linspace(0.0, 1.0, 60)[:, None, None] * (b - a)
    return float(exact_clearance(world.obstacles, lines.reshape(-1, 3)).min())


@in_float64
def least_clearance(world: World, points: np.ndarray) -> float:
    """Along one path [m]."""
    legs = [np.linspace(a, b, 200) for a, b in itertools.pairwise(points)]
    return float(exact_clearance(world.obstacles, np.concatenate(legs)).min())


def test_a_pillar_is_passed_on_either_side() -> None:
    goal = np.array([[8.5, 5.3, 1.0]])
    found = ways(find_routes(build_lattices(room(PILLAR)), room(PILLAR), START, goal, 5.0, alternatives=3), 0, 1)
    assert len(found) == 2
    beside = [np.interp(5.0, way[:, 0], way[:, 1]) for way in found]
    assert beside[0] > 6.0, "the shorter one is on the goal's side"
    assert beside[1] < 4.0


def test_two_pillars_are_passed_on_either_side_and_between() -> None:
    pair = room([[4.5, 3.0, 0.0], [5.5, 4.2, 2.0]], [[4.5, 5.8, 0.0], [5.5, 7.0, 2.0]])
    goal = np.array([[8.5, 4.5, 1.0]])
    found = ways(find_routes(build_lattices(pair), pair, np.array([1.5, 4.5, 1.0]), goal, 5.0, alternatives=3), 0, 1)
    beside = [np.interp(5.0, way[:, 0], way[:, 1]) for way in found]
    assert [np.digitize(y, [3.0, 4.2, 5.8, 7.0]) for y in beside] == [2, 0, 4]


def test_a_box_is_passed_above_too() -> None:
    low = room([[4.5, 3.0, 0.0], [5.5, 7.0, 1.0]])
    goal = np.array([[8.5, 5.3, 0.5]])
    found = ways(find_routes(build_lattices(low), low, np.array([1.5, 5.0, 0.5]), goal, 5.0, alternatives=3), 0, 1)
    above = [bool((evenly(way, 101)[45:55, 2] > 1.3).all()) for way in found]
    assert above[0]
    assert sum(above) == 1 < len(found)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_alternatives_are_different_clear_and_in_order(name: str) -> None:
    world = load_world(name)
    lattices, several = build_lattices(world), 0
    for seed in range(3):
        start, goals = free_points(world, 1, seed)[0], free_points(world, 40, 100 + seed)
        one = find_routes(lattices, world, start, goals, 5.0)
        three = find_routes(lattices, world, start, goals, 5.0, alternatives=3)
        assert len(three.count) == 120
        assert (three.length[:40] <= one.length).all()
        same = three.length[:40] == one.length
        assert same.mean() > 0.8
        np.testing.assert_array_equal(three.points[:40][same], one.points[same])
        for goal in range(40):
            found = ways(three, goal, 40)
            lengths = [three.length[row] for row in (goal, goal + 40, goal + 80)]
            assert lengths == sorted(lengths)
            several += len(found) > 1
            for way in found:
                np.testing.assert_array_equal(way[0], start)
                np.testing.assert_array_equal(way[-1], goals[goal])
                assert least_clearance(world, way) >= 0.5 - 1e-3
            for first, second in itertools.combinations(found, 2):
                assert between(world, first, second) < 0.15
            assert all(np.isinf(length) or length <= LONGEST * max(one.length[goal], lengths[0]) for length in lengths)
    assert several >= 20


def test_no_alternative_for_what_is_seen_or_cannot_be_reached() -> None:
    world = room([[4.9, 0.0, 0.0], [5.1, 10.0, 2.0]])
    lattices = build_lattices(world)
    goals = np.array([[2.0, 8.0, 1.0], [8.0, 5.0, 1.0], [np.nan, 1.0, 1.0]])
    found = find_routes(lattices, world, START, goals, 5.0, alternatives=2)
    assert found.reasons.tolist() == [0, *5 * [Reason.NO_PATH]]
    assert len(find_routes(lattices, world, START, np.zeros((0, 3)), 5.0, alternatives=3).count) == 0
    nowhere = find_routes(lattices, world, np.full(3, np.nan), goals, 5.0, alternatives=3)
    assert (nowhere.reasons == Reason.NO_PATH).all()
    assert len(nowhere.count) == 9


@pytest.fixture(scope="module")
def by_rule() -> Lattices:
    return build_lattices(room(PILLAR), SearchConfig(method="multi-resolution"))


@pytest.mark.parametrize("alternatives", [0, 4, -1, 2])
def test_what_cannot_be_asked_for(by_rule: Lattices, alternatives: int) -> None:
    """Two are more than lattices know."""
    with pytest.raises(InputError, match="alternatives: have"):
        find_routes(by_rule, room(PILLAR), START, START[None], 5.0, alternatives=alternatives)
