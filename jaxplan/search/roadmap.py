"""The roadmap of a world: where shortest paths can bend, and which of these places see each other (host).

It is made once for a world and answers for any start and goals. A second one, at a smaller distance from obstacles,
knows the passages that the padding closes. When the world changes, the tiles around the change are looked at again and
the roads through it: what results is what would be made from the start.
"""

import functools
import logging
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Int32

from jaxplan.batching import beside, side_by_side
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
MANY = 6000
"""Places from which on a log says that their roads take minutes (arbitrary: 9,000 took three on busy cores)."""

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
    box = _widened(roadmap.field, lower, upper)
    found = _found(roadmap, field, box)
    labels = [beside(functools.partial(_changed_labels, level, field, roadmap.room, box)) for level in roadmap.levels]
    levels: list[_Changed] = []
    for level, places in zip(roadmap.levels, found, strict=True):
        levels.append(_changed_level(level, field, box, opens, places, levels[-1] if levels else None))
    changed = zip(levels, labels, strict=True)
    return Roadmap(field, roadmap.room, tuple(level._replace(components=new.result()) for (level, _), new in changed))


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
    if len(points) > MANY:
        logging.getLogger(__name__).warning(
            "jaxplan: this map has %d places to fly around at cells of %g m: their roads take minutes, once; a larger "
            "resolution has fewer",
            len(points),
            field.frame[6],
        )
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


def _found(roadmap: Roadmap, field: Field, box: Box) -> list[dict[int, _Places]]:
    """By level the places that there are after a change within a box [m], by the numbers of the tiles around."""
    above = None, *roadmap.levels[:-1]
    levels = list(zip(roadmap.levels, above, strict=True))
    tiles = _tiles(field.values.shape)
    jobs = [(level.limit, wider, n) for level, wider in levels for n in _around(field, box, level.limit, wider)]
    places = iter(side_by_side(lambda job: _places(field, roadmap.room, *job[:2], *tiles[job[2]]), jobs))
    return [{n: next(places) for n in _around(field, box, level.limit, wider)} for level, wider in levels]


def _around(field: Field, box: Box, limit: float, wider: Level | None) -> list[int]:
    """The numbers of the tiles whose places a change within a box [m] may change, ascending."""
    reach = PLACES_REACH + (limit if wider is None else wider.limit)
    begin, end = _cells(field, box[0] - reach, box[1] + reach)
    rows, columns = (range(begin[axis] // TILE, -(-end[axis] // TILE)) for axis in range(2))
    across = -(-field.values.shape[1] // TILE)
    return [row * across + column for row in rows for column in columns] if (begin < end).all() else []


def _changed_level(
    level: Level, field: Field, box: Box, opens: bool, found: dict[int, _Places], wider: _Changed | None
) -> _Changed:
    """Places and roads after a change within a box [m]: the places ``found`` by tile, roads to them and through.

    Where nothing ``opens``, no two places that were there see each other that did not before. Labels stay.
    """
    limit, roads, above = level.limit, level.roads, None if wider is None else wider.level
    points, normals, before, counts = _replaced(level, found, wider)
    shared = len(points) - int(counts.sum())
    near, now = (box[0] - limit, box[1] + limit), np.full(len(roads.points), -1, np.int32)
    now[before[before >= 0]] = np.flatnonzero(before >= 0)
    held = beside(lambda: kept(roads, level.shared, now, tuple(field), limit, near, not opens))
    fresh = join(tuple(field), limit, points, normals, before < 0, shared, near if opens else NOWHERE)
    pairs = np.concatenate([held.result(), fresh])
    linking = linked(points, normals, pairs, None if above is None else above.roads)
    return _Changed(Level(limit, linking, shared, counts, level.components), before)


def _replaced(
    level: Level, found: dict[int, _Places], wider: _Changed | None
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Int[np.ndarray, "n"], Int[np.ndarray, "t"]]:
    """Positions and normals with the places ``found`` in some tiles, their numbers before, and how many each tile has.

    The number is -1 where there was no such place.
    """
    first = (level.shared + np.concatenate([[0], np.cumsum(level.tiles)])).tolist()
    points, normals, counts, done = level.roads.points, level.roads.normals, level.tiles.copy(), level.shared
    parts, before = [], [np.zeros(0, np.int64) if wider is None else wider.before]
    for n, places in found.items():
        kept_on, here = slice(done, first[n]), slice(first[n], first[n + 1])
        parts += [(points[kept_on], normals[kept_on]), places]
        before += [np.arange(done, first[n]), _same((points[here], normals[here]), places, first[n])]
        counts[n], done = len(places[0]), first[n + 1]
    parts.append((points[done:], normals[done:]))
    before.append(np.arange(done, first[-1]))
    points, normals, _ = _numbered(parts, None if wider is None else wider.level)
    return points, normals, np.concatenate(before), counts


def _changed_labels(
    level: Level, field: Field, room: Float[np.ndarray, "2 3"], box: Box
) -> Int32[np.ndarray, "nx ny nz"]:
    """The labels of connected parts after a change within a box [m]."""
    ends = _cells(field, box[0] - level.limit, box[1] + level.limit)
    window = tuple(slice(int(a), int(b)) for a, b in zip(*ends, strict=True))
    return join_components(level.components, _open_cells(field, room, level.limit, window), window)


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


def _same(known: _Places, found: _Places, first: int) -> Int[np.ndarray, "n"]:
    """For each place found the number of the same known one, counted from ``first``; -1 where there is none."""
    keys = [list(map(tuple, np.concatenate(places, axis=1).tolist())) for places in (known, found)]
    numbers = {key: first + n for n, key in reversed(list(enumerate(keys[0])))}
    return np.array([numbers.get(key, -1) for key in keys[1]], dtype=np.int64)


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
