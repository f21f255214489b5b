"""Roads between the places where paths can bend (host, compiled).

Two places are joined if the segment between them keeps its distance from obstacles and can be part of a shortest path:
at both ends it runs along the surface there, not into it.
"""

import functools
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32

from jaxplan.batching import CORES, side_by_side
from jaxplan.search.kernels.boxes import between, sides, touches
from jaxplan.search.kernels.cells import at, distance
from jaxplan.search.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.fans import SECTORS, look_round, sector_of
from jaxplan.search.kernels.sight import FEW, Box, follows_clear, keeps_clear, too_close_among

TANGENT = 0.45
"""Largest sine of the angle between a road and the surface at its ends: neighbouring places are up to ``places.TURN``
apart, and off the surface."""


NOWHERE: Box = np.full(3, 1e9), np.full(3, 1e9)
"""A box that no road touches."""
GROUP = 16
"""Places that are looked at together, to see whether roads from them can touch a box (arbitrary)."""


class Roads(NamedTuple):
    """Places and the roads between them; compiled code takes a plain tuple."""

    points: Float[np.ndarray, "n 3"]
    """[m, world]"""
    normals: Float[np.ndarray, "n 3"]
    """Outward normal of the surface; 0 in passages."""
    first: Int32[np.ndarray, "ends"]
    """By place, where its roads begin; one entry more."""
    ends: Int32[np.ndarray, "e"]
    """Where they lead, ascending."""
    lengths: Float32[np.ndarray, "e"]
    """[m]"""


@runtime_checkable
class _Join(Protocol):
    """Roads between places."""

    def __call__(
        self,
        field: tuple,
        limit: float,
        points: Float[np.ndarray, "n 3"],
        normals: Float[np.ndarray, "n 3"],
        fresh: Bool[np.ndarray, "n"],
        own: int,
        lower: tuple,
        upper: tuple,
        share: int,
        shares: int,
    ) -> Int32[np.ndarray, "e 2"]:
        """Pairs of places, a share of them."""


def join(
    field: tuple,
    limit: float,
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    fresh: Bool[np.ndarray, "n"],
    own: int,
    box: Box,
) -> Int32[np.ndarray, "e 2"]:
    """Pairs of places that a road joins, the lower number first; where one is ``fresh`` or the road touches a box.

    The other number is at least ``own``.
    """
    corners, compiled = (tuple(box[0].tolist()), tuple(box[1].tolist())), _compiled_join()
    pairs = side_by_side(
        lambda share: compiled(field, float(limit), points, normals, fresh, own, *corners, share, CORES), range(CORES)
    )
    return np.concatenate(pairs)


def kept(
    roads: Roads,
    shared: int,
    now: Int32[np.ndarray, "n"],
    field: tuple,
    limit: float,
    box: Box,
    again: bool,
) -> Int32[np.ndarray, "m 2"]:
    """Pairs of places that a road joined before and joins still, as they are numbered ``now`` (-1: not there any more).

    One of the two is at least number ``shared`` before. Roads that touch the ``box`` [m] are looked at ``again``, or
    left out.
    """
    corners = tuple(box[0].tolist()), tuple(box[1].tolist())
    return _compiled_kept()(tuple(roads), shared, now, field, float(limit), *corners, again)


def linked(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    pairs: Int32[np.ndarray, "e 2"],
    wider: Roads | None,
) -> Roads:
    """Roads in both directions, in order: these, and those between the first places that a ``wider`` level has."""
    if wider is None:
        wider = Roads(points[:0], normals[:0], np.zeros(1, np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32))
    elif len(points) == len(wider.points):  # no places of its own, so no roads
        return wider
    return Roads(points, normals, *_compiled_linked()(points, pairs, tuple(wider)))


