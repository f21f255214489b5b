"""The roadmap of a world: where shortest paths can bend, and which of these places see each other (host).

It is made once for a world and answers for any start and goals. A second one, at a smaller distance from obstacles,
knows the passages that the padding closes. When the world changes, the tiles around the change are looked at again and
the roads through it: what results is what would be made from the start.
"""

import functools
import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Int32

from jaxplan.batching import side_by_side
from jaxplan.search.components import join_components, label_components
from jaxplan.search.kernels.graph import make_frame
from jaxplan.search.kernels.places import REACH as PLACES_REACH
from jaxplan.search.kernels.places import WIDE, places_of
from jaxplan.search.kernels.roads import NOWHERE, Roads, join, kept, linked
from jaxplan.search.kernels.sight import HALF_DIAGONAL, Box, Field, fill
from jaxplan.search.kernels.solids import REACH, solids_of
from jaxplan.world.obstacles import World
from jaxplan.world.occupancy import cell_centres, finest_shape

TILE = 20
"""Cells of the finest lattice along a side of a tile (arbitrary)."""

_Places = tuple[Float[np.ndarray, "_ 3"], Float[np.ndarray, "_ 3"]]
"""Positions [m] and normals."""


class Level(NamedTuple):
    """Places and roads at one distance from obstacles."""

    limit: float
    """[m]"""
    roads: Roads
    """Of the level before, if there is one, and this level's own, which begin or end at one of its own places."""
    shared: int
    """How many places are those of the level before; they come first."""
    tiles: Int[np.ndarray, "t"]
    """How many places of its own each tile has; they are numbered tile by tile."""
    components: Int32[np.ndarray, "nx ny nz"]
    """By cell of the finest lattice the label of its connected part; 0 where no point of the cell is free."""


class _Changed(NamedTuple):
    """A level after a change."""

    level: Level
    before: Int[np.ndarray, "n"]
    """By place its number before the change, -1 where there was none."""


class Roadmap(NamedTuple):
    """Places and roads of a world, and the clearances by which lines of sight are tested."""

    field: Field
    room: Float[np.ndarray, "2 3"]
    """Corners of the box in which paths may be [m]."""
    levels: tuple[Level, ...]
    """The first at the padding, the others closer to obstacles: these know the passages that the one before has not."""


def build_roadmap(world: World, resolution: float, limits: tuple[float, ...]) -> Roadmap:
    """The roadmap of a world for paths at the distances ``limits`` [m] from obstacles.

    Places are looked for, and clearances known, on cells of side ``resolution`` [m].
    """
    field, room = field_of(world, resolution), corners_of(world)
    fill(field.values, field.frame, field.solids, np.zeros(3, np.int64), np.array(field.values.shape))
    levels: list[Level] = []
    for limit in limits:
        levels.append(_level(field, room, limit, levels[-1] if levels else None))
    return Roadmap(field, room, tuple(levels))


def update_field(
    field: Field, world: World, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]
) -> tuple[Field, bool]:
    """Clearances after a change within a box [m], and whether there is any place with more than before."""
    lower, upper = _widened(field, lower, upper)
    solids, values = tuple(solids_of(world)), field.values.copy()
    begin, end = _cells(field, lower - REACH, upper + REACH)
    changed = lower - 4.0 * field.shortfall, upper + 4.0 * field.shortfall
    opens = fill(values, field.frame, solids, begin, end, changed)
    return Field(values, field.frame, field.shortfall, solids), opens


def update_roadmap(
    roadmap: Roadmap, field: Field, opens: bool, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]
) -> Roadmap:
    """The roadmap of a world of which only the obstacles in the box from ``lower`` to ``upper`` [m] have changed.

    ``field`` as ``update_field`` gives it, and whether anything ``opens``.
    """
    lower, upper = _widened(roadmap.field, lower, upper)
    levels: list[_Changed] = []
    for level in roadmap.levels:
        wider = levels[-1] if levels else None
        levels.append(_changed_level(level, field, roadmap.room, (lower, upper), opens, wider))
    return Roadmap(field, roadmap.room, tuple(changed.level for changed in levels))


