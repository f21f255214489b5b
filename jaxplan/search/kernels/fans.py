"""Which primitives stand in which direction of a place (host, compiled into the search).

Seen from above, the box around a primitive, grown by the distance that is to be kept, takes up an interval of
directions. A segment from the place can come too close only to primitives in whose interval it points: a few of them,
where all would have to be asked.
"""

import math
from typing import no_type_check

from jaxplan.search.kernels.compiled import inner

SECTORS = 64
"""Into which a full turn is divided (arbitrary)."""
_PER_TURN = SECTORS / 4.0
_ROUNDING = 1e-6
"""Sectors; by how much intervals are made wider (arbitrary)."""


@inner
@no_type_check
def look_round(boxes, limit, a, members, counts):
    """Write for each sector about a point a [m] which ``boxes``, grown by ``limit`` [m], reach into it."""
    for s in range(SECTORS):
        counts[s] = 0
    for n in range(len(boxes)):
        left, right = boxes[n, 0] - limit - a[0], boxes[n, 3] + limit - a[0]
        front, back = boxes[n, 1] - limit - a[1], boxes[n, 4] + limit - a[1]
        begin, end = 0, SECTORS
        if left > 0.0 or right < 0.0 or front > 0.0 or back < 0.0:
            middle = _turn(0.5 * (left + right), 0.5 * (front + back))
            low = high = 0.0
            for corner in range(4):
                off = _turn(left if corner % 2 == 0 else right, front if corner < 2 else back) - middle
                off -= 4.0 * math.floor(0.25 * off + 0.5)
                low, high = min(low, off), max(high, off)
            begin = math.floor((middle + low) * _PER_TURN - _ROUNDING)
            end = math.floor((middle + high) * _PER_TURN + _ROUNDING) + 1
        for s in range(begin, end):
            sector = s % SECTORS
            members[sector, counts[sector]] = n
            counts[sector] += 1


@inner
@no_type_check
def sector_of(a, b):
    """The sector about a point a [m] in which b is."""
    return min(int(_turn(b[0] - a[0], b[1] - a[1]) * _PER_TURN), SECTORS - 1)


@inner
@no_type_check
def _turn(dx, dy):
    """Grows from 0 to 4 with the direction as its angle does, and needs no arc tangent."""
    both = abs(dx) + abs(dy)
    if both == 0.0:
        return 0.0
    if dx < 0.0:
        return 2.0 - dy / both
    return dy / both if dy >= 0.0 else 4.0 + dy / both
