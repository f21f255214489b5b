"""Multi-goal A* on an occupancy lattice (host, compiled by numba).

The graph: free cells, joined to those of their 26 neighbours that can be reached without cutting a corner (every cell
of the step's bounding box is free). The exact start and the exact goals are nodes of their own, joined to each free
cell among the 27 around them whose centre they see, and to each other if they see each other and lie in neighbouring
cells. Seeing: the segment crosses no cell of the finest lattice that is too close to an obstacle; the goal's own cell
does not count. Paths therefore leave the start and enter the goal without a detour over a cell's centre.

The search: f = g + h with h(x) = |x - c|, c the mean of the goals (interception paper, section III.A). By the
triangle inequality h is consistent, so a cell is settled at its least cost when it is popped; h is not a lower bound
of the cost to any one goal, so the search ends only when no open cell can improve any goal: min f >= max_k (cost_k +
h(goal_k)). Every path is optimal on its lattice. Goals in another connected component are left out beforehand. A
budget bounds the number of settled cells; goals whose paths are not proven optimal by then count as not reached.

Two things make it fast. A cell with free surroundings offers itself only to the neighbours for which it can be the
best way (``graph.onward_steps``): 1 to 7 of 26. And the arrays over all cells are kept per thread and left clean,
because fresh zeroed memory for a million cells costs more than settling thousands of them.

Only the entry points are cached by numba. They take arrays, numbers and plain tuples, because a cache that names
classes of an older version cannot be read, and they hold the digest of the sources (``compiled``).
"""

import functools
from typing import Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxplan.search.kernels import graph as g
from jaxplan.search.kernels.cells import at, centre_of, distance, flat, indices, neighbour
from jaxplan.search.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.graph import (
    DIRECT,
    EVERY_STEP,
    LENGTHS,
    NO_ENTRY,
    NO_STEP,
    STEPS,
    Frame,
    Goals,
    Graph,
    make_goals,
    plain,
)
from jaxplan.search.kernels.heap import Heap, pop, push
from jaxplan.search.kernels.line_of_sight import sees
from jaxplan.search.kernels.paths import Found, collect_paths
from jaxplan.search.kernels.workspace import cell_of, clean_up, workspace

_RECHECK = 32
"""Settled cells between updates of the bound that ends the search; arbitrary."""

_ONWARD, _ONWARD_COUNT = g.onward_steps()

_push, _pop = inner(push), inner(pop)


def search(
    graph: Graph,
    start: Float[np.ndarray, "3"],
    goals: Float[np.ndarray, "k 3"],
    wanted: Bool[np.ndarray, "k"],
    budget: int,
    anytime: bool = False,
) -> Found:
    """Shortest paths from ``start`` to all ``wanted`` goals, settling at most ``budget`` cells.

    Points in metres (world frame). ``start`` and the wanted goals must be finite and inside the lattice. A goal that is
    not reached, or whose path is not proven shortest, by the end of the budget has no path; if ``anytime``, it has the
    best one known: the one found, or one to the settled cell that is nearest to it.
    """
    centre = goals[wanted].mean(axis=0) if wanted.any() else start.copy()
    space = workspace(graph.moves.size)
    lists = make_goals(goals, wanted, centre, space.head, space.nearby)
    ends = tuple(start.tolist()), tuple(centre.tolist())
    first = np.zeros(len(goals) + 1, np.int64)
    expanded, least, cells = _compiled_search()(
        plain(graph), tuple(space.heap), tuple(lists), space.cost, space.arrival, first, *ends, budget, anytime
    )
    cost, entry = lists.cost[lists.alias], lists.entry[lists.alias]
    unproven = cost + lists.heuristic > least  # where the budget ended the search, an open cell may improve them still
    if not anytime:
        cost[unproven], entry[unproven] = np.inf, NO_ENTRY
    return Found(cost=cost, entry=entry, cells=cells, first=first, expanded=int(expanded), proven=~unproven)


def warmup() -> None:
    """Compile the search, or load it from numba's cache, by solving a room of two cells."""
    search(g.two_free_cells(), np.array([0.5, 0.5, 0.5]), np.array([[1.5, 0.5, 0.5]]), np.ones(1, np.bool_), 10)


