"""A world as what Foxglove draws (host, NumPy)."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxplan.io.foxglove import LINE_LOOP, ROUND, Colour, Json, line, scene, solid, triangles
from jaxplan.world.obstacles import DistanceGrid, World

SOLID: Colour = (0.55, 0.58, 0.63, 0.9)
FACES: Colour = (0.3, 0.33, 0.38, 1.0)


def world_scene(world: World) -> Json:
    """The room's edges and all that stands in it, as an entity called ``world``; half spaces are left out."""
    lower, upper = np.asarray(world.bounds, dtype=float)
    cubes, spheres, cylinders = _primitives(world)
    parts = {"cubes": cubes, "spheres": spheres, "cylinders": cylinders, "lines": _edges(lower, upper)}
    if world.mesh is not None:
        indices = np.asarray(world.mesh.faces).ravel().tolist()
        parts["triangles"] = [triangles(np.asarray(world.mesh.vertices, dtype=float), indices, SOLID)]
    return scene(0.0, "world", **parts)


def _primitives(world: World) -> tuple[list[Json], list[Json], list[Json]]:
    """Cubes, spheres and cylinders; a capsule is one cylinder and two spheres."""
    boxes = world.boxes
    cubes = [
        solid(center, _wxyz(Rotation.from_matrix(rotation)), 2.0 * half, SOLID)
        for center, half, rotation in _rows(boxes.center, boxes.half, boxes.rotation)
    ]
    if world.voxels is not None:
        cubes += [solid(center, None, size, SOLID) for center, size in _columns(world.voxels)]
    spheres = [
        solid(center, None, np.full(3, 2.0 * radius), SOLID)
        for center, radius in _rows(world.spheres.center, world.spheres.radius)
    ]
    cylinders = []
    for rods in (world.cylinders, world.capsules):
        for center, axis, radius, half in _rows(rods.center, rods.axis, rods.radius, rods.half_length):
            size = np.array([2.0 * radius, 2.0 * radius, 2.0 * half])
            cylinders.append(solid(center, _wxyz(_upright_to(axis)), size, SOLID) | ROUND)
            if rods is world.capsules:
                ends = (center - half * axis, center + half * axis)
                spheres += [solid(end, None, np.full(3, 2.0 * radius), SOLID) for end in ends]
    return cubes, spheres, cylinders


def _rows(*columns: object) -> zip:
    return zip(*(np.asarray(column, dtype=float) for column in columns), strict=True)


def _wxyz(rotation: Rotation) -> Float[np.ndarray, "4"]:
    return np.asarray(rotation.as_quat(scalar_first=True))


def _upright_to(axis: Float[np.ndarray, "3"]) -> Rotation:
    """A turn of z to ``axis``."""
    return Rotation.align_vectors(np.asarray(axis)[None], np.array([[0.0, 0.0, 1.0]]))[0]


def _columns(voxels: DistanceGrid) -> list[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]]:
    """Centres and sizes [m] of boxes that fill the occupied cells: one for each run of them along z."""
    occupied = np.pad(np.asarray(voxels.occupied, dtype=np.int8), [(0, 0), (0, 0), (1, 1)])
    steps = np.diff(occupied, axis=2)
    begins, ends = np.argwhere(steps == 1), np.argwhere(steps == -1)
    spacing, origin = float(voxels.spacing), np.asarray(voxels.origin, dtype=float)
    lower, upper = origin + spacing * begins, origin + spacing * (ends + np.array([1, 1, 0]))
    return list(zip((lower + upper) / 2.0, upper - lower, strict=True))


def _edges(lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]) -> list[Json]:
    """Of the room: floor, ceiling and the corners between them."""
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    floor, ceiling = (lower + (upper - lower) * np.column_stack([square, np.full(4, level)]) for level in (0, 1))
    rings = [line(floor, FACES, LINE_LOOP), line(ceiling, FACES, LINE_LOOP)]
    return rings + [line(np.stack(corners), FACES) for corners in zip(floor, ceiling, strict=True)]
