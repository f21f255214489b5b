"""Obstacle avoidance for guidance laws: they aim at the next corner of our shortest path instead of at the target."""

import functools
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices
from jaxplan.search.routes import find_routes
from jaxplan.world.obstacles import World

from .named_world import NamedWorld, named

PADDING, REACHED = 0.5, 0.3
"""m; that paths keep from obstacles, and from which on a corner counts as turned."""

Aim = Callable[[Float[np.ndarray, "3"], Float[np.ndarray, "3"]], Float[np.ndarray, "3"] | None]


def around_obstacles(world: World) -> Aim:
    """For a place and a target [m, world] the next corner on the way; None where nothing is in between, or no way."""
    lattices = _lattices(named(world))

    def aim(place: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"] | None:
        apart = float(np.linalg.norm(target - place))
        paths = find_routes(lattices, world, place, target[None], apart)
        corners = paths.points[0, 1 : int(paths.count[0]) - 1]
        ahead = corners[np.linalg.norm(corners - place, axis=1) > REACHED]
        return None if paths.reasons[0] or not len(ahead) else np.asarray(ahead[0])

    return aim


@functools.lru_cache(maxsize=4)
def _lattices(room: NamedWorld) -> Lattices:
    return build_lattices(room.world, SearchConfig(padding=PADDING))