@runtime_checkable
class _Search(Protocol):
    """The compiled search; records come as plain tuples."""

    def __call__(
        self,
        graph: tuple,
        heap: tuple,
        goals: tuple,
        cost: Float[np.ndarray, "n"],
        arrival: Int[np.ndarray, "n"],
        first: Int[np.ndarray, "ends"],
        start: tuple[float, float, float],
        centre: tuple[float, float, float],
        budget: int,
        anytime: bool,
    ) -> tuple[int, float, Int[np.ndarray, "c"]]:
        """Settle cells; ``goals`` and ``first`` are written. Points in metres (world frame)."""


@functools.cache
def _compiled_search() -> _Search:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(graph, heap, goals, cost, arrival, first, start, centre, budget, anytime):
        """Name the parts of the plain tuples and search.

        Returns the number of settled cells, the least f of those that are open, and the cells of all paths.
        """
        _ = version
        moves, components, frame, fine, fine_frame = graph
        graph = Graph(moves, components, Frame(*frame), fine, Frame(*fine_frame))
        heap, goals = Heap(*heap), Goals(*goals)
        expanded = _settle_all(graph, heap, goals, cost, arrival, start, centre, budget)
        least = heap.keys[1] if heap.size[0] > 0 else np.inf
        if anytime and expanded == budget and heap.size[0] > 0:
            _enter_nearest(graph, heap, goals, expanded)
        collect_paths(graph.frame, goals, arrival, first, np.empty(0, np.int32))
        cells = np.empty(first[-1], np.int32)
        collect_paths(graph.frame, goals, arrival, first, cells)
        clean_up(graph.frame, heap, goals, expanded)
        return expanded, least, cells

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _settle_all(graph, heap, goals, cost, arrival, start, centre, budget):
    """Settle cells in order of f; returns their number. They are kept at the end of ``heap.cells``, latest first."""
    _list_goals(graph, goals)
    _open_around_start(graph, heap, goals, cost, arrival, start, centre)
    remaining = _drop_unreachable(graph, heap, goals)
    expanded, bound = 0, np.inf
    while remaining > 0 and heap.size[0] > 0 and expanded < budget:
        if heap.keys[1] >= bound:
            break
        cell = _pop(heap)
        expanded += 1
        heap.cells[len(heap.cells) - expanded] = cell
        if goals.nearby[cell]:
            _improve_goals(graph, goals, cell, cost[cell])
        _relax(graph, heap, cost, arrival, cell, centre)
        if expanded % _RECHECK == 0:
            bound = _bound(goals)
    return expanded


@inner
@no_type_check
def _enter_nearest(graph, heap, goals, expanded):
    """Give each goal that is left the settled cell nearest to it as its entry; its cost stays infinite."""
    for k in range(len(goals.points)):
        if goals.wanted[k] and goals.cost[k] == np.inf:
            least = np.inf
            for number in range(1, expanded + 1):
                cell = heap.cells[len(heap.cells) - number]
                away = distance(centre_of(graph.frame, *indices(graph.frame, cell)), at(goals.points, k))
                if away < least:
                    least = away
                    goals.entry[k] = cell


@inner
@no_type_check
def _list_goals(graph, goals):
    """Enter each wanted goal once in the list of its cell, and mark the cells around it."""
    for k in range(len(goals.points)):
        if not goals.wanted[k]:
            continue
        i, j, m = cell_of(graph.frame, at(goals.points, k))
        cell = flat(graph.frame, i, j, m)
        other = goals.head[cell]
        while other > 0 and at(goals.points, k) != at(goals.points, other - 1):
            other = goals.following[other - 1]
        if other > 0:
            goals.alias[k] = other - 1
            goals.wanted[k] = False
            continue
        goals.following[k] = goals.head[cell]
        goals.head[cell] = k + 1
        for number in range(27):
            near = neighbour(graph.frame, i, j, m, number)
            if near >= 0:
                goals.nearby[near] = True


