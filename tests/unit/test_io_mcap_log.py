"""MCAP as a target's flight: bags of ROS 2, PX4's topics, our own recordings, and damaged ones."""

import json
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplan.errors import FileError, ResourceError
from jaxplan.io.log_columns import LogFormat
from jaxplan.io.target_log import read_target_log
from oracles.flight_logs import ENU, NED, TIMES, memory_below, read_or_refused
from tolerances import tolerance

writer = pytest.importorskip("mcap.writer")
ros2 = pytest.importorskip("mcap_ros2.writer")
SINGLE = tolerance("exact", np.float32)


ODOMETRY = "\n".join(
    [
        "std_msgs/Header header",
        "string child_frame_id",
        "geometry_msgs/PoseWithCovariance pose",
        "=" * 80,
        "MSG: std_msgs/Header",
        "builtin_interfaces/Time stamp",
        "string frame_id",
        "=" * 80,
        "MSG: geometry_msgs/PoseWithCovariance",
        "geometry_msgs/Pose pose",
        "float64[36] covariance",
        "=" * 80,
        "MSG: geometry_msgs/Pose",
        "geometry_msgs/Point position",
        "geometry_msgs/Quaternion orientation",
        "=" * 80,
        "MSG: geometry_msgs/Point",
        "float64 x",
        "float64 y",
        "float64 z",
        "=" * 80,
        "MSG: geometry_msgs/Quaternion",
        "float64 x",
        "float64 y",
        "float64 z",
        "float64 w",
        "=" * 80,
        "MSG: builtin_interfaces/Time",
        "int32 sec",
        "uint32 nanosec",
    ]
)


def odometry(t: float, position: np.ndarray) -> dict:
    sec = int(t)
    stamp = {"sec": sec, "nanosec": round(1e9 * (t - sec))}
    pose = {"position": dict(zip("xyz", position.tolist(), strict=True)), "orientation": {"w": 1.0}}
    return {"header": {"stamp": stamp, "frame_id": "map"}, "pose": {"pose": pose, "covariance": [0.0] * 36}}


def bag(path: Path, topics: tuple[str, ...] = ("/odom",), late: float = 0.01, **options: object) -> Path:
    """A bag of ROS 2 with a topic of odometry each, recorded a while after it was measured, and one of text."""
    with path.open("wb") as stream:
        written = ros2.Writer(stream, **options)
        schema = written.register_msgdef("nav_msgs/msg/Odometry", ODOMETRY)
        text = written.register_msgdef("std_msgs/msg/String", "string data")
        for t, position in zip(TIMES, ENU, strict=True):
            at = round(1e9 * (t + late))
            written.write_message("/chatter", text, {"data": "hello"}, log_time=at, publish_time=at)
            for number, topic in enumerate(topics):
                said = odometry(t, position + number)
                written.write_message(topic, schema, said, log_time=at, publish_time=at)
        written.finish()
    return path


@pytest.mark.parametrize("compression", list(writer.CompressionType), ids=lambda kind: kind.name)
def test_a_bag_of_ros_2(tmp_path: Path, compression: object) -> None:
    path = bag(tmp_path / "bag.mcap", compression=compression, chunk_size=10_000)
    log = read_target_log(path)
    np.testing.assert_allclose(log.times, TIMES, rtol=0.0, atol=1e-8)  # nanoseconds
    np.testing.assert_allclose(log.positions, ENU, **tolerance("exact"))
    assert log.report.chosen == "/odom (nav_msgs/msg/Odometry) by header.stamp as z up"
    ned = read_target_log(path, LogFormat(frame="ned"))
    np.testing.assert_allclose(ned.positions, NED, **tolerance("exact"))


