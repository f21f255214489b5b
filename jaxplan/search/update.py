"""The lattices of a world that was changed in flight, without building everything anew (host).

Only the cells within the padding of what changed are looked at again, and only the steps around those. The labels of
connected parts are joined where something was freed, and kept where something was closed: two cells of one label may
then be apart, which costs a search its budget but never hides a path. Arrays keep their shapes, so nothing is compiled.
"""

import numpy as np
from jaxtyping import Bool, Int

from jaxplan.batching import beside
from jaxplan.precision import in_float64
from jaxplan.records import replace
from jaxplan.search.components import join_components
from jaxplan.search.kernels.graph import permitted_moves
from jaxplan.search.lattice import Lattices, SearchLattice, inside_faces
from jaxplan.search.roadmap import update_field, update_roadmap
from jaxplan.world.obstacles import World
from jaxplan.world.occupancy import Lattice, coarsen, kept_in, padded_cells
from jaxplan.world.update import Change


@in_float64
def update_lattices(lattices: Lattices, change: Change) -> Lattices:
    """The lattices of a world after ``update_world``; ``lattices`` are those of the world before."""
    world, lower, upper = inside_faces(change.world, lattices.config), change.lower, change.upper
    finest = lattices.levels[0].grid
    reach = lattices.config.padding + finest.resolution + _shortfall(world)
    factors = [round(level.grid.resolution / finest.resolution) for level in lattices.levels]
    whole = int(np.lcm.reduce(factors))  # a window of whole cells of every lattice
    first = np.floor((lower - reach - finest.origin) / finest.resolution).astype(int) // whole * whole
    last = -(-np.ceil((upper + reach - finest.origin) / finest.resolution).astype(int) // whole) * whole
    first, last = np.clip(first, 0, finest.shape), np.clip(last, 0, finest.shape)
    if not (first < last).all():
        return lattices
    roadmap = lattices.roadmap
    if roadmap is None:
        where = finest.origin, last - first, finest.resolution
        padded = padded_cells(world.obstacles, *where, lattices.config.padding, first)
        return replace(lattices, levels=_update_levels(lattices, world, padded, first, factors))
    field, opens = update_field(roadmap.field, world, lower, upper)
    window = tuple(slice(a, b) for a, b in zip(first.tolist(), last.tolist(), strict=True))
    padded = field.values[window] < lattices.config.padding
    levels = beside(lambda: _update_levels(lattices, world, padded, first, factors))
    roadmap = update_roadmap(roadmap, field, opens, lower, upper)
    return replace(lattices, levels=levels.result(), roadmap=roadmap)


def _update_levels(
    lattices: Lattices,
    world: World,
    padded: Bool[np.ndarray, "wx wy wz"],
    first: Int[np.ndarray, "3"],
    factors: list[int],
) -> tuple[SearchLattice, ...]:
    """All levels; each one's cells span so many of the finest lattice's, by ``factors``."""
    levels = zip(lattices.levels, factors, strict=True)
    return tuple(_update_level(world, level, padded, first, factor) for level, factor in levels)


def _shortfall(world: World) -> float:
    """Distance [m] by which the clearance from changed cells may be below the truth (``jaxplan.world.clearance``)."""
    return 0.0 if world.voxels is None else np.sqrt(3.0) * float(world.voxels.spacing)


def _update_level(
    world: World,
    level: SearchLattice,
    padded: Bool[np.ndarray, "wx wy wz"],
    first: Int[np.ndarray, "3"],
    factor: int,
) -> SearchLattice:
    """One level with the ``padded`` cells of the finest lattice from ``first`` on put in; its cells span ``factor``."""
    grid = level.grid
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
    labels = join_components(level.components.reshape(grid.shape), ~occupied[around], around)
    return SearchLattice(grid=fresh, moves=moves.reshape(-1), components=labels.reshape(-1))


def _grown(window: tuple[slice, ...], cells: int) -> tuple[slice, ...]:
    """The window with so many more cells on each side, as far as there are any."""
    return tuple(slice(max(part.start - cells, 0), part.stop + cells) for part in window)