@inner
@no_type_check
def _open_around_start(graph, heap, goals, cost, arrival, start, centre):
    """Open the free cells that the start sees, and join the goals next to it directly."""
    i, j, m = cell_of(graph.frame, start)
    for number in range(27):
        cell = neighbour(graph.frame, i, j, m, number)
        if cell < 0:
            continue
        k = goals.head[cell]
        while k > 0:
            if sees(graph.fine, graph.fine_frame, start, at(goals.points, k - 1)):
                goals.cost[k - 1] = distance(start, at(goals.points, k - 1))
                goals.entry[k - 1] = DIRECT
            k = goals.following[k - 1]
        middle = centre_of(graph.frame, *indices(graph.frame, cell))
        if graph.components[cell] > 0 and sees(graph.fine, graph.fine_frame, start, middle):
            cost[cell] = distance(start, middle)
            arrival[cell] = NO_STEP
            _push(heap, cell, cost[cell] + distance(middle, centre))


@inner
@no_type_check
def _drop_unreachable(graph, heap, goals):
    """Unwant the goals that no opened component leads to; returns how many stay wanted."""
    remaining = 0
    for k in range(len(goals.points)):
        if not goals.wanted[k]:
            continue
        reachable = goals.entry[k] == DIRECT or _touches_open_component(graph, heap, at(goals.points, k))
        goals.wanted[k] = reachable
        remaining += reachable
    return remaining


@inner
@no_type_check
def _touches_open_component(graph, heap, goal):
    """Whether a goal's own cell (26), or one around it that the goal is in sight of, is connected to the start."""
    i, j, m = cell_of(graph.frame, goal)
    for number in range(27):
        cell = neighbour(graph.frame, i, j, m, 26 - number)
        if cell >= 0 and _is_open_component(graph, heap, cell):
            middle = centre_of(graph.frame, *indices(graph.frame, cell))
            if number == 0 or sees(graph.fine, graph.fine_frame, middle, goal):
                return True
    return False


@inner
@no_type_check
def _is_open_component(graph, heap, cell):
    """Whether a cell is connected to one that was opened around the start."""
    if graph.components[cell] == 0:
        return False
    for position in range(1, heap.size[0] + 1):
        if graph.components[heap.cells[position]] == graph.components[cell]:
            return True
    return False


@inner
@no_type_check
def _improve_goals(graph, goals, cell, cost):
    """Offer a settled cell as the entry of the goals around it."""
    i, j, m = indices(graph.frame, cell)
    middle = centre_of(graph.frame, i, j, m)
    for number in range(27):
        near = neighbour(graph.frame, i, j, m, number)
        if near < 0:
            continue
        k = goals.head[near]
        while k > 0:
            offered = cost + distance(middle, at(goals.points, k - 1))
            if offered < goals.cost[k - 1] and sees(graph.fine, graph.fine_frame, middle, at(goals.points, k - 1)):
                goals.cost[k - 1] = offered
                goals.entry[k - 1] = cell
            k = goals.following[k - 1]


@inner
@no_type_check
def _relax(graph, heap, cost, arrival, cell, centre):
    """Offer a settled cell as the predecessor of its neighbours."""
    i, j, m = indices(graph.frame, cell)
    moves = graph.moves[cell]
    came = arrival[cell] if moves == EVERY_STEP else NO_STEP
    for number in range(_ONWARD_COUNT[came]):
        bit = _ONWARD[came, number]
        if not (moves >> np.uint32(bit)) & np.uint32(1):
            continue
        a, b, c = i + STEPS[bit, 0], j + STEPS[bit, 1], m + STEPS[bit, 2]
        other = flat(graph.frame, a, b, c)
        place = heap.place[other]
        if place < 0:
            continue
        offered = cost[cell] + LENGTHS[bit] * graph.frame.h
        if place == 0 or offered < cost[other]:
            cost[other] = offered
            arrival[other] = bit
            _push(heap, other, offered + distance(centre_of(graph.frame, a, b, c), centre))


@inner
@no_type_check
def _bound(goals):
    """No cell of at least this f can improve a goal."""
    bound = 0.0
    for k in range(len(goals.points)):
        if goals.wanted[k] and goals.cost[k] + goals.heuristic[k] > bound:
            bound = goals.cost[k] + goals.heuristic[k]
    return bound
