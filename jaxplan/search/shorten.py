"""Pull lattice paths taut: drop every point that its neighbours can see past (host, compiled).

A lattice path is a staircase, and on coarse lattices it dips to cell centres far from the straight line. Waypoints
taken from it make a trajectory turn where nothing is in the way. Here a point is kept only where the straight line from
the last kept point would enter an occupied cell of the *finest* lattice. The result is never longer than the path.
"""

import numba
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxplan.search.lattice import Lattices, Paths

_STEP = 0.5
"""Distance between samples of a line of sight, in cells."""


def shorten(paths: Paths, lattices: Lattices) -> Paths:
    """The same paths with as few corners as sight allows; ends stay exact, ``length`` is that of the lattice path."""
    grid = lattices.levels[0].grid
    points, count = paths.points.copy(), paths.count.copy()
    _shorten_all(points, count, grid.occupied, grid.origin, float(grid.resolution))
    return Paths(
        points=points,
        count=count,
        reasons=paths.reasons,
        notes=paths.notes,
        resolution=paths.resolution,
        length=paths.length,
        expanded=paths.expanded,
    )


@numba.njit(cache=True, nogil=True)
def _shorten_all(
    points: Float[np.ndarray, "k n 3"],
    count: Int[np.ndarray, "k"],
    occupied: Bool[np.ndarray, "x y z"],
    origin: Float[np.ndarray, "3"],
    resolution: float,
) -> None:
    """Rewrite every path in place and pad it with its last point."""
    for k in range(points.shape[0]):
        path, last = points[k], count[k] - 1
        kept, here = 1, 0
        while here < last:
            here = _farthest_seen(path, here, last, occupied, origin, resolution)
            path[kept] = path[here]
            kept += 1
        if last > 0:
            path[kept:] = path[kept - 1]
            count[k] = kept


@numba.njit(cache=True, nogil=True)
def _farthest_seen(
    path: Float[np.ndarray, "n 3"],
    here: int,
    last: int,
    occupied: Bool[np.ndarray, "x y z"],
    origin: Float[np.ndarray, "3"],
    resolution: float,
) -> int:
    """Index of a late point in sight of point ``here``, at least the next one: doubling steps, then bisection."""
    seen, step = here + 1, 2
    hidden = last + 1
    while seen < last:
        trial = min(here + step, last)
        if not _in_sight(path[here], path[trial], occupied, origin, resolution):
            hidden = trial
            break
        seen, step = trial, 2 * step
    while hidden - seen > 1 and seen < last:
        middle = (seen + hidden) // 2
        if _in_sight(path[here], path[middle], occupied, origin, resolution):
            seen = middle
        else:
            hidden = middle
    return seen


@numba.njit(cache=True, nogil=True)
def _in_sight(
    a: Float[np.ndarray, "3"],
    b: Float[np.ndarray, "3"],
    occupied: Bool[np.ndarray, "x y z"],
    origin: Float[np.ndarray, "3"],
    resolution: float,
) -> bool:
    """Whether every sample of the segment lies in a free cell."""
    distance = np.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
    steps = int(np.ceil(distance / (_STEP * resolution))) + 1
    for i in range(steps + 1):
        t = i / steps
        x = int(np.floor((a[0] + t * (b[0] - a[0]) - origin[0]) / resolution))
        y = int(np.floor((a[1] + t * (b[1] - a[1]) - origin[1]) / resolution))
        z = int(np.floor((a[2] + t * (b[2] - a[2]) - origin[2]) / resolution))
        inside = 0 <= x < occupied.shape[0] and 0 <= y < occupied.shape[1] and 0 <= z < occupied.shape[2]
        if not inside or occupied[x, y, z]:
            return False
    return True
