"""Where shortest paths can bend: a few places around everything convex, and along narrow passages (host, compiled).

A path that is as short as possible is straight but where it touches something convex. So places are set close to the
surface at distance ``limit`` from the obstacles where that surface is convex, and so densely that neighbours see each
other: the closer, the stronger the surface turns; along an upright edge they are far apart. Passages hardly wider than
twice the limit get places in their middle, which lines from elsewhere would miss.

The room is divided into tiles, and the places of a tile depend on the clearances in and around that tile alone, so that
after a change only the tiles about it are looked at again.
"""

import functools
import math
from typing import Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from jaxplan.search.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.solids import clearance_at

OFF = 0.1
"""From the surface to the places, as a share of the limit. Around an edge two of them see each other up to a turn of
2 acos(1 / (1 + OFF)), 49 degrees."""
TURN = 0.39
"""rad; between the normals of neighbouring places of a curved surface."""
SPAN = 1.0
"""m; between neighbouring places along an edge."""
STEP = 0.5
"""m; between neighbouring places in a passage."""
REACH = 0.8
"""m; the places of a tile do not depend on obstacles farther away from it than the limit and this."""
_SHELL = 0.13
"""m; how far from the surface cells are looked at: more than a cell of the lattice."""
WIDE = 0.25
"""m; passages wider than twice the limit and this need no places."""
_SLOPE = 0.6
"""Slope of the clearance below which a cell is in the middle between obstacles; in a square corner it is 0.71."""
_PROBE = 0.3
"""m; to both sides, to see whether the surface is convex."""
_BULGE = 0.01
"""m; by how much the surface must fall back at that distance. A cylinder of radius R: 0.045 / R."""


