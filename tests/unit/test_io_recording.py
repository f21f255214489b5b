"""A recording as its independent readers see it: mcap's own, and Foxglove's schemas."""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_cli import flight, made_up_metrics
from test_viz_episode import cube_mesh

from jaxplan import cli
from jaxplan.cli.intercept import write_results
from jaxplan.config import InterceptConfig
from jaxplan.errors import FileError
from jaxplan.io.cycles import read_cycles
from jaxplan.io.output import OutputFolder
from jaxplan.io.plans import read_commitments
from jaxplan.io.recording import TOPICS, record_episode
from jaxplan.io.target_log import read_target_log
from jaxplan.io.targets import load_target
from jaxplan.io.world_scene import world_scene
from jaxplan.spline import PiecewisePolynomial
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import Boxes, Capsules, Cylinders, DistanceGrid, Spheres, World, make_obstacles
from tolerances import tolerance

mcap_reader = pytest.importorskip("mcap.reader")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What ``jaxplan intercept`` writes of an episode with a turning vehicle and one plan."""
    config = InterceptConfig()
    episode = flight(config)
    times = episode.flight.times
    episode.flight.quat_wxyz = Rotation.from_euler("ZYX", np.outer(times, [0.5, 0.1, -0.2])).as_quat(scalar_first=True)
    position = np.zeros((2, 10, 3))
    position[0, 0], position[0, 1], position[1, 0], position[1, 1] = [1, 2, 1], [1, 0, 0], [2, 2, 1], [0, 1, 0]
    spline = PiecewisePolynomial(durations=np.ones(2), position=position, yaw=np.zeros((2, 6)))
    episode.plans[0].spline, episode.plans[0].goal = spline, np.array([2.0, 3.0, 1.0])
    out = tmp_path_factory.mktemp("results") / "episode"
    with OutputFolder(out) as staged:
        write_results(staged, config, episode, made_up_metrics())
        staged.publish()
    return out


@pytest.fixture(scope="module")
def messages(folder: Path) -> list[tuple[str, str, float, Any]]:
    """Schema, topic, seconds and decoded message of everything in the recording."""
    content = record_episode(folder).content
    read = mcap_reader.make_reader(io.BytesIO(content), validate_crcs=True).iter_messages()
    return [(s.name, c.topic, 1e-9 * m.log_time, json.loads(m.data)) for s, c, m in read]


def on(messages: list, topic: str) -> list[tuple[float, Any]]:
    return [(time, message) for _, name, time, message in messages if name == topic]


def xyz(values: dict[str, float]) -> list[float]:
    return [values[axis] for axis in "xyz"]


def test_every_value_is_the_episodes(folder: Path, messages: list) -> None:
    table = {name: np.loadtxt(folder / f"{name}.csv") for name in ("flown", "target")}
    for topic, name in (("/defender", "flown"), ("/target", "target")):
        found = on(messages, topic)
        np.testing.assert_allclose([time for time, _ in found], table[name][:, 0], rtol=0.0, atol=1e-9)  # ns
        poses = [m["pose"] for _, m in found]
        rows = [[*xyz(p["position"]), *xyz(p["orientation"]), p["orientation"]["w"]] for p in poses]
        np.testing.assert_allclose(rows, table[name][:, 1:], **tolerance("exact"))
    moved = [[*xyz(m["translation"]), *xyz(m["rotation"]), m["rotation"]["w"]] for _, m in on(messages, "/tf")]
    np.testing.assert_allclose(moved, table["flown"][:, 1:], **tolerance("exact"))
    apart = np.linalg.norm(table["flown"][:, 1:4] - table["target"][:, 1:4], axis=1)
    np.testing.assert_allclose([m["distance"] for _, m in on(messages, "/flight")], apart, **tolerance("exact"))


def test_a_committed_plan_is_a_line_and_its_numbers(folder: Path, messages: list) -> None:
    (commitment,) = read_commitments(folder)
    ((time, drawn),) = on(messages, "/plan")
    (entity,) = drawn["entities"]
    assert (entity["timestamp"]["sec"], entity["timestamp"]["nsec"]) == (0, 600_000_000)
    assert (time, commitment.start_time) == (pytest.approx(0.6), 0.6)
    points = np.array([xyz(point) for point in entity["lines"][0]["points"]])
    wanted = commitment.spline.evaluate(np.linspace(0.0, 2.0, len(points)))[:, :3]
    np.testing.assert_allclose(points, wanted, **tolerance("exact"))
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() < 0.03
    assert xyz(entity["spheres"][0]["pose"]["position"]) == [2.0, 3.0, 1.0]
    ((_, numbers),) = on(messages, "/committed")
    assert numbers["alpha"] == 1.1
    assert numbers["status"] == "intercept"
    cycles = on(messages, "/cycle")
    for (time, cycle), saved in zip(cycles, read_cycles(folder / "cycles.npz", 1), strict=True):
        assert (time, cycle["time"]) == (pytest.approx(saved.time), saved.time)  # nanoseconds
        assert (cycle["computed_ms"], cycle["search_ms"]) == (3.75, 2.25)
        assert (cycle["latency"], cycle["sooner"], cycle["generated"]) == (saved.latency, saved.sooner, saved.generated)
        assert cycle["rejected"] == sum(saved.rejected.values())
    assert [cycle["status"] for _, cycle in cycles] == ["kept_committed", "kept_committed"]
    assert [m["message"] for _, m in on(messages, "/log")][-1] == "the episode ends: intercepted"


def test_the_world_is_there_by_value(messages: list) -> None:
    ((_, drawn),) = on(messages, "/world")
    world, (entity,) = load_world("env1"), drawn["entities"]
    assert len(entity["cubes"]) == len(world.boxes.center)
    for cube, center, half in zip(entity["cubes"], world.boxes.center, world.boxes.half, strict=True):
        assert xyz(cube["pose"]["position"]) == np.asarray(center).tolist()
        assert xyz(cube["size"]) == (2.0 * np.asarray(half)).tolist()
    corners = np.array([xyz(point) for ring in entity["lines"] for point in ring["points"]])
    np.testing.assert_array_equal([corners.min(axis=0), corners.max(axis=0)], world.bounds)


def test_foxgloves_own_schemas_take_every_message(messages: list) -> None:
    """Field by field, and nothing that they do not know."""
    json_format = pytest.importorskip("google.protobuf.json_format")
    for name in ("FrameTransform", "PoseInFrame", "SceneUpdate", "Log"):
        module = pytest.importorskip(f"foxglove_schemas_protobuf.{name}_pb2")
        found = [message for schema, _, _, message in messages if schema == f"foxglove.{name}"]
        assert found
        for message in found[:5]:
            json_format.ParseDict(with_protobufs_times(message), getattr(module, name)())


def with_protobufs_times(value: Any) -> Any:
    """Its own JSON has times as text; everything else is the same."""
    if isinstance(value, list):
        return [with_protobufs_times(item) for item in value]
    if not isinstance(value, dict):
        return value
    found = {key: with_protobufs_times(item) for key, item in value.items()}
    for key, text in (("timestamp", f"1970-01-01T00:00:{0:02d}Z"), ("lifetime", "0s")):
        if key in found:
            assert set(value[key]) == {"sec", "nsec"}
            found[key] = text
    return found


def test_the_schemas_say_what_the_messages_hold(folder: Path, messages: list) -> None:
    summary = mcap_reader.make_reader(io.BytesIO(record_episode(folder).content)).get_summary()
    assert {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()} == TOPICS
    schemas = {schema.name: json.loads(schema.data) for schema in summary.schemas.values()}
    assert "search_ms" in schemas["jaxplan.Cycle"]["properties"]
    for name, _, _, message in messages:
        fits(schemas[name], message, name)


def fits(schema: dict, value: Any, where: str) -> None:
    kinds = {"object": dict, "array": list, "string": str, "integer": int, "number": (int, float), "boolean": bool}
    assert isinstance(value, kinds[schema["type"]]), where
    if isinstance(value, dict) and "properties" in schema:
        assert set(value) == set(schema["properties"]), where
        for key, item in value.items():
            fits(schema["properties"][key], item, f"{where}.{key}")
    for item in value if isinstance(value, list) else []:
        fits(schema["items"], item, f"{where}[]")


def test_every_kind_of_obstacle_is_drawn() -> None:
    """A world with one of each: centres, sizes and turns by value."""
    axis = np.array([[0.6, 0.0, 0.8]])
    turn = Rotation.from_euler("z", 0.3)
    rod = {"center": np.ones((1, 3)), "axis": axis, "radius": np.array([0.2]), "half_length": np.array([0.5])}
    occupied = np.zeros((2, 2, 4), bool)
    occupied[1, 0, 1:3] = occupied[0, 1, 3] = True
    grid = DistanceGrid(occupied=occupied, squared=np.zeros((3, 3, 5)), origin=np.zeros(3), spacing=0.5)
    obstacles = make_obstacles(
        boxes=Boxes(center=np.ones((1, 3)), half=np.full((1, 3), 0.1), rotation=turn.as_matrix()[None]),
        cylinders=Cylinders(**rod),
        capsules=Capsules(**rod),
        spheres=Spheres(center=np.zeros((1, 3)), radius=np.array([0.3])),
        mesh=cube_mesh(),
        voxels=grid,
    )
    world = World(name="all", bounds=np.array([[-5.0, -5, -5], [5, 5, 5]]), obstacles=obstacles, keep_in=0.2)
    (entity,) = world_scene(world)["entities"]
    box, *cells = entity["cubes"]
    quat = [box["pose"]["orientation"][key] for key in "wxyz"]
    np.testing.assert_allclose(quat, turn.as_quat(scalar_first=True), **tolerance("exact"))
    found = sorted((xyz(cell["pose"]["position"]), xyz(cell["size"])) for cell in cells)
    assert found == [([0.25, 0.75, 1.75], [0.5, 0.5, 0.5]), ([0.75, 0.25, 1.0], [0.5, 0.5, 1.0])]
    for cylinder in entity["cylinders"]:
        turned = Rotation.from_quat([cylinder["pose"]["orientation"][key] for key in "wxyz"], scalar_first=True)
        np.testing.assert_allclose(turned.apply([0.0, 0.0, 1.0]), axis[0], **tolerance("formula"))
        np.testing.assert_allclose(xyz(cylinder["size"]), [0.4, 0.4, 1.0], **tolerance("exact"))
    centres = sorted(xyz(ball["pose"]["position"]) for ball in entity["spheres"])
    np.testing.assert_allclose(centres, [[0, 0, 0], [0.7, 1, 0.6], [1.3, 1, 1.4]], **tolerance("formula"))
    assert len(entity["triangles"][0]["indices"]) == 36


def test_from_the_command_line(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "episode.mcap"
    export = ["export", "--format", "mcap", "--out", str(out)]
    assert cli.run([*export, str(folder)]) == 0
    assert "messages" in capsys.readouterr().out
    for arguments, code, said in (
        ([str(folder / "plans.npz")], 11, "is no folder"),
        ([str(tmp_path)], 11, "flown.csv: no such file"),
        ([str(folder), "--frame", "ned"], 10, "--format mcap: have --plan or --frame ned"),
        ([str(folder), "--plan", "0"], 10, "the whole episode is written"),
    ):
        assert cli.run([*export[:-1], str(tmp_path / "none"), *arguments]) == code
        printed = capsys.readouterr().err
        assert said in printed
        assert printed.count("\n") == 1
        assert not (tmp_path / "none").exists()


def test_what_is_missing_is_said(folder: Path, tmp_path: Path) -> None:
    """An episode of an earlier version, whose map was moved since."""
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "cycles.npz").unlink()
    (tmp_path / "config.json").write_text('{"world": "moved.stl"}')
    found = record_episode(tmp_path)
    assert len(found.warnings) == 2
    assert "cycles.npz" in found.warnings[0]
    assert "moved.stl" in found.warnings[1]
    for name, content in (
        ("flown.csv", "1 2 3\n"),
        ("flown.csv", ""),
        ("metrics.json", "[1]"),
        ("cycles.npz", "no archive"),
    ):
        kept = (folder / name).read_bytes()
        (tmp_path / name).write_text(content)
        with pytest.raises(FileError, match=name):
            record_episode(tmp_path)
        (tmp_path / name).write_bytes(kept)


def test_without_mcap_it_says_so(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "mcap.writer", None)
    assert cli.run(["export", str(folder), "--format", "mcap", "--out", str(tmp_path / "x")]) == 12
    assert "pip install 'jaxplan[logs]'" in capsys.readouterr().err


def test_our_own_recording_is_a_target_again(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "episode.mcap"
    path.write_bytes(record_episode(folder).content)
    log, direct = read_target_log(path), read_target_log(folder / "target.csv")
    np.testing.assert_allclose(log.positions, direct.positions, **tolerance("exact"))
    np.testing.assert_allclose(log.times, direct.times, rtol=0.0, atol=2e-9)  # nanoseconds
    assert load_target(str(path), world="room").read_as == "/target (foxglove.PoseInFrame) by timestamp as z up"
