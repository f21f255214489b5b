"""Recorded flights: what is accepted, what is refused, and in which words."""

import os
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplan.errors import FileError, InputError
from jaxplan.io.log_columns import LogFormat
from jaxplan.io.target_log import read_target_log, resample, target_log
from tolerances import tolerance

TIMES = np.array([10.0, 10.1, 10.2, 10.3])
POSITIONS = np.array([[0.0, 1.0, 2.0], [0.1, 1.0, 2.0], [0.2, 1.1, 2.0], [0.3, 1.1, 2.5]])


def lines(separator: str, extra: str = "") -> str:
    return "".join(
        separator.join(f"{value:.6f}" for value in (t, *p)) + extra + "\n"
        for t, p in zip(TIMES, POSITIONS, strict=True)
    )


GOOD = {
    "csv with header": "t,x,y,z\n" + lines(","),
    "csv without header": lines(","),
    "csv with trailing commas": "t,x,y,z,\n" + lines(",", ","),
    "semicolons": "t;x;y;z\n" + lines(";"),
    "spaces": "timestamp tx ty tz\n" + lines(" "),
    "tabs": lines("\t"),
    "tum": "# timestamp tx ty tz qx qy qz qw\n" + lines(" ", " 0 0 0 1"),
    "comments and blank lines": "# a flight\n\n" + lines(" ") + "\n# the end\n",
    "byte order mark": "\ufefft,x,y,z\n" + lines(","),
    "windows": ("t, x, y, z\n" + lines(", ")).replace("\n", "\r\n"),
    "units in the header": '"Time [s]","x [m]","y [m]","z (m)"\n' + lines(","),
    "upper case": "T,X,Y,Z\n" + lines(","),
    "further columns": "t,x,y,z,battery\n" + lines(",", ",full"),
}

ROW = "0,0,0,1\n"
BAD = {
    "empty": ("", "no data"),
    "only comments": ("# nothing\n\n", "no data"),
    "only a header": ("t,x,y,z\n", "a header and no data"),
    "one sample": (ROW, "1 sample, want at least 2"),
    "nan": ("t,x,y,z\n" + ROW + "1,0,nan,1\n", "line 3, column 3: have 'nan', want a finite number"),
    "inf": (ROW + "1,0,0,-inf\n", "line 2, column 4"),
    "nan time": (ROW + "nan,0,0,1\n", "line 2, column 1"),
    "nan first": ("nan,0,0,1\n" + ROW, "line 1, column 1"),
    "words": (ROW + "1,0,lost,1\n", "line 2, column 3: have 'lost', want a number"),
    "empty field": (ROW + "1,,0,1\n", "line 2, column 2: have ''"),
    "two columns": ("0,1\n1,2\n", "line 1: have 2 columns, want at least 4"),
    "short row": (ROW + "1,0,0\n", "line 2: have 3 columns"),
    "missing z": ("t,x,y\n0,0,0\n", "line 1: no column for z"),
    "missing time": ("x,y,z,w\n0,0,0,1\n", "no column for time"),
    "prose": ("hello world\nthis is prose\n", "no column for time, x, y, z"),
    "backwards": (ROW + "1,0,0,1\n0.5,0,0,1\n", "line 3: the time goes backwards, have 0.5 after 1;"),
    "repeated": ("t,x,y,z\n" + ROW + ROW, "line 3: the time repeats"),
    "nanoseconds": ("1000000000,0,0,1\n1100000000,0,0,1\n", "want times in seconds"),
}


@pytest.mark.parametrize("name", GOOD)
def test_accepted_forms(tmp_path: Path, name: str) -> None:
    path = tmp_path / "flight with space.csv"
    path.write_text(GOOD[name], encoding="utf-8", newline="")
    log = read_target_log(path)
    np.testing.assert_allclose(log.times, TIMES, **tolerance("solve"))
    np.testing.assert_allclose(log.positions, POSITIONS, **tolerance("solve"))
    assert log.report.samples == 4
    assert log.report.rate_hz == pytest.approx(10.0)
    assert log.report.warnings() == []


@pytest.mark.parametrize("name", BAD)
def test_refused_forms(tmp_path: Path, name: str) -> None:
    content, message = BAD[name]
    path = tmp_path / "bad.csv"
    path.write_text(content)
    with pytest.raises(FileError) as caught:
        read_target_log(path)
    assert message in str(caught.value)
    assert "bad.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_columns_are_found_by_name(tmp_path: Path) -> None:
    path = tmp_path / "flight.csv"
    path.write_text("z,battery,y,x,t\n3,full,2,1,0\n6,full,5,4,1\n")
    log = read_target_log(path)
    assert log.times.tolist() == [0.0, 1.0]
    assert log.positions.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]


