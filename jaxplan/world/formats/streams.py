"""Files read a piece at a time, so that one that turns out to be damaged has not filled the memory."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from jaxplan.errors import FileError
from jaxplan.names import require_map

LONGEST_LINE = 2**16
"""Bytes; arbitrary, a polygon of ten thousand corners."""
MOST_LINES = 6_000_000
"""Arbitrary; a little more than the largest cloud has points. Empty ones cost time too."""
_BLOCK = 2**20
"""Bytes per block of a table; arbitrary."""


@runtime_checkable
class ByteStream(Protocol):
    """What a reader wants of an open file, or of an entry of an archive."""

    def read(self, size: int = -1, /) -> bytes:
        """The next ``size`` bytes; fewer at the end, all that are left for -1."""

    def readline(self, size: int = -1, /) -> bytes:
        """The bytes up to the next line end, at most ``size``."""

    def seek(self, offset: int, whence: int = 0, /) -> int:
        """Go to a place in bytes, which is returned."""

    def tell(self) -> int:
        """The place in bytes."""


def file_size(path: Path) -> int:
    """Bytes of a regular file; ``FileError`` for anything else."""
    require_map(path)
    return path.stat().st_size


def remaining(stream: ByteStream) -> int:
    """Bytes from here to the end of the file."""
    here = stream.tell()
    end = stream.seek(0, os.SEEK_END)
    stream.seek(here)
    return end - here


def lines(path: Path, stream: ByteStream) -> Iterator[bytes]:
    """The lines from here on; a file without line ends is refused instead of read as one line."""
    for _ in range(MOST_LINES):
        line = stream.readline(LONGEST_LINE + 1)
        if len(line) > LONGEST_LINE:
            raise FileError(f"{path}: have a line of more than {LONGEST_LINE} bytes, want text; export it again")
        if not line:
            return
        yield line
    raise FileError(f"{path}: have more than {MOST_LINES} lines, want at most that; simplify it")


def table_blocks(path: Path, stream: ByteStream, dtype: np.dtype, rows: int, name: str) -> Iterator[np.ndarray]:
    """The next ``rows`` entries of type ``dtype``, about a megabyte at a time."""
    at_once = max(1, _BLOCK // dtype.itemsize)
    for first in range(0, rows, at_once):
        count = min(at_once, rows - first)
        data = stream.read(count * dtype.itemsize)
        if len(data) != count * dtype.itemsize:
            have = first * dtype.itemsize + len(data)
            raise FileError(
                f"{path}: {name} ends after {have} bytes, want {rows * dtype.itemsize}; the file is truncated"
            )
        yield np.frombuffer(data, dtype)
