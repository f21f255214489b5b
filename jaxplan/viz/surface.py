"""A world as triangles, for those who draw in three dimensions: what is solid, and what the planner keeps out of."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull, QhullError

from jaxplan.viz.scene import Surface, solids
from jaxplan.world.obstacles import World
from jaxplan.world.occupancy import exact_clearance

MOST_FACES = 120_000
"""Triangles of a surface; larger ones are coarsened (arbitrary: 3 MB in a page)."""
_NODES = 150_000
"""Nodes of the grid by which the padding is traced (arbitrary)."""
_ABOVE = 0.4
"""m over a flight, where worlds with a ceiling are cut open (arbitrary)."""
_SPACING = 0.12
"""m between them, where that is not too many."""


NOTHING = Surface(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))


def world_surface(world: World) -> Surface:
    """All obstacles; half spaces are left out. What has too many triangles is drawn coarser."""
    parts = [_hull(points) for points in solids(world)]
    if world.voxels is not None:
        parts.append(_cells(world))
    if world.mesh is not None:
        parts.append(Surface(np.asarray(world.mesh.vertices, dtype=float), np.asarray(world.mesh.faces)))
    return coarsened(joined(parts))


def padding_surface(world: World, padding: float) -> Surface:
    """Where the distance to the nearest obstacle is ``padding`` [m], inside the room."""
    lower, upper = np.asarray(world.bounds, dtype=float)
    spacing = max(_SPACING, float((np.prod(upper - lower) / _NODES) ** (1 / 3)))
    counts = np.maximum(np.ceil((upper - lower) / spacing).astype(int), 1) + 1
    axes = [np.linspace(low, high, count) for low, high, count in zip(lower, upper, counts, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    away = exact_clearance(world.obstacles, nodes.reshape(-1, 3)).reshape(nodes.shape[:3])
    return level_surface(np.nan_to_num(away - padding, posinf=1e3), lower, (upper - lower) / (counts - 1))


def cut_height(surface: Surface, path: Float[np.ndarray, "n 3"]) -> float:
    """Where to cut a world open that lies over a flight [m]; infinite where most of the flight is seen from above."""
    some = path[np.linspace(0, len(path) - 1, min(len(path), 24)).astype(int)]
    corners = surface.vertices[surface.faces]
    hidden = [_is_below(point, corners) for point in some]
    return float(path[:, 2].max()) + _ABOVE if np.mean(hidden) > 0.5 else np.inf


def _is_below(point: Float[np.ndarray, "3"], corners: Float[np.ndarray, "f 3 3"]) -> bool:
    """Whether any triangle lies over a point."""
    high = corners[corners[..., 2].min(axis=1) > point[2]]
    (ax, ay), (bx, by), (cx, cy) = ((high[:, i, :2] - point[:2]).T for i in range(3))
    turns = np.stack([ax * by - ay * bx, bx * cy - by * cx, cx * ay - cy * ax])
    return bool(((turns > 0.0).all(axis=0) | (turns < 0.0).all(axis=0)).any())


def level_surface(
    values: Float[np.ndarray, "x y z"], origin: Float[np.ndarray, "3"], spacing: Float[np.ndarray, "3"]
) -> Surface:
    """Where values on a grid change their sign; outside is where they are positive.

    By surface nets (Gibson, MICCAI 1998): one vertex in every cell that it crosses.
    """
    inside = values < 0.0
    total = np.zeros((*(side - 1 for side in values.shape), 3))
    crossings = np.zeros(total.shape[:3], dtype=int)
    for axis in range(3):
        low, high = _ends(values, axis)
        crossed = (low < 0.0) != (high < 0.0)
        share = np.where(crossed, low / np.where(crossed, low - high, 1.0), 0.0)
        for corner in np.ndindex(2, 2):
            at = np.insert(np.array(corner), axis, 0)
            window = tuple(slice(start, start + side) for start, side in zip(at, total.shape, strict=False))
            place = np.broadcast_to(at.astype(float), (*total.shape[:3], 3)).copy()
            place[..., axis] = share[window]
            total += crossed[window][..., None] * place
            crossings += crossed[window]
    number = np.full(crossings.shape, -1)
    cells = np.argwhere(crossings > 0)
    number[tuple(cells.T)] = np.arange(len(cells))
    vertices = origin + (cells + total[tuple(cells.T)] / crossings[tuple(cells.T)][:, None]) * spacing
    quads = np.concatenate([_quads(inside, number, axis) for axis in range(3)])
    return Surface(vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


def coarsened(surface: Surface, most: int = MOST_FACES) -> Surface:
    """The same with at most so many triangles: vertices fall together in ever larger cells."""
    vertices, faces = surface
    side = float(np.ptp(vertices, axis=0).max()) / 1024.0 if len(vertices) else 0.0
    while len(faces) > most:
        cells = np.round(surface.vertices / side).astype(np.int64)
        _, first, merged = np.unique(cells, axis=0, return_index=True, return_inverse=True)
        vertices, faces = surface.vertices[first], merged.ravel()[surface.faces]
        faces = faces[(np.diff(np.sort(faces, axis=1), axis=1) > 0).all(axis=1)]
        side *= 1.25
    return Surface(vertices, faces)


def joined(parts: list[Surface]) -> Surface:
    """Several surfaces as one."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, starts, strict=False)]
    return Surface(
        np.concatenate([NOTHING.vertices, *(p.vertices for p in parts)]), np.concatenate([NOTHING.faces, *faces])
    )


