"""What is solid near a plan, in arrays of one size for all worlds, so that a refinement compiles once (host).

A refinement stays near the plan that it begins from. Of each kind of primitive the nearest are kept, and of a mesh's or
an occupancy map's nodes those around the plan, every second or third where there are too many: the squared distances at
the nodes are exact, so a coarser grid of them still bounds the distance from below (``jaxplan.world.clearance``). What
is left out is seen by the last look at what the refinement gives.
"""

import numpy as np
from jaxtyping import Float, Float32

from jaxplan.search.kernels.graph import Frame
from jaxplan.search.kernels.solids import BOX, CAPSULE, CYLINDER, PLANE, SPHERE, Solids
from jaxplan.world.obstacles import (
    Boxes,
    Capsules,
    Cylinders,
    DistanceGrid,
    Mesh,
    Obstacles,
    Planes,
    Spheres,
    make_obstacles,
)

CAPACITY = {BOX: 24, CYLINDER: 32, PLANE: 4, SPHERE: 8, CAPSULE: 8}
"""Primitives of each kind: as many as the stored rooms have (arbitrary)."""
NODES = (64, 64, 32)
"""Of a grid of distances, along each axis (arbitrary: 6.4 m at the usual 0.1 m)."""
AROUND = 1.0
"""m; how far from the plan nodes of a grid are wanted (arbitrary: more than a plan keeps from obstacles)."""
NOWHERE = 1e3
"""m; where the primitives are that fill up the arrays."""


def surroundings(solids: Solids, places: Float[np.ndarray, "n 3"]) -> Obstacles:
    """The obstacles of a world that are nearest to ``places`` along a plan [m, world].

    Whatever the world holds the arrays are of the same shapes, but that a mesh and occupied cells are only there where
    the world has them, of both the distances alone.
    """
    apart = _apart(solids.boxes, places)
    box, cylinder, plane, sphere, capsule = (_nearest(solids, apart, kind) for kind in CAPACITY)
    surface = _around(solids.mesh, Frame(*solids.mesh_frame), places)
    return make_obstacles(
        boxes=Boxes(center=box[:, :3], half=box[:, 3:6], rotation=box[:, 6:15].reshape(-1, 3, 3)),
        cylinders=Cylinders(**_rods(cylinder)),
        planes=Planes(normal=plane[:, :3], offset=plane[:, 3]),
        spheres=Spheres(center=sphere[:, :3], radius=sphere[:, 3]),
        capsules=Capsules(**_rods(capsule)),
        mesh=None if surface is None else _without_faces(surface),
        voxels=_around(solids.voxels, Frame(*solids.voxels_frame), places),
    )


def _apart(boxes: Float[np.ndarray, "n 6"], places: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "n"]:
    """From the box around each primitive to the nearest of the places [m]."""
    lower, upper = boxes[:, None, :3], boxes[:, None, 3:]
    beyond = np.maximum(np.maximum(lower - places[None], places[None] - upper), 0.0)
    return np.asarray(np.linalg.norm(beyond, axis=-1).min(axis=1))


def _nearest(solids: Solids, apart: Float[np.ndarray, "n"], kind: int) -> Float[np.ndarray, "m 16"]:
    """The rows of the nearest primitives of one kind, filled up with ones that are far away."""
    rows = np.tile(_FILLERS[kind], (CAPACITY[kind], 1))
    members = np.flatnonzero(solids.kinds == kind)
    members = members[np.argsort(apart[members], kind="stable")][: len(rows)]
    rows[: len(members)] = solids.numbers[members]
    return rows


def _rods(rows: Float[np.ndarray, "m 16"]) -> dict[str, Float[np.ndarray, "m ..."]]:
    """Fields of cylinders and capsules."""
    return {"center": rows[:, :3], "axis": rows[:, 3:6], "radius": rows[:, 6], "half_length": rows[:, 7]}


def _around(
    squared: Float32[np.ndarray, "nx ny nz"], frame: Frame, places: Float[np.ndarray, "n 3"]
) -> DistanceGrid | None:
    """The nodes around the places; none where the grid has none.

    Nodes beyond the grid have the distance of the nearest one in it, which is less: all that is solid is in its box.
    """
    if not squared.size:
        return None
    origin, nodes = np.array([frame.x, frame.y, frame.z]), np.array(NODES)
    low = (places.min(axis=0) - AROUND - origin) / frame.h
    high = (places.max(axis=0) + AROUND - origin) / frame.h
    stride = max(1, int(np.ceil(((high - low) / (nodes - 2)).max())))
    last = np.array(squared.shape) - 1
    first = np.clip(np.floor(0.5 * (low + high - stride * (nodes - 1))).astype(int), 0, last - 1)
    taken = (np.minimum(first[axis] + stride * np.arange(nodes[axis]), last[axis]) for axis in range(3))
    return DistanceGrid(
        occupied=np.zeros((0, 0, 0), bool),
        squared=squared[np.ix_(*taken)],
        origin=origin + first * frame.h,
        spacing=stride * frame.h,
    )


def _without_faces(grid: DistanceGrid) -> Mesh:
    """A mesh of which the distances are known only."""
    vertices, faces = np.zeros((0, 3)), np.zeros((0, 3), np.int32)
    return Mesh(vertices=vertices, faces=faces, squared=grid.squared, origin=grid.origin, spacing=grid.spacing)


def _filler(*numbers: float) -> Float[np.ndarray, "16"]:
    return np.pad(np.array(numbers), (0, 16 - len(numbers)))


_ROD = _filler(0.0, 0.0, -NOWHERE, 0.0, 0.0, 1.0)
_FILLERS = {
    BOX: _filler(0.0, 0.0, -NOWHERE, 0.0, 0.0, 0.0, *np.eye(3).ravel()),
    CYLINDER: _ROD,
    PLANE: _filler(0.0, 0.0, 1.0, -NOWHERE),
    SPHERE: _filler(0.0, 0.0, -NOWHERE),
    CAPSULE: _ROD,
}
