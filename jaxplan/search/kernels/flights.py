"""Which polynomial trajectories keep their distance from obstacles (host, compiled into the search).

Each segment is cut into even pieces. Within half a piece h of its middle the position moves at most |v| h + a h^2 / 2,
where a bounds the acceleration on the segment: it lies in the hull of its control points. The distance to obstacles
changes no faster than the position (Lipschitz), so what is left at the middle holds all over the piece. A piece that
only this bound's looseness rejects is cut again; at the first one that is too near the trajectory is given up.
"""

import functools
import math
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from jaxplan.polynomials import control_point_table
from jaxplan.search.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.solids import clearance_at


class Cut(NamedTuple):
    """How finely trajectories are looked at."""

    pieces: int
    """Of each segment."""
    finer: int
    """Of each piece that is too near by the bound on the whole of it."""


@runtime_checkable
class _FlightsClear(Protocol):
    """Which of many trajectories keep their distance."""

    def __call__(
        self,
        solids: tuple,
        corners: tuple,
        durations: Float[np.ndarray, "k m"],
        position: Float[np.ndarray, "k m n 3"],
        table: Float[np.ndarray, "c n"],
        kept: tuple,
        cut: tuple,
        clear: Bool[np.ndarray, "k"],
        least: Float[np.ndarray, "k"],
    ) -> None:
        """Write ``clear`` and ``least``."""


def flights_keep_clear(
    solids: tuple,
    bounds: Float[np.ndarray, "2 3"],
    durations: Float[np.ndarray, "k m"],
    position: Float[np.ndarray, "k m n 3"],
    kept: tuple[float, float, float, float],
    cut: Cut,
) -> tuple[Bool[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Which trajectories keep their distance from obstacles and faces, and what distance they keep at least [m].

    Args:
        solids: what is solid in the room.
        bounds: corners of the room [m].
        durations: of the segments [s]; 0 for those that are not there.
        position: ascending coefficients in normalised time [m, world].
        kept: the least distance [m], the speed [m/s] from which it is more, how much more [m per m/s], the most [m].
        cut: how finely.

    Returns:
        The second, a lower bound, is that of a beginning where a trajectory is given up. What is not finite is not
        clear.
    """
    clear, least = np.zeros(len(durations), bool), np.full(len(durations), np.nan)
    table = control_point_table(position.shape[2], derivative=2, pieces=1)
    corners = tuple(bounds.ravel().tolist())
    times = np.array(durations, np.float64, order="C")  # a copy may be written to, as its type says: one program
    coefficients = np.array(position, np.float64, order="C")
    _compiled()(solids, corners, times, coefficients, table, kept, tuple(cut), clear, least)
    return clear, least


@functools.cache
def _compiled() -> _FlightsClear:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(solids, corners, durations, position, table, kept, cut, clear, least):
        _ = version
        for k in range(len(durations)):
            clear[k], least[k] = _flight(solids, corners, durations[k], position[k], table, kept, cut)

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _flight(solids, corners, durations, position, table, kept, cut):
    """Whether one trajectory keeps its distance, and the least one that was found [m]."""
    pieces, finer = cut
    least = math.inf
    for m in range(len(durations)):
        duration = durations[m]
        if duration == 0.0:
            continue
        bent, half = _acceleration_bound(position[m], table, duration), 0.5 * duration / pieces
        for i in range(pieces):
            free, spare = _piece(solids, corners, position[m], duration, (i + 0.5) / pieces, half, bent, kept)
            if not spare >= 0.0:
                free = math.inf
                for j in range(finer):
                    s = (i + (j + 0.5) / finer) / pieces
                    part, spare = _piece(solids, corners, position[m], duration, s, half / finer, bent, kept)
                    free = min(free, part)
                    if not spare >= 0.0:
                        return False, min(least, free)
            least = min(least, free)
    return True, least


@inner
@no_type_check
def _piece(solids, corners, c, duration, s, half, bent, kept):
    """Least distance [m] on the piece that reaches ``half`` [s] about s, and the same less what is kept there."""
    x, y, z, u, v, w = c[len(c) - 1, 0], c[len(c) - 1, 1], c[len(c) - 1, 2], 0.0, 0.0, 0.0
    for power in range(len(c) - 2, -1, -1):
        u, v, w = u * s + x, v * s + y, w * s + z
        x, y, z = x * s + c[power, 0], y * s + c[power, 1], z * s + c[power, 2]
    speed = math.sqrt(u * u + v * v + w * w) / duration
    moved = speed * half + 0.5 * bent * half * half
    least, slow, per_speed, most = kept
    keep = min(max(least + per_speed * (speed - slow), least), most)
    inside = min(x - corners[0], y - corners[1], z - corners[2], corners[3] - x, corners[4] - y, corners[5] - z)
    if not inside - moved >= keep:
        return inside - moved, inside - moved - keep
    free = min(inside, clearance_at(solids, x, y, z)) - moved
    return free, free - keep


@inner
@no_type_check
def _acceleration_bound(c, table, duration):
    """An upper bound [m/s^2] of the acceleration on a segment: the largest of its control points."""
    most = 0.0
    for point in range(len(table)):
        x, y, z = 0.0, 0.0, 0.0
        for power in range(len(c)):
            share = table[point, power]
            x, y, z = x + share * c[power, 0], y + share * c[power, 1], z + share * c[power, 2]
        most = max(most, x * x + y * y + z * z)
    return math.sqrt(most) / (duration * duration)
