"""Obstacle avoidance for guidance laws: they aim at the next corner of our shortest path instead of at the target."""

import functools
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices
from jaxplan.search.routes import find_routes
from jaxplan.world.obstacles import World

PADDING, REACHED = 0.5, 0.3
"""m; that paths keep from obstacles, and from which on a corner counts as turned."""

Aim = Callable[[Float[np.ndarray, "3"], Float[np.ndarray, "3"]], Float[np.ndarray, "3"] | None]


def around_obstacles(world: World) -> Aim:
    """For a place and a target [m, world] the next corner on the way; None where nothing is in between, or no way."""
    lattices = _lattices(_Named(world))

    def aim(place: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"] | None:
        apart = float(np.linalg.norm(target - place))
        paths = find_routes(lattices, world, place, target[None], apart)
        corners = paths.points[0, 1 : int(paths.count[0]) - 1]
        ahead = corners[np.linalg.norm(corners - place, axis=1) > REACHED]
        return None if paths.reasons[0] or not len(ahead) else np.asarray(ahead[0])

    return aim


class _Named:
    """A world that caches can tell by its name."""

    def __init__(self, world: World) -> None:
        self.world = world

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Named) and other.world.name == self.world.name

    def __hash__(self) -> int:
        return hash(self.world.name)


@functools.lru_cache(maxsize=4)
def _lattices(named: _Named) -> Lattices:
    return build_lattices(named.world, SearchConfig(padding=PADDING))
