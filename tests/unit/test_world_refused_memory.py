"""Files within the limit of their kind that turn out to be damaged, late too, never fill the memory."""

import io
import re
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from jaxplan.errors import FileError
from jaxplan.world.formats import streams
from jaxplan.world.load import load_world
from oracles.fresh_reader import Read, fresh_reader

NOISE = np.random.default_rng(0).bytes(2**20)
PCD = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nPOINTS {n}\nDATA {kind}\n"
PLY = "ply\nformat {kind} 1.0\nelement vertex {n}\nproperty double x\nproperty double y\nproperty double z\n"
FACES = "element face {n}\nproperty list uint int vertex_indices\n"
NPY = (
    b"\x93NUMPY\x01\x00v\x00" + b"{'descr': '<f8', 'fortran_order': False, 'shape': (5000000, 3), }".ljust(117) + b"\n"
)
LONG_HEADER = b"\x93NUMPY\x02\x00" + (100 * 2**20).to_bytes(4, "little")
COMPRESSED = "\0\0\0\3" + "\0\x87\x93\3"
BT = b"# Octomap OcTree binary file\nid OcTree\nsize 9\nres 0.1\ndata\n"


SIZES = {".xml": 4, ".json": 2, ".bt": 16} | dict.fromkeys((".stl", ".obj", ".ply", ".pcd", ".npy", ".npz"), 124)


def fill(path: Path, head: bytes, body: bytes, size: int, tail: bytes = b"") -> Path:
    """A file of about ``size`` bytes: a head, as many whole copies of ``body`` as fit, a tail."""
    with path.open("wb") as stream:
        stream.write(head)
        block = body * max(1, 2**20 // len(body))
        for _ in range(size // len(block)):
            stream.write(block)
        stream.write(tail)
    return path


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Read]:
    """Reads in a process that has read something of every kind, so that what is left is what a file takes."""
    folder = tmp_path_factory.mktemp("small")
    with fresh_reader() as ask:
        for ending in SIZES:
            ask(fill(folder / f"map{ending}", b"solid a\n", b"vertex 1 2 3\n", 2**20))
        yield ask


def assert_refused(read: Read, path: Path, word: str = "") -> None:
    said, grown = read(path)
    assert said is not None
    assert re.search(word, said)
    assert "\n" not in said
    assert grown <= 64 * 2**20


@pytest.mark.parametrize("body", [NOISE, b"\0"], ids=["noise", "zeros"])
@pytest.mark.parametrize("ending", list(SIZES))
def test_files_without_a_header(read: Read, tmp_path: Path, ending: str, body: bytes) -> None:
    assert_refused(read, fill(tmp_path / f"map{ending}", b"", body, (SIZES[ending] - 1) * 2**20))


@pytest.mark.parametrize("ending", [".obj", ".stl", ".ply", ".pcd"])
def test_more_lines_than_any_map_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str) -> None:
    monkeypatch.setattr(streams, "MOST_LINES", 1000)
    heads = {
        ".obj": "",
        ".stl": "solid a\n",
        ".ply": PLY.format(kind="ascii", n=3) + "end_header\n",
        ".pcd": PCD.format(kind="ascii", n=3),
    }
    with pytest.raises(FileError, match="lines"):
        load_world(fill(tmp_path / f"map{ending}", heads[ending].encode(), b"\n", 2**20))


def octomap_of_leaves() -> bytes:
    """Trees of eight levels whose last nodes have eight known leaves each: the densest file there is."""

    def subtree(level: int) -> bytes:
        return b"\x55\x55" if level == 0 else b"\xff\xff" + 8 * subtree(level - 1)

    return BT + subtree(7)


