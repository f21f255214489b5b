"""OctoMap's binary trees (``.bt``), metres, z up.

A text header, then the tree depth first: two bits for each of a node's eight children (1 free, 2 occupied, 3 an inner
node that follows, 0 unknown). Child i lies on the upper side in x, y, z where bit 0, 1, 2 of i is set; cells of the
lowest of the 16 levels have the side ``res``. The room is the box around all known cells. What nobody has seen is
occupied: a vehicle must not fly where a wall may be.
"""

import re
from array import array
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from jaxplan.errors import FileError
from jaxplan.world.formats.streams import ByteStream
from jaxplan.world.obstacles import World
from jaxplan.world.voxels import check_cells, voxel_world

DEPTH = 16
_HEADER = re.compile(rb"\A# Octomap OcTree binary file\s*\n(?:[^\n]*\n){0,64}?data\s?\n")
_FREE, _OCCUPIED, _INNER = 1, 2, 3
_MAX_HEADER = 4096
MAX_LEAVES = 2**21
"""16 MB while they are read; arbitrary, four times a building of 39 x 15 m at 5 cm."""


class _Leaves(NamedTuple):
    """Known leaves: lower corner in cells from the tree's lower corner, side in cells, and whether occupied."""

    corner: Int[np.ndarray, "n 3"]
    side: Int[np.ndarray, "n"]
    occupied: Bool[np.ndarray, "n"]


def load_octomap(path: Path, stream: ByteStream) -> World:
    """The world of an OctoMap binary tree; unknown cells are occupied."""
    resolution, body = _header(path, stream.read())
    leaves = _read_tree(path, body)
    sides = np.unique(leaves.side)
    first = leaves.corner.min(axis=0).astype(int)
    last = np.max([leaves.corner[leaves.side == side].max(axis=0).astype(int) + int(side) for side in sides], axis=0)
    check_cells(path, (last - first).astype(float), resolution)
    occupied = np.ones(tuple(last - first), dtype=bool)
    for side in sides:
        chosen = ~leaves.occupied & (leaves.side == side)
        _clear(occupied, leaves.corner[chosen] - first, int(side))
    origin = (first - 2 ** (DEPTH - 1)) * resolution
    kind = f"OctoMap, {len(leaves.side)} known leaves, cells of {resolution:g} m, unknown cells occupied"
    return voxel_world(path, kind, occupied, origin, resolution)


def _clear(occupied: Bool[np.ndarray, "nx ny nz"], corner: Int[np.ndarray, "n 3"], side: int) -> None:
    """Free the cubes of ``side`` cells; the few large ones one by one."""
    if side > 4:
        for x, y, z in corner:
            occupied[x : x + side, y : y + side, z : z + side] = False
        return
    for i in range(side):
        for j in range(side):
            for k in range(side):
                occupied[corner[:, 0] + i, corner[:, 1] + j, corner[:, 2] + k] = False


def _header(path: Path, data: bytes) -> tuple[float, memoryview]:
    """Side of the smallest cells [m], and the bytes of the tree."""
    match = _HEADER.match(data[:_MAX_HEADER])
    fields = dict(re.findall(rb"^(id|res|size) +(\S+)\s*$", match.group(), re.MULTILINE)) if match else {}
    try:
        resolution = float(fields.get(b"res", b"nan"))
    except ValueError:
        resolution = np.nan
    if match is None or fields.get(b"id") != b"OcTree" or not 1e-3 <= resolution <= 1e2:
        raise FileError(
            f"{path}: have no OctoMap binary header, want '# Octomap OcTree binary file', 'id OcTree', "
            "'res METRES' and 'data' lines; write it with writeBinary"
        )
    return resolution, memoryview(data)[match.end() :]


def _read_tree(path: Path, body: memoryview) -> _Leaves:
    """All known leaves, by one pass over the nodes."""
    corners, sides, states = array("H"), array("H"), array("B")
    stack, position, end = [(0, 0, 0, 2**DEPTH)], 0, len(body)
    while stack:
        x, y, z, side = stack.pop()
        if position + 2 > end or side < 2:
            what = "ends in the middle of the tree" if side >= 2 else f"has more than {DEPTH} levels"
            raise FileError(f"{path}: the OctoMap {what}, want a whole tree; copy the file again")
        bits = body[position] | body[position + 1] << 8
        position, half = position + 2, side // 2
        inner = []
        for child in range(8):
            state = bits >> 2 * child & 3
            if state == 0:
                continue
            corner = (x + half * (child & 1), y + half * (child >> 1 & 1), z + half * (child >> 2))
            if state == _INNER:
                inner.append((*corner, half))
            else:
                corners.extend(corner)
                sides.append(half)
                states.append(state)
        if len(sides) > MAX_LEAVES:
            raise FileError(f"{path}: have more than {MAX_LEAVES} known leaves; prune the map, or make it coarser")
        stack.extend(reversed(inner))
    if position != end or not corners:
        what = f"{end - position} bytes after the tree" if corners else "no known cell"
        raise FileError(f"{path}: the OctoMap has {what}, want one whole tree; write it again")
    leaves = np.frombuffer(corners, np.uint16).reshape(-1, 3), np.frombuffer(sides, np.uint16)
    return _Leaves(*leaves, np.frombuffer(states, np.uint8) == _OCCUPIED)