def corners_of(world: World) -> Float[np.ndarray, "2 3"]:
    """Corners [m] of the box in which paths may be."""
    return np.asarray(world.bounds, dtype=np.float64) + float(world.keep_in) * np.array([[1.0], [-1.0]])


def field_of(world: World, resolution: float) -> Field:
    """Cells of side ``resolution`` [m], whose clearances are not yet known."""
    shape = finest_shape(world, resolution)
    frame = tuple(make_frame(shape, np.asarray(world.bounds, dtype=np.float64)[0], resolution))
    solids, values = tuple(solids_of(world)), np.empty(shape, np.float32)
    sides = [float(grid.spacing) for grid in (world.mesh, world.voxels) if grid is not None]
    return Field(values, frame, HALF_DIAGONAL * max(sides, default=0.0), solids)


def _widened(field: Field, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]) -> Box:
    """A box [m], and what a clearance may fall short around it."""
    return lower - 2.0 * field.shortfall, upper + 2.0 * field.shortfall


def _cells(
    field: Field, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]
) -> tuple[Int[np.ndarray, "3"], Int[np.ndarray, "3"]]:
    """First and last cell, the last excluded, that a box [m] touches."""
    origin, side, shape = np.array(field.frame[3:6]), field.frame[6], np.array(field.values.shape)
    begin, end = np.floor((lower - origin) / side), np.ceil((upper - origin) / side)
    return np.clip(begin, 0, shape).astype(np.int64), np.clip(end, 0, shape).astype(np.int64)


@functools.cache
def _tiles(shape: tuple[int, ...]) -> list[tuple[Int[np.ndarray, "3"], Int[np.ndarray, "3"]]]:
    """First and last cells, the last excluded, of all tiles."""
    corners = [np.array([i, j, 0]) for i in range(0, shape[0], TILE) for j in range(0, shape[1], TILE)]
    return [(begin, np.minimum(begin + np.array([TILE, TILE, shape[2]]), shape)) for begin in corners]


def _level(field: Field, room: Float[np.ndarray, "2 3"], limit: float, wider: Level | None) -> Level:
    """Places and roads at the distance ``limit`` [m] from obstacles."""
    parts = side_by_side(lambda tile: _places(field, room, limit, wider, *tile), _tiles(field.values.shape))
    points, normals, tiles = _numbered(parts, wider)
    shared = len(points) - int(tiles.sum())
    pairs = join(tuple(field), limit, points, normals, np.ones(len(points), dtype=bool), shared, (room[0], room[1]))
    labels = label_components(_open_cells(field, room, limit, (slice(None),) * 3))
    return Level(limit, linked(points, normals, pairs, None if wider is None else wider.roads), shared, tiles, labels)


def _places(
    field: Field,
    room: Float[np.ndarray, "2 3"],
    limit: float,
    wider: Level | None,
    begin: Int[np.ndarray, "3"],
    end: Int[np.ndarray, "3"],
) -> _Places:
    """The places of one tile; where there is a ``wider`` level, those that it has not."""
    passages = (limit, limit + WIDE if wider is None else wider.limit)
    return places_of(tuple(field), passages, wider is None, room, begin, end)


