"""A binary heap with decreasing keys, for the search.

Plain functions on NumPy arrays, written for numba: ``jaxplan.search.kernels.astar`` compiles them. Position 1 holds the
least key.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int


class Heap(NamedTuple):
    """A binary heap of cells with decreasing keys; ``place`` is 0 for unseen cells and -1 for settled ones."""

    keys: Float[np.ndarray, "n+1"]
    cells: Int[np.ndarray, "n+1"]
    place: Int[np.ndarray, "n"]
    """By cell, its position in the heap."""
    size: Int[np.ndarray, "1"]


def make_heap(cells: int) -> Heap:
    """An empty heap for cells 0 .. cells - 1."""
    return Heap(
        keys=np.empty(cells + 1),
        cells=np.empty(cells + 1, np.int32),
        place=np.zeros(cells, np.int32),
        size=np.zeros(1, np.int64),
    )


@no_type_check
def push(heap, cell, key):
    """Insert a cell, or lower the key of one that is in the heap."""
    position = heap.place[cell]
    if position == 0:
        heap.size[0] += 1
        position = heap.size[0]
    while position > 1 and heap.keys[position // 2] > key:
        above = position // 2
        heap.keys[position], heap.cells[position] = heap.keys[above], heap.cells[above]
        heap.place[heap.cells[position]] = position
        position = above
    heap.keys[position], heap.cells[position], heap.place[cell] = key, cell, position


@no_type_check
def pop(heap):
    """Remove the cell of least key and mark it settled."""
    first, size = heap.cells[1], heap.size[0] - 1
    heap.place[first] = -1
    heap.size[0] = size
    if size == 0:
        return first
    key, cell, position = heap.keys[size + 1], heap.cells[size + 1], 1
    while 2 * position <= size:
        below = 2 * position
        if below < size and heap.keys[below + 1] < heap.keys[below]:
            below += 1
        if heap.keys[below] >= key:
            break
        heap.keys[position], heap.cells[position] = heap.keys[below], heap.cells[below]
        heap.place[heap.cells[position]] = position
        position = below
    heap.keys[position], heap.cells[position], heap.place[cell] = key, cell, position
    return first
