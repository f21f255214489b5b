"""Where plans come to rest behind their goals: in free space, straight on if there is room."""

import numpy as np
import pytest

from jaxplan.precision import in_float64
from jaxplan.search.kernels.sight import clearances
from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices
from jaxplan.search.routes import find_routes
from jaxplan.search.stops import DISTANCES, stop_points
from jaxplan.world.load import ENVIRONMENTS, load_world
from jaxplan.world.obstacles import World, aligned_boxes, make_obstacles
from tolerances import tolerance


def room(*corners: list[list[float]]) -> World:
    """10 m by 10 m by 3 m with some boxes."""
    low, high = np.array(corners, dtype=float).reshape(-1, 2, 3).transpose(1, 0, 2)
    bounds = np.array([[0.0, 0.0, 0.0], [10.0, 10.0, 3.0]])
    return World(name="room", bounds=bounds, obstacles=make_obstacles(boxes=aligned_boxes(low, high)), keep_in=0.3)


def stop(world: World, start: list[float], goal: list[float]) -> np.ndarray:
    lattices = build_lattices(world)
    paths = find_routes(lattices, world, np.array(start), np.array([goal]), 1.0)
    assert paths.reasons[0] == 0
    return np.asarray(in_float64(stop_points)(lattices, world, paths)[0])


def test_straight_on_where_there_is_room() -> None:
    found = stop(room(), [1.0, 5.0, 1.0], [4.0, 5.0, 1.0])
    np.testing.assert_allclose(found, [4.0 + max(DISTANCES), 5.0, 1.0], **tolerance("formula"))


def test_a_descent_is_levelled_before_the_floor() -> None:
    found = stop(room(), [1.0, 5.0, 2.5], [4.0, 5.0, 0.5])
    np.testing.assert_allclose(found[2], 0.5, **tolerance("formula"))
    assert found[0] == pytest.approx(6.0)


def test_before_a_wall_it_turns_or_stops_sooner() -> None:
    found = stop(room([[5.0, 0.0, 0.0], [5.2, 10.0, 3.0]]), [1.0, 5.0, 1.0], [4.3, 5.0, 1.0])
    assert found[0] <= 4.5
    assert np.linalg.norm(found - [4.3, 5.0, 1.0]) > 0.4


def test_in_a_niche_the_goal_itself() -> None:
    walls = [
        [[5.0, 3.0, 0.0], [5.2, 7.0, 3.0]],
        [[3.0, 5.51, 0.0], [5.0, 5.8, 3.0]],
        [[3.0, 4.2, 0.0], [5.0, 4.49, 3.0]],
    ]
    goal = [4.49, 5.0, 1.0]
    np.testing.assert_array_equal(stop(room(*walls), [1.0, 5.0, 1.0], goal), goal)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_stops_and_the_ways_to_them_keep_the_padding(name: str) -> None:
    world = load_world(name)
    lattices = build_lattices(world)
    assert lattices.roadmap is not None
    grid, rng = lattices.levels[0].grid, np.random.default_rng(0)
    free = np.argwhere(~grid.occupied)
    points = grid.origin + (free[rng.integers(len(free), size=401)] + 0.5) * grid.resolution
    paths = find_routes(lattices, world, points[0], points[1:], 1.0)
    stops = in_float64(stop_points)(lattices, world, paths)
    share = np.linspace(0.0, 1.0, 50)[:, None, None]
    between = points[1:] + share * (stops - points[1:])
    free_distance = clearances(lattices.roadmap.field.solids, between.reshape(-1, 3))
    assert free_distance.min() >= 0.5 - 1e-3
    assert ((stops >= lattices.roadmap.room[0]) & (stops <= lattices.roadmap.room[1])).all()
    assert (np.linalg.norm(stops - points[1:], axis=1) > 0.4).mean() > 0.9


def test_ahead_of_the_target_where_its_velocity_is_given() -> None:
    """Not on along the path; a target at rest has none ahead, so the path's continuation counts."""
    world, goal = room(), np.array([[4.0, 5.0, 1.0]])
    lattices = build_lattices(world)
    paths = find_routes(lattices, world, np.array([1.0, 5.0, 1.0]), goal, 1.0)
    for velocity, ahead in (([0.0, 3.0, 0.0], [0.0, 1.0, 0.0]), ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0])):
        found = np.asarray(in_float64(stop_points)(lattices, world, paths, np.array([velocity])))
        np.testing.assert_allclose(found, goal + max(DISTANCES) * np.array(ahead), **tolerance("formula"))


def test_lattices_alone_have_no_stops() -> None:
    world = room()
    lattices: Lattices = build_lattices(world, SearchConfig(method="multi-resolution"))
    goals = np.array([[4.0, 5.0, 1.0], [99.0, 0.0, 0.0]])
    paths = find_routes(lattices, world, np.array([1.0, 5.0, 1.0]), goals, 1.0)
    np.testing.assert_array_equal(in_float64(stop_points)(lattices, world, paths)[0], goals[0])
