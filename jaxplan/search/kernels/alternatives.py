"""Clearly different routes to the same goals (host, compiled).

Two paths are clearly different where something stands between them: points at equal shares of their lengths do not all
see each other, which is the test for uniform visibility deformation (Jaillet and Simeon 2008; Zhou, Pan, Gao and Shen,
"RAPTOR", 2021), here with straight lines that nearly touch obstacles.

The candidates are the shortest ways over each place, from the start to it and from it to the goal, in the order of
their lengths (the via-node method of road networks: Abraham, Delling, Goldberg and Werneck 2013), where they turn
around what stands at the place. Goals near each other share them.
"""

import functools
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxplan.search.kernels.cells import at, distance
from jaxplan.search.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.follow import Follow, Limits, settle, write
from jaxplan.search.kernels.heap import Heap, make_heap
from jaxplan.search.kernels.roads import Roads
from jaxplan.search.kernels.sight import keeps_clear
from jaxplan.search.kernels.tighten import last_needed, put, tighten
from jaxplan.search.kernels.ways import FAR, NEAR, Search, sort_ways, turns_around, unroll

LONGEST = 1.5
"""An alternative is at most so many times as long as the shortest route (arbitrary)."""
SHARES = 16
"""Points of two paths that are compared (arbitrary)."""
MOST_TRIED = 400
"""Candidates that are compared for one goal (arbitrary)."""
BETWEEN = 0.05
"""m; how near the straight lines between two paths of the same kind may come to obstacles (arbitrary)."""


def find_alternatives(
    field: tuple,
    limits: Limits,
    roads: Roads,
    head: Float[np.ndarray, "h 3"],
    goals: Float[np.ndarray, "k 3"],
    wanted: Bool[np.ndarray, "k"],
    points: Float[np.ndarray, "rows capacity 3"],
    count: Int[np.ndarray, "rows"],
    length: Float[np.ndarray, "rows"],
) -> int:
    """Write routes that differ clearly from the shortest one, and from each other, for every wanted goal.

    Row ``k`` of ``points``, ``count`` and ``length`` has the shortest path to goal k, which is read; the rows
    ``k + len(goals)``, ``k + 2 len(goals)`` and so on get the others, as in ``follow``. Returns the places settled.
    """
    heap, kept = tuple(make_heap(len(roads.points))), tuple(float(limit) for limit in limits)
    return int(_compiled_alternatives()(field, kept, tuple(roads), heap, head, goals, wanted, points, count, length))


@functools.cache
def _compiled_alternatives() -> Follow:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(field, limits, roads, heap, head, goals, wanted, points, count, length):
        _ = version
        n, k, heap = len(roads[0]), len(goals), Heap(*heap)
        most = len(points) // k
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
        settled = settle(s, roads, heap, -1.0, FAR)
        cost, parent = np.empty(n), np.empty(n, np.int64)
        paths = points, count, length
        size = 2 * n + 2, 3
        scratch = np.empty(size), np.zeros(size), np.empty((most * SHARES, 3)), np.empty((SHARES, 3))
        over, done = np.empty(most, np.int64), np.logical_not(wanted)
        for g in range(k):
            if not done[g]:
                here = at(goals, g)
                t = Search(field, s.limit, s.limit, s.tangent, s.points, s.normals, here, cost, parent, s.ways, s.order)
                settled += _settle_anew(t, roads, heap, LONGEST * length[g])
                kept = _look_for_ways(s, t, g, most, over, head, goals, scratch, paths)
                for other in range(g + 1, k):
                    if not done[other] and distance(here, at(goals, other)) <= NEAR:
                        done[other] = True
                        _take_ways(s, t, other, kept, over, head, goals, scratch, paths)
        return settled

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _settle_anew(t, roads, heap, reach):
    """Least ways of all places up to ``reach`` [m], whatever was known before; how many they are."""
    for u in range(len(t.cost)):
        t.cost[u], t.parent[u], heap.place[u] = np.inf, -1, 0
    heap.size[0] = 0
    return settle(t, roads, heap, -1.0, reach)


