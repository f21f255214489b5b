"""Which goals cannot be met whatever the way there, compiled (host): ``prediction.candidates.reject_early``.

Where a goal is in the room the search's bins say which obstacles are near; behind its faces all are looked at.
"""

import functools
import math
from typing import Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt32

from jaxplan.planner.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.solids import REACH, clearance_at, to_grid, to_primitive
from jaxplan.status import Reason

NONFINITE, OUTSIDE, OCCUPIED = (int(bit) for bit in (Reason.NONFINITE, Reason.GOAL_OUTSIDE, Reason.GOAL_OCCUPIED))
INVALID, FAR = int(Reason.T_GOAL_INVALID), int(Reason.OUT_OF_REACH)


def reasons_against(
    solids: tuple,
    bounds: Float[np.ndarray, "2 3"],
    distances: tuple[float, float],
    start: Float[np.ndarray, "3"],
    goals: Float[np.ndarray, "k 3"],
    times: Float[np.ndarray, "k"],
    reach: Float[np.ndarray, "k"],
) -> UInt32[np.ndarray, "k"]:
    """Early reasons against goals.

    Args:
        solids: what is solid in the room.
        bounds: corners of the room [m].
        distances: of goals from faces and from obstacles at least [m].
        start: where the plan begins [m, world].
        goals: positions [m, world].
        times: when they are to be reached [s from the start].
        reach: how far [m] the vehicle can get until then.
    """
    found = np.zeros(len(goals), np.uint32)
    corners = tuple(bounds.ravel().tolist())
    begin, ends, when, far = (np.array(part, float, order="C") for part in (start, goals, times, reach))
    _compiled()(solids, corners, distances, begin, ends, when, far, found)
    return found


@runtime_checkable
class _Reasons(Protocol):
    def __call__(
        self,
        solids: tuple,
        corners: tuple,
        distances: tuple,
        start: Float[np.ndarray, "3"],
        goals: Float[np.ndarray, "k 3"],
        times: Float[np.ndarray, "k"],
        reach: Float[np.ndarray, "k"],
        found: UInt32[np.ndarray, "k"],
    ) -> None:
        """Write ``found``."""


@functools.cache
def _compiled() -> _Reasons:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(solids, corners, distances, start, goals, times, reach, found):
        _ = version
        for k in range(len(goals)):
            x, y, z, time = goals[k, 0], goals[k, 1], goals[k, 2], times[k]
            reasons = 0
            if (x * 0.0) + (y * 0.0) + (z * 0.0) != 0.0:  # NaN or infinite
                reasons |= NONFINITE | OCCUPIED
            elif not _clearance(solids, corners, distances[1], x, y, z) >= distances[1]:
                reasons |= OCCUPIED
            if not _wall(corners, x, y, z) >= distances[0]:
                reasons |= OUTSIDE
            if not (time > 0.0 and time < math.inf):
                reasons |= INVALID
            x, y, z = x - start[0], y - start[1], z - start[2]
            if not math.sqrt(x * x + y * y + z * z) <= reach[k]:
                reasons |= FAR
            found[k] = reasons

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _wall(corners, x, y, z):
    """Distance [m] to the nearest face of the room from inside; NaN for NaN."""
    if x + y + z != x + y + z:
        return math.nan
    wall = min(min(x - corners[0], corners[3] - x), min(y - corners[1], corners[4] - y))
    return min(wall, min(z - corners[2], corners[5] - z))


@inner
@no_type_check
def _clearance(solids, corners, wanted, x, y, z):
    """Distance [m] to the nearest obstacle; what is farther than ``wanted`` may count as nearer, but not than that."""
    if wanted <= REACH and _wall(corners, x, y, z) >= 0.0:
        return clearance_at(solids, x, y, z)
    least = math.inf
    for n in range(len(solids[0])):
        least = min(least, to_primitive(solids[0][n], solids[1][n], x, y, z))
    if solids[6].size > 0:
        least = min(least, to_grid(solids[6], solids[7], x, y, z))
    if solids[8].size > 0:
        least = min(least, to_grid(solids[8], solids[9], x, y, z))
    return least
