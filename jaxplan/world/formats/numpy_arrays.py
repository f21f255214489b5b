"""NumPy's array format, read with care: the header first, no more bytes than it may ask for, no objects."""

import io
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from jaxplan.errors import FileError
from jaxplan.world.formats.streams import ByteStream, table_blocks

_LONGEST_HEADER = 10_000
"""Bytes, as in NumPy, which however reads a longer one before it refuses it."""


def array_header(path: Path, stream: ByteStream, name: str) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type that an array's header announces; nothing is allocated. C order only."""
    try:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        size = stream.read(2 if version == (1, 0) else 4)
        if int.from_bytes(size, "little") > _LONGEST_HEADER:
            raise ValueError(f"a header of {int.from_bytes(size, 'little')} bytes")
        shape, fortran, dtype = read(io.BytesIO(size + stream.read(int.from_bytes(size, "little"))))
    except (ValueError, EOFError, SyntaxError, zipfile.BadZipFile, zlib.error, RecursionError) as error:
        reason = " ".join(str(error).split())[:120]
        raise FileError(f"{path}: {name} is no NumPy array ({reason}), want one written by numpy.save") from error
    if dtype.hasobject:
        raise FileError(f"{path}: {name} holds Python objects, want plain numbers; save it as an array of numbers")
    if fortran and len(shape) > 1:
        raise FileError(f"{path}: {name} is stored in Fortran order, want C order; use numpy.ascontiguousarray")
    return tuple(int(n) for n in shape), dtype


def array_blocks(path: Path, stream: ByteStream, dtype: np.dtype, rows: int, name: str) -> Iterator[np.ndarray]:
    """The ``rows`` entries behind a header, whose size the caller has checked, a block at a time."""
    try:
        yield from table_blocks(path, stream, dtype, rows, name)
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError) as error:
        raise FileError(f"{path}: {name} is damaged ({error}); write it again") from error