def _changed_level(
    level: Level, field: Field, room: Float[np.ndarray, "2 3"], box: Box, opens: bool, wider: _Changed | None
) -> _Changed:
    """Places and roads after a change within a box [m]: places in the tiles around, roads to them and through.

    Where nothing ``opens``, no two places that were there see each other that did not before.
    """
    limit, roads = level.limit, level.roads
    above = None if wider is None else wider.level
    around = PLACES_REACH + (limit if above is None else above.limit)
    begin, end = _cells(field, box[0] - around, box[1] + around)
    first = level.shared + np.concatenate([[0], np.cumsum(level.tiles)])
    olds = [np.arange(*ends) for ends in itertools.pairwise(first.tolist())]
    parts, numbers = [(roads.points[old], roads.normals[old]) for old in olds], list(olds)
    tiles = _tiles(field.values.shape)
    looked_at = [
        n for n, (low, high) in enumerate(tiles) if ((low < end) & (begin < high))[:2].all() and begin[2] < end[2]
    ]
    found = side_by_side(lambda n: _places(field, room, limit, above, *tiles[n]), looked_at)
    for n, places in zip(looked_at, found, strict=True):
        numbers[n] = _same(parts[n], places, olds[n])
        parts[n] = places
    numbers.insert(0, np.zeros(0, np.int64) if wider is None else wider.before)
    points, normals, counts = _numbered(parts, above)
    before, shared = np.concatenate(numbers), len(points) - int(counts.sum())
    near, now = (box[0] - limit, box[1] + limit), np.full(len(roads.points), -1, np.int32)
    now[before[before >= 0]] = np.flatnonzero(before >= 0)
    held = kept(roads, level.shared, now, tuple(field), limit, near, not opens)
    fresh = join(tuple(field), limit, points, normals, before < 0, shared, near if opens else NOWHERE)
    pairs = np.concatenate([held, fresh])
    window = tuple(slice(int(a), int(b)) for a, b in zip(*_cells(field, *near), strict=True))
    labels = join_components(level.components, _open_cells(field, room, limit, window), window)
    linking = linked(points, normals, pairs, None if above is None else above.roads)
    return _Changed(Level(limit, linking, shared, counts, labels), before)


def _open_cells(
    field: Field, room: Float[np.ndarray, "2 3"], limit: float, window: tuple[slice, ...]
) -> Bool[np.ndarray, "wx wy wz"]:
    """Cells of a window in which a point may keep the distance ``limit`` [m] from obstacles and be in the room."""
    side = field.frame[6]
    centres = cell_centres(np.array(field.frame[3:6]), side, field.values.shape)
    within = room + 0.5 * side * np.array([[-1.0], [1.0]])
    inside = [((c >= low) & (c <= high))[w] for c, low, high, w in zip(centres, *within, window, strict=True)]
    free = field.values[window] >= limit - HALF_DIAGONAL * side - field.shortfall
    free &= inside[0][:, None, None] & inside[1][None, :, None] & inside[2][None, None, :]
    return np.asarray(free)


def _same(known: _Places, found: _Places, numbers: Int[np.ndarray, "k"]) -> Int[np.ndarray, "n"]:
    """For each place found the number of the same known one, -1 where there is none."""
    if not len(numbers):
        return np.full(len(found[0]), -1)
    same = np.ones((len(found[0]), len(known[0])), dtype=bool)
    for a, b in zip(found, known, strict=True):
        same &= (a[:, None] == b[None]).all(axis=2)
    return np.where(same.any(axis=1), numbers[same.argmax(axis=1)], -1)


def _numbered(
    parts: list[_Places], wider: Level | None
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Int[np.ndarray, "t"]]:
    """Positions and normals: those of the wider level, then tile by tile; and how many each tile has."""
    above = (np.zeros((0, 3)), np.zeros((0, 3))) if wider is None else (wider.roads.points, wider.roads.normals)
    points, normals = (np.concatenate([above[i], *(part[i] for part in parts)]) for i in range(2))
    return points, normals, np.array([len(part[0]) for part in parts])


def connected(
    roadmap: Roadmap, level: Level, start: Float[np.ndarray, "3"], goals: Float[np.ndarray, "k 3"]
) -> Bool[np.ndarray, "k"]:
    """Goals that may be in the connected part of a start [m]: all but those whose cell is certainly in another one."""
    shape, side = np.array(level.components.shape), roadmap.field.frame[6]
    cells = np.floor((np.concatenate([start[None], goals]) - roadmap.field.frame[3:6]) / side).astype(np.int64)
    labels = level.components[tuple(np.clip(cells, 0, shape - 1).T)]
    return (labels[1:] == labels[0]) | (labels[1:] == 0) | (labels[0] == 0)
