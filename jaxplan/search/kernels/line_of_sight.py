"""Lines of sight on a lattice (host, compiled into the search).

A segment is followed from cell to cell through the face that it leaves by, so no cell that it crosses is missed,
however small the corner that it cuts.
"""

from typing import no_type_check

import numpy as np

from jaxplan.search.kernels.cells import index
from jaxplan.search.kernels.compiled import inner


@inner
@no_type_check
def sees(blocked, frame, a, b):
    """Whether the segment a-b [m] crosses no blocked cell, b's own cell left out."""
    return crosses_only(blocked, 1, 1, frame, a, b)


@inner
@no_type_check
def crosses_only(values, sign, least, frame, a, b):
    """Whether in all cells that the segment a-b [m] crosses, b's own left out, ``sign`` times the value is less."""
    i, di, ni, ti, hi = _axis_walk(frame.x, frame.h, frame.nx, a[0], b[0])
    j, dj, nj, tj, hj = _axis_walk(frame.y, frame.h, frame.ny, a[1], b[1])
    m, dm, nm, tm, hm = _axis_walk(frame.z, frame.h, frame.nz, a[2], b[2])
    for _ in range(ni + nj + nm):
        if sign * values[i, j, m] >= least:
            return False
        if ti <= tj and ti <= tm:
            i, ni = i + di, ni - 1
            ti = ti + hi if ni > 0 else np.inf
        elif tj <= tm:
            j, nj = j + dj, nj - 1
            tj = tj + hj if nj > 0 else np.inf
        else:
            m, nm = m + dm, nm - 1
            tm = tm + hm if nm > 0 else np.inf
    return True


@inner
@no_type_check
def _axis_walk(origin, h, count, a, b):
    """One axis of a segment: where a walk along it begins and what its steps are.

    Returns first cell, direction, number of faces to cross, and the fractions of the segment at the first face and
    between faces.
    """
    u, v = (a - origin) / h, (b - origin) / h
    cell = index(a, origin, h, count)
    faces = abs(index(b, origin, h, count) - cell)
    if faces == 0:
        return cell, 1, faces, np.inf, np.inf
    between = 1.0 / abs(v - u)
    if v > u:
        return cell, 1, faces, (cell + 1 - u) * between, between
    return cell, -1, faces, (u - cell) * between, between
