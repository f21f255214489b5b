"""Maps of every format: what is read, against other readers, and files that are not what they say."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from jaxplan.errors import FileError
from jaxplan.precision import in_float64
from jaxplan.search.lattice import SearchConfig, build_lattices
from jaxplan.search.routes import find_routes
from jaxplan.world.clearance import clearance
from jaxplan.world.formats.point_clouds import load_pcd
from jaxplan.world.load import load_world
from oracles.peak_memory import peak_memory, start_peak_memory
from tolerances import tolerance

CORNERS = np.array([[x, y, z] for x in (0.0, 4.0) for y in (0.0, 3.0) for z in (0.0, 2.0)])
QUADS = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
TRIANGLES = np.array([[q[0], b, c] for q in QUADS for b, c in ((q[1], q[2]), (q[2], q[3]))])


def write(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def refused(path: Path) -> str:
    """The message, and that refusing took at most 64 MB; the kernel's record of the peak starts anew before it."""
    before = start_peak_memory()
    with pytest.raises(FileError) as caught:
        load_world(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    assert peak_memory() - before <= 64 * 2**20
    return message


@in_float64
def distance(world, points):
    return np.asarray(clearance(world, points))


def obj(faces: list) -> str:
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + ["vn 0 0 1", "usemtl /etc/passwd"]
    return "\n".join(lines + ["f " + " ".join(f"{i + 1}//1" for i in face) for face in faces])


def ply(kind: str, faces: list) -> bytes:
    header = (
        f"ply\nformat {kind} 1.0\ncomment made here\nelement vertex 8\nproperty float x\nproperty float y\n"
        f"property float z\nproperty uchar red\nelement face {len(faces)}\nproperty list uchar int vertex_indices\n"
        "end_header\n"
    )
    if kind == "ascii":
        rows = [f"{x} {y} {z} 7" for x, y, z in CORNERS] + [" ".join(map(str, [len(f), *f])) for f in faces]
        return (header + "\n".join(rows) + "\n").encode()
    order = "<" if "little" in kind else ">"
    body = b"".join(np.array(v, order + "f4").tobytes() + b"\7" for v in CORNERS)
    body += b"".join(bytes([len(f)]) + np.array(f, order + "i4").tobytes() for f in faces)
    return header.encode() + body


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("box.obj", obj(TRIANGLES.tolist())),
        ("quads.obj", obj(QUADS)),
        ("ascii.ply", ply("ascii", QUADS)),
        ("little.ply", ply("binary_little_endian", QUADS)),
        ("big.ply", ply("binary_big_endian", TRIANGLES.tolist())),
    ],
)
def test_surfaces_of_all_formats_are_the_same_box(tmp_path: Path, name: str, content: str | bytes) -> None:
    world = load_world(write(tmp_path, name, content))
    np.testing.assert_allclose(world.bounds, [[0, 0, 0], [4, 3, 2]])
    assert world.mesh.faces.shape == (12, 3)
    assert np.linalg.norm(
        np.cross(*np.diff(world.mesh.vertices[world.mesh.faces], axis=1).transpose(1, 0, 2)), axis=1
    ).sum() == pytest.approx(104.0)
    assert distance(world, np.array([2.0, 1.5, 1.0])) == pytest.approx(1.0, abs=0.02)


def pcd(points: np.ndarray, kind: str) -> bytes:
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x rgb y z\nSIZE 4 4 8 4\nTYPE F U F F\nCOUNT 1 2 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA {kind}\n"
    ).encode()
    table = np.zeros(len(points), [("x", "<f4"), ("rgb", "<u4", (2,)), ("y", "<f8"), ("z", "<f4")])
    table["x"], table["y"], table["z"] = points.T
    if kind == "ascii":
        return header + "\n".join(f"{x:.9g} 5 6 {y:.9g} {z:.9g}" for x, y, z in points).encode()
    if kind == "binary":
        return header + table.tobytes()
    raw = b"".join(np.ascontiguousarray(table[name]).tobytes() for name in table.dtype.names)
    packed = b"".join(bytes([len(raw[i : i + 32]) - 1]) + raw[i : i + 32] for i in range(0, len(raw), 32))
    return header + len(packed).to_bytes(4, "little") + len(raw).to_bytes(4, "little") + packed


@pytest.fixture
def cloud() -> np.ndarray:
    """Random points of a room, on a raster of 1/64 m that float32 holds."""
    return np.round(np.random.default_rng(0).uniform([0, 0, 0], [6, 5, 3], (300, 3)) * 64) / 64


@pytest.mark.parametrize("kind", ["ascii", "binary", "binary_compressed", "npy", "ply"])
def test_clouds_of_all_formats_bound_the_distance_to_the_points(tmp_path: Path, kind: str, cloud: np.ndarray) -> None:
    stream = io.BytesIO()
    if kind == "npy":
        np.save(stream, cloud)
        path = write(tmp_path, "cloud.npy", stream.getvalue())
    elif kind == "ply":
        header = PLY_HEAD.format(kind="ascii", n=300).replace("float", "double")
        path = write(tmp_path, "cloud.ply", header + "\n".join(" ".join(map(str, p)) for p in cloud))
    else:
        path = write(tmp_path, "cloud.pcd", pcd(cloud, kind))
    world = load_world(path)
    points = np.random.default_rng(1).uniform(world.bounds[0], world.bounds[1], (500, 3))
    truth = np.linalg.norm(points[:, None] - cloud, axis=2).min(axis=1)
    ours = distance(world, points)
    assert (ours <= truth + 1e-9).all()
    error = np.sqrt(3.0) * 0.1 + np.sqrt(0.75) * 0.1
    assert (ours**2 >= np.minimum(np.maximum(truth - error, 0.0), 1.5) ** 2 - 0.75 * 0.1**2 - 1e-9).all()


def test_compressed_copies_of_earlier_output() -> None:
    """LZF's back references, longer than their distance too: 96 zero bytes from one literal."""
    header = pcd(np.zeros((4, 3)), "binary").split(b"DATA")[0] + b"DATA binary_compressed\n"
    packed = bytes([0, 0]) + bytes([7 << 5, 86, 0])
    body = len(packed).to_bytes(4, "little") + (96).to_bytes(4, "little") + packed
    with pytest.raises(FileError, match="span"):  # four points at the origin are no room, but they were read
        load_pcd(Path("zeros.pcd"), io.BytesIO(header + body))


def test_third_party_cloud(examples: Path) -> None:
    pypcd4 = pytest.importorskip("pypcd4")
    path = examples / "maps" / "kr_cloud_0917.pcd"
    points = pypcd4.PointCloud.from_path(path).numpy(("x", "y", "z")).astype(float)
    world = load_world(path)
    np.testing.assert_allclose(world.bounds[0], points.min(axis=0))
    cells = np.unique(np.floor((points - world.bounds[0]) / 0.2 + 1e-9).astype(int), axis=0)
    assert abs(int(world.voxels.occupied.sum()) - len(cells)) <= 5  # points on faces between cells
    assert (distance(world, points[::50]) <= 1e-6).all()


def test_octomap_equals_its_own_library(examples: Path) -> None:
    pyoctomap = pytest.importorskip("pyoctomap")
    path = examples / "maps" / "octomap_geb079.bt"
    tree, world = pyoctomap.OcTree(str(path).encode()), load_world(path)
    assert tree.size() == 532566
    np.testing.assert_allclose(world.bounds, [tree.getMetricMin(), tree.getMetricMax()], **tolerance("solve"))
    grid, points = world.voxels, np.random.default_rng(0).uniform(*world.bounds, (4000, 3))
    for point in points:
        node = tree.search(point.tolist())
        try:
            expected = bool(tree.isNodeOccupied(node))
        except Exception:  # the library's null node: unknown, hence occupied
            expected = True
        cell = tuple(np.floor((point - grid.origin) / float(grid.spacing)).astype(int))
        assert bool(grid.occupied[cell]) == expected


def test_octomap_is_planned_in_on_all_lattices(examples: Path) -> None:
    """The example flight inside it keeps 0.37 m from all that is occupied or unknown."""
    world = load_world(examples / "maps" / "octomap_geb079.bt")
    flight = np.loadtxt(examples / "scenarios" / "oda_003__in__octomap_geb079_0.csv", delimiter=",", skiprows=1)[:, 1:]
    assert distance(world, flight).min() > 0.3
    lattices = build_lattices(world, SearchConfig(padding=0.25))
    for share in (0.05, 0.15, 0.3, 0.9):
        routes = find_routes(lattices, world, flight[0], flight[1::20], share * world.diagonal)
        assert (routes.reasons == 0).all()


def npz(folder: Path, name: str = "grid.npz", **arrays: object) -> Path:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return write(folder, name, stream.getvalue())


