"""The lattices of a world that was changed in flight, without building everything anew (host).

Only the cells within the padding of what changed are judged again, and only the steps around those. The labels of
connected parts are joined where something was freed, and kept where something was closed: two cells of one label may
then be apart, which costs a search its budget but never hides a path. Arrays keep their shapes, so nothing is compiled.
"""

import numpy as np
from jaxtyping import Bool, Int
from scipy import ndimage

from jaxplan.precision import in_float64
from jaxplan.search.kernels.graph import permitted_moves
from jaxplan.search.lattice import Lattices, SearchLattice
from jaxplan.world.obstacles import World
from jaxplan.world.occupancy import Lattice, coarsen, kept_in, padded_cells
from jaxplan.world.update import Change


@in_float64
def update_lattices(lattices: Lattices, change: Change) -> Lattices:
    """The lattices of a world after ``update_world``; ``lattices`` are those of the world before."""
    world, lower, upper = change
    finest = lattices.levels[0].grid
    reach = lattices.config.padding + finest.resolution
    factor = round(lattices.levels[-1].grid.resolution / finest.resolution)
    first = np.floor((lower - reach - finest.origin) / finest.resolution).astype(int) // factor * factor
    last = -(-np.ceil((upper + reach - finest.origin) / finest.resolution).astype(int) // factor) * factor
    first, last = np.clip(first, 0, finest.shape), np.clip(last, 0, finest.shape)
    if not (first < last).all():
        return lattices
    where = finest.origin, last - first, finest.resolution
    padded = padded_cells(world.obstacles, *where, lattices.config.padding, first)
    levels = tuple(_update_level(world, level, padded, first, finest.resolution) for level in lattices.levels)
    return Lattices(levels=levels, config=lattices.config)


def _update_level(
    world: World, level: SearchLattice, padded: np.ndarray, first: Int[np.ndarray, "3"], finest: float
) -> SearchLattice:
    """One level with the ``padded`` cells of the finest lattice from ``first`` on put in."""
    grid = level.grid
    factor = round(grid.resolution / finest)
    near_here = coarsen(padded, factor)
    window = tuple(slice(int(a), int(a) + n) for a, n in zip(first // factor, near_here.shape, strict=True))
    near, occupied = grid.near_obstacle.copy(), grid.occupied.copy()
    near[window] = near_here
    occupied[window] = near_here | ~kept_in(world, grid.resolution, grid.shape, window)
    fresh = Lattice(occupied=occupied, near_obstacle=near, origin=grid.origin, resolution=grid.resolution)
    around, beyond = _grown(window, 1), _grown(window, 2)
    moves = level.moves.reshape(grid.shape).copy()
    local = permitted_moves(occupied[beyond]).reshape(occupied[beyond].shape)
    offset = [slice(a.start - b.start, a.start - b.start + 10**9) for a, b in zip(around, beyond, strict=True)]
    moves[around] = local[tuple(offset)][tuple(slice(0, n) for n in moves[around].shape)]
    labels = _joined_labels(level.components.reshape(grid.shape), occupied, around)
    return SearchLattice(grid=fresh, moves=moves.reshape(-1), components=labels.reshape(-1))


def _grown(window: tuple[slice, ...], cells: int) -> tuple[slice, ...]:
    """The window with so many more cells on each side, as far as there are any."""
    return tuple(slice(max(part.start - cells, 0), part.stop + cells) for part in window)


def _joined_labels(
    labels: Int[np.ndarray, "nx ny nz"], occupied: Bool[np.ndarray, "nx ny nz"], around: tuple[slice, ...]
) -> Int[np.ndarray, "nx ny nz"]:
    """Labels in which all parts that touch within ``around`` are one; closed cells have none."""
    labels = labels.copy()
    local, parts = ndimage.label(~occupied[around])
    before = labels[around].copy()
    labels[around] = 0
    joined = np.arange(labels.max(initial=before.max(initial=0)) + 1)
    fresh = np.zeros(parts + 1, labels.dtype)
    for part in range(1, parts + 1):
        old = np.unique(joined[before[(local == part) & (before > 0)]])
        fresh[part] = old[0] if len(old) else len(joined) + part
        for other in old[1:]:
            joined[joined == other] = old[0]
    if (joined != np.arange(len(joined))).any():
        labels = joined.astype(labels.dtype)[labels]
    renamed = np.where(fresh < len(joined), joined[np.minimum(fresh, len(joined) - 1)], fresh)
    labels[around] = renamed.astype(labels.dtype)[local]
    return labels
