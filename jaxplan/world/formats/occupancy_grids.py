"""Occupancy grids in NumPy's ``.npz``: arrays ``occupancy`` (nx, ny, nz), ``origin`` (3,) [m] and ``resolution`` [m].

Any value of ``occupancy`` but 0 and False means occupied, NaN too.
"""

import os
import zipfile
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxplan.errors import FileError
from jaxplan.world.formats.numpy_arrays import array_blocks, array_header
from jaxplan.world.formats.streams import ByteStream
from jaxplan.world.obstacles import World
from jaxplan.world.voxels import check_cells, voxel_world

_WANT = "want an .npz with the arrays occupancy (nx, ny, nz), origin (3,) [m] and resolution [m]"
_SMALL = 2**16
"""Bytes at most for origin and resolution, and for the archive's directory; arbitrary."""


def load_occupancy_grid(path: Path, stream: ByteStream) -> World:
    """The world of an ``.npz`` grid."""
    try:
        _check_directory(stream)
        archive = zipfile.ZipFile(stream)
        names = set(archive.namelist())
    except (zipfile.BadZipFile, ValueError, OSError) as error:
        raise FileError(f"{path}: have no zip archive ({error}), {_WANT}; write it with numpy.savez") from error
    missing = [name for name in ("occupancy", "origin", "resolution") if f"{name}.npy" not in names]
    if missing:
        raise FileError(f"{path}: have no array {missing[0]!r}, {_WANT}; add it")
    origin = _small(path, archive, "origin", (3,))
    resolution = float(_small(path, archive, "resolution", ()))
    if not (np.isfinite(origin).all() and np.abs(origin).max() < 1e6 and 0.0 < resolution < 1e3):
        raise FileError(f"{path}: have origin {origin.tolist()} and resolution {resolution:g}, want finite metres")
    with _opened(path, archive, "occupancy") as entry:
        shape, dtype = array_header(path, entry, "occupancy")
        if len(shape) != 3 or 0 in shape or dtype.kind not in "biuf":
            raise FileError(f"{path}: occupancy: have {dtype} of shape {shape}, {_WANT}; correct it")
        check_cells(path, np.array(shape, dtype=float), resolution)
        occupied = np.empty(int(np.prod(shape)), dtype=bool)
        first = 0
        for block in array_blocks(path, entry, dtype, len(occupied), "occupancy"):
            occupied[first : first + len(block)] = block != 0
            first += len(block)
    return voxel_world(path, f"occupancy grid, cells of {resolution:g} m", occupied.reshape(shape), origin, resolution)


def _check_directory(stream: ByteStream) -> None:
    """Refuse what does not end in the short directory of an archive of NumPy's: Python reads any directory at once."""
    end = 22
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(size - end, 0))
    record = stream.read(end)
    if len(record) < end or not record.startswith(b"PK\5\6") or int.from_bytes(record[12:16], "little") > _SMALL:
        raise zipfile.BadZipFile("no directory of a few arrays at its end")


def _small(path: Path, archive: zipfile.ZipFile, name: str, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    """A small array of numbers."""
    with _opened(path, archive, name) as stream:
        have, dtype = array_header(path, stream, name)
        if have not in (shape, (*shape, 1), (1,) if shape == () else shape) or dtype.kind not in "iuf":
            raise FileError(f"{path}: {name}: have {dtype} of shape {have}, {_WANT}; correct it")
        if np.prod(have) * dtype.itemsize > _SMALL:
            raise FileError(f"{path}: {name} is too large, {_WANT}")
        blocks = list(array_blocks(path, stream, dtype, int(np.prod(have)), name))
        return np.concatenate(blocks).reshape(shape).astype(np.float64)


def _opened(path: Path, archive: zipfile.ZipFile, name: str) -> AbstractContextManager[ByteStream]:
    try:
        return archive.open(f"{name}.npy")
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError) as error:
        raise FileError(f"{path}: {name} cannot be read ({error}), {_WANT}; write it again") from error
