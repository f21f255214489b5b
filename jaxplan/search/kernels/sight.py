"""Lines of sight that keep an exact distance from obstacles (host, compiled into the search).

Where there are few primitives each is tested on its own. Meshes, cells and many primitives are traced: a segment is
followed in steps as long as the clearance allows. The clearances of the finest lattice's centres, known beforehand,
decide nearly all steps: clearance changes by no more than the way to the centre. Where they leave it open the exact
clearance is asked.

Where the clearance is hardly more than the limit r, no step is shorter than s = sqrt(8 r ``MISSED``). Obstacles are
outside of balls of radius r about both ends of a step, so every point of it keeps at least r - s^2 / (8 r) = r -
``MISSED``.
"""

import functools
import math
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from jaxplan.search.kernels.cells import at, index
from jaxplan.search.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.graph import Frame
from jaxplan.search.kernels.line_of_sight import crosses_only
from jaxplan.search.kernels.solids import clearance_at, to_primitive

MISSED = 4e-4
"""m; by how much a segment may come closer between the points that are looked at."""
SLACK = 4e-4
"""m; by how much the points that are looked at may fall short of the limit."""


FEW = 64
"""Up to so many primitives are tested one by one."""
ROUNDED = 1e-5
"""m; by how much a stored clearance may differ from the exact one: it has single precision."""
HALF_DIAGONAL = 0.5 * math.sqrt(3.0)
"""Of a cell with side 1."""
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)

NOTHING, CELLS = np.int64(-1), np.int64(-2)
"""Answers of ``what_blocks`` that are no primitive: what else is solid has no number."""
Box = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]
"""Lower and upper corner [m]."""
EVERYWHERE: Box = np.full(3, -np.inf), np.full(3, np.inf)


class Field(NamedTuple):
    """Clearances at the centres of the finest lattice's cells. Compiled code takes it as a plain tuple."""

    values: Float32[np.ndarray, "nx ny nz"]
    """[m], at most ``solids.REACH``."""
    frame: tuple
    shortfall: float
    """By how much the clearance between centres may be below what the distance to a centre suggests [m]: 0 for
    primitives, up to sqrt(3) cells for worlds of cells (``jaxplan.world.clearance``)."""
    solids: tuple


@inner
@no_type_check
def keeps_clear(field, limit, a, b):
    """Whether all points of the segment a-b [m] keep the distance ``limit`` [m] from obstacles, if its ends do."""
    solids = field[3]
    few = len(solids[0]) <= FEW
    if few and _is_blocked(solids, limit, a, b):
        return False
    return (few and solids[6].size == 0 and solids[8].size == 0) or follows_clear(field, limit, a, b)


@inner
@no_type_check
def what_blocks(field, limit, a, b):
    """As ``keeps_clear``, but tells what stands in the way: a number of a primitive, ``CELLS``, or ``NOTHING``."""
    solids = field[3]
    few = len(solids[0]) <= FEW
    if few:
        way, fine = _way(limit, a, b)
        for n in range(len(solids[0])):
            if _too_close(solids[0][n], solids[1][n], solids[2][n], limit, a, way, fine):
                return n
    clear = (few and solids[6].size == 0 and solids[8].size == 0) or follows_clear(field, limit, a, b)
    return NOTHING if clear else CELLS


@inner
@no_type_check
def still_blocks(field, limit, a, b, n):
    """Whether a segment comes too close to one primitive, that was in the way before; never where ``n`` is none's."""
    if n < 0:
        return False
    solids = field[3]
    way, fine = _way(limit, a, b)
    return _too_close(solids[0][n], solids[1][n], solids[2][n], limit, a, way, fine)


@inner
@no_type_check
def too_close_among(kinds, numbers, boxes, limit, a, b, likely, members):
    """A primitive to which a segment comes too close, of the ``members``; -1 for none.

    The ``likely`` one is looked at first, if any: what is in the way of one segment mostly is in that of the next.
    """
    way, fine = _way(limit, a, b)
    if likely >= 0 and _too_close(kinds[likely], numbers[likely], boxes[likely], limit, a, way, fine):
        return likely
    for n in members:
        if n != likely and _too_close(kinds[n], numbers[n], boxes[n], limit, a, way, fine):
            return n
    return -1


