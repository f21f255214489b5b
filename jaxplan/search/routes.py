"""Taut routes to all candidates within a time budget (host, compiled): what the planner calls.

1. A goal in sight of the start gets the straight segment. No lattice path is shorter, and most goals of a close pursuit
   end here.
2. The other goals are searched on the lattice of the paper's rule, with a budget of settled cells. Goals that it does
   not reach are searched on the next coarser lattices: a path around more cells than the budget is long, so a coarse
   one is as good, and the coarsest lattices cover any room.
3. Only then finer lattices are tried, for passages that are closed on the coarser ones, with a larger budget.
4. Every path is pulled taut (``jaxplan.search.kernels.taut``).
"""

from collections.abc import Iterator
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from jaxplan.precision import in_float64
from jaxplan.search.kernels import astar
from jaxplan.search.kernels.graph import NO_ENTRY
from jaxplan.search.kernels.taut import write_straight, write_taut
from jaxplan.search.lattice import Lattices, Paths, choose_level, grid_frame, level_graph
from jaxplan.search.request import Request, finish, mark_finer, open_request
from jaxplan.world.obstacles import World
from jaxplan.world.occupancy import exact_clearance


@in_float64
def find_routes(
    lattices: Lattices,
    world: World,
    start: Annotated[ArrayLike, "3"],
    goals: Annotated[ArrayLike, "k 3"],
    target_distance: float,
    capacity: int = 32,
) -> Paths:
    """Taut paths from ``start`` to each of ``goals`` [m, world]; ``length`` is that of the taut path.

    ``target_distance`` [m] between the drones selects the lattice. A goal that is not finite, outside the room's
    keep-in box or closer to an obstacle than the padding has NO_PATH, as has every goal if the start sees no free cell.
    """
    request = open_request(lattices, world, start, goals, capacity)
    if not len(request.head):
        return request.paths
    _find_straight(lattices, request)
    first = choose_level(lattices, target_distance, world.diagonal)
    straight, expanded = ~request.open, 0
    cut_short: set[int] = set()
    for level, budget in _attempts(lattices, first, cut_short):
        if not request.open.any():
            break
        settled = _search_level(lattices, level, budget, request)
        expanded += settled
        if settled >= budget:
            cut_short.add(level)
    request.paths.resolution[straight] = np.nan
    mark_finer(lattices, first, request.paths)
    request.paths.resolution[straight & (request.paths.count > 0)] = lattices.levels[0].grid.resolution
    return finish(request.paths, expanded)


def warmup(lattices: Lattices, world: World, capacity: int = 32) -> None:
    """Compile everything that ``find_routes`` may call for this world, the search too where all is in sight."""
    middle = np.asarray(world.bounds).mean(axis=0)
    astar.warmup()
    exact_clearance(world.obstacles, middle[None])
    find_routes(lattices, world, middle, middle[None], 0.0, capacity)


def _attempts(lattices: Lattices, first: int, cut_short: set[int]) -> Iterator[tuple[int, int]]:
    """Levels and budgets in order; ``cut_short`` is filled in between with the levels whose budget ran out."""
    config = lattices.config
    for level in range(first, len(lattices.levels)):
        yield level, config.first_budget
    for level in range(len(lattices.levels) - 1, -1, -1):
        if level < first or level in cut_short:
            yield level, config.last_budget


def _find_straight(lattices: Lattices, request: Request) -> None:
    grid, paths = lattices.levels[0].grid, request.paths
    where = grid.occupied, grid_frame(grid), request.head
    write_straight(*where, request.goals, request.open, paths.points, paths.count, paths.length)
    request.open[paths.count > 0] = False


def _search_level(lattices: Lattices, level: int, budget: int, request: Request) -> int:
    """Search one lattice for the open goals and write taut paths; returns the settled cells."""
    graph, grid, paths = level_graph(lattices, level), lattices.levels[0].grid, request.paths
    found = astar.search(graph, request.head[-1], request.goals, request.open, budget)
    write_taut(graph, found, grid.occupied, request.head, request.goals, paths.points, paths.count, paths.length)
    reached = found.entry != NO_ENTRY
    paths.resolution[reached] = graph.frame.h
    request.open[reached] = False
    return found.expanded
