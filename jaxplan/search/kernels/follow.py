"""Taut paths over roads from a start to many goals (host, compiled).

A search is one run of Dijkstra's algorithm from the start, over all places up to a reach that grows as needed. Then
each goal looks for the place that it sees over which the way is shortest, in the order of those ways: the first place
seen is the best one. Goals near each other share that order.

The bends of a path are moved to where it is shortest (``tighten``).
"""

import functools
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxplan.search.kernels.cells import at, distance
from jaxplan.search.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.heap import Heap, make_heap, pop, push
from jaxplan.search.kernels.roads import TANGENT, Roads, along_surface
from jaxplan.search.kernels.sight import keeps_clear
from jaxplan.search.kernels.tighten import last_needed, put, tighten

NEAR = 0.4
"""m; goals that share an order of places (arbitrary)."""
GAIN = 0.99
"""A goal takes another place than the goals around it where its way is shorter by this factor (arbitrary)."""
FIRST_REACH = 1.3
"""How far is looked at first, as a multiple of the distance to the farthest goal; then twice as far (arbitrary)."""
FIRST_SPREAD = 0.2
"""m; how much longer than the shortest way ways are looked at first; then four times as much (arbitrary)."""
TURN_SLACK = 0.1
"""By how much a bend may turn away from the surface, as a difference of unit vectors; the bends are not yet moved."""
_FAR = 1e6
"""m; beyond every room."""

_push, _pop = inner(push), inner(pop)


class Limits(NamedTuple):
    """What a search over roads keeps."""

    distance: float
    """From obstacles [m]."""
    from_start: float
    """The same on the way from the start to the first place, which may be nearer to obstacles [m]."""
    tangent: float = TANGENT
    """Sine of the angle to the surface, for the ways from the start and to goals; 1 for any."""


class _Search(NamedTuple):
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


@runtime_checkable
class _Follow(Protocol):
    """The compiled search."""

    def __call__(
        self,
        field: tuple,
        limits: tuple,
        roads: tuple,
        heap: tuple,
        head: Float[np.ndarray, "h 3"],
        goals: Float[np.ndarray, "k 3"],
        wanted: Bool[np.ndarray, "k"],
        points: Float[np.ndarray, "k capacity 3"],
        count: Int[np.ndarray, "k"],
        length: Float[np.ndarray, "k"],
    ) -> int:
        """Write ``points``, ``count`` and ``length`` [m, world] of the goals reached; returns the places settled."""


def follow(
    field: tuple,
    limits: Limits,
    roads: Roads,
    head: Float[np.ndarray, "h 3"],
    goals: Float[np.ndarray, "k 3"],
    wanted: Bool[np.ndarray, "k"],
    points: Float[np.ndarray, "k capacity 3"],
    count: Int[np.ndarray, "k"],
    length: Float[np.ndarray, "k"],
) -> int:
    """Write the taut path from the end of ``head`` [m] to every wanted goal that it, or a place on its roads, sees.

    ``points`` gets the path with ``head`` before it, as far as there is room; ``count`` the number of points of the
    whole path, ``length`` its length [m]. Returns the number of places settled.
    """
    heap, kept = tuple(make_heap(len(roads.points))), tuple(float(limit) for limit in limits)
    return int(_compiled_follow()(field, kept, tuple(roads), heap, head, goals, wanted, points, count, length))


@functools.cache
def _compiled_follow() -> _Follow:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(field, limits, roads, heap, head, goals, wanted, points, count, length):
        _ = version
        n, heap = len(roads[0]), Heap(*heap)
        s = _Search(
            field,
            limits[0],
            limits[1],
            limits[2],
            roads[0],
            roads[1],
            at(head, len(head) - 1),
            np.full(n, np.inf),
            np.full(n, -1, np.int64),
            np.empty(n),
            np.empty(n, np.int64),
        )
        left, done = wanted.copy(), np.empty(len(goals), np.bool_)
        farthest = _write_straight(s, head, goals, left, points, count, length)
        raw, bent, normals = np.empty((n + 2, 3)), np.empty((n + 2, 3)), np.zeros((n + 2, 3))
        settled, before, reach = 0, -1.0, FIRST_REACH * farthest
        while left.any() and before < _FAR:
            settled += _settle(s, roads, heap, before, reach)
            ended = settled == n or reach >= _FAR
            _write_bent(s, _FAR if ended else reach, head, goals, left, done, raw, bent, normals, points, count, length)
            before, reach = (_FAR if ended else reach), 2.0 * reach
        return settled

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _write_straight(s, head, goals, left, points, count, length):
    """Write the paths of goals that the start sees; returns the distance to the farthest one that is left [m]."""
    farthest = 0.0
    for g in range(len(goals)):
        if left[g]:
            goal = at(goals, g)
            if keeps_clear(s.field, s.near, s.start, goal):
                _write(head, head, 0, goal, g, points, count, length)
                left[g] = False
            else:
                farthest = max(farthest, distance(s.start, goal))
    return farthest


