"""Point clouds, metres, z up: ``.pcd`` (ASCII, binary, compressed), ``.npy`` (n, 3), and ``.ply`` without faces.

A cell of 0.1 m that holds a point is occupied (of up to 0.4 m in clouds too large for that), so the clearance is at
most the truth, and below it by at most a cell's diagonal more than the grid's own bound (``jaxplan.world.voxels``).
The room is the box around the points.
"""

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxplan.errors import FileError
from jaxplan.world.formats.numpy_arrays import array_blocks, array_header
from jaxplan.world.formats.streams import ByteStream, lines, remaining, table_blocks
from jaxplan.world.obstacles import World
from jaxplan.world.voxels import MAX_CELLS, SPACING, check_cells, voxel_world

MAX_POINTS = 5_000_000
"""Arbitrary."""
MAX_COMPRESSED = 16 * 2**20
"""Bytes of compressed points, before and after: they are decompressed at once; arbitrary, about a million points."""
_MAX_COLUMNS = 1024
_LINES = 2**13
"""Lines of text that are read at once."""
_TYPES = {("F", "4"): "<f4", ("F", "8"): "<f8", ("U", "1"): "<u1", ("U", "2"): "<u2", ("U", "4"): "<u4"} | {
    ("I", "1"): "<i1", ("I", "2"): "<i2", ("I", "4"): "<i4", ("I", "8"): "<i8", ("U", "8"): "<u8"
}  # fmt: skip
_MAX_HEADER = 8192
COARSEST = 0.4
"""Largest cell [m] of a cloud; arbitrary, a little less than the padding."""


def load_npy(path: Path, stream: ByteStream) -> World:
    """The world of an ``.npy`` file of points."""
    shape, dtype = array_header(path, stream, "the file")
    if len(shape) != 2 or not 3 <= shape[1] <= _MAX_COLUMNS or dtype.kind not in "fiu":
        raise FileError(f"{path}: have {dtype} of shape {shape}, want numbers of shape (n, 3): x, y, z in metres")
    check_count(path, shape[0])
    begin, row = stream.tell(), np.dtype((dtype, (shape[1],)))

    def blocks() -> Iterator[np.ndarray]:
        stream.seek(begin)
        for block in array_blocks(path, stream, row, shape[0], "the file"):
            yield block[:, :3]

    return point_world(path, "NumPy points", blocks)


def load_pcd(path: Path, stream: ByteStream) -> World:
    """The world of a PCD file."""
    header = _pcd_header(path, stream)
    count, kind = int(header["POINTS"][0]), header["DATA"][0]
    check_count(path, count)
    dtype = np.dtype([(f"{i}", _TYPES[kind], (n,)) for i, (kind, n) in enumerate(_pcd_columns(path, header))])
    axes = [str(header["FIELDS"].index(axis)) for axis in "xyz"]
    begin = stream.tell()
    if kind == "binary_compressed":
        columns = _decompressed_columns(path, stream, dtype, count, axes)
        return point_world(path, f"PCD points, {kind}", lambda: iter((np.stack(columns, axis=1),)))

    def blocks() -> Iterator[np.ndarray]:
        stream.seek(begin)
        if kind == "ascii":
            yield from _pcd_ascii(path, header, stream, count)
            return
        for table in table_blocks(path, stream, dtype, count, "the table of points"):
            yield np.stack([table[axis][:, 0] for axis in axes], axis=1)

    return point_world(path, f"PCD points, {kind}", blocks)


def check_count(path: Path, count: int) -> None:
    """Refuse a cloud without points or of too many."""
    if not 0 < count <= MAX_POINTS:
        raise FileError(f"{path}: have {count:.12g} points, want 1 to {MAX_POINTS}; thin the cloud")


def point_world(path: Path, kind: str, blocks: Callable[[], Iterator[np.ndarray]]) -> World:
    """The world of points [m] (n, 3); those that are not finite (no return of the sensor) are dropped.

    ``blocks`` goes through the points from the first on, twice: for their extent, and for the cells that they occupy.
    """
    lower, upper, used, total = np.full(3, np.inf), np.full(3, -np.inf), 0, 0
    for block in blocks():
        finite = _finite(block)
        lower = np.minimum(lower, finite.min(axis=0, initial=np.inf))
        upper = np.maximum(upper, finite.max(axis=0, initial=-np.inf))
        used, total = used + len(finite), total + len(block)
    if not used:
        raise FileError(f"{path}: no point is finite, want x, y, z in metres; export the cloud again")
    extent = np.minimum(upper - lower, 1e9)
    spacing = SPACING
    while np.prod(np.floor(extent / spacing) + 1.0) > MAX_CELLS and spacing < COARSEST:
        spacing *= 2.0
    shape = np.floor(extent / spacing) + 1.0
    check_cells(path, shape, spacing)
    occupied = np.zeros(tuple(shape.astype(int)), dtype=bool)
    for block in blocks():
        occupied[tuple(np.minimum((_finite(block) - lower) / spacing, shape - 1).astype(int).T)] = True
    read = f"{kind}: {used} used, {total - used} not finite, cells of {spacing:g} m"
    return voxel_world(path, read, occupied, lower, spacing, finest=spacing)


