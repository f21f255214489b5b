"""Which segments touch a box along the room's axes (host, compiled into the search)."""

import math
from typing import no_type_check

from jaxplan.search.kernels.compiled import inner

ROUNDING = 1e-9
"""m (arbitrary)."""


@inner
@no_type_check
def sides(a, lower, upper):
    """Where the right and the left side of a box are, seen from above a point, as unit vectors; 0 from within it."""
    left, right, front, back = lower[0] - a[0], upper[0] - a[0], lower[1] - a[1], upper[1] - a[1]
    rx, ry, lx, ly = left, front, left, front
    for x, y in ((left, back), (right, front), (right, back)):
        if rx * y - ry * x < 0.0:
            rx, ry = x, y
        if lx * y - ly * x > 0.0:
            lx, ly = x, y
    if left <= 0.0 <= right and front <= 0.0 <= back:
        rx = ry = lx = ly = 0.0
    far_right, far_left = max(math.hypot(rx, ry), 1e-12), max(math.hypot(lx, ly), 1e-12)
    return rx / far_right, ry / far_right, lx / far_left, ly / far_left


@inner
@no_type_check
def between(seen, a, b, around):
    """Whether b is between the two ``sides`` of a box as seen from a, or so close [m] to that: else a-b misses it."""
    rx, ry, lx, ly = seen
    dx, dy = b[0] - a[0], b[1] - a[1]
    return rx * dy - ry * dx >= -around - ROUNDING and dx * ly - dy * lx >= -around - ROUNDING


@inner
@no_type_check
def touches(a, b, lower, upper, around):
    """Whether the segment a-b touches a box, or comes so close [m] to its faces."""
    begin, end = 0.0, 1.0
    for axis in range(3):
        step = b[axis] - a[axis]
        if abs(step) < 1e-12:
            if not lower[axis] - around <= a[axis] <= upper[axis] + around:
                return False
        else:
            low, high = (lower[axis] - around - a[axis]) / step, (upper[axis] + around - a[axis]) / step
            begin, end = max(begin, min(low, high)), min(end, max(low, high))
    return begin <= end