def test_occupancy_grid(tmp_path: Path) -> None:
    occupied = np.zeros((10, 8, 6), np.uint8)
    occupied[4, 3] = 1
    world = load_world(npz(tmp_path, occupancy=occupied, origin=[-1.0, 0.0, 0.5], resolution=0.5))
    np.testing.assert_allclose(world.bounds, [[-1, 0, 0.5], [4, 4, 3.5]])
    assert world.voxels.occupied.shape == (50, 40, 30)
    assert float(world.voxels.spacing) == pytest.approx(0.1)
    column = np.array([[1.0, 1.5], [1.5, 2.0]])
    points = np.random.default_rng(0).uniform([-0.5, 0.2, 0.6], [3.5, 3.5, 3.4], (400, 3))
    truth = np.linalg.norm(np.maximum(np.maximum(column[0] - points[:, :2], points[:, :2] - column[1]), 0), axis=1)
    ours = distance(world, points)
    assert (ours <= truth + 1e-9).all()
    least = np.minimum(np.maximum(truth - np.sqrt(0.75) * 0.1, 0.0), 1.5)
    assert (ours**2 >= least**2 - 0.75 * 0.1**2 - 1e-9).all()


HUGE = (
    b"\x93NUMPY\x01\x00v\x00"
    + b"{'descr': '|b1', 'fortran_order': False, 'shape': (10000, 10000, 10000), }".ljust(117)
    + b"\n"
)


def huge_npz() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("occupancy.npy", HUGE)
        for name, value in (("origin", np.zeros(3)), ("resolution", np.float64(0.1))):
            one = io.BytesIO()
            np.save(one, value)
            archive.writestr(f"{name}.npy", one.getvalue())
    return stream.getvalue()


