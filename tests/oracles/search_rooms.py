"""Rooms of boxes, and free points in any room, for tests of the search."""

import numpy as np

from jaxplan.world.obstacles import World, aligned_boxes, make_obstacles
from jaxplan.world.occupancy import exact_clearance


def room(*corners: list[list[float]]) -> World:
    """10 m x 10 m x 2 m with boxes from corner to corner [m]."""
    lower, upper = np.array([c[0] for c in corners]), np.array([c[1] for c in corners])
    obstacles = make_obstacles(boxes=aligned_boxes(lower, upper))
    bounds = np.array([[0.0, 0.0, 0.0], [10.0, 10.0, 2.0]])
    return World(name="room", bounds=bounds, obstacles=obstacles, keep_in=np.float64(0.2))


def free_points(world: World, count: int, seed: int, padding: float = 0.5) -> np.ndarray:
    """Points that keep the padding [m] from all obstacles."""
    rng, keep_in, found = np.random.default_rng(seed), float(world.keep_in), np.zeros((0, 3))
    while len(found) < count:
        points = rng.uniform(world.bounds[0] + keep_in, world.bounds[1] - keep_in, (512, 3))
        found = np.concatenate([found, points[exact_clearance(world.obstacles, points) >= padding]])
    return found[:count]
