"""Occupancy grids in NumPy's ``.npz``: arrays ``occupancy`` (nx, ny, nz), ``origin`` (3,) [m] and ``resolution`` [m].

Any value of ``occupancy`` but 0 and False means occupied, NaN too.
"""

import io
import zipfile
from pathlib import Path

import numpy as np

from jaxplan.errors import FileError
from jaxplan.world.npy import array_header, read_array
from jaxplan.world.obstacles import World
from jaxplan.world.voxels import check_cells, voxel_world

_WANT = "want an .npz with the arrays occupancy (nx, ny, nz), origin (3,) [m] and resolution [m]"
_SMALL = 2**16
"""Bytes at most for origin and resolution; arbitrary."""


def load_npz_grid(path: Path, data: bytes) -> World:
    """The world of an ``.npz`` grid, whose bytes are ``data``."""
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
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
    with _opened(path, archive, "occupancy") as stream:
        shape, dtype = array_header(path, stream, "occupancy")
        if len(shape) != 3 or 0 in shape or dtype.kind not in "biuf":
            raise FileError(f"{path}: occupancy: have {dtype} of shape {shape}, {_WANT}; correct it")
        check_cells(path, np.array(shape, dtype=float), resolution)
        occupied = read_array(path, stream, shape, dtype, "occupancy") != 0
    return voxel_world(path, f"occupancy grid, cells of {resolution:g} m", occupied, origin, resolution)


def _small(path: Path, archive: zipfile.ZipFile, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """A small array of numbers."""
    with _opened(path, archive, name) as stream:
        have, dtype = array_header(path, stream, name)
        if have not in (shape, (*shape, 1), (1,) if shape == () else shape) or dtype.kind not in "iuf":
            raise FileError(f"{path}: {name}: have {dtype} of shape {have}, {_WANT}; correct it")
        if np.prod(have) * dtype.itemsize > _SMALL:
            raise FileError(f"{path}: {name} is too large, {_WANT}")
        return read_array(path, stream, have, dtype, name).reshape(shape).astype(np.float64)


def _opened(path: Path, archive: zipfile.ZipFile, name: str):  # type: ignore[no-untyped-def]
    try:
        return archive.open(f"{name}.npy")
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError) as error:
        raise FileError(f"{path}: {name} cannot be read ({error}), {_WANT}; write it again") from error