@pytest.mark.parametrize(
    ("name", "head", "body", "size", "tail", "word"),
    [
        ("m.stl", b"solid a\n", b"vertex 1 2 3\n", 40, b"", "triangles"),
        ("m.stl", b"solid a\n", b"facet normal 0 0 1\n", 40, b"", "truncated"),
        ("m.stl", b"solid a\n", b"vertex 1 2 3\nvertex 1 2 3\nvertex 1 2 3\n", 7, b"endsolid\n", "span"),
        ("m.stl", bytes(80) + (2**21).to_bytes(4, "little"), b"\0" * 50 * 2**15, 100, b"", ""),
        ("m.obj", b"", b"v 1.25 2.5 3.75\n", 40, b"", "vertices"),
        ("m.obj", b"v 0 0 0\n", b"f 1 1 1\n", 100, b"", "triangles"),
        ("m.obj", b"", b"v 1.25 2.5 3.75\n", 4, b"f 1 2 x", "line"),
        ("m.obj", b"", b"# nothing\n", 10, b"", "empty"),
        ("m.ply", PLY.format(kind="ascii", n=10**6) + "end_header\n", b"1.25 2.5 3.5\n", 12, b"x", "vertex"),
        ("m.ply", PLY.format(kind="ascii", n=4) + "end_header\n", b"nan nan nan\n", 12, b"", "finite"),
        ("m.ply", PLY.format(kind="binary_little_endian", n=4900000) + "end_header\n", b"\xff", 120, b"", "finite"),
        ("m.ply", PLY.format(kind="binary_big_endian", n=2) + FACES.format(n=9) + "end_header\n", b"\xff", 99, b"", ""),
        ("m.ply", PLY.format(kind="ascii", n=2) + FACES.format(n=200000) + "end_header\n", b"3 0 1 2\n", 12, b"", ""),
        ("m.ply", "ply\nformat ascii 1.0\nelement vertex 5\nend_header\n", b"1 ", 12, b"", "property"),
        ("m.pcd", PCD.format(kind="ascii", n=900000), b"1.25 2.5 3.5\n", 10, b"", "truncated"),
        ("m.pcd", PCD.format(kind="binary", n=5000000), b"\xff", 70, b"", "finite"),
        ("m.pcd", PCD.format(kind="binary_compressed", n=5000000) + COMPRESSED, NOISE, 61, b"", "save it as binary"),
        ("m.pcd", PCD.format(kind="binary_compressed", n=5000000), NOISE, 70, b"", "damaged"),
        ("m.pcd", PCD.format(kind="binary", n=5000000), b"\0", 50, b"", "truncated"),
        ("m.npy", NPY, b"\xff", 120, b"", "finite"),
        ("m.npy", NPY, b"\0", 100, b"", "truncated"),
        ("m.npy", LONG_HEADER, b" ", 120, b"", "header"),
        ("m.npz", b"", NOISE, 100, b"PK\5\6" + bytes(8) + (2**26).to_bytes(4, "little") + bytes(6), "directory"),
        ("m.bt", BT, NOISE, 15, b"", ""),
        ("m.bt", octomap_of_leaves(), b"\0", 1, b"", "leaves"),
        ("m.bt", BT, b"\x03\0", 8, b"", "levels"),
        ("m.json", '{"bounds": 1, "blocks": [', b'{"a":[]},', 1, b"{}]}", ""),
        ("m.json", "[", b"[],", 1, b"[]]", ""),
        ("m.json", "[", b"0.5,", 1, b"1]", ""),
    ],
)  # fmt: skip
def test_files_that_begin_well(
    read: Read, tmp_path: Path, name: str, head: bytes | str, body: bytes, size: int, tail: bytes, word: str
) -> None:
    start = head.encode("latin-1") if isinstance(head, str) else head
    assert_refused(read, fill(tmp_path / name, start, body, size * 2**20, tail), word)


def test_compressed_points_damaged_at_their_end(read: Read, tmp_path: Path) -> None:
    count = 1_300_000
    packed = (bytes([31]) + bytes(32)) * (12 * count // 32 - 9)
    head = PCD.format(kind="binary_compressed", n=count).encode()
    sizes = len(packed).to_bytes(4, "little") + (12 * count).to_bytes(4, "little")
    assert_refused(read, fill(tmp_path / "m.pcd", head + sizes + packed, b"\0", 2**20), "damaged")


@pytest.mark.parametrize("damage", [b"", b"\1\2\3"])
def test_a_grid_that_unpacks_to_much(read: Read, tmp_path: Path, damage: bytes) -> None:
    """16 million cells of eight bytes, which are more than enough; truncated or with a wrong check sum at the end."""
    arrays: dict[str, np.ndarray] = {"origin": np.zeros(3), "resolution": np.float64(0.01)}
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    with zipfile.ZipFile(stream, "a", zipfile.ZIP_DEFLATED) as archive, archive.open("occupancy.npy", "w") as entry:
        shape = "(256, 256, 256)" if damage else "(256, 256, 255)"
        head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117).encode() + b"\n"
        entry.write(b"\x93NUMPY\x01\x00v\x00" + head)
        for _ in range(127):
            entry.write(bytes(2**20))
    data = stream.getvalue()
    where = data.index(b"occupancy.npy") + 3000
    path = tmp_path / "m.npz"
    path.write_bytes(data[:where] + damage + data[where + len(damage) :])
    assert_refused(read, path)


def truncated_scene(folder: Path, write: Callable[[Path], object]) -> Path:
    write(folder / "large.stl")
    site = '<site name="room" type="box" size="4 3 2"/>'
    path = folder / "room.xml"
    asset = '<mesh name="a" file="large.stl"/>'
    path.write_text(f"<mujoco><asset>{asset}</asset><worldbody>{site}<geom type='mesh' mesh='a'/></worldbody></mujoco>")
    return path


@pytest.mark.parametrize(("size", "word"), [(120, "bytes"), (15, "MuJoCo")])
def test_a_mesh_of_a_scene(read: Read, tmp_path: Path, size: int, word: str) -> None:
    path = truncated_scene(tmp_path, lambda file: fill(file, b"solid\n", b"vertex 1 2 3\n", size * 2**20))
    assert_refused(read, path, word)
