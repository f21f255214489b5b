"""Pull lattice paths taut: drop every point that its neighbours can see past (host, compiled).

A lattice path is a staircase, and on coarse lattices it dips to cell centres far from the straight line. Waypoints
taken from it make a trajectory turn where nothing is in the way. Here a point is kept only where the straight line from
the last kept point would cross an occupied cell of the *finest* lattice. The result is never longer than the path.
"""

import functools
from typing import Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxplan.search.kernels.cells import at, centre_of, distance, indices
from jaxplan.search.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.graph import IF_SEEN, NO_ENTRY, Frame, Graph
from jaxplan.search.kernels.line_of_sight import sees
from jaxplan.search.kernels.paths import Found


def write_straight(
    occupied: Bool[np.ndarray, "fx fy fz"],
    frame: Frame,
    head: Float[np.ndarray, "h 3"],
    goals: Float[np.ndarray, "k 3"],
    wanted: Bool[np.ndarray, "k"],
    points: Float[np.ndarray, "k capacity 3"],
    count: Int[np.ndarray, "k"],
    length: Float[np.ndarray, "k"],
) -> None:
    """Write ``head`` and goal as the path of every wanted goal that the end of ``head`` sees, with its length [m]."""
    entries = np.where(wanted, IF_SEEN, NO_ENTRY)
    no_cells = np.empty(0, np.int32), np.zeros(len(goals) + 1, np.int64)
    path = np.empty((len(head) + 1, 3))
    _compiled_taut()(tuple(frame), tuple(frame), *no_cells, entries, occupied, head, path, goals, points, count, length)


def write_taut(
    graph: Graph,
    found: Found,
    occupied: Bool[np.ndarray, "fx fy fz"],
    head: Float[np.ndarray, "h 3"],
    goals: Float[np.ndarray, "k 3"],
    points: Float[np.ndarray, "k capacity 3"],
    count: Int[np.ndarray, "k"],
    length: Float[np.ndarray, "k"],
) -> None:
    """Write the path of every reached goal, pulled taut, into its row of ``points``, and its ``length`` [m].

    ``count`` becomes the number of points of the whole path; where that exceeds the capacity the row is its prefix.
    """
    frames = tuple(graph.frame), tuple(graph.fine_frame)
    path = np.empty((len(head) + int(np.diff(found.first).max(initial=0)) + 1, 3))
    parts = found.cells, found.first, found.entry
    _compiled_taut()(*frames, *parts, occupied, head, path, goals, points, count, length)


@runtime_checkable
class _WriteTaut(Protocol):
    """The compiled writer of taut paths; frames come as plain tuples."""

    def __call__(
        self,
        frame: tuple,
        fine: tuple,
        cells: Int[np.ndarray, "c"],
        first: Int[np.ndarray, "ends"],
        entries: Int[np.ndarray, "k"],
        occupied: Bool[np.ndarray, "fx fy fz"],
        head: Float[np.ndarray, "h 3"],
        path: Float[np.ndarray, "longest 3"],
        goals: Float[np.ndarray, "k 3"],
        points: Float[np.ndarray, "k capacity 3"],
        count: Int[np.ndarray, "k"],
        length: Float[np.ndarray, "k"],
    ) -> None:
        """Write ``points``, ``count`` and ``length`` [m, world]; ``path`` is room for the longest path."""


@functools.cache
def _compiled_taut() -> _WriteTaut:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(frame, fine, cells, first, entries, occupied, head, path, goals, points, count, length):
        _ = version
        frame, fine = Frame(*frame), Frame(*fine)
        end = len(head) - 1
        for k in range(len(goals)):
            if entries[k] == NO_ENTRY or (
                entries[k] == IF_SEEN and not sees(occupied, fine, at(head, end), at(goals, k))
            ):
                continue
            last = _unroll(frame, cells, first[k], first[k + 1], head, path)
            _copy(path, last, goals, k)
            kept = _pull_taut(path, last + 1, occupied, fine)
            length[k] = 0.0
            for i in range(kept - 1):
                length[k] += distance(at(path, i), at(path, i + 1))
            for i in range(points.shape[1]):
                _copy(points[k], i, path, i if i < kept else kept - 1)
            count[k] = kept

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _copy(to, i, source, j):
    """Copy one point; numba takes seconds to compile the assignment of a slice."""
    to[i, 0], to[i, 1], to[i, 2] = source[j, 0], source[j, 1], source[j, 2]


@inner
@no_type_check
def _unroll(frame, cells, begin, end, head, path):
    """Write the head and the centres of the cells from ``begin`` to ``end``; returns their number."""
    for i in range(len(head)):
        _copy(path, i, head, i)
    for i in range(end - begin):
        x, y, z = centre_of(frame, *indices(frame, cells[begin + i]))
        row = len(head) + i
        path[row, 0], path[row, 1], path[row, 2] = x, y, z
    return len(head) + end - begin


@inner
@no_type_check
def _pull_taut(path, count, occupied, frame):
    """Rewrite the first ``count`` points of one path in place; returns how many are left."""
    last = count - 1
    kept, here = count - last, last - last  # 1 and 0: numba compiles calls with constants a second time
    while here < last:
        here = _farthest_seen(path, here, last, occupied, frame)
        _copy(path, kept, path, here)
        kept += 1
    return kept


@inner
@no_type_check
def _farthest_seen(path, here, last, occupied, frame):
    """Index of a late point in sight of point ``here``, at least the next one: doubling steps, then bisection."""
    seen, step = here + 1, 2
    hidden = last + 1
    while seen < last:
        trial = here + step if here + step < last else last
        if not sees(occupied, frame, at(path, here), at(path, trial)):
            hidden = trial
            break
        seen, step = trial, 2 * step
    while hidden - seen > 1 and seen < last:
        middle = (seen + hidden) // 2
        if sees(occupied, frame, at(path, here), at(path, middle)):
            seen = middle
        else:
            hidden = middle
    return seen
