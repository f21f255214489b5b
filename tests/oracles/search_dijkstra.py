"""Shortest paths on voxel maps by SciPy's Dijkstra, built edge by edge from the definition of the graph."""

import itertools

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

STEPS = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]


def grid_edges(occupied: np.ndarray, *, corner_cutting: bool) -> list[tuple[int, int, float]]:
    """(from, to, cost in cells) for all 26-neighbour steps between free cells."""
    edges = []
    for cell in itertools.product(*(range(n) for n in occupied.shape)):
        for step in STEPS:
            other = tuple(c + s for c, s in zip(cell, step, strict=True))
            if any(not 0 <= c < n for c, n in zip(other, occupied.shape, strict=True)):
                continue
            box = (
                [cell, other]
                if corner_cutting
                else itertools.product(*({c, o} for c, o in zip(cell, other, strict=True)))
            )
            if not any(occupied[corner] for corner in box):
                cost = float(np.sqrt(sum(s * s for s in step)))
                edges.append((number(cell, occupied.shape), number(other, occupied.shape), cost))
    return edges


def number(cell: tuple[int, ...], shape: tuple[int, ...]) -> int:
    """A cell's number in C order."""
    return int(np.ravel_multi_index(cell, shape))


def shortest(edges: list[tuple[int, int, float]], nodes: int, source: int) -> np.ndarray:
    """Cost from ``source`` to every node; inf where there is no path."""
    if not edges:
        return np.where(np.arange(nodes) == source, 0.0, np.inf)
    rows, columns, costs = (np.array(column) for column in zip(*edges, strict=True))
    return dijkstra(coo_array((costs, (rows, columns)), shape=(nodes, nodes)).tocsr(), indices=source)
