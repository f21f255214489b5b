"""Taut routes on lattices, within a budget of cells: the paper's rule (host, compiled).

1. A goal in sight of the start gets the straight segment. No lattice path is shorter, and most goals of a close pursuit
   end here.
2. The other goals are searched on the lattice of the paper's rule, with a budget of settled cells. Goals that it does
   not reach are searched on the next coarser lattices: a path around more cells than the budget is long, so a coarse
   one is as good, and the coarsest lattices cover any room.
3. Only then finer lattices are tried, for passages that are closed on the coarser ones, with a larger budget.
4. Every path is pulled taut (``jaxplan.search.kernels.taut``).
"""

from collections.abc import Iterator

import numpy as np

from jaxplan.search.kernels import astar
from jaxplan.search.kernels.graph import NO_ENTRY
from jaxplan.search.kernels.taut import write_straight, write_taut
from jaxplan.search.lattice import Lattices, choose_level, grid_frame, level_graph
from jaxplan.search.request import Request, mark_finer
from jaxplan.status import Note, Reason
from jaxplan.world.obstacles import World


def search_lattices(lattices: Lattices, world: World, request: Request, target_distance: float) -> int:
    """Write taut paths to all open goals; returns the settled cells.

    ``target_distance`` [m] between the drones selects the lattice.
    """
    _find_straight(lattices, request)
    first = choose_level(lattices, target_distance, world.diagonal)
    straight, expanded = ~request.open, 0
    cut_short: set[int] = set()
    for level, budget in _attempts(lattices, first, cut_short):
        if not request.open.any():
            break
        settled = search_lattice(lattices, level, budget, request)
        expanded += settled
        if settled >= budget:
            cut_short.add(level)
    request.paths.resolution[straight] = np.nan
    mark_finer(lattices, first, request.paths)
    request.paths.resolution[straight & (request.paths.count > 0)] = lattices.levels[0].grid.resolution
    return expanded


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


def search_lattice(lattices: Lattices, level: int, budget: int, request: Request, anytime: bool = False) -> int:
    """Search one lattice for the open goals and write taut paths; returns the settled cells.

    If ``anytime``, goals get the best path known when the budget ends, with a note, or a reason where it ends before
    them.
    """
    graph, grid, paths = level_graph(lattices, level), lattices.levels[0].grid, request.paths
    found = astar.search(graph, request.head[-1], request.goals, request.open, budget, anytime)
    reached, ends = found.entry != NO_ENTRY, request.goals.copy()
    short = np.flatnonzero(reached & np.isinf(found.cost))
    ends[short] = grid.origin + graph.frame.h * (np.stack(np.unravel_index(found.entry[short], grid.shape), -1) + 0.5)
    write_taut(graph, found, grid.occupied, request.head, ends, paths.points, paths.count, paths.length)
    paths.reasons[short] |= np.uint32(Reason.PREFIX_ONLY)
    paths.length[short] += np.linalg.norm(request.goals[short] - ends[short], axis=1)
    paths.notes[reached & ~found.proven] |= np.uint32(Note.SEARCH_ENDED)
    paths.resolution[reached] = graph.frame.h
    request.open[reached] = False
    return found.expanded
