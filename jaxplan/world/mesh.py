"""Surface meshes, and the grid of exact squared distances behind ``clearance``.

A mesh is a hollow shell: its inside reads as free, and is unreachable from outside. The room of a mesh world is the box
around the mesh, which also caps the height of halls that are open at the top.
"""

from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplan.errors import FileError
from jaxplan.numerics import safe_divide
from jaxplan.precision import in_float64
from jaxplan.world.obstacles import DEFAULT_KEEP_IN, Mesh, World, make_obstacles
from jaxplan.world.voxels import extent_text

SPACING = 0.1
"""m between grid nodes. Measured on a hall of boxes: the clearance falls short of the truth by 1 cm in the mean."""
MAX_FACES = 200_000
"""Arbitrary: their distances take about a minute."""
MAX_NODES = 2**24
"""128 MB of distances."""

_BLOCK = 8
"""Grid nodes per side of the blocks that share a list of nearby triangles."""
_PAIRS = 256
"""Pairs of block and triangle per compiled call."""
_CENTRES = 64
"""Block centres per compiled call of the culling."""


def mesh_world(path: Path, kind: str, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> World:
    """The world of a surface [m, z up]; its room is the box around the mesh."""
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    check_mesh(path, vertices, faces)
    if not (upper - lower > 2.0 * DEFAULT_KEEP_IN).all():
        raise FileError(
            f"{path}: the mesh spans {extent_text(upper - lower)} m, want more than {2 * DEFAULT_KEEP_IN:g} m along "
            "each axis; give the whole room, in metres"
        )
    return World(
        name=path.stem,
        bounds=np.stack([lower, upper]),
        obstacles=make_obstacles(mesh=mesh_with_distances(vertices, faces)),
        keep_in=np.float64(DEFAULT_KEEP_IN),
        provenance=f"{path} ({kind} surface, {len(faces)} triangles; the room is the box around it)",
    )


def check_mesh(path: Path, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> None:
    """Refuse a mesh that is too large for a grid of distances."""
    if len(faces) > MAX_FACES:
        raise FileError(f"{path}: have {len(faces)} triangles, want at most {MAX_FACES}; simplify the mesh")
    extent = vertices.max(axis=0) - vertices.min(axis=0)
    nodes = np.ceil(extent / SPACING - 1e-9) + 1.0
    if not np.prod(nodes) <= MAX_NODES:
        raise FileError(
            f"{path}: the mesh spans {extent_text(extent)} m, want at most {MAX_NODES} cells of {SPACING:g} m; "
            "if it is in millimetres, scale it to metres"
        )


def mesh_with_distances(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Mesh:
    """A mesh [m] and the exact squared distances to it on a grid that covers its bounding box."""
    vertices = np.asarray(vertices, dtype=np.float64)
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    shape = np.maximum(np.ceil((upper - lower) / SPACING - 1e-9).astype(int) + 1, 2)
    squared = _squared_distances(lower, shape, vertices[faces])
    return Mesh(vertices=vertices, faces=np.asarray(faces), squared=squared, origin=lower, spacing=np.float64(SPACING))


@in_float64
def _squared_distances(
    lower: Float[np.ndarray, "3"], shape: Int[np.ndarray, "3"], triangles: Float[np.ndarray, "f 3 3"]
) -> Float[np.ndarray, "nx ny nz"]:
    """Exact squared distance [m^2] from each node of the grid to the nearest triangle.

    The grid is cut into blocks. With c a block's centre, r its circumscribed radius and d the distance of c to the
    nearest triangle, only triangles within d + 2 r of c can be nearest to a node of the block.
    """
    blocks = -(-shape // _BLOCK)
    side = np.stack(np.meshgrid(*(np.arange(_BLOCK),) * 3, indexing="ij"), axis=-1).reshape(-1, 3) * SPACING
    corners = np.stack(np.meshgrid(*(np.arange(n) for n in blocks), indexing="ij"), axis=-1).reshape(-1, 3)
    corners = lower + corners * (_BLOCK * SPACING)
    nearest = np.full((len(corners), len(side)), np.inf)
    for block, triangle in _close_pairs(corners + side[-1] / 2.0, float(np.linalg.norm(side[-1] / 2.0)), triangles):
        nodes = corners[block][:, None, :] + side
        np.minimum.at(nearest, block, np.asarray(_nodes_to_triangles(nodes, triangles[triangle])))
    grid = nearest.reshape(*blocks, _BLOCK, _BLOCK, _BLOCK).transpose(0, 3, 1, 4, 2, 5).reshape(blocks * _BLOCK)
    return np.ascontiguousarray(grid[: shape[0], : shape[1], : shape[2]])


def _close_pairs(
    centres: Float[np.ndarray, "b 3"], radius: float, triangles: Float[np.ndarray, "f 3 3"]
) -> Iterator[tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]]:
    """Chunks of pairs (block, triangle) that can be nearest, all of one length (the last pair is repeated)."""
    for first in range(0, len(centres), _CENTRES):
        index = np.minimum(np.arange(first, first + _CENTRES), len(centres) - 1)
        distance = np.sqrt(np.asarray(_points_to_all_triangles(centres[index], triangles)))
        close = distance <= distance.min(axis=1, keepdims=True) + 2.0 * radius + 1e-9
        row, triangle = np.nonzero(close[: len(centres) - first])
        short = -len(row) % _PAIRS
        row, triangle = np.pad(row, (0, short), mode="edge"), np.pad(triangle, (0, short), mode="edge")
        for start in range(0, len(row), _PAIRS):
            yield index[row[start : start + _PAIRS]], triangle[start : start + _PAIRS]


@jax.jit
def _nodes_to_triangles(nodes: Float[Array, "p n 3"], triangles: Float[Array, "p 3 3"]) -> Float[Array, "p n"]:
    """Squared distances [m^2], one triangle per row."""
    return squared_distance_to_triangle(nodes, triangles[:, None])


@jax.jit
def _points_to_all_triangles(points: Float[Array, "p 3"], triangles: Float[Array, "f 3 3"]) -> Float[Array, "p f"]:
    """Squared distances [m^2], all pairs."""
    return squared_distance_to_triangle(points[:, None], triangles[None])


def squared_distance_to_triangle(
    point: Float[Array, "*#batch 3"], triangle: Float[Array, "*#batch 3 3"]
) -> Float[Array, "*batch"]:
    """Squared distance [m^2] to a triangle, degenerate ones included.

    To its plane where the foot of the perpendicular lies inside all three edges, else to the nearest edge.
    """
    corners = [triangle[..., i, :] for i in range(3)]
    normal = _cross(corners[1] - corners[0], corners[2] - corners[0])
    area = _dot(normal, normal)
    to_edges, inside = jnp.asarray(jnp.inf, area.dtype), area > 0.0
    for i in range(3):
        edge, offset = corners[(i + 1) % 3] - corners[i], point - corners[i]
        fraction = jnp.clip(safe_divide(_dot(offset, edge), _dot(edge, edge)), 0.0, 1.0)
        away = offset - fraction[..., None] * edge
        to_edges = jnp.minimum(to_edges, _dot(away, away))
        inside = inside & (_dot(_cross(normal, edge), offset) >= 0.0)
    to_plane = safe_divide(_dot(point - corners[0], normal) ** 2, area)
    return jnp.where(inside, jnp.minimum(to_plane, to_edges), to_edges)


def _dot(a: Float[Array, "*#batch 3"], b: Float[Array, "*#batch 3"]) -> Float[Array, "*batch"]:
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def _cross(a: Float[Array, "*#batch 3"], b: Float[Array, "*#batch 3"]) -> Float[Array, "*batch 3"]:
    return jnp.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )
