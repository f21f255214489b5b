"""Change a world in flight: new boxes, and cells that became occupied or free, without building everything anew (host).

Only the cells within the padding of what changed are judged again, and only the steps around those. The labels of
connected parts are joined where something was freed, and kept where something was closed: two cells of one label may
then be apart, which costs a search its budget but never hides a path. Arrays keep their shapes, so nothing is compiled:
boxes go into slots that ``with_spare_boxes`` reserved.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from jaxplan.errors import InputError
from jaxplan.numerics import in_float64
from jaxplan.records import replace
from jaxplan.search.graph import permitted_moves
from jaxplan.search.lattice import Lattices, SearchLattice
from jaxplan.world.obstacles import Boxes, World
from jaxplan.world.occupancy import Lattice, coarsen, kept_in, padded_cells
from jaxplan.world.voxels import set_cells

_ABSENT = 1e6
"""m; where boxes wait that are not there, below every room. Their distance is finite and never the least."""


class Change(NamedTuple):
    """A world and its lattices after a change."""

    world: World
    lattices: Lattices


def with_spare_boxes(world: World, count: int = 16) -> World:
    """The same world with ``count`` more boxes that are not there yet."""
    boxes = world.boxes
    spare = Boxes(
        center=np.concatenate([np.asarray(boxes.center), np.full((count, 3), -_ABSENT)]),
        half=np.concatenate([np.asarray(boxes.half), np.full((count, 3), 0.5)]),
        rotation=np.concatenate([np.asarray(boxes.rotation), np.tile(np.eye(3), (count, 1, 1))]),
    )
    return replace(world, obstacles=replace(world.obstacles, boxes=spare))


def add_box(world: World, lattices: Lattices, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]) -> Change:
    """Add an axis-aligned box from ``lower`` to ``upper`` [m] in a spare slot."""
    lower, upper = _corners(lower, upper)
    free = np.flatnonzero(np.asarray(world.boxes.center)[:, 2] <= -_ABSENT)
    if not len(free):
        raise InputError("world: have no spare box left, want one; reserve more with with_spare_boxes")
    moved = _place_box(world, int(free[0]), (lower + upper) / 2.0, (upper - lower) / 2.0)
    return Change(moved, update_lattices(lattices, moved, lower, upper))


def remove_box(world: World, lattices: Lattices, index: int) -> Change:
    """Take away box ``index``, whatever its attitude; its slot is spare from then on."""
    boxes = world.boxes
    center, reach = np.asarray(boxes.center)[index], np.linalg.norm(np.asarray(boxes.half)[index])
    moved = _place_box(world, index, np.full(3, -_ABSENT), np.full(3, 0.5))
    return Change(moved, update_lattices(lattices, moved, center - reach, center + reach))


def set_occupied(
    world: World, lattices: Lattices, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"], occupied: bool
) -> Change:
    """Set all cells of a voxel world that touch the box from ``lower`` to ``upper`` [m]."""
    lower, upper = _corners(lower, upper)
    if world.voxels is None:
        raise InputError(f"world {world.name!r}: have no cells, want a world of cells; use add_box")
    voxels = set_cells(world.voxels, lower, upper, occupied)
    moved = replace(world, obstacles=replace(world.obstacles, voxels=voxels))
    side = float(world.voxels.spacing)
    return Change(moved, update_lattices(lattices, moved, lower - side, upper + side))


@in_float64
def update_lattices(lattices: Lattices, world: World, lower: np.ndarray, upper: np.ndarray) -> Lattices:
    """The lattices of ``world``, of which only the box from ``lower`` to ``upper`` [m] has changed."""
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
    occupied[window] = near_here | ~kept_in(world, grid.resolution, grid.shape)[window]
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


def _place_box(world: World, index: int, center: Float[np.ndarray, "3"], half: Float[np.ndarray, "3"]) -> World:
    """The world with box ``index`` somewhere else, along the room's axes."""
    boxes = world.boxes
    centers, halves, rotations = np.array(boxes.center), np.array(boxes.half), np.array(boxes.rotation)
    centers[index], halves[index], rotations[index] = center, half, np.eye(3)
    moved = Boxes(center=centers, half=halves, rotation=rotations)
    return replace(world, obstacles=replace(world.obstacles, boxes=moved))


def _corners(lower: object, upper: object) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    low, high = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
    if low.shape != (3,) or high.shape != (3,) or not (np.isfinite(low) & np.isfinite(high) & (low < high)).all():
        raise InputError(
            f"box: have corners {low.tolist()} and {high.tolist()}, want three finite metres each, lower < upper"
        )
    return low, high