FLIGHT = np.column_stack([TIMES, POSITIONS])
HEADERS = {
    "milliseconds in the header": ("t [ms],x [mm],y,z (cm)", [1e3, 1e3, 1.0, 100.0]),
    "units behind underscores": ("time_us,x_mm,y_m,z", [1e6, 1e3, 1.0, 1.0]),
    "a ROS topic": ("%time,field.pose.position.x,field.pose.position.y,field.pose.position.z", [1e9, 1, 1, 1]),
    "a ROS topic by its stamp": ("field.header.stamp,pose.position.x,pose.position.y,pose.position.z", [1e9, 1, 1, 1]),
    "PlotJuggler": ("__time,/odom/pose/pose/position/x,/odom/pose/pose/position/y,/odom/pose/pose/position/z", [1] * 4),
    "cflib": ("timestamp,stateEstimate.x,stateEstimate.y,stateEstimate.z", [1e3, 1, 1, 1]),
    "feet": ("t,x [ft],y [ft],z [ft]", [1.0, 1 / 0.3048, 1 / 0.3048, 1 / 0.3048]),
}


def written(path: Path, header: str, scales: list[float], columns: np.ndarray = FLIGHT) -> Path:
    rows = ("\n" if header else "").join(["", *(",".join(f"{v:.9f}" for v in row) for row in columns * scales)])
    path.write_text(header + rows if header else "\n".join(",".join(map(str, row)) for row in columns * scales))
    return path


@pytest.mark.parametrize("name", HEADERS)
def test_what_a_header_says_counts(tmp_path: Path, name: str) -> None:
    log = read_target_log(written(tmp_path / "flight.csv", *HEADERS[name]))
    np.testing.assert_allclose(log.times, TIMES, **tolerance("solve"))
    np.testing.assert_allclose(log.positions, POSITIONS, **tolerance("solve"))


def test_velocities_are_no_positions(tmp_path: Path) -> None:
    header = "t,twist.linear.x,twist.linear.y,twist.linear.z,pose.position.x,pose.position.y,pose.position.z"
    columns = np.column_stack([TIMES, 9.0 + POSITIONS, POSITIONS])
    log = read_target_log(written(tmp_path / "flight.csv", header, [1.0] * 7, columns))
    np.testing.assert_allclose(log.positions, POSITIONS, **tolerance("solve"))


def test_what_the_file_does_not_say_can_be_told(tmp_path: Path) -> None:
    path = tmp_path / "flight.csv"
    long = np.column_stack([10.0 + 0.01 * np.arange(50), 0.01 * np.arange(50)[:, None] * np.array([1.0, 0.0, -1.0])])
    with pytest.raises(FileError, match="give --time-unit"):
        read_target_log(written(path, "t,x,y,z", [1e3, 1, 1, 1], long))
    log = read_target_log(path, LogFormat(time_unit="ms"))
    np.testing.assert_allclose(log.times, long[:, 0], **tolerance("solve"))
    written(path, "", [1.0, 1.0, 1.0, 1.0])
    ned = read_target_log(path, LogFormat(frame="ned"))
    np.testing.assert_allclose(ned.positions, POSITIONS[:, [1, 0, 2]] * [1.0, 1.0, -1.0], **tolerance("solve"))
    shuffled = read_target_log(path, LogFormat(columns=("1", "3", "2", "4")))
    np.testing.assert_allclose(shuffled.positions, POSITIONS[:, [1, 0, 2]], **tolerance("solve"))
    written(path, "when [ms],east,north,height", [1e3, 1, 1, 1])
    named = read_target_log(path, LogFormat(columns=("when", "east", "north", "Height")))
    np.testing.assert_allclose(named.times, TIMES, **tolerance("solve"))
    np.testing.assert_allclose(named.positions, POSITIONS, **tolerance("solve"))


def test_px4_is_known_by_its_columns_and_its_axes_are_asked_for(tmp_path: Path) -> None:
    path = written(tmp_path / "px4.csv", "timestamp,x,y,z,xy_valid", [1e6, 1, 1, 1, 1], np.c_[FLIGHT, np.ones(4)])
    with pytest.raises(FileError, match="north-east-down; give --frame ned"):
        read_target_log(path)
    log = read_target_log(path, LogFormat(frame="ned"))
    np.testing.assert_allclose(log.times, TIMES, **tolerance("solve"))
    np.testing.assert_allclose(log.positions[:, 2], -POSITIONS[:, 2], **tolerance("solve"))


