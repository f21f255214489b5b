"""The roadmap of a world: where shortest paths can bend, and which of these places see each other (host).

It is made once for a world and answers for any start and goals. A second one, at a smaller distance from obstacles,
knows the passages that the padding closes. When the world changes, the tiles around the change are looked at again and
the roads through it: what results is what would be made from the start.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Int32
from scipy.sparse import coo_array

from jaxplan.search.components import join_components, label_components
from jaxplan.search.kernels.graph import make_frame
from jaxplan.search.kernels.places import REACH as PLACES_REACH
from jaxplan.search.kernels.places import places_of
from jaxplan.search.kernels.roads import Box, Roads, join, touching
from jaxplan.search.kernels.sight import HALF_DIAGONAL, Field, fill
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
    tiles: Int[np.ndarray, "t"]
    """How many places each tile has; they are numbered tile by tile."""
    components: Int32[np.ndarray, "nx ny nz"]
    """By cell of the finest lattice the label of its connected part; 0 where no point of the cell is free."""


class Roadmap(NamedTuple):
    """Places and roads of a world, and the clearances by which lines of sight are tested."""

    field: Field
    room: Float[np.ndarray, "2 3"]
    """Corners of the box in which paths may be [m]."""
    levels: tuple[Level, ...]
    """The first at the padding, the others closer to obstacles."""


def build_roadmap(world: World, resolution: float, limits: tuple[float, ...]) -> Roadmap:
    """The roadmap of a world for paths at the distances ``limits`` [m] from obstacles.

    Places are looked for, and clearances known, on cells of side ``resolution`` [m].
    """
    field = _field(world, resolution)
    room = np.asarray(world.bounds, dtype=np.float64) + float(world.keep_in) * np.array([[1.0], [-1.0]])
    return Roadmap(field, room, tuple(_level(field, room, limit) for limit in limits))


def update_roadmap(
    roadmap: Roadmap, world: World, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]
) -> Roadmap:
    """The roadmap of a world of which only the obstacles in the box from ``lower`` to ``upper`` [m] have changed."""
    lower, upper = lower - 2.0 * roadmap.field.shortfall, upper + 2.0 * roadmap.field.shortfall
    field = _changed_field(roadmap.field, world, lower, upper)
    levels = tuple(_changed_level(level, field, roadmap.room, lower, upper) for level in roadmap.levels)
    return Roadmap(field, roadmap.room, levels)


def _field(world: World, resolution: float) -> Field:
    """Clearances at the centres of cells of side ``resolution`` [m]."""
    shape = finest_shape(world, resolution)
    frame = tuple(make_frame(shape, np.asarray(world.bounds, dtype=np.float64)[0], resolution))
    solids, values = tuple(solids_of(world)), np.empty(shape, np.float32)
    fill(values, frame, solids, np.zeros(3, np.int64), np.array(shape))
    sides = [float(grid.spacing) for grid in (world.mesh, world.voxels) if grid is not None]
    return Field(values, frame, HALF_DIAGONAL * max(sides, default=0.0), solids)


def _changed_field(field: Field, world: World, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]) -> Field:
    """Clearances after a change within a box [m]."""
    solids, values = tuple(solids_of(world)), field.values.copy()
    begin, end = _cells(field, lower - REACH, upper + REACH)
    fill(values, field.frame, solids, begin, end)
    return Field(values, field.frame, field.shortfall, solids)


def _cells(
    field: Field, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]
) -> tuple[Int[np.ndarray, "3"], Int[np.ndarray, "3"]]:
    """First and last cell, the last excluded, that a box [m] touches."""
    origin, side, shape = np.array(field.frame[3:6]), field.frame[6], np.array(field.values.shape)
    begin, end = np.floor((lower - origin) / side), np.ceil((upper - origin) / side)
    return np.clip(begin, 0, shape).astype(np.int64), np.clip(end, 0, shape).astype(np.int64)


def _tiles(shape: tuple[int, ...]) -> list[tuple[Int[np.ndarray, "3"], Int[np.ndarray, "3"]]]:
    """First and last cells, the last excluded, of all tiles."""
    corners = [np.array([i, j, 0]) for i in range(0, shape[0], TILE) for j in range(0, shape[1], TILE)]
    return [(begin, np.minimum(begin + np.array([TILE, TILE, shape[2]]), shape)) for begin in corners]


def _level(field: Field, room: Float[np.ndarray, "2 3"], limit: float) -> Level:
    """Places and roads at the distance ``limit`` [m] from obstacles."""
    parts = [places_of(tuple(field), limit, room, begin, end) for begin, end in _tiles(field.values.shape)]
    points, normals, tiles = _numbered(parts)
    pairs = join(tuple(field), limit, points, normals, np.ones(len(points), dtype=bool), (room[0], room[1]))
    return Level(limit, _roads(points, normals, pairs), tiles, label_components(_open_cells(field, room, limit)))


def _changed_level(
    level: Level,
    field: Field,
    room: Float[np.ndarray, "2 3"],
    lower: Float[np.ndarray, "3"],
    upper: Float[np.ndarray, "3"],
) -> Level:
    """Places and roads after a change within a box [m]: places in the tiles around, roads to them and through."""
    limit, roads, tiles = level.limit, level.roads, level.tiles
    around = limit + PLACES_REACH
    begin, end = _cells(field, lower - around, upper + around)
    first = np.concatenate([[0], np.cumsum(tiles)])
    parts, numbers = [], []
    for tile, (low, high) in enumerate(_tiles(field.values.shape)):
        old = np.arange(first[tile], first[tile + 1])
        known = roads.points[old], roads.normals[old]
        if (low < end).all() and (begin < high).all():
            parts.append(places_of(tuple(field), limit, room, low, high))
            numbers.append(_same(known, parts[-1], old))
        else:
            parts.append(known)
            numbers.append(old)
    points, normals, counts = _numbered(parts)
    before = np.concatenate([np.zeros(0, np.int64), *numbers])
    box = lower - limit, upper + limit
    fresh = join(tuple(field), limit, points, normals, before < 0, box)
    pairs = np.concatenate([_untouched(roads, before, points, box), fresh])
    near = tuple(slice(int(a), int(b)) for a, b in zip(*_cells(field, *box), strict=True))
    labels = join_components(level.components, ~_open_cells(field, room, limit), near)
    return Level(limit, _roads(points, normals, pairs), counts, labels)


def _open_cells(field: Field, room: Float[np.ndarray, "2 3"], limit: float) -> Bool[np.ndarray, "nx ny nz"]:
    """Cells in which a point may keep the distance ``limit`` [m] from obstacles and be in the room."""
    side = field.frame[6]
    centres = cell_centres(np.array(field.frame[3:6]), side, field.values.shape)
    within = room + 0.5 * side * np.array([[-1.0], [1.0]])
    inside = [(c >= low) & (c <= high) for c, low, high in zip(centres, *within, strict=True)]
    free = field.values >= limit - HALF_DIAGONAL * side - field.shortfall
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


def _untouched(
    roads: Roads, before: Int[np.ndarray, "n"], points: Float[np.ndarray, "n 3"], box: Box
) -> Int32[np.ndarray, "e 2"]:
    """The roads between places that were there ``before``, by their old numbers, and that do not touch the box [m]."""
    now = np.full(len(roads.points), -1, np.int32)
    now[before[before >= 0]] = np.flatnonzero(before >= 0)
    begin, end = now[np.repeat(np.arange(len(roads.points)), np.diff(roads.first))], now[roads.ends]
    pairs = np.stack([begin, end], axis=1)[(begin >= 0) & (end >= 0) & (begin < end)]
    return pairs[~touching(points, pairs, box)]


def _numbered(
    parts: list[_Places],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Int[np.ndarray, "t"]]:
    """Positions and normals of all tiles' places, one tile after the other, and how many each has."""
    points, normals = (np.concatenate([np.zeros((0, 3)), *(part[i] for part in parts)]) for i in range(2))
    return points, normals, np.array([len(part[0]) for part in parts])


def _roads(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], pairs: Int32[np.ndarray, "e 2"]
) -> Roads:
    """Roads in both directions, in order."""
    lengths = np.linalg.norm(points[pairs[:, 1]] - points[pairs[:, 0]], axis=1).astype(np.float32)
    ends = np.concatenate([pairs, pairs[:, ::-1]])
    table = coo_array((np.tile(lengths, 2), ends.T), shape=(len(points), len(points))).tocsr()
    table.sort_indices()
    return Roads(points, normals, table.indptr.astype(np.int32), table.indices.astype(np.int32), table.data)


def connected(
    roadmap: Roadmap, level: Level, start: Float[np.ndarray, "3"], goals: Float[np.ndarray, "k 3"]
) -> Bool[np.ndarray, "k"]:
    """Goals that may be in the connected part of a start [m]: all but those whose cell is certainly in another one."""
    shape, side = np.array(level.components.shape), roadmap.field.frame[6]
    cells = np.floor((np.concatenate([start[None], goals]) - roadmap.field.frame[3:6]) / side).astype(np.int64)
    labels = level.components[tuple(np.clip(cells, 0, shape - 1).T)]
    return (labels[1:] == labels[0]) | (labels[1:] == 0) | (labels[0] == 0)
