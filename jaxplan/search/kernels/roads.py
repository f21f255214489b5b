"""Roads between the places where paths can bend (host, compiled).

Two places are joined if the segment between them keeps its distance from obstacles and can be part of a shortest path:
at both ends it runs along the surface there, not into it.
"""

import functools
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32

from jaxplan.search.kernels.cells import at, distance
from jaxplan.search.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.sight import keeps_clear

TANGENT = 0.45
"""Largest sine of the angle between a road and the surface at its ends: neighbouring places are up to ``places.TURN``
apart, and off the surface."""


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


Box = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]
"""Lower and upper corner [m]."""


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
    ) -> Int32[np.ndarray, "e 2"]:
        """Pairs of places."""


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
    corners = tuple(box[0].tolist()), tuple(box[1].tolist())
    return _compiled_join()(field, float(limit), points, normals, fresh, own, *corners)


def touching(points: Float[np.ndarray, "n 3"], pairs: Int32[np.ndarray, "e 2"], box: Box) -> Bool[np.ndarray, "e"]:
    """Which segments between pairs of points [m] touch a box."""
    found = np.zeros(len(pairs), dtype=bool)
    _compiled_touching()(points, pairs, tuple(box[0].tolist()), tuple(box[1].tolist()), found)
    return found


@functools.cache
def _compiled_join() -> _Join:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(field, limit, points, normals, fresh, own, lower, upper):
        _ = version
        n = len(points)
        groups = -(-n // GROUP)
        middles, radii, some_fresh = np.zeros((groups, 3)), np.zeros(groups), np.zeros(groups, np.bool_)
        _group(points, fresh, middles, radii, some_fresh)
        pairs = np.empty((1024, 2), np.int32)
        total = 0
        for g in range(len(radii)):
            for h in range(max(g, own // GROUP), len(radii)):
                far = max(radii[g], radii[h])
                if not (some_fresh[g] or some_fresh[h] or _touches(at(middles, g), at(middles, h), lower, upper, far)):
                    continue
                for u in range(g * GROUP, min((g + 1) * GROUP, n)):
                    a = at(points, u)
                    for v in range(max(u + 1, max(own, h * GROUP)), min((h + 1) * GROUP, n)):
                        b = at(points, v)
                        if not (fresh[u] or fresh[v] or _touches(a, b, lower, upper, 0.0)):
                            continue
                        if not _joined(field, limit, normals, u, v, a, b):
                            continue
                        if total == len(pairs):
                            wider = np.empty((2 * total, 2), np.int32)
                            wider[:total] = pairs
                            pairs = wider
                        pairs[total, 0], pairs[total, 1] = u, v
                        total += 1
        return pairs[:total].copy()

    return entry  # type: ignore[no-any-return]


@runtime_checkable
class _Touching(Protocol):
    """Which segments touch a box."""

    def __call__(
        self,
        points: Float[np.ndarray, "n 3"],
        pairs: Int32[np.ndarray, "e 2"],
        lower: tuple,
        upper: tuple,
        found: Bool[np.ndarray, "e"],
    ) -> None:
        """Write ``found``."""


@functools.cache
def _compiled_touching() -> _Touching:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(points, pairs, lower, upper, found):
        _ = version
        for e in range(len(pairs)):
            found[e] = _touches(at(points, pairs[e, 0]), at(points, pairs[e, 1]), lower, upper, 0.0)

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _joined(field, limit, normals, u, v, a, b):
    """Whether a road joins places ``u`` and ``v``, at a and b [m]."""
    most = TANGENT * distance(a, b)
    if not along_surface(normals, u, a, b, most) or not along_surface(normals, v, a, b, most):
        return False
    return keeps_clear(field, limit, a, b)


@inner
@no_type_check
def along_surface(normals, u, a, b, most):
    """Whether the segment a-b rises or falls by at most so much [m] over the surface at place ``u``."""
    rise = normals[u, 0] * (b[0] - a[0]) + normals[u, 1] * (b[1] - a[1]) + normals[u, 2] * (b[2] - a[2])
    return abs(rise) <= most


@inner
@no_type_check
def _group(points, fresh, middles, radii, some):
    """Write middles and radii [m] of groups of neighbouring places, and whether one of a group is fresh."""
    for g in range(len(radii)):
        begin, end = g * GROUP, min((g + 1) * GROUP, len(points))
        for u in range(begin, end):
            for axis in range(3):
                middles[g, axis] += points[u, axis] / (end - begin)
            some[g] = some[g] or fresh[u]
        for u in range(begin, end):
            radii[g] = max(radii[g], distance(at(middles, g), at(points, u)))


@inner
@no_type_check
def _touches(a, b, lower, upper, around):
    """Whether the segment a-b touches a box, or comes so close [m] to its faces."""
    begin, end = 0.0, 1.0
    for axis in range(3):
        step = b[axis] - a[axis]
        if abs(step) < 1e-12:
            if not lower[axis] - around <= a[axis] <= upper[axis] + around:
                return False
        else:
            low, high = (lower[axis] - around - a[axis]) / step, (upper[axis] + around - a[axis]) / step
            begin, end = max(begin, min(low, high)), min(end, max(low, high))
    return begin <= end
