"""PLY files (ASCII and binary): vertex positions and faces. Sizes are checked against the file before allocation."""

import itertools
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxplan.errors import FileError

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
_TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
_ENDS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MAX_HEADER = 2**16


class _Element(NamedTuple):
    """A table of the file."""

    name: str
    rows: int
    properties: dict[str, tuple[str, str]]
    """By name, in order: the type of a list's length ("" for a single number), and the type of the values."""


def read_ply(path: Path, data: bytes) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices [m] and triangles (polygons become fans; none for a point cloud)."""
    order, elements, body = _header(path, data)
    vertices, faces = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    position: int = 0
    words = body.split() if order == "" else []
    for element in elements:
        try:
            if any(length for length, _ in element.properties.values()):
                polygons, position = _lists(element, order, words or body, position)
                faces = polygons if element.name == "face" else faces
            else:
                table, position = _table(element, order, words or body, position)
                vertices = table if element.name == "vertex" else vertices
        except (ValueError, IndexError, KeyError, OverflowError) as error:
            reason = " ".join(str(error).split())[:120]
            raise FileError(f"{path}: element {element.name!r} cannot be read ({reason}); export it again") from error
    return vertices, faces


def _header(path: Path, data: bytes) -> tuple[str, list[_Element], bytes]:
    end = data.find(b"end_header", 0, _MAX_HEADER)
    lines = [line.split() for line in data[: max(end, 0)].decode("latin-1").splitlines()]
    formats = [words[1] for words in lines if len(words) == 3 and words[0] == "format" and words[1] in _ENDS]
    if not data.startswith(b"ply") or end < 0 or not formats:
        raise FileError(f"{path}: have no PLY header, want 'ply', a format and 'end_header'; export it again")
    elements: list[_Element] = []
    try:
        for words in lines:
            if words[:1] == ["element"]:
                elements.append(_Element(words[1], int(words[2]), {}))
            elif words[:2] == ["property", "list"]:
                elements[-1].properties[words[4]] = (_TYPES[words[2]], _TYPES[words[3]])
            elif words[:1] == ["property"]:
                elements[-1].properties[words[2]] = ("", _TYPES[words[1]])
    except (ValueError, KeyError, IndexError) as error:
        raise FileError(f"{path}: the PLY header cannot be read ({error}); export it again") from error
    body = data[data.index(b"\n", end) + 1 :] if b"\n" in data[end:] else b""
    for element in elements:
        if not 0 <= element.rows <= len(body):
            raise FileError(
                f"{path}: the header asks for {element.rows:.12g} of {element.name!r} in {len(body)} bytes; "
                "the file is truncated or damaged"
            )
    return _ENDS[formats[0]], elements, body


def _table(element: _Element, order: str, source: bytes | list[bytes], position: int):  # type: ignore[no-untyped-def]
    """Positions of an element without lists (0 columns if it has no x, y, z), and where the next one starts."""
    names = list(element.properties)
    if isinstance(source, list):
        stop = position + element.rows * len(names)
        rows = np.array(source[position:stop], dtype=np.float64).reshape(element.rows, len(names))
        columns = {name: rows[:, i] for i, name in enumerate(names)}
    else:
        dtype = np.dtype([(name, order + code) for name, (_, code) in element.properties.items()])
        stop = position + element.rows * dtype.itemsize
        table = np.frombuffer(source[position:stop], dtype=dtype)
        if len(table) != element.rows:
            raise ValueError("the file is truncated")
        columns = {name: table[name] for name in names}
    if element.name != "vertex":
        return np.zeros((0, 3)), stop
    return np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=1), stop


def _lists(element: _Element, order: str, source: bytes | list[bytes], position: int):  # type: ignore[no-untyped-def]
    """Triangles of an element with lists, and where the next element starts; row by row, as rows differ in length."""
    triangles: list[tuple[int, int, int]] = []
    for _ in range(element.rows):
        for name, (length_code, code) in element.properties.items():
            length: float = 1
            if length_code:
                length, position = _number(source, position, order, length_code)
            values = []
            if not 0 <= length <= len(source):
                raise ValueError("a list is longer than the file")
            for _ in range(int(length)):
                value, position = _number(source, position, order, code)
                values.append(int(value))
            if name in ("vertex_indices", "vertex_index"):
                triangles += [(values[0], b, c) for b, c in itertools.pairwise(values[1:])]
    return np.array(triangles, dtype=np.int64).reshape(-1, 3), position


def _number(source: bytes | list[bytes], position: int, order: str, code: str) -> tuple[float, int]:
    if isinstance(source, list):
        return float(source[position]), position + 1
    size = int(code[1])
    if position + size > len(source):
        raise ValueError("the file is truncated")
    return np.frombuffer(source, order + code, 1, position)[0], position + size
