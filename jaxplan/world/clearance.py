"""Distance to the nearest obstacle, as pure JAX functions.

Primitives: exact signed distance (negative inside). With q the excess of a point over a box or a cylinder along each
of its own axes, the distance is ``|max(q, 0)| + min(max_i q_i, 0)``: outside and inside parts. Over many primitives
the squared outside parts and the inside parts are minimised apart, so one square root serves all boxes, cylinders and
planes. The derivative is that of the nearest primitive alone.

Meshes and voxels: a lower bound from the exact squared distances D_i at the grid nodes n_i. Squared distance to any
set is ``|p|^2`` plus a concave function of p (a minimum of affine ones), so by Jensen's inequality the trilinear
weights w_i give ``d(p)^2 >= sum w_i D_i - sum w_i |n_i - p|^2 = sum w_i D_i - h^2 sum_axis t (1 - t)``, t being the
point's fractions in its cell: never an overestimate. Where one flat or pointed feature is nearest throughout a cell it
falls short by at most ``3/4 h^2`` in the square; where several compete, by at most ``sqrt(3)/2 h`` more in the
distance.

Precision: float64 where the caller's JAX has 64-bit types enabled. Layout: the coordinates are separate arrays, so
that each primitive is one vectorised pass over the points.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxplan.arrays import AnyArray
from jaxplan.errors import InputError
from jaxplan.world.obstacles import Boxes, Capsules, Cylinders, DistanceGrid, Mesh, Obstacles, Planes, Spheres, World

_FEW = 32
"""Up to so many primitives of a kind are one pass over the points; measured, it halves the time of 400 x 100 points in
environment 3, and more take seconds to compile."""
_UNROLL = 8
"""Primitives per pass where there are more; measured, 4 to 16 are alike."""


class _Nearest(NamedTuple):
    """The nearest surface so far: squared distance [m^2] outside (0 inside) and depth [m] inside (0 outside)."""

    outside: Float[Array, "*batch"]
    inside: Float[Array, "*batch"]


class _Points(NamedTuple):
    """Coordinates of the points [m, world]."""

    x: Float[Array, "*batch"]
    y: Float[Array, "*batch"]
    z: Float[Array, "*batch"]


@runtime_checkable
class _Distance(Protocol):
    """The distance to one kind of primitive."""

    def __call__(self, primitive: Any, p: _Points, /) -> _Nearest:
        """From all points to one primitive: a row of its record, or for each point a row of its own."""


@runtime_checkable
class DistanceIn(Protocol):
    """Distances to obstacles, or to obstacles and faces."""

    def __call__(self, world: World, points: Float[AnyArray, "*batch 3"], /) -> Float[Array, "*batch"]:
        """Signed [m], from each point [m, world] to the nearest one; negative inside."""


_T = TypeVar("_T")


def clearance(world: World | Obstacles, points: Float[AnyArray, "*batch 3"], /) -> Float[Array, "*batch"]:
    """Signed distance [m] from each point (world frame, m) to the nearest obstacle; negative inside one.

    The room's own faces do not count (see ``wall_clearance``). Exact for primitives; for a mesh and for
    voxels a lower bound that is never negative. No obstacle at all: inf. A point with a coordinate that is not
    finite: NaN, so that ``clearance >= margin`` is False. Raises ``InputError`` for points without three coordinates.
    """
    obstacles = world.obstacles if isinstance(world, World) else world
    points = jnp.asarray(points)
    if points.ndim == 0 or points.shape[-1] != 3:
        raise InputError(f"clearance: points have shape {points.shape}, want (..., 3)")
    finite = jnp.isfinite(points).all(axis=-1)
    p = _Points(*(jnp.where(finite, points[..., axis], 0.0) for axis in range(3)))
    kinds = jax.tree.map(lambda leaf: jnp.asarray(leaf, points.dtype), _kinds_of(obstacles))
    distance = _to_primitives(kinds, p)
    if obstacles.mesh is not None:
        distance = jnp.minimum(distance, _grid_distance(obstacles.mesh, p))
    if obstacles.voxels is not None:
        distance = jnp.minimum(distance, _grid_distance(obstacles.voxels, p))
    return jnp.where(finite, distance, jnp.nan)


def wall_clearance(world: World, points: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch"]:
    """Distance [m] from each point to the nearest face of the room from inside; negative outside; NaN for NaN."""
    points = jnp.asarray(points)
    lower, upper = (jnp.broadcast_to(corner, points.shape) for corner in jnp.asarray(world.bounds, points.dtype))
    return jnp.minimum(points - lower, upper - points).min(axis=-1)


def free_distance(world: World, points: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch"]:
    """Signed distance [m] to the nearest obstacle or face of the room; negative inside or outside; NaN for NaN."""
    return jnp.minimum(clearance(world, points), wall_clearance(world, points))


def clearance_at_once(world: World, points: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch"]:
    """``clearance`` with all primitives in one pass, for finite points: little to compile, and soonest on a GPU."""
    points = jnp.asarray(points)
    p = _Points(*(points[..., axis] for axis in range(3)))
    obstacles = jax.tree.map(lambda leaf: jnp.asarray(leaf).astype(points.dtype), _kinds_of(world.obstacles))
    nearest = _Nearest(jnp.full_like(p.x, jnp.inf), jnp.zeros_like(p.x))
    for distance, primitives in zip(_DISTANCES, obstacles, strict=True):
        if _count(primitives):
            found = jax.vmap(distance, in_axes=(0, None))(primitives, p)
            nearest = _Nearest(
                jnp.minimum(nearest.outside, jnp.min(found.outside, axis=0)),
                jnp.minimum(nearest.inside, jnp.min(found.inside, axis=0)),
            )
    grids = [grid for grid in (world.mesh, world.voxels) if grid is not None]
    return functools.reduce(jnp.minimum, (_grid_distance(grid, p) for grid in grids), _signed(nearest))


def free_distance_at_once(world: World, points: Float[AnyArray, "*batch 3"], /) -> Float[Array, "*batch"]:
    """``free_distance`` likewise."""
    return jnp.minimum(clearance_at_once(world, points), wall_clearance(world, points))


def _kinds_of(obstacles: Obstacles) -> tuple:
    """The primitives, in the order of ``_DISTANCES``."""
    return obstacles.boxes, obstacles.cylinders, obstacles.planes, obstacles.spheres, obstacles.capsules


@jax.custom_jvp
def _to_primitives(kinds: tuple, p: _Points) -> Float[Array, "*batch"]:
    """Signed distance to the nearest primitive; inf where there is none."""
    nearest = _Nearest(jnp.full_like(p.x, jnp.inf), jnp.zeros_like(p.x))
    for distance, primitives in zip(_DISTANCES, kinds, strict=True):

        def merge(so_far: _Nearest, primitive: object, distance: _Distance = distance) -> tuple[_Nearest, None]:
            found = distance(primitive, p)
            outside = jnp.minimum(so_far.outside, found.outside)
            return _Nearest(outside, jnp.minimum(so_far.inside, found.inside)), None

        nearest = _over_primitives(merge, nearest, primitives)
    return _signed(nearest)


@_to_primitives.defjvp
def _to_primitives_jvp(primals: tuple, tangents: tuple) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """The derivative of the distance to the one primitive that is nearest to each point."""
    kinds, p = primals
    pairs = list(zip(_DISTANCES, kinds, strict=True))
    nearest = [_index_of_nearest(distance, primitives, p) for distance, primitives in pairs]

    def to_nearest(kinds: tuple, p: _Points) -> Float[Array, "*batch"]:
        best = jnp.full_like(p.x, jnp.inf)
        for distance, primitives, index in zip(_DISTANCES, kinds, nearest, strict=True):
            if _count(primitives):
                chosen = jax.tree.map(
                    lambda leaf, at=index: jnp.take(jnp.moveaxis(leaf, 0, -1), at, -1, mode="clip"), primitives
                )
                best = jnp.minimum(best, _signed(distance(chosen, p)))
        return best

    return jax.jvp(to_nearest, primals, tangents)


def _index_of_nearest(distance: _Distance, primitives: object, p: _Points) -> Int[Array, "*batch"]:
    """For each point the number of the nearest primitive of one kind, 0 if there is none."""

    def compare(so_far: tuple[Array, Array], numbered: tuple[Array, object]) -> tuple[tuple[Array, Array], None]:
        number, primitive = numbered
        value = _signed(distance(primitive, p))
        closer = value < so_far[0]
        return (jnp.where(closer, value, so_far[0]), jnp.where(closer, number, so_far[1])), None

    start = jnp.full_like(p.x, jnp.inf), jnp.zeros(p.x.shape, jnp.int32)
    return _over_primitives(compare, start, primitives, numbered=True)[1]


def _over_primitives(
    merge: Callable[[_T, Any], tuple[_T, None]], start: _T, primitives: object, numbered: bool = False
) -> _T:
    """``merge`` every primitive of one kind into ``start``, one after the other.

    ``numbered`` ones in as many passes: XLA would otherwise repeat the whole comparison at every use of the number.
    """
    count = _count(primitives)
    if count == 0:
        return start
    rows = (jnp.arange(count, dtype=jnp.int32), primitives) if numbered else primitives
    passes = 1 if numbered else count if count <= _FEW else _UNROLL
    return jax.lax.scan(merge, start, rows, unroll=passes)[0]


def _count(primitives: object) -> int:
    return int(jax.tree.leaves(primitives)[0].shape[0])


def _signed(nearest: _Nearest) -> Float[Array, "*batch"]:
    return _sqrt(nearest.outside) + nearest.inside


def _box(box: Boxes, p: _Points) -> _Nearest:
    dx, dy, dz = p.x - box.center[0], p.y - box.center[1], p.z - box.center[2]
    q = [
        jnp.abs(box.rotation[0, i] * dx + box.rotation[1, i] * dy + box.rotation[2, i] * dz) - box.half[i]
        for i in range(3)
    ]
    beyond = [jnp.maximum(excess, 0.0) ** 2 for excess in q]
    inside = jnp.minimum(jnp.maximum(jnp.maximum(q[0], q[1]), q[2]), 0.0)
    return _Nearest(beyond[0] + beyond[1] + beyond[2], inside)


def _cylinder(cylinder: Cylinders, p: _Points) -> _Nearest:
    along, across = _along_and_across(cylinder.center, cylinder.axis, p)
    radial = _sqrt(across) - cylinder.radius
    axial = jnp.abs(along) - cylinder.half_length
    outside = jnp.maximum(radial, 0.0) ** 2 + jnp.maximum(axial, 0.0) ** 2
    return _Nearest(outside, jnp.minimum(jnp.maximum(radial, axial), 0.0))


def _plane(plane: Planes, p: _Points) -> _Nearest:
    height = plane.normal[0] * p.x + plane.normal[1] * p.y + plane.normal[2] * p.z - plane.offset
    return _from_signed(height)


def _sphere(sphere: Spheres, p: _Points) -> _Nearest:
    dx, dy, dz = p.x - sphere.center[0], p.y - sphere.center[1], p.z - sphere.center[2]
    return _from_signed(_sqrt(dx * dx + dy * dy + dz * dz) - sphere.radius)


def _capsule(capsule: Capsules, p: _Points) -> _Nearest:
    along, across = _along_and_across(capsule.center, capsule.axis, p)
    beyond = jnp.maximum(jnp.abs(along) - capsule.half_length, 0.0)
    return _from_signed(_sqrt(across + beyond * beyond) - capsule.radius)


_DISTANCES: tuple[_Distance, ...] = (_box, _cylinder, _plane, _sphere, _capsule)
"""In the order of ``_kinds_of``; each maps one primitive and the points to a ``_Nearest``."""


def _along_and_across(
    center: Float[AnyArray, "3 ..."], axis: Float[AnyArray, "3 ..."], p: _Points
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Coordinate along an axis through ``center`` [m], and squared distance from that axis [m^2]."""
    dx, dy, dz = p.x - center[0], p.y - center[1], p.z - center[2]
    along = axis[0] * dx + axis[1] * dy + axis[2] * dz
    rx, ry, rz = dx - along * axis[0], dy - along * axis[1], dz - along * axis[2]
    return along, rx * rx + ry * ry + rz * rz


