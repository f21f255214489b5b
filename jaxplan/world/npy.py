"""NumPy's array format, read with suspicion: the header first, no more bytes than it may ask for, no objects."""

import zipfile
import zlib
from pathlib import Path
from typing import IO

import numpy as np

from jaxplan.errors import FileError


def array_header(path: Path, stream: IO[bytes], name: str) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type that an array's header announces; nothing is allocated. C order only."""
    try:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(stream)
    except (ValueError, EOFError, SyntaxError, zipfile.BadZipFile, zlib.error, RecursionError) as error:
        reason = " ".join(str(error).split())[:120]
        raise FileError(f"{path}: {name} is no NumPy array ({reason}), want one written by numpy.save") from error
    if dtype.hasobject:
        raise FileError(f"{path}: {name} holds Python objects, want plain numbers; save it as an array of numbers")
    if fortran and len(shape) > 1:
        raise FileError(f"{path}: {name} is stored in Fortran order, want C order; use numpy.ascontiguousarray")
    return tuple(int(n) for n in shape), dtype


def read_array(path: Path, stream: IO[bytes], shape: tuple[int, ...], dtype: np.dtype, name: str) -> np.ndarray:
    """The array behind a header, whose size the caller has checked."""
    wanted = int(np.prod(shape, dtype=float)) * dtype.itemsize
    try:
        data = stream.read(wanted)
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError) as error:
        raise FileError(f"{path}: {name} is damaged ({error}); write it again") from error
    if len(data) != wanted:
        raise FileError(f"{path}: {name} ends after {len(data)} bytes, want {wanted}; the file is truncated")
    return np.frombuffer(data, dtype=dtype).reshape(shape)
