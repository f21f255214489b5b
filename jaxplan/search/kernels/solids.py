"""What is solid in a room as flat arrays, and the exact clearance of single points (host, compiled into the search).

The distances of ``jaxplan.world.clearance``, which says why they hold; here point by point, for code that decides after
every point where to look next. Distances beyond ``REACH`` count as ``REACH``: primitives are found by bins.
"""

import functools
import math
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float, Float32, Int8, Int32

from jaxplan.search.kernels.cells import centre_of, flat, index
from jaxplan.search.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.graph import Frame, make_frame
from jaxplan.world.obstacles import DistanceGrid, Mesh, World

REACH = 1.5
"""m; larger distances count as this one (arbitrary: three times the paper's padding)."""
BIN = 1.0
"""m; side of the bins (arbitrary)."""
NEAR = 0.5 * math.sqrt(3.0)
"""From the middle of a bin to its corners, as a share of its side."""
BOX, CYLINDER, PLANE, SPHERE, CAPSULE = range(5)


class Solids(NamedTuple):
    """All that is solid in a room. Compiled code takes it as a plain tuple."""

    kinds: Int8[np.ndarray, "n"]
    numbers: Float[np.ndarray, "n 16"]
    """Box: centre, half sides, rotation by rows. Cylinder and capsule: centre, axis, radius, half length. Plane:
    normal, offset. Sphere: centre, radius. Then zeros."""
    boxes: Float[np.ndarray, "n 6"]
    """Lower and upper corner of the box around each [m]; a plane's is larger than any room."""
    first: Int32[np.ndarray, "bins"]
    """By bin, where its members begin; one entry more."""
    members: Int32[np.ndarray, "m"]
    """Primitives within ``REACH`` of each bin."""
    bins: tuple
    """Frame of the bins."""
    mesh: Float32[np.ndarray, "nx ny nz"]
    """Squared distances to the mesh [m^2] at nodes of a grid; no nodes where there is no mesh."""
    mesh_frame: tuple
    """Cell (i, j, m) of this frame begins at node (i, j, m)."""
    voxels: Float32[np.ndarray, "mx my mz"]
    """The same for occupied cells."""
    voxels_frame: tuple


def solids_of(world: World) -> Solids:
    """The obstacles of a world for compiled code."""
    kinds, numbers = _primitives(world)
    lower, upper = np.asarray(world.bounds, dtype=np.float64)
    bins = make_frame(tuple(np.ceil((upper - lower) / BIN).astype(int).tolist()), lower, BIN)
    boxes = _boxes(kinds, numbers)
    first, members = _compiled_bins()(kinds, numbers, boxes, tuple(bins))
    return Solids(kinds, numbers, boxes, first, members, tuple(bins), *_nodes(world.mesh), *_nodes(world.voxels))


def _primitives(world: World) -> tuple[Int8[np.ndarray, "n"], Float[np.ndarray, "n 16"]]:
    """All primitives, a row of numbers each."""
    box, plane, sphere = world.boxes, world.planes, world.spheres
    columns = {
        BOX: (box.center, box.half, box.rotation),
        PLANE: (plane.normal, plane.offset),
        SPHERE: (sphere.center, sphere.radius),
    }
    for kind, one in ((CYLINDER, world.cylinders), (CAPSULE, world.capsules)):
        columns[kind] = (one.center, one.axis, one.radius, one.half_length)
    kinds, rows = [], []
    for kind, parts in columns.items():
        count = len(parts[0])
        row = np.zeros((count, 16))
        flat = np.concatenate([np.asarray(part, float).reshape(count, -1) for part in parts], axis=1) if count else row
        row[:, : flat.shape[1]] = flat
        kinds.append(np.full(count, kind, np.int8))
        rows.append(row)
    return np.concatenate(kinds), np.concatenate(rows)


def _boxes(kinds: Int8[np.ndarray, "n"], numbers: Float[np.ndarray, "n 16"]) -> Float[np.ndarray, "n 6"]:
    """Boxes around primitives [m], along the room's axes."""
    half = np.full((len(kinds), 3), 1e9)
    box, sphere = kinds == BOX, kinds == SPHERE
    half[box] = (np.abs(numbers[box, 6:15].reshape(-1, 3, 3)) @ numbers[box, 3:6, None])[..., 0]
    half[sphere] = numbers[sphere, 3:4]
    for kind in (CYLINDER, CAPSULE):
        rows = numbers[kinds == kind]
        axis, radius, length = np.abs(rows[:, 3:6]), rows[:, 6:7], rows[:, 7:8]
        across = np.sqrt(np.maximum(1.0 - axis**2, 0.0)) if kind == CYLINDER else 1.0
        half[kinds == kind] = length * axis + radius * across
    centre = np.where((kinds == PLANE)[:, None], 0.0, numbers[:, :3])
    return np.concatenate([centre - half, centre + half], axis=1)


def _nodes(grid: Mesh | DistanceGrid | None) -> tuple[Float32[np.ndarray, "nx ny nz"], tuple]:
    """Squared distances and where they are; no node at all for no grid."""
    if grid is None:
        return np.zeros((0, 0, 0), np.float32), tuple(make_frame((1, 1, 1), np.zeros(3), 1.0))
    squared = np.ascontiguousarray(grid.squared, dtype=np.float32)
    return squared, tuple(make_frame(squared.shape, np.asarray(grid.origin), float(grid.spacing)))


@runtime_checkable
class _Bins(Protocol):
    """Which primitives are near each bin."""

    def __call__(
        self,
        kinds: Int8[np.ndarray, "n"],
        numbers: Float[np.ndarray, "n 16"],
        boxes: Float[np.ndarray, "n 6"],
        bins: tuple,
    ) -> tuple[Int32[np.ndarray, "b"], Int32[np.ndarray, "m"]]:
        """``first`` and ``members`` of ``Solids``."""