@inner
@no_type_check
def _settle(s, roads, heap, before, reach):
    """Least ways of all places up to ``reach`` [m], where those up to ``before`` are known; how many are new."""
    first, ends, lengths = roads[2], roads[3], roads[4]
    for u in range(len(s.points)):
        p = at(s.points, u)
        apart = distance(s.start, p)
        fresh = before < apart <= reach and apart < s.cost[u]
        if fresh and _runs_along(s, u, s.start, p, apart) and keeps_clear(s.field, s.near, s.start, p):
            s.cost[u], s.parent[u] = apart, -1
            _push(heap, u, apart)
    settled = 0
    while heap.size[0] > 0 and heap.keys[1] <= reach:
        u = _pop(heap)
        settled += 1
        for e in range(first[u], first[u + 1]):
            v = ends[e]
            through = s.cost[u] + lengths[e]
            if through < s.cost[v]:
                s.cost[v], s.parent[v] = through, u
                _push(heap, v, through)
    return settled


@inner
@no_type_check
def _write_bent(s, reach, head, goals, left, done, raw, bent, normals, points, count, length):
    """Write the paths of goals whose way is at most ``reach`` [m], which no way over other places can undercut."""
    for g in range(len(goals)):
        done[g] = not left[g]
    hint = -1
    for g in range(len(goals)):
        if done[g]:
            continue
        here = at(goals, g)
        first, listed = _list_ways(s, here, hint)
        hint = first if first >= 0 else hint
        last, bends = -1, 0
        for other in range(g, len(goals)):
            goal = at(goals, other)
            if done[other] or distance(here, goal) > NEAR:
                continue
            u = _best_place(s, goal, here, first, listed)
            if u < 0 and other > g and first >= 0:
                continue  # with an order of its own, later
            done[other] = True
            if u < 0 or s.cost[u] + distance(at(s.points, u), goal) > reach:
                continue
            left[other] = False
            if u != last:
                last, bends = u, _unroll(s, u, goal, bent, normals)
                bends = tighten(s, bent, normals, bends)
            kept = last_needed(s, bent, bends, goal)
            if kept >= 0:
                _write(head, bent, kept, goal, other, points, count, length)
            else:
                kept = _unroll(s, u, goal, raw, normals)
                last = -1
                _write(head, raw, kept, goal, other, points, count, length)


@inner
@no_type_check
def _list_ways(s, goal, hint):
    """The place over which the way to a goal is shortest, and how many are listed; -1 and 0 without any.

    Listed, in the order of their ways, are the places that may be best for a goal up to ``NEAR`` from this one. Those
    with shorter ways are not: they do not see the goal. Place ``hint``, if there is one, is tried first: longer ways
    are of no interest.
    """
    shortest = np.inf
    for u in range(len(s.points)):
        s.ways[u] = s.cost[u] + distance(at(s.points, u), goal)
        shortest = min(shortest, s.ways[u])
    if shortest == np.inf:
        return -1, 0
    best, tested, bound = -1, 0, shortest + FIRST_SPREAD
    if hint >= 0 and _leads_on(s, hint, goal):
        best, bound = hint, s.ways[hint]
    while True:
        listed = _sort_ways(s, -1.0, bound)
        for n in range(tested, listed):
            u = s.order[n]
            if best >= 0 and s.ways[u] >= bound:
                break
            if _leads_on(s, u, goal):
                best = u
                break
        if best >= 0:
            return best, _sort_ways(s, s.ways[best], s.ways[best] + 2.0 * NEAR)
        if bound > _FAR:
            return -1, 0
        tested, bound = listed, shortest + 4.0 * (bound - shortest)


@inner
@no_type_check
def _sort_ways(s, least, most):
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
def _best_place(s, goal, here, first, listed):
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
    if not _runs_along(s, u, p, goal, apart):
        return False
    before = s.start if s.parent[u] < 0 else at(s.points, s.parent[u])
    since = max(distance(before, p), 1e-9)
    turn = 0.0
    for axis in range(3):
        turn += s.normals[u, axis] * ((goal[axis] - p[axis]) / apart - (p[axis] - before[axis]) / since)
    return turn <= TURN_SLACK and keeps_clear(s.field, s.limit, p, goal)


@inner
@no_type_check
def _runs_along(s, u, a, b, apart):
    """Whether the segment a-b of this length [m] may begin or end at place ``u``."""
    return along_surface(s.normals, u, a, b, s.tangent * apart)


@inner
@no_type_check
def _unroll(s, u, goal, path, normals):
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


@inner
@no_type_check
def _write(head, path, bends, goal, g, points, count, length):
    """Write the path of goal ``g``: the head, the bends 1 .. ``bends`` of ``path``, the goal."""
    before = len(head)
    total, capacity = before + bends + 1, points.shape[1]
    last = at(head, 0)
    length[g] = 0.0
    for i in range(max(total, capacity)):
        p = goal
        if i < before:
            p = at(head, i)
        elif i < total - 1:
            p = at(path, i - before + 1)
        length[g] += distance(last, p)
        last = p
        if i < capacity:
            points[g, i, 0], points[g, i, 1], points[g, i, 2] = p
    count[g] = total
