"""Surface meshes from files: STL (binary and ASCII), Wavefront OBJ and PLY, metres, z up.

A PLY file without faces is a point cloud.
"""

import itertools
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from jaxplan.errors import FileError
from jaxplan.world.mesh import MAX_FACES, mesh_world
from jaxplan.world.obstacles import World
from jaxplan.world.ply import read_ply
from jaxplan.world.points import check_count, point_world

MAX_VERTICES = 3 * MAX_FACES


def load_stl(path: Path, data: bytes) -> World:
    """The world of an STL file, whose bytes are ``data``."""
    return mesh_world(path, "STL", *read_stl(path, data))


def load_obj(path: Path, data: bytes) -> World:
    """The world of an OBJ file, whose bytes are ``data``."""
    return mesh_world(path, "OBJ", *read_obj(path, data))


def load_ply(path: Path, data: bytes) -> World:
    """The world of a PLY file, whose bytes are ``data``: a surface, or points if it has no faces."""
    vertices, faces = read_ply(path, data)
    if not len(faces):
        check_count(path, len(vertices))
        return point_world(path, "PLY points", vertices)
    return mesh_world(path, "PLY", *checked_surface(path, vertices, faces))


def read_stl(path: Path, data: bytes) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices [m] and faces; ``FileError`` for whatever is not a usable STL file."""
    import trimesh  # heavy, and only mesh worlds need it

    count = int.from_bytes(data[80:84], "little")
    binary = len(data) >= 84 and len(data) == 84 + 50 * count
    if not binary and not (data.lstrip().startswith(b"solid") and b"endsolid" in data):
        raise FileError(
            f"{path}: have {len(data)} bytes that are not STL, want a binary or ASCII STL file; export it again"
        )
    try:
        mesh = trimesh.load(trimesh.util.wrap_as_stream(data if binary else data.decode("utf-8")), file_type="stl")
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    except (ValueError, TypeError, KeyError, IndexError, AttributeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise FileError(f"{path}: the STL file cannot be read ({reason}); export it again") from error
    return checked_surface(path, vertices, faces)


def read_obj(path: Path, data: bytes) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices [m] and faces of the ``v`` and ``f`` lines; polygons become fans, everything else is ignored."""
    vertices: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for number, line in enumerate(data.decode("latin-1").splitlines(), 1):
        words = line.split("#")[0].split()
        try:
            if words[:1] == ["v"]:
                vertices.append([float(word) for word in words[1:4]])
                if len(vertices[-1]) != 3:
                    raise ValueError("fewer than three coordinates")
            elif words[:1] == ["f"]:
                corners = [int(word.split("/")[0]) for word in words[1:]]
                corners = [corner - 1 if corner > 0 else len(vertices) + corner for corner in corners]
                faces += [(corners[0], b, c) for b, c in itertools.pairwise(corners[1:])]
        except (ValueError, IndexError) as error:
            raise FileError(f"{path}: line {number} cannot be read ({error}); export the OBJ file again") from error
        if len(vertices) > MAX_VERTICES or len(faces) > MAX_FACES:
            raise FileError(f"{path}: have more than {MAX_FACES} triangles or {MAX_VERTICES} vertices; simplify it")
    return checked_surface(path, np.array(vertices).reshape(-1, 3), np.array(faces, dtype=np.int64).reshape(-1, 3))


def checked_surface(
    path: Path, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """The same surface without unused vertices, if it can be used."""
    if len(faces) == 0 or vertices.size == 0:
        raise FileError(f"{path}: the mesh is empty, want at least one triangle; export the surface again")
    if len(faces) > MAX_FACES:
        raise FileError(f"{path}: have {len(faces)} triangles, want at most {MAX_FACES}; simplify the mesh")
    if not (faces.min() >= 0 and faces.max() < len(vertices)):
        raise FileError(f"{path}: a face names a vertex that is not there; export the surface again")
    if not np.isfinite(vertices).all():
        raise FileError(f"{path}: the mesh has NaN or infinite vertices, want finite metres; export it again")
    used, compact = np.unique(faces, return_inverse=True)
    return np.asarray(vertices[used], dtype=np.float64), compact.reshape(-1, 3)
