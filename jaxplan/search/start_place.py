"""A place to start from, in worlds that name none."""

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.search.lattice import Lattices
from jaxplan.search.multi_resolution import find_paths
from jaxplan.world.obstacles import World
from jaxplan.world.occupancy import cell_centres

_SHARE_OF_DIAGONAL = 0.3
"""How far away the place should be, along the path, as a share of the room's diagonal (arbitrary)."""
_MOST_PLACES = 400


def reachable_place(lattices: Lattices, world: World, target: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """A free point [m, world] from which a path leads to ``target``, about a third of the room's diagonal long.

    Raises:
        InputError: no free point is connected to the target.
    """
    grid = lattices.levels[-2].grid
    axes = cell_centres(grid.origin, grid.resolution, grid.shape)
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)[~grid.occupied]
    level = np.abs(centres[:, 2] - target[2])
    near = centres[level <= level.min(initial=np.inf) + 1e-6]
    places = near[np.linspace(0, len(near) - 1, min(len(near), _MOST_PLACES)).astype(int)]
    paths = find_paths(lattices, world, target, places, target_distance=0.0)
    if not np.isfinite(paths.length).any():
        raise InputError(
            f"world {world.name!r}: no free place is connected to the target's first position; give --start X Y Z"
        )
    return places[int(np.argmin(np.abs(paths.length - _SHARE_OF_DIAGONAL * world.diagonal)))]