@inner
@no_type_check
def _look_for_ways(s, t, g, most, over, head, goals, scratch, paths):
    """Write the alternatives for goal ``g``, and ``over`` which places they lead; how many routes there are."""
    goal = at(goals, g)
    _take_shortest(g, scratch, paths)
    for u in range(len(s.ways)):
        s.ways[u] = s.cost[u] + t.cost[u]
    kept, tried = 1, 0
    for i in range(sort_ways(s, -1.0, LONGEST * paths[2][g])):
        u = s.order[i]
        if kept == most or tried == MOST_TRIED:
            break
        after = t.start if t.parent[u] < 0 else at(t.points, t.parent[u])
        if turns_around(s, u, after, distance(at(s.points, u), after)):
            tried += 1
            if _write_if_different(s, t, u, head, goal, g, kept, g + kept * len(goals), scratch, paths):
                over[kept] = u
                kept += 1
    return kept


@inner
@no_type_check
def _take_ways(s, t, g, found, over, head, goals, scratch, paths):
    """Write the alternatives for goal ``g`` over the places that were ``found`` for a goal near it."""
    goal, kept = at(goals, g), 1
    _take_shortest(g, scratch, paths)
    for i in range(1, found):
        if _write_if_different(s, t, over[i], head, goal, g, kept, g + kept * len(goals), scratch, paths):
            kept += 1


@inner
@no_type_check
def _take_shortest(g, scratch, paths):
    """Sample the shortest path to goal ``g``."""
    bent, known, (points, count, _) = scratch[0], scratch[2], paths
    used = min(count[g], points.shape[1])
    for i in range(used):
        put(bent, i, (points[g, i, 0], points[g, i, 1], points[g, i, 2]))
    _sample(bent, used, known)


@inner
@no_type_check
def _write_if_different(s, t, u, head, goal, g, kept, row, scratch, paths):
    """Write the path over place ``u`` to goal ``g`` if it differs from all ``kept`` ones; returns whether it does."""
    (bent, normals, known, trial), (points, count, length) = scratch, paths
    bends = _unroll_both(s, t, u, goal, bent, normals)
    _sample(bent, bends + 2, trial)
    if not _differs(s, trial, known, kept):
        return False
    bends = last_needed(s, bent, tighten(s, bent, normals, bends), goal)
    if bends < 1:
        return False
    put(bent, bends + 1, goal)
    _sample(bent, bends + 2, trial)
    if _length(bent, bends + 2) > LONGEST * length[g] or not _differs(s, trial, known, kept):
        return False
    write(head, bent, bends, goal, row, points, count, length)
    for i in range(SHARES):
        put(known, kept * SHARES + i, at(trial, i))
    return True


@inner
@no_type_check
def _unroll_both(s, t, u, goal, path, normals):
    """Write the start, the places up to ``u`` and from there on to the goal; returns the number of places."""
    bends, v = unroll(s, u, goal, path, normals), t.parent[u]
    while v >= 0:
        bends += 1
        put(path, bends, at(s.points, v))
        put(normals, bends, at(s.normals, v))
        v = t.parent[v]
    put(path, bends + 1, goal)
    return bends


@inner
@no_type_check
def _sample(path, count, samples):
    """Write points at equal shares of the length of a path of ``count`` points, both ends left out."""
    total = _length(path, count)
    i, gone, step = 1, 0.0, distance(at(path, 0), at(path, 1))
    for m in range(SHARES):
        wanted = total * (m + 1) / (SHARES + 1)
        while gone + step < wanted and i < count - 1:
            gone += step
            i += 1
            step = distance(at(path, i - 1), at(path, i))
        a, b, share = at(path, i - 1), at(path, i), (wanted - gone) / max(step, 1e-9)
        p = a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])
        put(samples, m, p)


@inner
@no_type_check
def _length(path, count):
    """Of a path of ``count`` points [m]."""
    total = 0.0
    for i in range(1, count):
        total += distance(at(path, i - 1), at(path, i))
    return total


@inner
@no_type_check
def _differs(s, trial, known, kept):
    """Whether something stands between a path and each of those that are kept."""
    for other in range(kept):
        between = False
        for m in range(SHARES):
            if not keeps_clear(s.field, BETWEEN, at(trial, m), at(known, other * SHARES + m)):
                between = True
                break
        if not between:
            return False
    return True
