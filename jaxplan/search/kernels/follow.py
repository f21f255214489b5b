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

from jaxplan.batching import side_by_side
from jaxplan.search.kernels.cells import at, distance
from jaxplan.search.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.heap import Heap, make_heap, pop, push
from jaxplan.search.kernels.roads import TANGENT, Roads
from jaxplan.search.kernels.sight import keeps_clear
from jaxplan.search.kernels.tighten import last_needed, tighten
from jaxplan.search.kernels.ways import FAR, NEAR, NO_PLACE, Search, best_place, list_ways, runs_along, unroll

SHARED = 100
"""Goals from which on they are shared by two cores (measured: one takes up to 45 us, to settle the roads 300)."""
FIRST_REACH = 1.3
"""How far is looked at first, as a multiple of the distance to the farthest goal; then twice as far (arbitrary)."""

_push, _pop = inner(push), inner(pop)


class Limits(NamedTuple):
    """What a search over roads keeps."""

    distance: float
    """From obstacles [m]."""
    from_start: float
    """The same on the way from the start to the first place, which may be nearer to obstacles [m]."""
    tangent: float = TANGENT
    """Sine of the angle to the surface, for the ways from the start and to goals; 1 for any."""


@runtime_checkable
class Follow(Protocol):
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
    whole path, ``length`` its length [m]. Returns the number of places settled,
    at most, where two cores share the goals.
    """
    kept, compiled = tuple(float(limit) for limit in limits), _compiled_follow()

    def some(part: Bool[np.ndarray, "k"]) -> int:
        heap = tuple(make_heap(len(roads.points)))
        return int(compiled(field, kept, tuple(roads), heap, head, goals, part, points, count, length))

    if np.count_nonzero(wanted) < SHARED:
        return some(wanted)
    return max(side_by_side(some, _halves(goals, wanted)))


def _halves(
    goals: Float[np.ndarray, "k 3"], wanted: Bool[np.ndarray, "k"]
) -> tuple[Bool[np.ndarray, "k"], Bool[np.ndarray, "k"]]:
    """Two parts of the wanted goals, those of each near each other."""
    places = goals[wanted]
    along = goals[:, np.argmax(np.ptp(places, axis=0))]
    first = along <= np.median(along[wanted])
    return wanted & first, wanted & ~first


@functools.cache
def _compiled_follow() -> Follow:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(field, limits, roads, heap, head, goals, wanted, points, count, length):
        _ = version
        n, heap = len(roads[0]), Heap(*heap)
        s = Search(
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
        extent = 0.0
        for u in range(n):
            extent = max(extent, distance(s.start, at(s.points, u)))
        while left.any() and before < FAR:
            settled += settle(s, roads, heap, before, reach)
            ended = settled == n or (heap.size[0] == 0 and reach >= extent)
            _write_bent(s, FAR if ended else reach, head, goals, left, done, raw, bent, normals, points, count, length)
            before, reach = (FAR if ended else reach), 2.0 * reach
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
                write(head, head, 0, goal, g, points, count, length)
                left[g] = False
            else:
                farthest = max(farthest, distance(s.start, goal))
    return farthest


@inner
@no_type_check
def settle(s, roads, heap, before, reach):
    """Least ways of all places up to ``reach`` [m], where those up to ``before`` are known; how many are new."""
    first, ends, lengths = roads[2], roads[3], roads[4]
    for u in range(len(s.points)):
        p = at(s.points, u)
        apart = distance(s.start, p)
        fresh = before < apart <= reach and apart < s.cost[u]
        if fresh and runs_along(s, u, s.start, p, apart) and keeps_clear(s.field, s.near, s.start, p):
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
    hint = NO_PLACE
    for g in range(len(goals)):
        if done[g]:
            continue
        here = at(goals, g)
        first, listed = list_ways(s, here, hint, reach)
        hint = first if first >= 0 else hint
        last, bends = -1, 0
        for other in range(g, len(goals)):
            goal = at(goals, other)
            if done[other] or distance(here, goal) > NEAR:
                continue
            u = best_place(s, goal, here, first, listed)
            if u < 0 and other > g and first >= 0:
                continue  # with an order of its own, later
            done[other] = True
            if u < 0 or s.cost[u] + distance(at(s.points, u), goal) > reach:
                continue
            left[other] = False
            if u != last:
                last, bends = u, unroll(s, u, goal, bent, normals)
                bends = tighten(s, bent, normals, bends)
            kept = last_needed(s, bent, bends, goal)
            if kept >= 0:
                write(head, bent, kept, goal, other, points, count, length)
            else:
                kept = unroll(s, u, goal, raw, normals)
                last = -1
                write(head, raw, kept, goal, other, points, count, length)


@inner
@no_type_check
def write(head, path, bends, goal, g, points, count, length):
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
