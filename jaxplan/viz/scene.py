"""A world drawn in two dimensions: seen from above (x, y) or from the side (x, z).

What the section plane cuts is filled; what lies in front of it or behind it is an outline. A surface mesh is its
section, filled where that is closed, over its sharp edges.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.patches import Polygon, Rectangle
from scipy.spatial import ConvexHull, QhullError

from jaxplan.world.obstacles import DistanceGrid, Mesh, World

FILL, EDGE, FAINT = "#b9bec6", "#5b626c", "#d4d8de"
SHARP_COSINE = np.cos(np.radians(25.0))
"""Edges between faces that turn by more than this are drawn (arbitrary)."""
_FINE = 500
"""Rows and columns by which a mesh's section is filled (arbitrary)."""
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)

Solid = Float[np.ndarray, "p 3"]
"""Points [m, world] whose convex hull is an obstacle."""


class Surface(NamedTuple):
    """Triangles, counter-clockwise seen from outside where there is an outside."""

    vertices: Float[np.ndarray, "v 3"]
    """Metres, world."""
    faces: Int[np.ndarray, "f 3"]


def draw_world(axes: Axes, world: World, across: int, level: float, free: Float[np.ndarray, "3"] | None = None) -> None:
    """Draw the room and its obstacles, projected along axis ``across`` (2: from above, 1: from the side).

    Args:
        axes: to draw on.
        world: the room.
        across: the axis that is looked along.
        level: where the section plane is on that axis [m].
        free: a place that is in no obstacle [m], where one is known: a mesh may be the room's own shell.
    """
    shown = [axis for axis in range(3) if axis != across]
    lower, upper = np.asarray(world.bounds, dtype=float)
    width, height = (upper - lower)[shown]
    axes.add_patch(Rectangle(tuple(lower[shown]), width, height, fill=False, edgecolor=EDGE, linewidth=1.2, zorder=1))
    for solid in solids(world):
        cut = bool(solid[:, across].min() <= level <= solid[:, across].max())
        style = {"facecolor": FILL, "edgecolor": EDGE} if cut else {"facecolor": "none", "edgecolor": FAINT}
        axes.add_patch(Polygon(_outline(solid[:, shown]), closed=True, linewidth=0.8, zorder=1.5 + 0.1 * cut, **style))
    if world.voxels is not None:
        _draw_voxels(axes, world.voxels, across, level)
    if world.mesh is not None:
        edges = sharp_edges(world.mesh)[..., shown]
        cuts = section(world.mesh, across, level)[..., shown]
        axes.add_collection(LineCollection(list(edges), colors=FAINT, linewidths=0.6, zorder=1.4), autolim=False)
        axes.add_collection(LineCollection(list(cuts), colors=EDGE, linewidths=1.2, zorder=1.6), autolim=False)
        _fill_section(axes, cuts, (lower[shown], upper[shown]), None if free is None else free[shown])


def _fill_section(
    axes: Axes,
    cuts: Float[np.ndarray, "n 2 2"],
    corners: tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]],
    free: Float[np.ndarray, "2"] | None,
) -> None:
    """Fill what a mesh's section encloses, apart from where ``free`` is."""
    (left, low), (right, high) = corners
    columns = np.linspace(left, right, _FINE)
    inside = enclosed(cuts, columns, np.linspace(low, high, _FINE))
    if free is not None and enclosed(cuts, free[:1], free[1:])[0, 0]:
        inside = ~inside
    image = np.ma.masked_where(~inside, np.ones(inside.shape))
    extent = (left, right, low, high)
    axes.imshow(image, origin="lower", extent=extent, cmap=ListedColormap([FILL]), aspect="auto", zorder=1.5)


def enclosed(
    cuts: Float[np.ndarray, "n 2 2"], columns: Float[np.ndarray, "c"], rows: Float[np.ndarray, "r"]
) -> Bool[np.ndarray, "r c"]:
    """Whether segments enclose the points of a grid: an odd number of them lies to the right.

    A row that crosses an odd number of segments meets an outline that is not closed, and encloses nothing.
    """
    found = np.zeros((len(rows), len(columns)), dtype=bool)
    (x0, y0), (x1, y1) = cuts[:, 0].T, cuts[:, 1].T
    for index, y in enumerate(rows):
        crossed = (y0 > y) != (y1 > y)
        share = (y - y0[crossed]) / (y1 - y0)[crossed]
        places = np.sort(x0[crossed] + share * (x1 - x0)[crossed])
        if len(places) % 2 == 0:
            found[index] = np.searchsorted(places, columns) % 2 == 1
    return found