@functools.cache
def _compiled_bins() -> _Bins:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(kinds, numbers, boxes, bins):
        _ = version
        frame = Frame(*bins)
        first, members = np.zeros(frame.nx * frame.ny * frame.nz + 1, np.int32), np.empty(0, np.int32)
        free = first
        for turn in range(2):  # count, then write
            for n in range(len(kinds)):
                low, high = _bins_near(boxes[n], frame)
                for i in range(low[0], high[0]):
                    for j in range(low[1], high[1]):
                        for m in range(low[2], high[2]):
                            x, y, z = centre_of(frame, i, j, m)
                            if to_primitive(kinds[n], numbers[n], x, y, z) <= NEAR * frame.h + REACH:
                                b = flat(frame, i, j, m)
                                if turn == 0:
                                    first[b + 1] += 1
                                else:
                                    members[free[b]] = n
                                    free[b] += 1
            if turn == 0:
                first = np.cumsum(first).astype(np.int32)
                members, free = np.empty(first[-1], np.int32), first.copy()
        return first, members

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _bins_near(box, frame):
    """First and last bin, the last excluded, whose centres may be near the box around a primitive."""
    around = REACH + NEAR * frame.h
    return (
        (
            index(box[0] - around, frame.x, frame.h, frame.nx),
            index(box[1] - around, frame.y, frame.h, frame.ny),
            index(box[2] - around, frame.z, frame.h, frame.nz),
        ),
        (
            index(box[3] + around, frame.x, frame.h, frame.nx) + 1,
            index(box[4] + around, frame.y, frame.h, frame.ny) + 1,
            index(box[5] + around, frame.z, frame.h, frame.nz) + 1,
        ),
    )


@inner
@no_type_check
def clearance_at(solids, x, y, z):
    """Distance [m] from a point in the room to the nearest obstacle, at most ``REACH``; negative inside a primitive."""
    kinds, numbers, _, first, members, bins, mesh, mesh_frame, voxels, voxels_frame = solids
    nx, ny, nz, ox, oy, oz, h = bins
    b = (index(x, ox, h, nx) * ny + index(y, oy, h, ny)) * nz + index(z, oz, h, nz)
    least = REACH
    for at in range(first[b], first[b + 1]):
        n = members[at]
        least = min(least, to_primitive(kinds[n], numbers[n], x, y, z))
    if mesh.size > 0:
        least = min(least, to_grid(mesh, mesh_frame, x, y, z))
    if voxels.size > 0:
        least = min(least, to_grid(voxels, voxels_frame, x, y, z))
    return least


@inner
@no_type_check
def to_primitive(kind, row, x, y, z):
    """Signed distance [m] to one primitive."""
    if kind == PLANE:
        return row[0] * x + row[1] * y + row[2] * z - row[3]
    dx, dy, dz = x - row[0], y - row[1], z - row[2]
    if kind == SPHERE:
        return math.sqrt(dx * dx + dy * dy + dz * dz) - row[3]
    if kind == BOX:
        a = abs(row[6] * dx + row[9] * dy + row[12] * dz) - row[3]
        b = abs(row[7] * dx + row[10] * dy + row[13] * dz) - row[4]
        c = abs(row[8] * dx + row[11] * dy + row[14] * dz) - row[5]
        most = max(a, max(b, c))
        if most <= 0.0:
            return most
        a, b, c = max(a, 0.0), max(b, 0.0), max(c, 0.0)
        return math.sqrt(a * a + b * b + c * c)
    along = row[3] * dx + row[4] * dy + row[5] * dz
    rx, ry, rz = dx - along * row[3], dy - along * row[4], dz - along * row[5]
    across = rx * rx + ry * ry + rz * rz
    axial = abs(along) - row[7]
    if kind == CAPSULE:
        beyond = max(axial, 0.0)
        return math.sqrt(across + beyond * beyond) - row[6]
    radial = math.sqrt(across) - row[6]
    most = max(radial, axial)
    if most <= 0.0:
        return most
    radial, axial = max(radial, 0.0), max(axial, 0.0)
    return math.sqrt(radial * radial + axial * axial)


@inner
@no_type_check
def to_grid(squared, frame, x, y, z):
    """Lower bound of the distance [m] by squared distances at nodes, never negative."""
    nx, ny, nz, ox, oy, oz, h = frame
    i, u, du = in_cell((x - ox) / h, nx)
    j, v, dv = in_cell((y - oy) / h, ny)
    m, w, dw = in_cell((z - oz) / h, nz)
    low = (1.0 - v) * ((1.0 - w) * squared[i, j, m] + w * squared[i, j, m + 1]) + v * (
        (1.0 - w) * squared[i, j + 1, m] + w * squared[i, j + 1, m + 1]
    )
    high = (1.0 - v) * ((1.0 - w) * squared[i + 1, j, m] + w * squared[i + 1, j, m + 1]) + v * (
        (1.0 - w) * squared[i + 1, j + 1, m] + w * squared[i + 1, j + 1, m + 1]
    )
    correction = u * (1.0 - u) + v * (1.0 - v) + w * (1.0 - w)
    bound = (1.0 - u) * low + u * high - h * h * correction
    outside = h * math.sqrt(du * du + dv * dv + dw * dw)
    return max(math.sqrt(max(bound, 0.0)) - outside, outside)


@inner
@no_type_check
def in_cell(steps, nodes):
    """The cell between nodes along one axis, the fraction of it, and how far outside of all nodes, in cells."""
    held = min(max(steps, 0.0), nodes - 1.0)
    cell = min(int(held), nodes - 2)
    return cell, held - cell, steps - held
