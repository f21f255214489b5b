"""Worlds by a stored name or from files: which reader takes which file."""

from importlib import resources
from pathlib import Path
from typing import Protocol, runtime_checkable

from jaxplan.errors import FileError, InputError
from jaxplan.names import ENVIRONMENTS, require_world
from jaxplan.validation import require_path
from jaxplan.world.formats.boxes import load_boxes
from jaxplan.world.formats.meshes import load_obj, load_ply, load_stl
from jaxplan.world.formats.mjcf import load_mjcf, load_own_mjcf
from jaxplan.world.formats.occupancy_grids import load_occupancy_grid
from jaxplan.world.formats.octomap import load_octomap
from jaxplan.world.formats.point_clouds import load_npy, load_pcd
from jaxplan.world.formats.streams import ByteStream, file_size
from jaxplan.world.obstacles import World

_MAX_BYTES = {".xml": 4 * 2**20, ".json": 2 * 2**20, ".bt": 16 * 2**20}
_MAX_BYTES |= dict.fromkeys((".stl", ".obj", ".ply", ".pcd", ".npy", ".npz"), 128 * 2**20)
"""Largest file per ending; arbitrary, far above any room. The first three are read at once: a few bytes of JSON become
an object of many."""


@runtime_checkable
class Reader(Protocol):
    """What takes a file of one kind."""

    def __call__(self, path: Path, stream: ByteStream) -> World:
        """The world in ``stream``, the bytes of the file at ``path``; ``FileError`` for what cannot be used."""


_READERS: dict[str, Reader] = {
    ".xml": load_mjcf,
    ".stl": load_stl,
    ".obj": load_obj,
    ".ply": load_ply,
    ".pcd": load_pcd,
    ".npy": load_npy,
    ".npz": load_occupancy_grid,
    ".bt": load_octomap,
    ".json": load_boxes,
}
"""Which reader takes a file, by its ending."""


def load_world(name_or_path: str | Path) -> World:
    """The world of a stored name (``ENVIRONMENTS``) or of a file.

    Files, by their ending: MJCF (.xml), surface meshes (.stl, .obj, .ply), point clouds (.pcd, .npy, and .ply without
    faces), OctoMap's binary trees (.bt), occupancy grids (.npz), rotorpy's boxes (.json).

    World frame z up, metres. Raises ``InputError`` for an unknown name, ``FileError`` for a file that cannot be used.
    """
    require_path("world", name_or_path)
    if str(name_or_path) in ENVIRONMENTS:
        return _read(environment_path(str(name_or_path)), load_own_mjcf)
    require_world(name_or_path)
    path = Path(name_or_path)
    return _read(path, _READERS[path.suffix.lower()])


def environment_path(name: str) -> Path:
    """The MJCF file of a stored world."""
    if name not in ENVIRONMENTS:
        raise InputError(f"world: have {name!r}, want one of {', '.join(ENVIRONMENTS)}; check the name")
    return Path(str(resources.files("jaxplan.world").joinpath("environments", f"{name}.xml")))


def _read(path: Path, reader: Reader) -> World:
    """The world of a file that is not too large for its kind."""
    limit = _MAX_BYTES[path.suffix.lower()]
    if file_size(path) > limit:  # before any of it takes memory
        raise FileError(f"{path}: have more than {limit} bytes, want a map of at most that; simplify it")
    try:
        with path.open("rb") as stream:
            return reader(path, stream)
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror}); check its permissions") from error