def test_several_topics_are_asked_about_and_named(tmp_path: Path) -> None:
    path = bag(tmp_path / "two.mcap", ("/own/odom", "/other/odom"))
    with pytest.raises(FileError, match="several topics with positions: /own/odom, /other/odom; name one by --columns"):
        read_target_log(path)
    columns = ("log_time", *(f"/other/odom.pose.pose.position.{axis}" for axis in "xyz"))
    log = read_target_log(path, LogFormat(columns=columns))
    np.testing.assert_allclose(log.times, TIMES + 0.01, rtol=0.0, atol=1e-8)  # nanoseconds
    np.testing.assert_allclose(log.positions, ENU + 1.0, **tolerance("exact"))
    slashes = ("/other/odom/header/stamp", *(f"/other/odom/pose/pose/position/{axis}" for axis in "xyz"))
    log = read_target_log(path, LogFormat(columns=slashes))
    np.testing.assert_allclose(log.times, TIMES, rtol=0.0, atol=1e-8)  # nanoseconds
    with_target = bag(tmp_path / "target.mcap", ("/own/odom", "/target/odom"))
    np.testing.assert_allclose(read_target_log(with_target).positions, ENU + 1.0, **tolerance("exact"))
    for bad, said in (
        (("log_time", "/nowhere.x", "/other/odom.y", "/other/odom.z"), "have '/nowhere.x', want log_time"),
        (("log_time", "/own/odom.pose", "/own/odom.pose", "/own/odom.pose"), "have 'pose', want a number"),
        (("/own/odom.pose", *columns[1:]), "several topics"),
        (("/other/odom.pose", *columns[1:]), "have 'pose', want a time"),
    ):
        with pytest.raises(FileError, match=said):
            read_target_log(path, LogFormat(columns=bad))


def px4_bag(path: Path) -> Path:
    """PX4's own topic over ROS 2: microseconds, north-east-down, x, y and z at the top."""
    fields = "uint64 timestamp\nfloat32 x\nfloat32 y\nfloat32 z\nbool xy_valid"
    with path.open("wb") as stream:
        written = ros2.Writer(stream)
        schema = written.register_msgdef("px4_msgs/msg/VehicleLocalPosition", fields)
        for t, (x, y, z) in zip(TIMES, NED, strict=True):
            said = {"timestamp": round(1e6 * t), "x": x, "y": y, "z": z, "xy_valid": True}
            written.write_message("/fmu/out/vehicle_local_position", schema, said, round(1e9 * t), round(1e9 * t))
        written.finish()
    return path


def test_px4_over_ros_2(tmp_path: Path) -> None:
    log = read_target_log(px4_bag(tmp_path / "px4.mcap"))
    np.testing.assert_allclose(log.positions, ENU, **SINGLE)
    np.testing.assert_allclose(log.times, TIMES, rtol=0.0, atol=1e-6)  # microseconds
    assert "as north, east, down" in log.report.chosen


def of_json(path: Path, messages: list[tuple[int, object]], **options: object) -> Path:
    with path.open("wb") as stream:
        written = writer.Writer(stream, **options)
        written.start()
        channel = written.register_channel("/where", "json", 0)
        for at, said in messages:
            content = said if isinstance(said, bytes) else json.dumps(said).encode()
            written.add_message(channel, at, content, at)
        written.finish()
    return path


def test_a_recording_that_was_cut_off(tmp_path: Path) -> None:
    said = [(round(1e9 * t), {"position": position.tolist()}) for t, position in zip(TIMES, ENU, strict=True)]
    path = of_json(tmp_path / "cut.mcap", said, chunk_size=500)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 3])
    log = read_target_log(path)
    assert 10 < len(log.times) < len(TIMES)
    np.testing.assert_allclose(log.positions, ENU[: len(log.times)], **tolerance("exact"))
    assert log.report.chosen == "/where (without a schema) by log_time as z up; the file is cut off"


def test_times_that_repeat_or_go_back(tmp_path: Path) -> None:
    place = {"x": 1.0, "y": 2.0, "z": 3.0}
    path = of_json(tmp_path / "again.mcap", [(10**9, place), (10**9, place), (2 * 10**9, place | {"x": 2.0})])
    log = read_target_log(path)
    assert log.times.tolist() == [1.0, 2.0]
    assert "1 samples that repeat a time left out" in log.report.chosen
    path = of_json(tmp_path / "back.mcap", [(2 * 10**9, place), (10**9, place)])
    with pytest.raises(FileError, match=r"goes backwards, have 1 s after 2 s \(sample 2\)"):
        read_target_log(path)


