"""The way over places to a goal (host, compiled into the search)."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int

from jaxplan.search.kernels.cells import at, distance
from jaxplan.search.kernels.compiled import inner
from jaxplan.search.kernels.roads import along_surface
from jaxplan.search.kernels.sight import keeps_clear
from jaxplan.search.kernels.tighten import put

NEAR = 0.4
"""m; goals that share an order of places (arbitrary)."""
GAIN = 0.99
"""A goal takes another place than the goals around it where its way is shorter by this factor (arbitrary)."""
FIRST_SPREAD = 0.2
"""m; how much longer than the shortest way ways are looked at first; then four times as much (arbitrary)."""
TURN_SLACK = 0.1
"""By how much a bend may turn away from the surface, as a difference of unit vectors; the bends are not yet moved."""
PATIENCE, MOST_TESTS = 48, 200
"""Places that do not see a goal before it is asked whether any near it can be reached; and, as long as not all places
are settled, before it has to wait (arbitrary)."""
GIVEN_UP = -2
NO_PLACE, NONE_TESTED = np.int64(-1), np.int64(0)
"""Typed, so that what takes them is not compiled for these constants beside all other numbers."""
WITNESSES = 3
"""The nearest places that see a goal: where none of them can be reached, the goal cannot (arbitrary)."""
FAR = 1e6
"""m; beyond every room."""


class Search(NamedTuple):
    """A search under way, in compiled code."""

    field: tuple
    limit: float
    near: float
    tangent: float
    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    start: tuple
    cost: Float[np.ndarray, "n"]
    """Least way from the start to each place so far [m]."""
    parent: Int[np.ndarray, "n"]
    """The place before; -1 for the start."""
    ways: Float[np.ndarray, "n"]
    """By place, the way over it to the goal that is looked at [m]."""
    order: Int[np.ndarray, "n"]
    """Places listed for that goal."""


@inner
@no_type_check
def list_ways(s, goal, hint, reach):
    """The place over which the way to a goal is shortest, and how many are listed; -1 and 0 without any.

    Ways longer than ``reach`` [m] are of no interest; where that is ``FAR``, all places are settled, and a goal in a
    pocket of its own is given up early.

    Listed, in the order of their ways, are the places that may be best for a goal up to ``NEAR`` from this one. Those
    with shorter ways are not: they do not see the goal. Place ``hint``, if there is one, is tried first: longer ways
    are of no interest.
    """
    shortest = _measure_ways(s, goal)
    if shortest > reach:
        return -1, 0
    best, tested, bound = NO_PLACE, NONE_TESTED, shortest + FIRST_SPREAD
    if hint >= 0 and _leads_on(s, hint, goal):
        best, bound = hint, s.ways[hint]
    while True:
        listed = sort_ways(s, -1.0, bound)
        best = _first_that_leads_on(s, goal, best, bound, tested, listed, reach)
        if best >= 0:
            return best, sort_ways(s, s.ways[best], s.ways[best] + 2.0 * NEAR)
        if best == GIVEN_UP or bound > reach:
            return -1, 0
        tested, bound = listed, shortest + 4.0 * (bound - shortest)


@inner
@no_type_check
def _first_that_leads_on(s, goal, best, bound, tested, listed, reach):
    """The first of the listed places, after ``tested`` ones, from which a goal is seen; ``best`` or ``GIVEN_UP``."""
    for n in range(tested, listed):
        u = s.order[n]
        if best >= 0 and s.ways[u] >= bound:
            break
        if _leads_on(s, u, goal):
            return u
        if best < 0 and n + 1 == MOST_TESTS and reach < FAR:
            return GIVEN_UP
        if best < 0 and n + 1 == PATIENCE and reach == FAR:
            if not _is_reachable(s, goal):
                return GIVEN_UP
            _measure_ways(s, goal)
            sort_ways(s, -1.0, bound)
    return best


@inner
@no_type_check
def _measure_ways(s, goal):
    """Write the ways over all places to a goal; returns the shortest [m]."""
    shortest = np.inf
    for u in range(len(s.points)):
        s.ways[u] = s.cost[u] + distance(at(s.points, u), goal)
        shortest = min(shortest, s.ways[u])
    return shortest


@inner
@no_type_check
def _is_reachable(s, goal):
    """Whether one of the nearest places that see a goal is settled; the list and the ways are lost."""
    for u in range(len(s.points)):
        s.ways[u] = distance(at(s.points, u), goal)
    seen, inner, outer = 0, -1.0, NEAR
    while inner < FAR:
        for n in range(sort_ways(s, inner, outer)):
            u = s.order[n]
            if keeps_clear(s.field, s.limit, at(s.points, u), goal):
                if s.cost[u] < np.inf:
                    return True
                seen += 1
                if seen == WITNESSES:
                    return False
        inner, outer = outer, 2.0 * outer
    return False


@inner
@no_type_check
def sort_ways(s, least, most):
    """List the places whose ways are longer than ``least`` and at most ``most`` [m] (Shell's sort); their number."""
    order, listed = s.order, 0
    for u in range(len(s.ways)):
        if least < s.ways[u] <= most and s.ways[u] < np.inf:
            order[listed] = u
            listed += 1
    gap = 1
    while gap < listed:
        gap = 3 * gap + 1
    while gap > 1:
        gap //= 3
        for n in range(gap, listed):
            u, to = order[n], n
            while to >= gap and s.ways[order[to - gap]] > s.ways[u]:
                order[to] = order[to - gap]
                to -= gap
            order[to] = u
    return listed


@inner
@no_type_check
def best_place(s, goal, here, first, listed):
    """The place over which the way to a goal is shortest, of those found for the goal ``here``; -1 for none."""
    away = distance(goal, here)
    best, least = -1, np.inf
    if first >= 0 and _leads_on(s, first, goal):
        best, least = first, s.cost[first] + distance(at(s.points, first), goal)
    for n in range(listed):
        u = s.order[n]
        if s.ways[u] - away >= GAIN * least:
            break
        way = s.cost[u] + distance(at(s.points, u), goal)
        if way < GAIN * least and _leads_on(s, u, goal):
            best, least = u, way
    return best


@inner
@no_type_check
def _leads_on(s, u, goal):
    """Whether a way can turn at place ``u`` towards a goal [m] that it sees."""
    p = at(s.points, u)
    apart = max(distance(p, goal), 1e-9)
    return (
        runs_along(s, u, p, goal, apart) and turns_around(s, u, goal, apart) and keeps_clear(s.field, s.limit, p, goal)
    )


@inner
@no_type_check
def turns_around(s, u, onward, apart):
    """Whether the way over place ``u`` to a point ``onward``, ``apart`` from it [m], turns around what stands there."""
    p = at(s.points, u)
    before = s.start if s.parent[u] < 0 else at(s.points, s.parent[u])
    since, apart, turn = max(distance(before, p), 1e-9), max(apart, 1e-9), 0.0
    for axis in range(3):
        turn += s.normals[u, axis] * ((onward[axis] - p[axis]) / apart - (p[axis] - before[axis]) / since)
    return turn <= TURN_SLACK


@inner
@no_type_check
def runs_along(s, u, a, b, apart):
    """Whether the segment a-b of this length [m] may begin or end at place ``u``."""
    return along_surface(s.normals, u, a, b, s.tangent * apart)


@inner
@no_type_check
def unroll(s, u, goal, path, normals):
    """Write the start, the places up to ``u`` with their normals, and the goal; returns the number of places."""
    bends, v = 0, u
    while v >= 0:
        bends, v = bends + 1, s.parent[v]
    v = u
    for i in range(bends, 0, -1):
        put(path, i, at(s.points, v))
        put(normals, i, at(s.normals, v))
        v = s.parent[v]
    put(path, 0, s.start)
    put(path, bends + 1, goal)
    return bends