def _from_signed(distance: Float[Array, "*batch"]) -> _Nearest:
    return _Nearest(jnp.maximum(distance, 0.0) ** 2, jnp.minimum(distance, 0.0))


def _sqrt(squared: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Square root with gradient 0 where the argument is 0 or less, instead of inf, or is infinite, instead of NaN."""
    positive = (squared > 0.0) & (squared < jnp.inf)
    root = jnp.sqrt(jnp.where(positive, squared, 1.0))
    return jnp.where(positive, root, jnp.where(squared > 0.0, jnp.inf, 0.0))


def _grid_distance(grid: Mesh | DistanceGrid, p: _Points) -> Float[Array, "*batch"]:
    """Lower bound of the distance [m], >= 0.

    Outside the grid, whose box contains all that is solid, the triangle inequality with the nearest point of the
    grid's box, or the distance to that box, whichever is larger.
    """
    shape = grid.squared.shape
    spacing, origin = jnp.asarray(grid.spacing, p.x.dtype), jnp.asarray(grid.origin, p.x.dtype)
    weights, indices, correction, beyond = [], [], jnp.zeros_like(p.x), jnp.zeros_like(p.x)
    for axis, coordinate in enumerate(p):
        steps = (coordinate - origin[axis]) / spacing
        held = jnp.clip(steps, 0.0, shape[axis] - 1.0)
        index = jnp.clip(jnp.floor(held), 0, shape[axis] - 2)
        fraction = held - index
        weights.append((1.0 - fraction, fraction))
        indices.append(index.astype(jnp.int32))
        correction += fraction * (1.0 - fraction)
        beyond += (steps - held) ** 2
    squared = _trilinear(jnp.asarray(grid.squared, p.x.dtype), indices, weights) - spacing**2 * correction
    outside = spacing * _sqrt(beyond)
    return jnp.maximum(_sqrt(squared) - outside, outside)


def _trilinear(
    values: Float[Array, "nx ny nz"], indices: list[Array], weights: list[tuple[Array, Array]]
) -> Float[Array, "*batch"]:
    """Trilinear interpolation at cells that are known to lie inside the grid."""
    _, ny, nz = values.shape
    flat = values.reshape(-1)
    base = (indices[0] * ny + indices[1]) * nz + indices[2]
    total = jnp.zeros_like(weights[0][0])
    for i in range(2):
        for j in range(2):
            for k in range(2):
                corner = flat.at[base + ((i * ny + j) * nz + k)].get(mode="promise_in_bounds")
                total += weights[0][i] * weights[1][j] * weights[2][k] * corner
    return total