def _finite(block: np.ndarray) -> Float[np.ndarray, "n 3"]:
    points = np.asarray(block, dtype=np.float64)
    return points[np.isfinite(points).all(axis=1)]


def _pcd_header(path: Path, stream: ByteStream) -> dict[str, list[str]]:
    """The header's lines by key; the points are what follows."""
    header: dict[str, list[str]] = {}
    while "DATA" not in header and stream.tell() < _MAX_HEADER and (line := stream.readline(_MAX_HEADER)):
        words = line.decode("latin-1").split("#")[0].split()
        if words:
            header[words[0]] = words[1:]
    known = all(header.get(key) for key in ("FIELDS", "SIZE", "TYPE", "POINTS", "DATA"))
    if not known or header["DATA"][0] not in ("ascii", "binary", "binary_compressed"):
        raise FileError(f"{path}: have no PCD header, want FIELDS, SIZE, TYPE, POINTS and DATA lines; export it again")
    if not header["POINTS"][0].isascii() or not header["POINTS"][0].isdigit() or len(header["POINTS"][0]) > 18:
        raise FileError(f"{path}: have POINTS {header['POINTS'][0][:20]!r}, want a whole number; correct it")
    return header


def _pcd_columns(path: Path, header: dict[str, list[str]]) -> list[tuple[tuple[str, str], int]]:
    """Type and length of each field."""
    fields, counts = header["FIELDS"], header.get("COUNT") or ["1"] * len(header["FIELDS"])
    columns = list(zip(header["TYPE"], header["SIZE"], strict=False))
    same = len(fields) == len(header["TYPE"]) == len(header["SIZE"]) == len(counts) <= 64
    if not same or not {"x", "y", "z"} <= set(fields) or not all(column in _TYPES for column in columns):
        raise FileError(f"{path}: have PCD fields {fields[:8]} of types {columns[:8]}, want x, y, z; export it again")
    if not all(n.isascii() and n.isdigit() and 0 < int(n[:6]) <= 4096 and len(n) < 6 for n in counts):
        raise FileError(f"{path}: have PCD COUNT {counts[:8]}, want 1 to 4096; export it again")
    return [(column, int(n)) for column, n in zip(columns, counts, strict=True)]


def _pcd_ascii(
    path: Path, header: dict[str, list[str]], stream: ByteStream, count: int
) -> Iterator[Float[np.ndarray, "n 3"]]:
    widths = [n for _, n in _pcd_columns(path, header)]
    starts = np.cumsum([0, *widths])
    columns = [int(starts[header["FIELDS"].index(axis)]) for axis in "xyz"]
    filled = (line for line in lines(path, stream) if line.split(b"#")[0].strip())
    for first in range(0, count, _LINES):
        wanted = min(_LINES, count - first)
        block = list(itertools.islice(filled, wanted))
        if len(block) < wanted:
            raise FileError(f"{path}: have {first + len(block)} lines of points, want {count}; the file is truncated")
        try:
            yield np.loadtxt(block, usecols=columns, ndmin=2)
        except (ValueError, IndexError) as error:
            reason = " ".join(str(error).split())[:120]
            raise FileError(f"{path}: a line of points cannot be read ({reason}); export the cloud again") from error


def _decompressed_columns(
    path: Path, stream: ByteStream, dtype: np.dtype, count: int, axes: list[str]
) -> list[Float[np.ndarray, "n"]]:
    """x, y and z of a compressed file, which holds field after field."""
    wanted, sizes = count * dtype.itemsize, stream.read(8)
    packed = int.from_bytes(sizes[:4], "little")
    if len(sizes) < 8 or int.from_bytes(sizes[4:], "little") != wanted or remaining(stream) < packed:
        raise FileError(f"{path}: the compressed points are damaged, want {wanted} bytes; export it again")
    if max(wanted, packed) > MAX_COMPRESSED:
        raise FileError(
            f"{path}: have {packed} compressed bytes of {wanted}, want at most {MAX_COMPRESSED}; save it as binary"
        )
    data, columns, position = _decompress(path, stream.read(packed), wanted), {}, 0
    for name in dtype.names or ():
        values = count * int(np.prod(dtype[name].shape))
        columns[name] = np.frombuffer(data, dtype[name].base, values, position).reshape(count, -1)[:, 0]
        position += count * dtype[name].itemsize
    return [columns[axis] for axis in axes]


def _decompress(path: Path, source: bytes, wanted: int) -> bytearray:
    """LZF: runs of literals and copies of earlier output."""
    out, i = bytearray(), 0
    try:
        while i < len(source) and len(out) <= wanted:
            control = source[i]
            i += 1
            if control < 32:
                out += source[i : i + control + 1]
                i += control + 1
                continue
            length = control >> 5
            if length == 7:
                length, i = length + source[i], i + 1
            start = len(out) - ((control & 31) << 8) - source[i] - 1
            i, length = i + 1, length + 2
            if start < 0:
                raise IndexError
            for offset in range(length):
                out.append(out[start + offset])
        if len(out) != wanted:
            raise IndexError
    except IndexError as error:
        raise FileError(f"{path}: the compressed points are damaged, want {wanted} bytes; export it again") from error
    return out
