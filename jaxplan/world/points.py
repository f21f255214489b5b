"""Point clouds, metres, z up: ``.pcd`` (ASCII, binary, compressed), ``.npy`` (n, 3), and ``.ply`` without faces.

A cell of 0.1 m that holds a point is occupied (of up to 0.4 m in clouds too large for that), so the clearance is at
most the truth, and below it by at most a cell's diagonal more than the grid's own bound (``jaxplan.world.voxels``).
The room is the box around the points.
"""

import io
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxplan.errors import FileError
from jaxplan.world.npy import array_header, read_array
from jaxplan.world.obstacles import World
from jaxplan.world.voxels import MAX_CELLS, SPACING, check_cells, voxel_world

MAX_POINTS = 5_000_000
"""Arbitrary."""
_TYPES = {("F", "4"): "<f4", ("F", "8"): "<f8", ("U", "1"): "<u1", ("U", "2"): "<u2", ("U", "4"): "<u4"} | {
    ("I", "1"): "<i1", ("I", "2"): "<i2", ("I", "4"): "<i4", ("I", "8"): "<i8", ("U", "8"): "<u8"
}  # fmt: skip
_MAX_HEADER = 8192
COARSEST = 0.4
"""Largest cell [m] of a cloud; arbitrary, a little less than the padding."""


def load_npy(path: Path, data: bytes) -> World:
    """The world of an ``.npy`` file of points, whose bytes are ``data``."""
    stream = io.BytesIO(data)
    shape, dtype = array_header(path, stream, "the file")
    if len(shape) != 2 or shape[1] < 3 or dtype.kind not in "fiu":
        raise FileError(f"{path}: have {dtype} of shape {shape}, want numbers of shape (n, 3): x, y, z in metres")
    check_count(path, shape[0])
    return point_world(path, "NumPy points", read_array(path, stream, shape, dtype, "the file")[:, :3])


def load_pcd(path: Path, data: bytes) -> World:
    """The world of a PCD file, whose bytes are ``data``."""
    header, body = _pcd_header(path, data)
    count = int(header["POINTS"][0])
    check_count(path, count)
    dtype = np.dtype([(f"{i}", _TYPES[kind], (n,)) for i, (kind, n) in enumerate(_pcd_columns(path, header))])
    kind = header["DATA"][0]
    if kind == "ascii":
        points = _pcd_ascii(path, header, body, count)
    else:
        if kind == "binary_compressed":
            body = _by_point(path, _decompress(path, body, count * dtype.itemsize), dtype, count)
        if len(body) < count * dtype.itemsize:
            want = count * dtype.itemsize
            raise FileError(f"{path}: have {len(body)} bytes of points, want {want}; the file is truncated")
        table = np.frombuffer(body, dtype=dtype, count=count)
        points = np.stack([table[str(header["FIELDS"].index(axis))][:, 0] for axis in "xyz"], axis=1)
    return point_world(path, f"PCD points, {kind}", points)


def check_count(path: Path, count: int) -> None:
    if not 0 < count <= MAX_POINTS:
        raise FileError(f"{path}: have {count:.12g} points, want 1 to {MAX_POINTS}; thin the cloud")


def point_world(path: Path, kind: str, points: Float[np.ndarray, "n 3"]) -> World:
    """The world of points [m]; those that are not finite (no return of the sensor) are dropped."""
    points = np.asarray(points, dtype=np.float64)
    finite = points[np.isfinite(points).all(axis=1)]
    if not len(finite):
        raise FileError(f"{path}: no point is finite, want x, y, z in metres; export the cloud again")
    lower = finite.min(axis=0)
    extent = np.minimum(finite.max(axis=0) - lower, 1e9)
    spacing = SPACING
    while np.prod(np.floor(extent / spacing) + 1.0) > MAX_CELLS and spacing < COARSEST:
        spacing *= 2.0
    shape = np.floor(extent / spacing) + 1.0
    check_cells(path, shape, spacing)
    occupied = np.zeros(tuple(shape.astype(int)), dtype=bool)
    occupied[tuple(np.minimum((finite - lower) / spacing, shape - 1).astype(int).T)] = True
    used = f"{kind}: {len(finite)} used, {len(points) - len(finite)} not finite, cells of {spacing:g} m"
    return voxel_world(path, used, occupied, lower, spacing, finest=spacing)


def _pcd_header(path: Path, data: bytes) -> tuple[dict[str, list[str]], bytes]:
    """The header's lines by key, and the bytes after them."""
    header: dict[str, list[str]] = {}
    position = 0
    while "DATA" not in header and position < min(len(data), _MAX_HEADER):
        end = data.find(b"\n", position)
        line = data[position : end if end >= 0 else len(data)].decode("latin-1").split("#")[0].split()
        position = end + 1 if end >= 0 else len(data)
        if line:
            header[line[0]] = line[1:]
    known = all(header.get(key) for key in ("FIELDS", "SIZE", "TYPE", "POINTS", "DATA"))
    if not known or header["DATA"][0] not in ("ascii", "binary", "binary_compressed"):
        raise FileError(f"{path}: have no PCD header, want FIELDS, SIZE, TYPE, POINTS and DATA lines; export it again")
    if not header["POINTS"][0].isascii() or not header["POINTS"][0].isdigit() or len(header["POINTS"][0]) > 18:
        raise FileError(f"{path}: have POINTS {header['POINTS'][0][:20]!r}, want a whole number; correct it")
    return header, data[position:]


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


def _pcd_ascii(path: Path, header: dict[str, list[str]], body: bytes, count: int) -> Float[np.ndarray, "n 3"]:
    widths = [n for _, n in _pcd_columns(path, header)]
    starts = np.cumsum([0, *widths])
    try:
        columns = [int(starts[header["FIELDS"].index(axis)]) for axis in "xyz"]
        points = np.loadtxt(io.BytesIO(body), usecols=columns, max_rows=count, ndmin=2)
    except (ValueError, IndexError) as error:
        raise FileError(f"{path}: a line of points cannot be read ({' '.join(str(error).split())[:120]})") from error
    if len(points) != count:
        raise FileError(f"{path}: have {len(points)} lines of points, want {count}; the file is truncated")
    return points


def _by_point(path: Path, data: bytes, dtype: np.dtype, count: int) -> bytes:
    """Compressed files hold field after field; put them point by point."""
    table, position = np.empty(count, dtype), 0
    for name in dtype.names or ():
        size = count * dtype[name].itemsize
        table[name] = np.frombuffer(data[position : position + size], dtype[name].base).reshape(table[name].shape)
        position += size
    return table.tobytes()


def _decompress(path: Path, body: bytes, wanted: int) -> bytes:
    """LZF: runs of literals and copies of earlier output, behind two little-endian sizes of 4 bytes."""
    packed = int.from_bytes(body[:4], "little")
    stated = int.from_bytes(body[4:8], "little")
    source, out, i = body[8 : 8 + packed], bytearray(), 0
    try:
        if stated != wanted or len(source) != packed:
            raise IndexError
        while i < packed and len(out) <= wanted:
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
    return bytes(out)