@runtime_checkable
class _Places(Protocol):
    """The places of one tile."""

    def __call__(
        self,
        field: tuple,
        passages: tuple,
        surface: bool,
        lower: tuple,
        upper: tuple,
        begin: tuple,
        end: tuple,
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Positions [m] and outward normals, 0 in passages; in cells ``begin`` to ``end``, within the box [m]."""


def places_of(
    field: tuple,
    passages: tuple[float, float],
    surface: bool,
    room: Float[np.ndarray, "2 3"],
    begin: Int[np.ndarray, "3"],
    end: Int[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """The places of one tile: positions [m] and outward normals of the surface there, 0 in passages.

    ``field`` as a plain tuple; ``passages``: the least and the largest distance [m] from obstacles in their middle;
    ``surface``: whether there are also places around everything convex, at the least distance; ``room``: corners [m] of
    where the vehicle may be; the tile has the cells from ``begin`` to ``end``.
    """
    ends = (tuple(room[0].tolist()), tuple(room[1].tolist()), tuple(begin.tolist()), tuple(end.tolist()))
    return _compiled_places()(field, (float(passages[0]), float(passages[1])), surface, *ends)


@functools.cache
def _compiled_places() -> _Places:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(field, passages, surface, lower, upper, begin, end):
        _ = version
        limit = passages[0]
        count = max((end[0] - begin[0]) * (end[1] - begin[1]) * (end[2] - begin[2]), 0)
        shell, normals, ridge = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3))
        on_shell, on_ridge = _look(field, passages, surface, lower, upper, begin, end, shell, normals, ridge)
        chosen = np.empty(on_shell + on_ridge, np.int64)
        far = np.empty(on_shell + on_ridge)
        bends = _spread(shell, normals, on_shell, SPAN, chosen, far)
        points, outward = np.zeros((bends + on_ridge, 3)), np.zeros((bends + on_ridge, 3))
        total = 0
        for n in range(bends):
            c = chosen[n]
            total += _to_surface(field, limit, lower, upper, shell[c], points[total], outward[total])
        normals[:on_ridge] = 0.0
        middles = _spread(ridge, normals, on_ridge, STEP, chosen, far)
        for n in range(middles):
            total += _to_middle(field, limit, lower, upper, ridge[chosen[n]], points[total], outward[total])
        return points[:total].copy(), outward[:total].copy()

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _look(field, passages, surface, lower, upper, begin, end, shell, normals, ridge):
    """Cells near a convex surface, with its normals, and cells in the middle of passages."""
    values, frame, _, solids = field
    limit, widest = passages
    _, _, _, ox, oy, oz, h = frame
    on_shell = on_ridge = 0
    for i in range(begin[0], end[0]):
        for j in range(begin[1], end[1]):
            for m in range(begin[2], end[2]):
                value = values[i, j, m]
                if not limit - 0.87 * h <= value <= widest:  # a free point's cell may have a centre that is not
                    continue
                x, y, z = ox + (i + 0.5) * h, oy + (j + 0.5) * h, oz + (m + 0.5) * h
                if not _inside(x, y, z, lower, upper):
                    continue
                gx, gy, gz = _slope_at_cell(values, solids, (i, j, m), (x, y, z), h)
                steep = math.sqrt(gx * gx + gy * gy + gz * gz)
                if steep < _SLOPE:
                    ridge[on_ridge, 0], ridge[on_ridge, 1], ridge[on_ridge, 2] = x, y, z
                    on_ridge += 1
                elif surface and limit <= value <= limit + _SHELL:
                    gx, gy, gz = gx / steep, gy / steep, gz / steep
                    if _is_convex(solids, x, y, z, gx, gy, gz):
                        shell[on_shell, 0], shell[on_shell, 1], shell[on_shell, 2] = x, y, z
                        normals[on_shell, 0], normals[on_shell, 1], normals[on_shell, 2] = gx, gy, gz
                        on_shell += 1
    return on_shell, on_ridge


@inner
@no_type_check
def _inside(x, y, z, lower, upper):
    """Whether a point is in the box."""
    return lower[0] <= x <= upper[0] and lower[1] <= y <= upper[1] and lower[2] <= z <= upper[2]


@inner
@no_type_check
def _slope_at_cell(values, solids, cell, centre, h):
    """Gradient of the clearance at a cell's centre, by the clearances of the cells around where there are six."""
    nx, ny, nz = values.shape
    i, j, m = cell
    if 0 < i < nx - 1 and 0 < j < ny - 1 and 0 < m < nz - 1:
        return (
            (values[i + 1, j, m] - values[i - 1, j, m]) / (2.0 * h),
            (values[i, j + 1, m] - values[i, j - 1, m]) / (2.0 * h),
            (values[i, j, m + 1] - values[i, j, m - 1]) / (2.0 * h),
        )
    return _slope(solids, centre[0], centre[1], centre[2], h)


@inner
@no_type_check
def _slope(solids, x, y, z, h):
    """Gradient of the clearance by central differences over two times ``h`` [m]."""
    return (
        (clearance_at(solids, x + h, y, z) - clearance_at(solids, x - h, y, z)) / (2.0 * h),
        (clearance_at(solids, x, y + h, z) - clearance_at(solids, x, y - h, z)) / (2.0 * h),
        (clearance_at(solids, x, y, z + h) - clearance_at(solids, x, y, z - h)) / (2.0 * h),
    )


@inner
@no_type_check
def _is_convex(solids, x, y, z, gx, gy, gz):
    """Whether the surface with this normal falls back to both sides by ``_BULGE`` in one of four directions."""
    if abs(gz) < 0.9:  # one tangent level, the other up
        flat = math.sqrt(gx * gx + gy * gy)
        ax, ay, az = -gy / flat, gx / flat, 0.0 * gz
    else:
        flat = math.sqrt(gx * gx + gz * gz)
        ax, ay, az = gz / flat, 0.0 * gy, -gx / flat
    bx, by, bz = gy * az - gz * ay, gz * ax - gx * az, gx * ay - gy * ax
    here = clearance_at(solids, x, y, z)
    for turn in range(4):
        c, s = math.cos(0.25 * math.pi * turn) * _PROBE, math.sin(0.25 * math.pi * turn) * _PROBE
        dx, dy, dz = c * ax + s * bx, c * ay + s * by, c * az + s * bz
        there = clearance_at(solids, x + dx, y + dy, z + dz) + clearance_at(solids, x - dx, y - dy, z - dz)
        if 0.5 * there - here >= _BULGE:
            return True
    return False


@inner
@no_type_check
def _spread(points, normals, count, span, chosen, far):
    """Choose points none of which are near each other; returns how many.

    Near: closer than ``span`` [m], and their normals closer than ``TURN``. Next comes always the one that is nearest to
    those chosen before: so gaps are hardly wider than they must be.
    """
    for c in range(count):
        far[c] = np.inf
    total, following = 0, 0 if count > 0 else -1
    while following >= 0:
        best, following, least = following, -1, np.inf
        chosen[total] = best
        total += 1
        for c in range(count):
            if far[c] < 1.0:
                continue
            dx, dy, dz = points[c, 0] - points[best, 0], points[c, 1] - points[best, 1], points[c, 2] - points[best, 2]
            apart = math.sqrt(dx * dx + dy * dy + dz * dz) / span
            if apart < far[c]:
                ex = normals[c, 0] - normals[best, 0]
                ey = normals[c, 1] - normals[best, 1]
                ez = normals[c, 2] - normals[best, 2]
                angle = 2.0 * math.asin(min(0.5 * math.sqrt(ex * ex + ey * ey + ez * ez), 1.0))
                far[c] = min(far[c], max(apart, angle / TURN))
            if far[c] >= 1.0 and (following < 0 or far[c] < least):
                following, least = c, far[c]
    return total


@inner
@no_type_check
def _to_surface(field, limit, lower, upper, cell, point, normal):
    """Move a cell's centre to its distance from the surface, less where something else is close; 1 if there is room."""
    solids = field[3]
    x, y, z = cell[0], cell[1], cell[2]
    gx = gy = gz = 0.0
    off = OFF * limit
    while off > 2e-3:
        for _ in range(2):
            gx, gy, gz = _slope(solids, x, y, z, 0.01)
            steep = max(math.sqrt(gx * gx + gy * gy + gz * gz), 1e-6)
            gx, gy, gz = gx / steep, gy / steep, gz / steep
            move = limit + off - clearance_at(solids, x, y, z)
            x, y, z = x + gx * move, y + gy * move, z + gz * move
        point[0] = min(max(x, lower[0]), upper[0])
        point[1] = min(max(y, lower[1]), upper[1])
        point[2] = min(max(z, lower[2]), upper[2])
        normal[0], normal[1], normal[2] = gx, gy, gz
        if clearance_at(solids, point[0], point[1], point[2]) >= limit:
            return 1
        x, y, z, off = cell[0], cell[1], cell[2], 0.5 * off
    return 0


@inner
@no_type_check
def _to_middle(field, limit, lower, upper, cell, point, normal):
    """Move a cell's centre to where the clearance is largest nearby; 1 if that is enough."""
    solids = field[3]
    x, y, z = cell[0], cell[1], cell[2]
    best, step = clearance_at(solids, x, y, z), 0.04
    while step > 0.004:
        moved = False
        for axis in range(6):
            d = step if axis % 2 == 0 else -step
            px, py, pz = x, y, z
            if axis < 2:
                px = x + d
            elif axis < 4:
                py = y + d
            else:
                pz = z + d
            if _inside(px, py, pz, lower, upper):
                there = clearance_at(solids, px, py, pz)
                far = max(abs(px - cell[0]), max(abs(py - cell[1]), abs(pz - cell[2])))
                if there > best + 1e-6 and far <= field[1][6]:
                    x, y, z, best, moved = px, py, pz, there, True
        if not moved:
            step *= 0.5
    point[0], point[1], point[2] = x, y, z
    normal[0], normal[1], normal[2] = 0.0, 0.0, 0.0
    return 1 if best >= limit else 0
