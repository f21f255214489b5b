"""Arithmetic of cells and points, compiled into the search: once, because each function costs a tenth of a second."""

import math
from typing import no_type_check

from jaxplan.search.kernels.compiled import inner
from jaxplan.search.kernels.graph import STEPS


@inner
@no_type_check
def index(x, origin, h, count):
    """The cell along one axis; the nearest one for a point on or beyond the lattice's outer faces."""
    cell = math.floor((x - origin) / h)
    if cell < 0:
        return 0
    return cell if cell < count else count - 1


@inner
@no_type_check
def flat(frame, i, j, m):
    """A cell's number in C order."""
    return (i * frame.ny + j) * frame.nz + m


@inner
@no_type_check
def indices(frame, cell):
    """A cell's indices from its number in C order."""
    row = cell // frame.nz
    return row // frame.ny, row % frame.ny, cell - row * frame.nz


@inner
@no_type_check
def centre_of(frame, i, j, m):
    """A cell's centre [m, world]."""
    return frame.x + (i + 0.5) * frame.h, frame.y + (j + 0.5) * frame.h, frame.z + (m + 0.5) * frame.h


@inner
@no_type_check
def neighbour(frame, i, j, m, number):
    """The cell itself (26) or its neighbour by one of ``STEPS`` (0..25), as a number in C order; -1 outside."""
    if number < 26:
        i, j, m = i + STEPS[number, 0], j + STEPS[number, 1], m + STEPS[number, 2]
    if i < 0 or j < 0 or m < 0 or i >= frame.nx or j >= frame.ny or m >= frame.nz:
        return -1
    return (i * frame.ny + j) * frame.nz + m


@inner
@no_type_check
def at(points, k):
    """Point k [m]."""
    return points[k, 0], points[k, 1], points[k, 2]


@inner
@no_type_check
def put(points, k, position, p):
    """Write point p [m] as number ``position`` of row k."""
    points[k, position, 0], points[k, position, 1], points[k, position, 2] = p


@inner
@no_type_check
def distance(p, q):
    """Distance between two points [m]."""
    return math.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)