def _draw_voxels(axes: Axes, voxels: DistanceGrid, across: int, level: float) -> None:
    """Fill the occupied cells that the section plane cuts."""
    occupied, spacing = np.asarray(voxels.occupied), float(voxels.spacing)
    lower = np.asarray(voxels.origin, dtype=float)
    index = int(np.clip((level - lower[across]) / spacing, 0, occupied.shape[across] - 1))
    cells = np.take(occupied, index, axis=across).T
    shown = [axis for axis in range(3) if axis != across]
    ends = lower + np.array(occupied.shape) * spacing
    extent = (lower[shown[0]], ends[shown[0]], lower[shown[1]], ends[shown[1]])
    image = np.ma.masked_where(~cells, np.ones(cells.shape))
    axes.imshow(image, origin="lower", extent=extent, cmap=ListedColormap([FILL]), aspect="auto", zorder=1.4)


def solids(world: World) -> Iterator[Solid]:
    """Every convex primitive as points on its surface; half spaces are left out."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    boxes = world.boxes
    for center, half, rotation in zip(*_arrays(boxes.center, boxes.half, boxes.rotation), strict=True):
        yield center + (corners * half) @ rotation.T
    cylinders = world.cylinders
    parts = (cylinders.center, cylinders.axis, cylinders.radius, cylinders.half_length)
    for center, axis, radius, half_length in zip(*_arrays(*parts), strict=True):
        rim = radius * _ring(axis)
        yield center + np.concatenate([rim - half_length * axis, rim + half_length * axis])
    for center, radius in zip(*_arrays(world.spheres.center, world.spheres.radius), strict=True):
        yield center + radius * _ball()
    capsules = world.capsules
    parts = (capsules.center, capsules.axis, capsules.radius, capsules.half_length)
    for center, axis, radius, half_length in zip(*_arrays(*parts), strict=True):
        ball = radius * _ball()
        yield center + np.concatenate([ball - half_length * axis, ball + half_length * axis])


def section(mesh: Mesh, across: int, level: float) -> Float[np.ndarray, "n 2 3"]:
    """Where the plane ``x[across] = level`` cuts the mesh's triangles: segments [m, world]."""
    corners = np.asarray(mesh.vertices, dtype=float)[np.asarray(mesh.faces)]
    height = corners[..., across] - level
    height = np.where(height == 0.0, 1e-12, height)  # a corner on the plane counts as just above it
    above = height > 0.0
    corners, height, above = (array[above.any(axis=1) & ~above.all(axis=1)] for array in (corners, height, above))
    if not len(corners):
        return np.zeros((0, 2, 3))
    alone = np.where((above.sum(axis=1) == 1)[:, None], above, ~above).argmax(axis=1)
    rows = np.arange(len(corners))
    ends = []
    for step in (1, 2):
        other = (alone + step) % 3
        share = height[rows, alone] / (height[rows, alone] - height[rows, other])
        ends.append(corners[rows, alone] + share[:, None] * (corners[rows, other] - corners[rows, alone]))
    return np.stack(ends, axis=1)


def sharp_edges(mesh: Mesh | Surface) -> Float[np.ndarray, "n 2 3"]:
    """The mesh's borders and the edges between faces that are not nearly coplanar: segments [m, world]."""
    vertices, faces = _welded(mesh)
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)
    pairs = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, inverse, counts = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    summed = np.zeros((len(edges), 3))
    np.add.at(summed, inverse.ravel(), normals.repeat(3, axis=0))
    return vertices[edges[_is_sharp(summed, counts)]]


def _is_sharp(summed: Float[np.ndarray, "n 3"], counts: Int[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    """|n1 + n2|^2 = 2 + 2 cos(angle) for two unit normals; an edge of one face is a border, of three a crossing."""
    cosine = (np.sum(summed**2, axis=1) - 2.0) / 2.0
    return (counts != 2) | (np.abs(cosine) < SHARP_COSINE)


def _welded(mesh: Mesh | Surface) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices with duplicates merged, as ``.stl`` files repeat them for every triangle."""
    vertices = np.round(np.asarray(mesh.vertices, dtype=float), 6)
    unique, inverse = np.unique(vertices, axis=0, return_inverse=True)
    return unique, inverse.ravel()[np.asarray(mesh.faces)]


def _arrays(*parts: object) -> list[np.ndarray]:
    return [np.asarray(part, dtype=float) for part in parts]


def _ring(axis: Float[np.ndarray, "3"]) -> Solid:
    """A unit circle around ``axis``."""
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    first = np.cross(axis, helper)
    first = first / np.linalg.norm(first)
    return np.cos(_CIRCLE)[:, None] * first + np.sin(_CIRCLE)[:, None] * np.cross(axis, first)


def _ball() -> Solid:
    """Points on the unit sphere: great circles in the three coordinate planes and between them."""
    slopes = np.linspace(0.0, np.pi, 8, endpoint=False)
    axes = [np.array([np.cos(slope), np.sin(slope), 0.0]) for slope in slopes] + [np.array([0.0, 0.0, 1.0])]
    return np.concatenate([_ring(axis) for axis in axes])


def _outline(points: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, "q 2"]:
    """The convex hull of projected points, counter-clockwise."""
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return points