@pytest.mark.parametrize(
    ("content", "how", "said"),
    [
        ("t [days],x,y,z\n0,0,0,1\n1,1,0,1\n", {}, "column 1 is in 'days'"),
        ("t,x [inch],y,z\n0,0,0,1\n1,1,0,1\n", {}, "column 2 is in 'inch'"),
        ("t,x,y,z\n0,0,0,1\n1,1,0,1\n", {"columns": ("t", "x", "y", "w")}, "--columns: have 'w'"),
        ("0,0,0,1\n1,1,0,1\n", {"columns": ("t", "x", "y", "z")}, "no header"),
        ("0,0,0,1\n1,1,0,1\n", {"columns": ("1", "2", "3", "9")}, "want at least 9"),
    ],
)
def test_what_cannot_be_understood_is_refused(tmp_path: Path, content: str, how: dict, said: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(content)
    with pytest.raises(FileError, match=said):
        read_target_log(path, LogFormat(**how))
    for bad in ({"time_unit": "h"}, {"frame": "nwu"}):
        with pytest.raises(InputError):
            LogFormat(**bad)


def test_a_large_file_is_read_at_once(tmp_path: Path) -> None:
    """A tenth of a million lines in well under a second; where one is bad, that one is named."""
    count = 100_000
    path = tmp_path / "long.csv"
    rows = [f"{0.001 * i:.4f},{0.001 * i % 5:.4f},1,2" for i in range(count)]
    path.write_text("t,x,y,z\n" + "\n".join(rows))
    began = time.perf_counter()
    assert len(read_target_log(path).times) == count
    assert time.perf_counter() - began < 2.0
    rows[77_777] = "77.777,lost,1,2"
    path.write_text("t,x,y,z\n" + "\n".join(rows))
    with pytest.raises(FileError, match=f"line {77_779}, column 2: have 'lost'"):
        read_target_log(path)


def test_things_that_are_not_text_files(tmp_path: Path) -> None:
    (tmp_path / "binary.csv").write_bytes(b"t,x,y,z\n\xff\xfe\x00")
    (tmp_path / "zeros.csv").write_bytes(b"\0" * 64)
    os.mkfifo(tmp_path / "pipe.csv")
    for name, message in [
        ("binary.csv", "not text"),
        ("zeros.csv", "not text"),
        ("pipe.csv", "not a regular file"),
        ("", "not a regular file"),
        ("absent.csv", "does not exist"),
    ]:
        with pytest.raises(FileError, match=message) as caught:
            read_target_log(tmp_path / name)
        assert caught.value.exit_code == 11
        assert "\n" not in str(caught.value)


def test_gaps_and_jumps_are_reported_not_refused() -> None:
    times = np.array([0.0, 0.1, 0.2, 1.2, 1.3, 1.4])
    positions = np.zeros((6, 3))
    positions[4:, 0] = 20.0
    report = target_log(times, positions).report
    assert [(gap.time, pytest.approx(gap.duration)) for gap in report.gaps] == [(0.2, 1.0)]
    assert [(jump.time, jump.distance) for jump in report.jumps] == [(1.2, 20.0)]
    assert report.jumps[0].speed == pytest.approx(200.0)
    assert len(report.warnings()) == 2


def test_resampling_passes_through_the_samples_and_never_overshoots() -> None:
    log = target_log(TIMES, POSITIONS)
    fine = resample(log, 0.01)
    assert len(fine.times) == 31
    assert fine.times[0] == 10.0
    assert fine.times[-1] == pytest.approx(10.3)
    np.testing.assert_allclose(fine.positions[::10], POSITIONS, **tolerance("formula"))
    assert (fine.positions <= POSITIONS.max(axis=0) + 1e-12).all()
    assert (fine.positions >= POSITIONS.min(axis=0) - 1e-12).all()
    np.testing.assert_allclose(resample(fine, 0.1).positions, POSITIONS, **tolerance("formula"))


@given(st.integers(0, 2**31), st.floats(0.001, 0.5))
def test_a_straight_constant_flight_stays_one(seed: int, dt: float) -> None:
    random = np.random.default_rng(seed)
    times = 3.0 + np.cumsum(random.uniform(0.01, 0.3, 20))
    velocity = random.normal(size=3)
    again = resample(target_log(times, times[:, None] * velocity), dt)
    np.testing.assert_allclose(again.positions, again.times[:, None] * velocity, **tolerance("formula"))
    np.testing.assert_allclose(np.diff(again.times), dt, **tolerance("formula"))
    assert again.times[-1] <= times[-1] < again.times[-1] + dt + 1e-9


@pytest.mark.parametrize("dt", [0.0, -0.1, float("nan"), 1e9, 1e-12])
def test_bad_intervals(dt: float) -> None:
    with pytest.raises(InputError, match="sample interval"):
        resample(target_log(TIMES, POSITIONS), dt)


@pytest.mark.parametrize(
    ("name", "samples", "rate"),
    [
        ("flights/oda_003.csv", 715, 80.0),
        ("flights/oda_010.csv", 1155, 80.0),
        ("flights/cs2_log202.csv", 2299, None),
        ("flights/airgarage_spiral.csv", 2186, None),
        ("flights/flightgoggles_example.csv", 8400, None),
        ("scenarios/oda_010__in__kr_skir_0.csv", 722, 50.0),
        ("scenarios/oda_003__in__octomap_geb079_0.csv", 447, 50.0),
    ],
)
def test_real_flights(examples: Path, name: str, samples: int, rate: float | None) -> None:
    log = read_target_log(examples / name)
    assert log.report.samples == samples
    if rate:
        assert log.report.rate_hz == pytest.approx(rate, rel=0.02)
    assert resample(log, 0.1).times[-1] <= log.times[-1]
    assert log.report.jumps == ()
