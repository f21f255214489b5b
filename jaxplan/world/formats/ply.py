"""PLY files (ASCII and binary): vertex positions and faces. Sizes are checked against the file before allocation."""

import itertools
import struct
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxplan.errors import FileError
from jaxplan.world.formats.streams import ByteStream, lines, remaining, table_blocks

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
_TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
_ENDS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MAX_HEADER = 2**16
_LONGEST_LIST = 2**12
"""Values of one list, such as the corners of a polygon; arbitrary."""
_ROWS = 2**13
"""Rows of text that are read at once."""


class _Element(NamedTuple):
    """A table of the file."""

    name: str
    rows: int
    properties: dict[str, tuple[str, str]]
    """By name, in order: the type of a list's length ("" for a single number), and the type of the values."""

    @property
    def has_lists(self) -> bool:
        return any(length for length, _ in self.properties.values())


class Ply(NamedTuple):
    """A PLY file whose header was read."""

    path: Path
    stream: ByteStream
    order: str
    """"<" or ">", the order of bytes; "" for text."""
    elements: list[_Element]
    begin: int
    """Where the body begins in ``stream``."""

    def rows(self, name: str) -> int:
        """Rows of the elements of that name; 0 if there are none."""
        return sum(element.rows for element in self.elements if element.name == name)


def open_ply(path: Path, stream: ByteStream) -> Ply:
    """The header of a PLY file: no more than its size is known of the body."""
    head = stream.read(_MAX_HEADER)
    end = head.find(b"end_header")
    words = [line.split() for line in head[: max(end, 0)].decode("latin-1").splitlines()]
    formats = [line[1] for line in words if len(line) == 3 and line[0] == "format" and line[1] in _ENDS]
    if not head.startswith(b"ply") or end < 0 or not formats:
        raise FileError(f"{path}: have no PLY header, want 'ply', a format and 'end_header'; export it again")
    elements: list[_Element] = []
    try:
        for line in words:
            if line[:1] == ["element"]:
                elements.append(_Element(line[1], int(line[2]), {}))
            elif line[:2] == ["property", "list"]:
                elements[-1].properties[line[4]] = (_TYPES[line[2]], _TYPES[line[3]])
            elif line[:1] == ["property"]:
                elements[-1].properties[line[2]] = ("", _TYPES[line[1]])
    except (ValueError, KeyError, IndexError) as error:
        raise FileError(f"{path}: the PLY header cannot be read ({error}); export it again") from error
    stream.seek(end)
    stream.readline(_MAX_HEADER)
    for element in elements:
        if not element.properties:
            raise FileError(f"{path}: element {element.name!r} has no property; export it again")
        if not 0 <= element.rows <= remaining(stream):
            raise FileError(
                f"{path}: the header asks for {element.rows:.12g} of {element.name!r} in {remaining(stream)} bytes; "
                "the file is truncated or damaged"
            )
    return Ply(path, stream, _ENDS[formats[0]], elements, stream.tell())


def ply_points(ply: Ply) -> Iterator[Float[np.ndarray, "n 3"]]:
    """The positions of all vertices [m] from the first on, a block at a time."""
    for element, found in _walk(ply, most_triangles=0):
        if element.name == "vertex":
            yield from found


def ply_surface(ply: Ply, most_triangles: int) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices [m] and triangles, of which there are at most so many; polygons become fans."""
    vertices, faces = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    for element, found in _walk(ply, most_triangles):
        if element.name == "vertex":
            vertices = np.concatenate([vertices, *found])
        elif element.name == "face":
            faces = np.concatenate([faces, *found])
    return vertices, faces


def _walk(ply: Ply, most_triangles: int) -> Iterator[tuple[_Element, Iterator[np.ndarray]]]:
    """Every element and the blocks read from it; what nobody asks for is passed over."""
    ply.stream.seek(ply.begin)
    words = itertools.chain.from_iterable(line.split() for line in lines(ply.path, ply.stream))
    for element in ply.elements:
        found = _triangles(ply, element, words, most_triangles) if element.has_lists else _table(ply, element, words)
        guarded = _guarded(ply, element, found)
        yield element, guarded
        for _ in guarded:
            pass


def _guarded(ply: Ply, element: _Element, blocks: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
    try:
        yield from blocks
    except FileError:
        raise
    except (ValueError, IndexError, KeyError, OverflowError) as error:
        reason = " ".join(str(error).split())[:120]
        raise FileError(f"{ply.path}: element {element.name!r} cannot be read ({reason}); export it again") from error


def _table(ply: Ply, element: _Element, words: Iterator[bytes]) -> Iterator[np.ndarray]:
    """Blocks of positions of an element without lists, (n, 3); (n, 0) if it has no x, y, z."""
    names = list(element.properties)
    axes = [name for name in "xyz" if element.name == "vertex"]
    if ply.order == "":
        columns = [names.index(axis) for axis in axes]
        for first in range(0, element.rows, _ROWS):
            rows = min(_ROWS, element.rows - first)
            block = np.array(list(itertools.islice(words, rows * len(names))), dtype=np.float64)
            if block.size != rows * len(names):
                raise ValueError("the file is truncated")
            yield block.reshape(rows, len(names))[:, columns]
        return
    dtype = np.dtype([(name, ply.order + code) for name, (_, code) in element.properties.items()])
    for table in table_blocks(ply.path, ply.stream, dtype, element.rows, f"element {element.name!r}"):
        yield np.array([table[axis] for axis in axes], np.float64).reshape(len(axes), len(table)).T


def _triangles(ply: Ply, element: _Element, words: Iterator[bytes], most: int) -> Iterator[np.ndarray]:
    """The triangles of an element with lists, (n, 3), in one block; row by row, as rows differ in length."""
    triangles = array("q")
    for _ in range(element.rows):
        for name, (length_code, code) in element.properties.items():
            length = int(_numbers(ply, words, length_code, 1)[0]) if length_code else 1
            if not 0 <= length <= _LONGEST_LIST:
                raise ValueError(f"a list of {length} values, want at most {_LONGEST_LIST}")
            values = _numbers(ply, words, code, length)
            if element.name == "face" and name in ("vertex_indices", "vertex_index"):
                for b, c in itertools.pairwise(values[1:]):
                    triangles.extend((int(values[0]), int(b), int(c)))
        if len(triangles) > 3 * most > 0:
            raise ValueError(f"more than {most} triangles")
    yield np.array(triangles, dtype=np.int64).reshape(-1, 3)


def _numbers(ply: Ply, words: Iterator[bytes], code: str, count: int) -> tuple[int | float, ...]:
    """The next numbers of the body."""
    if ply.order == "":
        found: tuple[int | float, ...] = tuple(float(word) for word in itertools.islice(words, count))
    else:
        data = ply.stream.read(count * int(code[1]))
        found = struct.unpack(f"{ply.order}{count}{_CODES[code]}", data) if len(data) == count * int(code[1]) else ()
    if len(found) != count:
        raise ValueError("the file is truncated")
    return found
