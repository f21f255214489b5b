"""Reading worlds: the stored one, third-party maps, and files that are not what they say."""

import json
from pathlib import Path

import numpy as np
import pytest

from jaxplan.errors import FileError, InputError
from jaxplan.world.load import ENVIRONMENTS, load_world
from tolerances import tolerance

PNG = b"\x89PNG\r\n\x1a\n" + bytes(200)
ROOM = '<site name="room" type="box" pos="0 0 1" size="5 5 1"/>'


def write(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def mjcf(inside: str, before: str = "") -> str:
    return f"<mujoco>{before}<worldbody>{ROOM}{inside}</worldbody></mujoco>"


def assert_refused(path: Path, *words: str) -> None:
    with pytest.raises(FileError) as caught:
        load_world(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    for word in words:
        assert word in message


def test_env1() -> None:
    world = load_world("env1")
    assert ENVIRONMENTS == ("env1", "env2", "env3")
    np.testing.assert_allclose(world.bounds, [[-5, -5, 0], [5, 5, 2]])
    assert len(world.boxes.center) + len(world.cylinders.center) == 8
    assert len(world.planes.offset) == 0
    assert float(world.keep_in) == 0.2
    np.testing.assert_allclose(world.start, [-4.3, -4.3, 1.0])


def test_unknown_name_lists_the_names() -> None:
    with pytest.raises(InputError, match="env1"):
        load_world("env9")


def test_mjcf_geoms_of_all_kinds(tmp_path: Path) -> None:
    text = mjcf(
        '<body pos="1 0 0" euler="0 0 90"><geom type="box" pos="1 0 0.5" size="0.1 0.2 0.5"/></body>'
        '<geom type="sphere" pos="0 0 1" size="0.3"/>'
        '<geom type="capsule" fromto="0 0 0 0 2 0" size="0.1"/>'
        '<geom type="cylinder" pos="2 2 1" size="0.2 1"/>'
        '<geom type="plane" pos="0 0 0.25" size="1 1 0.1"/>'
        '<geom type="sphere" pos="3 3 1" size="0.3" contype="0" conaffinity="0"/>'
    )
    world = load_world(write(tmp_path, "a room.xml", text))
    assert world.name == "a room"
    assert world.start is None
    np.testing.assert_allclose(world.boxes.center, [[1.0, 1.0, 0.5]], **tolerance("exact"))
    np.testing.assert_allclose(np.abs(world.boxes.rotation[0, :, 0]), [0, 1, 0], **tolerance("exact"))
    np.testing.assert_allclose(world.capsules.half_length, [1.0])
    np.testing.assert_allclose(np.abs(world.capsules.axis), [[0, 1, 0]], **tolerance("exact"))
    np.testing.assert_allclose(world.planes.offset, [0.25])
    assert len(world.spheres.radius) == 1


@pytest.mark.parametrize(
    "name", ["rotorpy_double_pillar.json", "rotorpy_grid_forest.json", "kr_skir.stl", "kr_simple.stl"]
)
def test_third_party_maps(examples: Path, name: str) -> None:
    world = load_world(examples / "maps" / name)
    assert (world.bounds[1] > world.bounds[0]).all()
    if name.endswith("json"):
        assert len(world.boxes.center) == len(json.loads((examples / "maps" / name).read_text())["blocks"])
    else:
        assert world.mesh is not None
        np.testing.assert_allclose(world.bounds, [world.mesh.vertices.min(0), world.mesh.vertices.max(0)])


@pytest.mark.parametrize("ending", [".xml", ".stl", ".json"])
def test_missing_folder_and_wrong_content(tmp_path: Path, ending: str) -> None:
    assert_refused(tmp_path / f"missing{ending}", "no such file", "check the path")
    (tmp_path / f"folder{ending}").mkdir()
    assert_refused(tmp_path / f"folder{ending}", "not a file")
    assert_refused(write(tmp_path, f"picture{ending}", PNG))
    assert_refused(write(tmp_path, f"empty{ending}", b""))
    assert_refused(write(tmp_path, f"zeros{ending}", bytes(84)))
    assert_refused(write(tmp_path, f"text{ending}", "solid nothing\nendsolid nothing\n"))


def test_unknown_ending(tmp_path: Path) -> None:
    assert_refused(write(tmp_path, "map.png", PNG), ".png", ".stl")


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("[1, 2]", "not a box world"),
        ('{"a": 1}', "not a box world"),
        ('{"bounds": {"extents": [0, 1, 0, 1, 0]}}', "six finite"),
        ('{"bounds": {"extents": [0, 10, 0, 10, 0, NaN]}}', "six finite"),
        ('{"bounds": {"extents": [0, 10, 0, 10, 0, true]}}', "six finite"),
        ('{"bounds": {"extents": [0, 10, 0, 10, 0, "3"]}}', "six finite"),
        ('{"bounds": {"extents": [10, 0, 0, 10, 0, 3]}}', "swap"),
        ('{"bounds": {"extents": [0, 10, 0, 10, 0, 0.3]}}', "span"),
        ('{"bounds": {"extents": [0, 10, 0, 10, 0, 3]}, "blocks": [{"extents": [1, 0, 0, 1, 0, 1]}]}', "blocks[0]"),
        ('{"bounds": {"extents": [0, 10, 0, 10, 0, 3]}, "blocks": [7]}', "blocks[0]"),
        ('{"bounds": {"extents": [0, 10, 0, 10, 0, 3]}, "blocks": 7}', "not a box world"),
        ("[" * 100_000, "JSON"),
    ],
)
def test_bad_box_worlds(tmp_path: Path, content: str, word: str) -> None:
    assert_refused(write(tmp_path, "map.json", content), word)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("<robot/>", "<mujoco>"),
        ("<mujoco><worldbody>", "well-formed"),
        ("<mujoco/>", "room"),
        ('<mujoco><worldbody><site name="room" size="5"/></worldbody></mujoco>', "room"),
        (mjcf('<include file="/etc/passwd"/>'), "include"),
        (mjcf('<replicate count="10000000"><geom size="1"/></replicate>'), "replicate"),
        (mjcf("", '<size nkey="2000000000"/>'), "size"),
        (mjcf("", '<extension><plugin plugin="x"/></extension>'), "extension"),
        (mjcf("", '<asset><hfield name="h" nrow="65536" ncol="65536" size="1 1 1 1"/></asset>'), "hfield"),
        (mjcf("", '<asset><texture name="t" type="2d" builtin="flat" width="99999" height="9"/></asset>'), "width"),
        (mjcf("", '<asset><texture name="t" type="2d" file="/etc/passwd"/></asset>'), "file"),
        (mjcf("", '<custom><numeric name="n" size="2000000000"/></custom>'), "size"),
        (mjcf("<body><freejoint/><geom size='1'/></body>"), "freejoint"),
        (mjcf('<geom type="ellipsoid" size="1 1 2"/>'), "ellipsoid"),
        (mjcf('<geom type="sphere" size="nan"/>'), ""),
        (mjcf('<geom type="sphere" size="1" pos="nan 0 0"/>'), ""),
        (mjcf("", '<custom><numeric name="keep_in" data="7"/></custom>'), "keep_in"),
        ('<!DOCTYPE a [<!ENTITY b "c">]>' + mjcf(""), "entity"),
        (mjcf("<body>" * 100 + "</body>" * 100), "nested"),
        (mjcf("<site/>" * 20_000), "too large"),
    ],
)
def test_bad_mjcf(tmp_path: Path, content: str, word: str) -> None:
    """I29: MJCF is not data; what is not a static scene of primitives never reaches MuJoCo."""
    assert_refused(write(tmp_path, "map.xml", content), word)


def triangles(points: np.ndarray) -> bytes:
    body = b"".join(np.concatenate([np.zeros(3), t.reshape(-1)]).astype("<f4").tobytes() + b"\0\0" for t in points)
    return bytes(80) + len(points).to_bytes(4, "little") + body


@pytest.mark.parametrize(
    ("points", "word"),
    [
        (np.zeros((0, 3, 3)), "empty"),
        (np.full((1, 3, 3), np.nan), ""),
        (np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]]), "span"),
        (np.array([[[0, 0, 0], [5000, 0, 0], [0, 5000, 3000.0]]]), "millimetres"),
    ],
)
def test_bad_meshes(tmp_path: Path, points: np.ndarray, word: str) -> None:
    assert_refused(write(tmp_path, "map.stl", triangles(points)), word)
