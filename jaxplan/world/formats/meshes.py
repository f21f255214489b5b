"""Surface meshes from files: STL (binary and ASCII), Wavefront OBJ and PLY, metres, z up.

A PLY file without faces is a point cloud.
"""

import itertools
from array import array
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from jaxplan.errors import FileError
from jaxplan.world.formats.ply import open_ply, ply_points, ply_surface
from jaxplan.world.formats.point_clouds import check_count, point_world
from jaxplan.world.formats.streams import ByteStream, lines, remaining
from jaxplan.world.mesh import MAX_FACES, mesh_world
from jaxplan.world.obstacles import World

MAX_VERTICES = 3 * MAX_FACES
_FACET = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def load_stl(path: Path, stream: ByteStream) -> World:
    """The world of an STL file."""
    return mesh_world(path, "STL", *read_stl(path, stream))


def load_obj(path: Path, stream: ByteStream) -> World:
    """The world of an OBJ file."""
    return mesh_world(path, "OBJ", *read_obj(path, stream))


def load_ply(path: Path, stream: ByteStream) -> World:
    """The world of a PLY file: a surface, or points if it has no faces."""
    ply = open_ply(path, stream)
    if not ply.rows("face"):
        check_count(path, ply.rows("vertex"))
        return point_world(path, "PLY points", lambda: ply_points(ply))
    if ply.rows("vertex") > MAX_VERTICES or ply.rows("face") > MAX_FACES:
        raise _too_many(path)
    return mesh_world(path, "PLY", *checked_surface(path, *ply_surface(ply, MAX_FACES)))


def read_stl(path: Path, stream: ByteStream) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices [m] and faces, each with vertices of its own; ``FileError`` for whatever is not a usable STL file."""
    size, head = remaining(stream), stream.read(84)
    count = int.from_bytes(head[80:], "little")
    if len(head) == 84 and size == 84 + _FACET.itemsize * count:
        if count > MAX_FACES:
            raise _too_many(path)
        corners = np.frombuffer(stream.read(size), _FACET)["corners"].reshape(-1, 3).astype(np.float64)
    elif head.lstrip().startswith(b"solid"):
        stream.seek(0)
        corners = _ascii_corners(path, stream)
    else:
        raise FileError(f"{path}: have {size} bytes that are not STL, want a binary or ASCII STL file; export it again")
    return checked_surface(path, corners, np.arange(len(corners)).reshape(-1, 3))


def _ascii_corners(path: Path, stream: ByteStream) -> Float[np.ndarray, "v 3"]:
    """The corners of the facets of an ASCII STL file, three for each [m]."""
    corners, ended, number = array("d"), False, 0
    for number, line in enumerate(lines(path, stream), 1):
        words = line.split()
        ended = words[:1] == [b"endsolid"] if words else ended
        if words[:1] == [b"vertex"]:
            try:
                x, y, z = (float(word) for word in words[1:])
            except ValueError as error:
                raise FileError(f"{path}: line {number} cannot be read ({error}); export the STL file again") from error
            corners.extend((x, y, z))
            if len(corners) > 3 * MAX_VERTICES:
                raise _too_many(path)
    if not ended or len(corners) % 9:
        raise FileError(f"{path}: line {number} is no end of an STL file; it is truncated or damaged, export it again")
    return np.array(corners).reshape(-1, 3)


def read_obj(path: Path, stream: ByteStream) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices [m] and faces of the ``v`` and ``f`` lines; polygons become fans, everything else is ignored."""
    vertices, faces = array("d"), array("q")
    for number, line in enumerate(lines(path, stream), 1):
        words = line.split(b"#")[0].split()
        try:
            if words[:1] == [b"v"]:
                x, y, z = (float(word) for word in words[1:4])
                vertices.extend((x, y, z))
            elif words[:1] == [b"f"]:
                corners = [int(word.split(b"/")[0]) for word in words[1:]]
                corners = [corner - 1 if corner > 0 else len(vertices) // 3 + corner for corner in corners]
                for b, c in itertools.pairwise(corners[1:]):
                    faces.extend((corners[0], b, c))
        except (ValueError, OverflowError) as error:
            raise FileError(f"{path}: line {number} cannot be read ({error}); export the OBJ file again") from error
        if len(vertices) > 3 * MAX_VERTICES or len(faces) > 3 * MAX_FACES:
            raise _too_many(path)
    return checked_surface(path, np.array(vertices).reshape(-1, 3), np.array(faces, np.int64).reshape(-1, 3))


def _too_many(path: Path) -> FileError:
    return FileError(f"{path}: have more than {MAX_FACES} triangles or {MAX_VERTICES} vertices; simplify the mesh")


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
