"""Pull a path over places taut (host, compiled into the search).

The places stand a little off the surface and at a few heights only. So the bends of a path are moved, along the surface
first and then towards it, as long as both neighbours see them there.

The functions take the search under way, of which they read the field, the limit and the limit near the start.
"""

from typing import no_type_check

from jaxplan.search.kernels.cells import at, distance
from jaxplan.search.kernels.compiled import inner
from jaxplan.search.kernels.sight import NOTHING, keeps_clear, still_blocks, what_blocks
from jaxplan.search.kernels.solids import clearance_at

SWEEPS = 3
"""Times that every bend is moved (arbitrary)."""


@inner
@no_type_check
def put(path, i, p):
    """Write one point."""
    path[i, 0], path[i, 1], path[i, 2] = p[0], p[1], p[2]


@inner
@no_type_check
def tighten(s, path, normals, bends):
    """Move the bends 1 .. ``bends`` so that the path gets shorter, drop needless ones; returns how many are left."""
    for _ in range(SWEEPS):
        for i in range(1, bends + 1):
            _shorten(s, path, normals, i)
    kept = 0
    for i in range(1, bends + 1):
        if not _sees(s, path, kept, at(path, i + 1)):
            kept += 1
            put(path, kept, at(path, i))
            put(normals, kept, at(normals, i))
    put(path, kept + 1, at(path, bends + 1))
    return kept


@inner
@no_type_check
def _shorten(s, path, normals, i):
    """Move one bend towards the line between its neighbours: along the surface, then down to it."""
    a, p, b = at(path, i - 1), at(path, i), at(path, i + 1)
    nx, ny, nz = at(normals, i)
    to_a, to_b = distance(a, p), distance(p, b)
    share = to_a / max(to_a + to_b, 1e-9)
    mx = a[0] + share * (b[0] - a[0]) - p[0]
    my = a[1] + share * (b[1] - a[1]) - p[1]
    mz = a[2] + share * (b[2] - a[2]) - p[2]
    rise = mx * nx + my * ny + mz * nz
    tx, ty, tz = mx - rise * nx, my - rise * ny, mz - rise * nz
    before = after = NOTHING
    if tx * tx + ty * ty + tz * tz > 1e-5:
        before, after = _move(s, path, i, (p[0] + tx, p[1] + ty, p[2] + tz), before, after)
    p = at(path, i)
    sink = max(rise, s.limit - clearance_at(s.field[3], p[0], p[1], p[2]))
    while sink < -5e-3:
        sunk = p[0] + sink * nx, p[1] + sink * ny, p[2] + sink * nz
        before, after = _move(s, path, i, sunk, before, after)
        if before == NOTHING and after == NOTHING:
            break
        sink *= 0.7


@inner
@no_type_check
def _move(s, path, i, p, before, after):
    """Move bend ``i`` to p [m] if its neighbours see it there; what is in the way from one of them, and to the other.

    ``before`` and ``after`` were the last time, and are looked at first.
    """
    here, there, near = at(path, i - 1), at(path, i + 1), s.near if i == 1 else s.limit
    if still_blocks(s.field, near, here, p, before) or still_blocks(s.field, s.limit, p, there, after):
        return before, after
    before = what_blocks(s.field, near, here, p)
    if before != NOTHING:
        return before, after
    after = what_blocks(s.field, s.limit, p, there)
    if after == NOTHING:
        put(path, i, p)
    return before, after


@inner
@no_type_check
def _sees(s, path, i, p):
    """Whether point ``i`` of a path sees p [m]; the start may be nearer to obstacles than the limit."""
    return keeps_clear(s.field, s.near if i == 0 else s.limit, at(path, i), p)


@inner
@no_type_check
def last_needed(s, path, bends, goal):
    """The first of the last bends from which on a path sees a goal; -1 if not even the last one does."""
    kept = bends + 1
    while kept > 0 and _sees(s, path, kept - 1, goal):
        kept -= 1
    return kept if kept <= bends else -1
