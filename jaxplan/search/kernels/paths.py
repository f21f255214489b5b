"""What a search found: the cells of every path, and how they are written as points (host, compiled)."""

import functools
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxplan.search.kernels.cells import at, centre_of, flat, indices, put
from jaxplan.search.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.graph import NO_ENTRY, NO_STEP, STEPS, Frame, Graph


class Found(NamedTuple):
    """What one search gives, per goal."""

    cost: Float[np.ndarray, "k"]
    """Length from the start [m]; inf if not reached."""
    entry: Int[np.ndarray, "k"]
    """The last cell before the goal, or ``NO_ENTRY`` or ``DIRECT``."""
    cells: Int[np.ndarray, "c"]
    """The cells of all paths, one path after the other, each from the start on."""
    first: Int[np.ndarray, "k+1"]
    """Where each path begins in ``cells``; the last number is where all end."""
    expanded: int
    """Settled cells."""
    proven: Bool[np.ndarray, "k"]
    """Whether nothing shorter can be found."""


def write_paths(
    graph: Graph,
    found: Found,
    head: Float[np.ndarray, "h 3"],
    goals: Float[np.ndarray, "k 3"],
    points: Float[np.ndarray, "k capacity 3"],
    count: Int[np.ndarray, "k"],
) -> None:
    """Write the path of every reached goal into its row of ``points``: ``head``, cell centres, goal, the goal repeated.

    ``count`` becomes the number of points of the whole path; where that exceeds the capacity the row is its prefix.
    """
    _compiled_write()(tuple(graph.frame), found.cells, found.first, found.entry, head, goals, points, count)


@runtime_checkable
class _Write(Protocol):
    """The compiled ``write_paths``; the frame comes as a plain tuple."""

    def __call__(
        self,
        frame: tuple,
        cells: Int[np.ndarray, "c"],
        first: Int[np.ndarray, "ends"],
        entries: Int[np.ndarray, "k"],
        head: Float[np.ndarray, "h 3"],
        goals: Float[np.ndarray, "k 3"],
        points: Float[np.ndarray, "k capacity 3"],
        count: Int[np.ndarray, "k"],
    ) -> None:
        """Write ``points`` [m, world] and ``count``."""


@functools.cache
def _compiled_write() -> _Write:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(frame, cells, first, entries, head, goals, points, count):
        _ = version
        _write_paths(Frame(*frame), cells, first, entries, head, goals, points, count)

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def collect_paths(frame, goals, arrival, first, cells):
    """Where each path begins, into ``first``, which is 0; or, if there are ``cells`` to write to, the cells of all."""
    writing = len(cells) > 0
    for k in range(len(goals.points)):
        length, cell = 0, goals.entry[goals.alias[k]]
        while cell >= 0:
            length += 1
            if writing:
                cells[first[k + 1] - length] = cell
            bit = arrival[cell]
            cell = -1 if bit == NO_STEP else cell - flat(frame, STEPS[bit, 0], STEPS[bit, 1], STEPS[bit, 2])
        if not writing:
            first[k + 1] = first[k] + length


@inner
@no_type_check
def _write_paths(frame, cells, first, entries, head, goals, points, count):
    capacity = points.shape[1]
    for k in range(len(goals)):
        if entries[k] == NO_ENTRY:
            continue
        total = len(head) + first[k + 1] - first[k] + 1
        count[k] = total
        for position in range(min(total, capacity)):
            if position < len(head):
                put(points, k, position, at(head, position))
            elif position < total - 1:
                cell = cells[first[k] + position - len(head)]
                put(points, k, position, centre_of(frame, *indices(frame, cell)))
        for position in range(total - 1, capacity):
            put(points, k, position, at(goals, k))