@inner
@no_type_check
def _is_blocked(solids, limit, a, b):
    """Whether a segment comes too close to any primitive."""
    way, fine = _way(limit, a, b)
    n, end = 0, len(solids[0])
    while n < end and not _too_close(solids[0][n], solids[1][n], solids[2][n], limit, a, way, fine):
        n += 1
    return n < end


@inner
@no_type_check
def _way(limit, a, b):
    """A segment as ``_too_close`` takes it, and the share of it that is not divided any further."""
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    way = dx, dy, dz, _inverse(dx), _inverse(dy), _inverse(dz), length
    return way, math.sqrt(8.0 * limit * MISSED) / max(length, 1e-9)


@inner
@no_type_check
def _too_close(kind, row, box, limit, a, way, fine):
    """Whether a segment from a comes too close to one primitive, whose distance is a convex function along it.

    Only where the segment is in the primitive's box, grown by the limit, can it be too close. Its least distance there
    is found by golden sections.
    """
    dx, dy, dz, ix, iy, iz, length = way
    low, high = (box[0] - limit - a[0]) * ix, (box[3] + limit - a[0]) * ix
    begin, end = max(0.0, min(low, high)), min(1.0, max(low, high))
    low, high = (box[1] - limit - a[1]) * iy, (box[4] + limit - a[1]) * iy
    begin, end = max(begin, min(low, high)), min(end, max(low, high))
    low, high = (box[2] - limit - a[2]) * iz, (box[5] + limit - a[2]) * iz
    begin, end = max(begin, min(low, high)), min(end, max(low, high))
    if begin > end:
        return False
    least = limit - SLACK
    s, t = end - GOLDEN * (end - begin), begin + GOLDEN * (end - begin)
    at_s = to_primitive(kind, row, a[0] + s * dx, a[1] + s * dy, a[2] + s * dz)
    at_t = to_primitive(kind, row, a[0] + t * dx, a[1] + t * dy, a[2] + t * dz)
    while at_s >= least and at_t >= least and end - begin > fine:
        if (at_s + at_t - (t - s + 2.0 * (end - t)) * length) * 0.5 >= least:
            break
        if at_s < at_t:
            end, t, at_t = t, s, at_s
            s = end - GOLDEN * (end - begin)
            at_s = to_primitive(kind, row, a[0] + s * dx, a[1] + s * dy, a[2] + s * dz)
        else:
            begin, s, at_s = s, t, at_t
            t = begin + GOLDEN * (end - begin)
            at_t = to_primitive(kind, row, a[0] + t * dx, a[1] + t * dy, a[2] + t * dz)
    return not (at_s >= least and at_t >= least)


@inner
@no_type_check
def _inverse(x):
    """1 / x, finite."""
    return 1.0 / x if abs(x) > 1e-12 else 1e12


@inner
@no_type_check
def follows_clear(field, limit, a, b):
    """As ``keeps_clear`` for all that is solid, in steps as long as the clearance allows."""
    values, frame, shortfall, solids = field
    nx, ny, nz, ox, oy, oz, h = frame
    closed = limit - SLACK - HALF_DIAGONAL * h - shortfall  # a cell with this clearance is too close all over
    if not crosses_only(values, -1.0, -closed, Frame(nx, ny, nz, ox, oy, oz, h), a, b):
        return False
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    inverse = 1.0 / max(length, 1e-12)
    least, least_step = limit - SLACK, math.sqrt(8.0 * limit * MISSED)
    if shortfall > 0.0:  # a bound that has kinks between its nodes
        least_step *= 0.5
    t = 0.0
    while True:
        s = t * inverse
        x, y, z = a[0] + s * dx, a[1] + s * dy, a[2] + s * dz
        i, j, m = index(x, ox, h, nx), index(y, oy, h, ny), index(z, oz, h, nz)
        u, v, w = x - (ox + (i + 0.5) * h), y - (oy + (j + 0.5) * h), z - (oz + (m + 0.5) * h)
        off = math.sqrt(u * u + v * v + w * w)
        value = values[i, j, m]
        known = value - off - shortfall
        if known < limit + least_step:
            if value + off + shortfall < least:
                return False
            exact = clearance_at(solids, x, y, z)
            if exact < least:
                return False
            known = exact - shortfall
        if t >= length:
            return True
        t = min(t + max(known - limit, least_step), length)


