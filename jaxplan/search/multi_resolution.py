"""Paths that are optimal on their lattice, whatever they cost (host, compiled): the reference for ``find_routes``."""

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from jaxplan.precision import in_float64
from jaxplan.search.kernels import astar
from jaxplan.search.kernels.graph import NO_ENTRY
from jaxplan.search.kernels.paths import write_paths
from jaxplan.search.lattice import Lattices, Paths, choose_level, level_graph
from jaxplan.search.request import Request, finish, mark_finer, open_request
from jaxplan.world.obstacles import World


@in_float64
def find_paths(
    lattices: Lattices,
    world: World,
    start: Annotated[ArrayLike, "3"],
    goals: Annotated[ArrayLike, "k 3"],
    target_distance: float,
    capacity: int = 256,
) -> Paths:
    """Shortest 26-connected paths from ``start`` to each of ``goals`` [m, world].

    ``target_distance`` [m] between the drones selects the lattice. A goal that is not finite, outside the room's
    keep-in box or closer to an obstacle than the padding has NO_PATH, as has every goal if the start sees no free cell.
    """
    request = open_request(lattices, world, start, goals, capacity)
    if not len(request.head):
        return request.paths
    expanded = 0
    first = choose_level(lattices, target_distance, world.diagonal)
    for level in range(first, -1, -1):
        if not request.open.any():
            break
        expanded += _search_level(lattices, level, request)
    mark_finer(lattices, first, request.paths)
    return finish(request.paths, expanded)


def _search_level(lattices: Lattices, level: int, request: Request) -> int:
    """Search one lattice for the open goals and write what is found; returns the settled cells."""
    graph, head, paths = level_graph(lattices, level), request.head, request.paths
    found = astar.search(graph, head[-1], request.goals, request.open, lattices.config.node_budget)
    write_paths(graph, found, head, request.goals, paths.points, paths.count)
    reached = found.entry != NO_ENTRY
    paths.resolution[reached] = graph.frame.h
    paths.length[reached] = found.cost[reached] + np.linalg.norm(np.diff(head, axis=0), axis=1).sum()
    request.open[reached] = False
    return found.expanded
