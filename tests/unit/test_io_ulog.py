"""PX4's flight logs as a target's flight, from files made after the format's specification."""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplan.errors import FileError, ResourceError
from jaxplan.io.log_columns import LogFormat
from jaxplan.io.target_log import read_target_log
from oracles import ulog_writer as ulog
from oracles.flight_logs import ENU, NED, TIMES, memory_below, read_or_refused
from tolerances import tolerance

pytest.importorskip("pyulog")
SINGLE = tolerance("exact", np.float32)


def px4_log(valid_from: int = 0) -> list[bytes]:
    """As PX4 writes it: definitions, an announcement, and the data of two topics between each other."""
    rows = ulog.local_positions(3, np.column_stack([TIMES, NED]), np.arange(len(TIMES)) >= valid_from)
    other = [ulog.data(7, "Qf", round(1e6 * t), 0.5) for t in TIMES]
    begin = [ulog.header(), ulog.info("sys_name", "PX4"), ulog.definition("battery", "uint64_t timestamp;float v;")]
    begin += [ulog.definition("vehicle_local_position", ulog.LOCAL_POSITION)]
    begin += [ulog.subscription(7, "battery"), ulog.subscription(3, "vehicle_local_position")]
    return begin + [part for pair in zip(rows, other, strict=True) for part in pair]


@pytest.fixture
def px4(tmp_path: Path) -> Path:
    path = tmp_path / "log_12.ulg"
    path.write_bytes(b"".join(px4_log()))
    return path


def test_where_px4_says_it_was(px4: Path) -> None:
    log = read_target_log(px4)
    np.testing.assert_allclose(log.times, TIMES, rtol=0.0, atol=1e-6)  # microseconds
    np.testing.assert_allclose(log.positions, ENU, **SINGLE)
    assert log.report.chosen == "vehicle_local_position as north, east, down"
    turned = read_target_log(px4, LogFormat(frame="enu", time_unit="ms"))
    np.testing.assert_allclose(turned.positions, NED, **SINGLE)
    np.testing.assert_allclose(turned.times, 1e3 * TIMES, rtol=0.0, atol=1e-3)  # microseconds as milliseconds


def test_what_the_estimator_does_not_vouch_for_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "early.ulg"
    path.write_bytes(b"".join(px4_log(valid_from=50)))
    log = read_target_log(path)
    assert len(log.times) == 150
    assert log.report.chosen.endswith("50 of 200 samples without a position left out")


def test_another_topic_by_its_columns(tmp_path: Path) -> None:
    """Two instances of odometry, an array each, and padding behind."""
    path = tmp_path / "odometry.ulg"
    parts = [ulog.header(), ulog.definition("vehicle_odometry", ulog.ODOMETRY)]
    parts += [ulog.subscription(1, "vehicle_odometry"), ulog.subscription(2, "vehicle_odometry", 1)]
    for t, (x, y, z) in zip(TIMES, NED, strict=True):
        parts += [ulog.data(1, "QfffB", round(1e6 * t), x, y, z, 1), ulog.data(2, "QfffB", round(1e6 * t), z, x, y, 2)]
    path.write_bytes(b"".join(parts))
    log = read_target_log(path)
    assert log.report.chosen == "vehicle_odometry as north, east, down"
    np.testing.assert_allclose(log.positions, ENU, **SINGLE)
    second = ("vehicle_odometry[1].timestamp", *(f"vehicle_odometry[1].position[{axis}]" for axis in (1, 2, 0)))
    with pytest.raises(FileError, match=r"vehicle_odometry\[1\]: its axes .* give --frame"):
        read_target_log(path, LogFormat(columns=second))
    log = read_target_log(path, LogFormat(columns=second, frame="ned"))
    np.testing.assert_allclose(log.positions, ENU, **SINGLE)
    usual = read_target_log(path, LogFormat(columns=("timestamp", "position[0]", "position[1]", "position[2]")))
    np.testing.assert_allclose(usual.positions, ENU, **SINGLE)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (("timestamp", "x", "y", "w"), "vehicle_local_position has no 'w', want one of timestamp"),
        (("timestamp", "x", "y", "battery.v"), "have topics battery, vehicle_local_position"),
        (("nothing.timestamp", "x", "y", "z"), "have 'nothing.timestamp', want topic.field of battery"),
        (("1", "2", "3", "4"), "has no '1'"),
        (("battery.timestamp", "battery.v", "battery.v", "battery.h"), "battery has no 'h'"),
    ],
)
def test_columns_that_are_none(px4: Path, columns: tuple, said: str) -> None:
    with pytest.raises(FileError, match=said) as caught:
        read_target_log(px4, LogFormat(columns=columns))
    assert "log_12.ulg" in str(caught.value)


def test_damaged_places_are_passed_over_and_a_cut_end_is_said(tmp_path: Path) -> None:
    parts = px4_log()
    parts[100:101] = [b"\x00\x00\x00\xff", parts[100], b"\xff\xff\xffgarbage", ulog.message("S", ulog.SYNC), parts[100]]
    path = tmp_path / "damaged.ulg"
    path.write_bytes(b"".join(parts)[:-5])
    log = read_target_log(path)
    assert len(log.times) >= 197
    np.testing.assert_allclose(log.positions[:40], ENU[:40], **SINGLE)
    assert "damaged or cut off" in log.report.chosen


ANNOUNCED = ulog.subscription(3, "vehicle_local_position")


HOSTILE = {
    "no data": ([ANNOUNCED], "is missing"),
    "nothing at all": ([], "have topics none"),
    "an endless definition": (
        [ulog.definition("vehicle_local_position", "vehicle_local_position x;"), ANNOUNCED],
        "is endless",
    ),
    "a definition that grows": (
        [ulog.definition("vehicle_local_position", "a0[9999] x;"), ANNOUNCED]
        + [ulog.definition(f"a{n}", f"a{n + 1}[9999] x;") for n in range(30)]
        + [ulog.definition("a30", "float x;")],
        "more than 4096 values",
    ),
    "a number of fields without end": (
        [ulog.definition("vehicle_local_position", f"float[{'9' * 5000}] x;"), ANNOUNCED],
        "more than 4096 values",
    ),
    "a definition without fields": (
        [ulog.definition("vehicle_local_position", ""), ANNOUNCED, ulog.data(3, "Q", 1)],
        "has no data",
    ),
    "incompatible flags": ([], "incompatible flags"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_ulogs_cost_a_line(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    parts, said = HOSTILE[name]
    path = tmp_path / "hostile.ulg"
    flags = bytes([0] * 8 + [6] + [0] * 31) if name == "incompatible flags" else bytes(40)
    path.write_bytes(b"".join([ulog.header(flags), *parts]))
    with memory_below(20e6), pytest.raises(FileError, match=said):
        read_target_log(path)
    assert capsys.readouterr().out == ""


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_no_damage_to_a_ulog_is_more_than_a_line(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    content = bytearray(b"".join(px4_log()[:40]))
    for _ in range(data.draw(st.integers(1, 6))):
        content[data.draw(st.integers(16, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "fuzzed.ulg"
    path.write_bytes(content[: data.draw(st.integers(20, len(content)))])
    read_or_refused(path)


def test_a_missing_package_is_named(px4: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(ResourceError, match=r"pyulog.*jaxplan\[logs\]"):
        read_target_log(px4)