PCD_HEAD = (
    "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 9\nHEIGHT 1\nPOINTS {n}\nDATA {kind}\n"
)
PLY_HEAD = (
    "ply\nformat {kind} 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
)
BT_HEAD = "# Octomap OcTree binary file\n# text\nid OcTree\nsize {n}\nres {res}\ndata\n"


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("m.obj", "", "empty"),
        ("m.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "NaN"),
        ("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "not there"),
        ("m.obj", "v 0 0\n", "line 1"),
        ("m.obj", "v 0 0 0\nf 1 x 3\n", "line 2"),
        ("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "span"),
        ("m.ply", b"\x89PNG" + bytes(300), "PLY header"),
        ("m.ply", PLY_HEAD.format(kind="ascii", n=10**12), "1e+12"),
        ("m.ply", PLY_HEAD.format(kind="binary_little_endian", n=4) + "short", "vertex"),
        ("m.ply", PLY_HEAD.format(kind="ascii", n=1) + "nan nan nan\n", "finite"),
        ("m.ply", ply("binary_little_endian", QUADS)[:-5], "truncated"),
        ("m.ply", ply("ascii", [[0, 1, 99]]), "not there"),
        ("m.pcd", "VERSION 0.7\n", "PCD header"),
        ("m.pcd", PCD_HEAD.format(n=10**12, kind="binary"), "1e+12 points"),
        ("m.pcd", PCD_HEAD.format(n="-1", kind="binary"), "POINTS"),
        ("m.pcd", PCD_HEAD.format(n=9, kind="binary") + "xx", "truncated"),
        ("m.pcd", PCD_HEAD.format(n=9, kind="ascii") + "1 2 3\n", "truncated"),
        ("m.pcd", PCD_HEAD.format(n=1, kind="ascii") + "a b c\n", "line"),
        ("m.pcd", PCD_HEAD.format(n=9, kind="binary_compressed") + "12345678x", "damaged"),
        ("m.pcd", PCD_HEAD.format(n=9, kind="binary").replace("x y z", "a b c"), "want x, y, z"),
        ("m.pcd", PCD_HEAD.format(n=2, kind="ascii") + "0 0 0\n1e30 1e30 1e30\n", "cells"),
        ("m.npy", b"\x93NUMPY\x01\x00", "NumPy array"),
        ("m.npy", HUGE, "shape"),
        ("m.npy", HUGE.replace(b"(10000, 10000, 10000)", b"(1000000000000, 3)   ").replace(b"b1", b"f4"), "points"),
        ("m.npy", HUGE.replace(b"(10000, 10000, 10000)", b"(1000, 3)            ").replace(b"b1", b"f4"), "truncated"),
        ("m.npz", b"PK\x03\x04" + bytes(40), "zip"),
        ("m.npz", huge_npz(), "1e+12 cells"),
        ("m.bt", "# Octomap OcTree binary file\ndata\n", "header"),
        ("m.bt", BT_HEAD.format(n=10**12, res="nan") + "\0\0", "header"),
        ("m.bt", BT_HEAD.format(n=10**12, res=0.1), "in the middle"),
        ("m.bt", BT_HEAD.format(n=10**12, res=0.1) + "\0\0", "no known cell"),
        ("m.bt", BT_HEAD.format(n=10**12, res=0.1) + "\1\1", "cells"),
        ("m.bt", BT_HEAD.format(n=3, res=0.1).encode() + b"\xff\xff" * 40, "levels"),
    ],
)  # fmt: skip
def test_bad_files_get_one_message(tmp_path: Path, name: str, content: str | bytes, word: str) -> None:
    assert word in refused(write(tmp_path, name, content))


@pytest.mark.parametrize(
    ("arrays", "word"),
    [
        ({"occupancy": np.zeros((9, 9, 9))}, "origin"),
        ({"occupancy": np.zeros((9, 9)), "origin": np.zeros(3), "resolution": 0.1}, "shape"),
        ({"occupancy": np.zeros((9, 9, 0)), "origin": np.zeros(3), "resolution": 0.1}, "shape"),
        ({"occupancy": np.zeros((9, 9, 9)), "origin": np.full(3, np.nan), "resolution": 0.1}, "finite"),
        ({"occupancy": np.zeros((9, 9, 9)), "origin": np.zeros(3), "resolution": -0.1}, "resolution"),
        ({"occupancy": np.zeros((9, 9, 9)), "origin": np.zeros(2), "resolution": 0.1}, "origin"),
        ({"occupancy": np.array([[["a"]]]), "origin": np.zeros(3), "resolution": 0.1}, "shape"),
        ({"occupancy": np.zeros((2, 2, 2)), "origin": np.zeros(3), "resolution": 0.1}, "span"),
        ({"occupancy": np.zeros((9, 9, 9)), "origin": np.zeros(3), "resolution": 900.0}, "cells"),
    ],
)
def test_bad_grids_get_one_message(tmp_path: Path, arrays: dict, word: str) -> None:
    assert word in refused(npz(tmp_path, **arrays))


ROOM = '<site name="room" type="box" pos="2 1.5 1" size="4 3 2"/>'


def scene_with_mesh(asset: str) -> str:
    return (
        f'<mujoco><asset>{asset}</asset><worldbody>{ROOM}<geom type="mesh" mesh="box" pos="1 0 0" euler="0 0 90"/>'
        "</worldbody></mujoco>"
    )


def test_mjcf_mesh_geoms_from_files_and_inline(tmp_path: Path) -> None:
    write(tmp_path, "box.obj", obj(TRIANGLES.tolist()))
    inline = " ".join(map(str, CORNERS.ravel()))
    scenes = [
        '<mesh name="box" file="box.obj" scale="0.5 0.5 0.5"/>',
        f'<mesh name="box" vertex="{inline}" scale="0.5 0.5 0.5"/>',
    ]
    for number, asset in enumerate(scenes):
        world = load_world(write(tmp_path, f"room{number}.xml", scene_with_mesh(asset)))
        lower, upper = world.mesh.vertices.min(axis=0), world.mesh.vertices.max(axis=0)
        np.testing.assert_allclose([lower, upper], [[-0.5, 0, 0], [1, 2, 1]], **tolerance("solve"))
        assert distance(world, np.array([2.0, 1.0, 0.5])) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    "file", ["/etc/passwd", "../box.stl", "box.stl/../../box.stl", "box.msh", "sub/link.stl", "box.stl\0"]
)
def test_mjcf_meshes_outside_the_folder_are_refused(tmp_path: Path, file: str) -> None:
    (tmp_path / "scene" / "sub").mkdir(parents=True)
    write(tmp_path, "box.stl", b"secret")
    (tmp_path / "scene" / "sub" / "link.stl").symlink_to(tmp_path / "box.stl")
    refused(write(tmp_path / "scene", "room.xml", scene_with_mesh(f'<mesh name="box" file="{file}"/>')))


def test_a_crash_of_the_compiler_is_a_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from jaxplan import mjcf_probe

    for child, word in (
        ("import os; os.abort()", "crashes"),
        ("while True: pass", "s"),
        ("x = bytearray(2**33)", "GB"),
    ):
        monkeypatch.setattr(mjcf_probe, "_CHILD", mjcf_probe._CHILD.split("import mujoco")[0] + child)
        monkeypatch.setattr(mjcf_probe, "SECONDS", 1)
        with pytest.raises(FileError, match=word):
            mjcf_probe.probe_mjcf(Path("room.xml"), "<mujoco/>", {})