def chunk(size: int, compression: bytes, content: bytes) -> bytes:
    body = struct.pack("<QQQI", 0, 0, size, 0) + struct.pack("<I", len(compression)) + compression
    body += struct.pack("<Q", len(content)) + content
    return struct.pack("<BQ", 6, len(body)) + body


def bombs() -> dict[str, bytes]:
    """Chunks that unpack to much more than they are, whatever they say of their size."""
    import lz4.frame
    import zstandard

    zeros = bytes(2**27)
    frames = {"zstd": zstandard.compress(zeros), "lz4": lz4.frame.compress(zeros)}
    return {
        f"{name} {size}": chunk(size, name.encode(), content) for name, content in frames.items() for size in (1, 2**40)
    }


DAMAGED = {
    "a record without end": (struct.pack("<BQ", 6, 2**63), "has a chunk of 9223372036854775808 bytes"),
    "a message without end": (struct.pack("<BQ", 5, 2**63), "no topic with a position"),
    "a chunk of nonsense": (chunk(10, b"zstd", b"nonsense"), "cannot be unpacked"),
    "a compression of the future": (chunk(10, b"brotli", b"nonsense"), "compression 'brotli'"),
    "a chunk that says too much": (chunk(2**40, b"", b""), "no topic with a position"),
    "half a schema": (struct.pack("<BQ", 3, 2) + b"\x01\x00", "record of kind 3 that cannot be read"),
    "nothing": (b"", "no topic with a position"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_recordings_cost_a_line(tmp_path: Path, name: str) -> None:
    content, said = DAMAGED[name]
    path = tmp_path / "damaged.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + content)
    with pytest.raises(FileError, match=said):
        read_target_log(path)


def test_bombs_cost_a_line_and_little_memory(tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    for content in bombs().values():
        path.write_bytes(b"\x89MCAP0\r\n" + content)
        with memory_below(300e6), pytest.raises(FileError, match="chunk of more than"):
            read_target_log(path)


def test_definitions_that_say_too_much_are_not_read(tmp_path: Path) -> None:
    """A list of four thousand million empty messages, in forty bytes."""
    path = tmp_path / "list.mcap"
    text = "mine/Empty[] many\nfloat64 x\nfloat64 y\nfloat64 z\n" + "=" * 80 + "\nMSG: mine/Empty\nfloat64[0] none\n"
    with path.open("wb") as stream:
        written = writer.Writer(stream)
        written.start()
        schema = written.register_schema("mine/msg/Many", "ros2msg", text.encode())
        channel = written.register_channel("/many", "cdr", schema)
        written.add_message(channel, 0, b"\x00\x01\x00\x00" + struct.pack("<I", 2**32 - 1), 0)
        written.finish()
    with memory_below(50e6), pytest.raises(FileError, match="no topic with a position"):
        read_target_log(path)


def test_messages_that_are_none(tmp_path: Path) -> None:
    beyond = b'{"x": 1%s, "y": 0, "z": 0}' % (b"0" * 400)
    for content in (b"[" * 100_000, b"\xff", b'{"x": 1e999, "y": 0, "z": 0}', beyond, b"x" * 2**21):
        of_json(tmp_path / "bad.mcap", [(1, content), (2, content)])
        with pytest.raises(FileError):
            read_target_log(tmp_path / "bad.mcap")


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_no_damage_to_an_mcap_is_more_than_a_line(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzzed.mcap"
    if not (path.parent / "whole.mcap").exists():
        said = [(k, {"position": [k, 0.0, 1.0]}) for k in range(1, 20)]
        of_json(path.parent / "whole.mcap", said, chunk_size=200, compression=writer.CompressionType.NONE)
    content = bytearray((path.parent / "whole.mcap").read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        content[data.draw(st.integers(8, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    read_or_refused(path)


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = bag(tmp_path / "bag.mcap")
    monkeypatch.setitem(sys.modules, "mcap_ros2.decoder", None)
    with pytest.raises(ResourceError, match=r"mcap-ros2-support.*jaxplan\[logs\]"):
        read_target_log(path)
    monkeypatch.setitem(sys.modules, "mcap.records", None)
    with pytest.raises(ResourceError, match=r"needs mcap,.*jaxplan\[logs\]"):
        read_target_log(path)