@functools.cache
def _compiled_join() -> _Join:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(field, limit, points, normals, fresh, own, lower, upper, share, shares):
        _ = version
        n, count = len(points), len(field[3][0]) if len(field[3][0]) <= FEW else 0
        members, counts = np.empty((SECTORS, count), np.int32), np.zeros(SECTORS, np.int32)
        everything = np.arange(count).astype(np.int32)
        groups = -(-n // GROUP) if lower[0] < NOWHERE[0][0] else 0
        middles, radii = np.zeros((groups, 3)), np.zeros(groups)
        _group(points, middles, radii)
        place, group, box = (points, normals, fresh, own), (middles, radii), (lower, upper)
        pairs, total = np.empty((n + 1024, 2), np.int32), 0
        for u in range(share, n, shares):
            if total + n > len(pairs):
                pairs = np.concatenate((pairs, pairs))
            if fresh[u]:
                total = _enter_all(field, limit, place, u, members, counts, pairs, total)
            elif groups > 0:
                total = _enter_through(field, limit, place, u, box, group, everything, pairs, total)
        return pairs[:total].copy()

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _enter_all(field, limit, place, u, members, counts, pairs, total):
    """Enter the roads from a fresh place, but those to lower places that are fresh as well; how many there are then."""
    points, normals, fresh, own = place
    kinds, numbers, boxes = field[3][0], field[3][1], field[3][2]
    few, alone = len(kinds) <= FEW, field[3][6].size == 0 and field[3][8].size == 0
    a, likely = at(points, u), -1  # neighbours mostly stand behind the same thing
    if few:
        look_round(boxes, limit, a, members, counts)
    for v in range(0 if u >= own else own, len(points)):
        b = at(points, v)
        if v == u or (v < u and fresh[v]) or not _along_both(normals, u, v, a, b):
            continue
        close, (low, high) = -1, ((a, b) if u < v else (b, a))  # what is found depends a little on the direction
        if few:
            s = sector_of(a, b)
            close = too_close_among(kinds, numbers, boxes, limit, low, high, likely, members[s, : counts[s]])
            likely = close if close >= 0 else likely
        if close < 0 and ((few and alone) or follows_clear(field, limit, low, high)):
            pairs[total, 0], pairs[total, 1] = min(u, v), max(u, v)
            total += 1
    return total


@inner
@no_type_check
def _enter_through(field, limit, place, u, box, group, everything, pairs, total):
    """Enter the roads through a box to higher places, where neither is fresh; how many there are then."""
    points, normals, fresh, own = place
    kinds, numbers, boxes = field[3][0], field[3][1], field[3][2]
    few, alone = len(kinds) <= FEW, field[3][6].size == 0 and field[3][8].size == 0
    a, likely, least = at(points, u), -1, max(u + 1, own)
    seen = sides(a, box[0], box[1])
    for g in range(least // GROUP, len(group[1])):
        middle, radius = at(group[0], g), group[1][g]
        if not (between(seen, a, middle, radius) and touches(a, middle, box[0], box[1], radius)):
            continue
        for v in range(max(least, g * GROUP), min((g + 1) * GROUP, len(points))):
            b = at(points, v)
            if fresh[v] or not (between(seen, a, b, 0.0) and _along_both(normals, u, v, a, b)):
                continue
            if not touches(a, b, box[0], box[1], 0.0):
                continue
            close = too_close_among(kinds, numbers, boxes, limit, a, b, likely, everything) if few else -1
            likely = close if close >= 0 else likely
            if close < 0 and ((few and alone) or follows_clear(field, limit, a, b)):
                pairs[total, 0], pairs[total, 1] = u, v
                total += 1
    return total


@runtime_checkable
class _Kept(Protocol):
    """Roads that are left."""

    def __call__(
        self,
        roads: tuple,
        shared: int,
        now: Int32[np.ndarray, "n"],
        field: tuple,
        limit: float,
        lower: tuple,
        upper: tuple,
        again: bool,
    ) -> Int32[np.ndarray, "m 2"]:
        """Pairs of places."""


@functools.cache
def _compiled_kept() -> _Kept:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(roads, shared, now, field, limit, lower, upper, again):
        _ = version
        points, _, first, ends, _ = roads
        pairs, total = np.empty((len(ends) // 2, 2), np.int32), 0
        for u in range(len(points)):
            if now[u] < 0:
                continue
            a = at(points, u)
            begin = first[u + 1]
            while begin > first[u] and ends[begin - 1] > u and ends[begin - 1] >= shared:
                begin -= 1
            for e in range(begin, first[u + 1]):
                v = ends[e]
                if now[v] < 0:
                    continue
                b = at(points, v)
                if touches(a, b, lower, upper, 0.0) and not (again and keeps_clear(field, limit, a, b)):
                    continue
                pairs[total, 0], pairs[total, 1] = min(now[u], now[v]), max(now[u], now[v])
                total += 1
        return pairs[:total].copy()

    return entry  # type: ignore[no-any-return]


@runtime_checkable
class _Linked(Protocol):
    """Roads by place."""

    def __call__(
        self, points: Float[np.ndarray, "n 3"], pairs: Int32[np.ndarray, "e 2"], wider: tuple
    ) -> tuple[Int32[np.ndarray, "ends"], Int32[np.ndarray, "m"], Float32[np.ndarray, "m"]]:
        """The last three of ``Roads``."""


@functools.cache
def _compiled_linked() -> _Linked:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(points, pairs, wider):
        _ = version
        _, _, known, leads, apart = wider
        first = np.zeros(len(points) + 1, np.int32)
        for u in range(len(known) - 1):
            first[u + 1] = known[u + 1] - known[u]
        for e in range(len(pairs)):
            first[pairs[e, 0] + 1] += 1
            first[pairs[e, 1] + 1] += 1
        for u in range(len(points)):
            first[u + 1] += first[u]
        ends, lengths, free = np.empty(first[-1], np.int32), np.empty(first[-1], np.float32), first[:-1].copy()
        for u in range(len(known) - 1):
            for e in range(known[u], known[u + 1]):
                _put(ends, lengths, first, free, u, leads[e], apart[e])
        for e in range(len(pairs)):
            u, v = pairs[e, 0], pairs[e, 1]
            length = np.float32(distance(at(points, u), at(points, v)))
            _put(ends, lengths, first, free, u, v, length)
            _put(ends, lengths, first, free, v, u, length)
        return first, ends, lengths

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _put(ends, lengths, first, free, u, v, length):
    """Enter a road from ``u`` to ``v`` behind those that lead to lower numbers: they come nearly in order."""
    e = free[u]
    free[u] += 1
    while e > first[u] and ends[e - 1] > v:
        ends[e], lengths[e] = ends[e - 1], lengths[e - 1]
        e -= 1
    ends[e], lengths[e] = v, length


@inner
@no_type_check
def _along_both(normals, u, v, a, b):
    """Whether a road between places ``u`` and ``v``, at a and b [m], would run along the surface at both."""
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    most = TANGENT * TANGENT * (dx * dx + dy * dy + dz * dz)
    at_u = normals[u, 0] * dx + normals[u, 1] * dy + normals[u, 2] * dz
    at_v = normals[v, 0] * dx + normals[v, 1] * dy + normals[v, 2] * dz
    return at_u * at_u <= most and at_v * at_v <= most


@inner
@no_type_check
def along_surface(normals, u, a, b, most):
    """Whether the segment a-b rises or falls by at most so much [m] over the surface at place ``u``."""
    rise = normals[u, 0] * (b[0] - a[0]) + normals[u, 1] * (b[1] - a[1]) + normals[u, 2] * (b[2] - a[2])
    return abs(rise) <= most


@inner
@no_type_check
def _group(points, middles, radii):
    """Write middles and radii [m] of groups of neighbouring places."""
    for g in range(len(radii)):
        begin, end = g * GROUP, min((g + 1) * GROUP, len(points))
        for u in range(begin, end):
            for axis in range(3):
                middles[g, axis] += points[u, axis] / (end - begin)
        for u in range(begin, end):
            radii[g] = max(radii[g], distance(at(middles, g), at(points, u)))
