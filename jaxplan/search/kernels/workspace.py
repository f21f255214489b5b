"""Arrays over all cells of a lattice, kept per thread and handed back clean (host).

Fresh zeroed memory for a million cells costs more than a search that settles thousands of them.
"""

import threading
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxplan.search.kernels.cells import at, flat, index, neighbour
from jaxplan.search.kernels.compiled import inner
from jaxplan.search.kernels.heap import Heap, make_heap


class Workspace(NamedTuple):
    """At least one entry per cell. Between searches ``place``, ``head`` and ``nearby`` are 0, the rest is arbitrary."""

    heap: Heap
    cost: Float[np.ndarray, "n"]
    """From the start [m]."""
    arrival: Int[np.ndarray, "n"]
    """The step by which a cell was reached, ``NO_STEP`` from the start."""
    head: Int[np.ndarray, "n"]
    nearby: Bool[np.ndarray, "n"]
    """As in ``graph.Goals``."""


_of_thread = threading.local()


def workspace(cells: int) -> Workspace:
    """This thread's arrays, for at least so many cells."""
    space: Workspace | None = getattr(_of_thread, "space", None)
    if space is None or space.cost.size < cells:
        space = Workspace(
            heap=make_heap(cells),
            cost=np.empty(cells),
            arrival=np.empty(cells, np.int8),
            head=np.zeros(cells, np.int32),
            nearby=np.zeros(cells, np.bool_),
        )
        _of_thread.space = space
    return space


@inner
@no_type_check
def clean_up(frame, heap, goals, expanded):
    """Leave the arrays over all cells as a search wants to find them."""
    for position in range(1, heap.size[0] + 1):
        heap.place[heap.cells[position]] = 0
    for number in range(1, expanded + 1):
        heap.place[heap.cells[len(heap.cells) - number]] = 0
    heap.size[0] = 0
    for k in range(len(goals.points)):
        if goals.listed[k]:
            i, j, m = cell_of(frame, at(goals.points, k))
            goals.head[flat(frame, i, j, m)] = 0
            for number in range(27):
                near = neighbour(frame, i, j, m, number)
                if near >= 0:
                    goals.nearby[near] = False


@inner
@no_type_check
def cell_of(frame, p):
    """Indices of the cell that holds a point [m]; of the nearest one for a point outside."""
    return (
        index(p[0], frame.x, frame.h, frame.nx),
        index(p[1], frame.y, frame.h, frame.ny),
        index(p[2], frame.z, frame.h, frame.nz),
    )