@runtime_checkable
class _Fill(Protocol):
    """Clearances of a part of a lattice."""

    def __call__(
        self,
        values: Float32[np.ndarray, "nx ny nz"],
        frame: tuple,
        solids: tuple,
        begin: tuple,
        end: tuple,
        lower: tuple,
        upper: tuple,
    ) -> bool:
        """Write ``values`` [m] of the cells from ``begin`` to ``end``; whether any grew."""


def fill(
    values: Float32[np.ndarray, "nx ny nz"],
    frame: tuple,
    solids: tuple,
    begin: Int[np.ndarray, "3"],
    end: Int[np.ndarray, "3"],
    changed: Box = EVERYWHERE,
) -> bool:
    """Write the clearances [m] at the centres of the cells from ``begin`` to ``end``; whether any is more than before.

    Obstacles have changed in a box [m] only: farther from it than a clearance was it stays what it was.
    """
    corners = tuple(changed[0].tolist()), tuple(changed[1].tolist())
    return _compiled_fill()(values, frame, solids, tuple(begin.tolist()), tuple(end.tolist()), *corners)


@functools.cache
def _compiled_fill() -> _Fill:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(values, frame, solids, begin, end, lower, upper):
        _ = version
        _, _, _, ox, oy, oz, h = frame
        more = False
        for i in range(begin[0], end[0]):
            x = ox + (i + 0.5) * h
            dx = max(lower[0] - x, max(x - upper[0], 0.0))
            for j in range(begin[1], end[1]):
                y = oy + (j + 0.5) * h
                dy = max(lower[1] - y, max(y - upper[1], 0.0))
                for m in range(begin[2], end[2]):
                    z = oz + (m + 0.5) * h
                    dz = max(lower[2] - z, max(z - upper[2], 0.0))
                    before = max(values[i, j, m], 0.0) + ROUNDED
                    if dx * dx + dy * dy + dz * dz > before * before:
                        continue
                    value = np.float32(clearance_at(solids, x, y, z))
                    more |= value > values[i, j, m]
                    values[i, j, m] = value
        return more

    return entry  # type: ignore[no-any-return]


@runtime_checkable
class _Clear(Protocol):
    """Which of many paths keep their distance."""

    def __call__(
        self,
        field: tuple,
        limit: float,
        points: Float[np.ndarray, "k capacity 3"],
        first: Int[np.ndarray, "k"],
        clear: Bool[np.ndarray, "k"],
    ) -> None:
        """Write ``clear``: of each path from point ``first`` on."""


def paths_keep_clear(
    field: Field, limit: float, points: Float[np.ndarray, "k capacity 3"], first: Int[np.ndarray, "k"]
) -> Bool[np.ndarray, "k"]:
    """Which of these paths [m] keep the distance ``limit`` [m] from obstacles, each from point ``first`` on."""
    clear = np.zeros(len(points), dtype=bool)
    _compiled_clear()(tuple(field), float(limit), points, first, clear)
    return clear


@functools.cache
def _compiled_clear() -> _Clear:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(field, limit, points, first, clear):
        _ = version
        for k in range(len(points)):
            good = True
            for i in range(first[k], points.shape[1] - 1):
                good = good and keeps_clear(field, limit, at(points[k], i), at(points[k], i + 1))
            clear[k] = good

    return entry  # type: ignore[no-any-return]


@runtime_checkable
class _Clearances(Protocol):
    """Exact clearances of points."""

    def __call__(self, solids: tuple, points: Float[np.ndarray, "n 3"], found: Float[np.ndarray, "n"]) -> None:
        """Write ``found`` [m]."""


def clearances(solids: tuple, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """Distances [m] from points in the room to the nearest obstacle, at most ``solids.REACH``."""
    found = np.zeros(len(points))
    points = np.ascontiguousarray(points)  # another layout would be another program, compiled in flight
    _compiled_clearances()(solids, points, found)
    return found


@functools.cache
def _compiled_clearances() -> _Clearances:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(solids, points, found):
        _ = version
        for n in range(len(points)):
            found[n] = clearance_at(solids, points[n, 0], points[n, 1], points[n, 2])

    return entry  # type: ignore[no-any-return]