def _hull(points: Float[np.ndarray, "p 3"]) -> Surface:
    """The convex hull; nothing where the points lie in a plane."""
    try:
        hull = ConvexHull(points)
    except QhullError:
        return NOTHING
    faces, corners = hull.simplices, points[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inwards = np.einsum("fa,fa->f", normals, hull.equations[:, :3]) < 0.0
    return Surface(points, np.where(inwards[:, None], faces[:, ::-1], faces).astype(np.int64))


def _cells(world: World) -> Surface:
    """The sides of occupied cells that no occupied cell touches, of larger cells where there are too many."""
    assert world.voxels is not None
    occupied, side = np.asarray(world.voxels.occupied), float(world.voxels.spacing)
    origin = np.asarray(world.voxels.origin, dtype=float)
    quads = _sides(occupied)
    while 2 * len(quads) > MOST_FACES:
        even = np.pad(occupied, [(0, count % 2) for count in occupied.shape])
        halves = [count // 2 for count in even.shape]
        occupied = np.asarray(even.reshape(halves[0], 2, halves[1], 2, halves[2], 2).any(axis=(1, 3, 5)))
        side, quads = 2.0 * side, _sides(occupied)
    corners, faces = np.unique(quads.reshape(-1, 3), axis=0, return_inverse=True)
    square = faces.reshape(-1, 4)
    return Surface(origin + side * corners, np.concatenate([square[:, [0, 1, 2]], square[:, [0, 2, 3]]]))


def _sides(occupied: Bool[np.ndarray, "x y z"]) -> Int[np.ndarray, "q 4 3"]:
    """Corners, in cells, of the sides of occupied cells towards free ones."""
    padded = np.pad(occupied, 1)
    found = [np.zeros((0, 4, 3), dtype=int)]
    for axis in range(3):
        square = np.insert(np.array([[0, 0], [1, 0], [1, 1], [0, 1]]), axis, 0, axis=1)
        square = square if axis != 1 else square[::-1]  # x cross z is -y
        low, high = _ends(padded, axis)
        for bare, order in ((low & ~high, 1), (~low & high, -1)):
            cells = np.argwhere(bare) - np.where(np.arange(3) == axis, 0, 1)
            found.append(cells[:, None] + square[::order])
    return np.concatenate(found)


def _ends(values: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """The values at both ends of every edge of the grid along an axis."""
    count = values.shape[axis]
    low, high = np.arange(count - 1), np.arange(1, count)
    return np.take(values, low, axis=axis), np.take(values, high, axis=axis)


def _quads(inside: Bool[np.ndarray, "x y z"], number: Int[np.ndarray, "a b c"], axis: int) -> Int[np.ndarray, "q 4"]:
    """The four cells around every inner edge along an axis whose ends differ, outwards."""
    low, high = _ends(inside, axis)
    first, second = (other for other in range(3) if other != axis)
    inner = tuple(slice(None) if other == axis else slice(1, -1) for other in range(3))
    edges = np.argwhere((low != high)[inner])
    edges[:, [first, second]] += 1
    outwards = low[tuple(edges.T)] != (axis == 1)
    corners = []
    for back in ((1, 1), (0, 1), (0, 0), (1, 0)):
        cell = edges.copy()
        cell[:, first] -= back[0]
        cell[:, second] -= back[1]
        corners.append(number[tuple(cell.T)])
    quads = np.stack(corners, axis=1)
    return np.where(outwards[:, None], quads, quads[:, ::-1])
