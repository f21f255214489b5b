"""What other programs would fly of a file, by decoders that know nothing but the format's specification."""

import csv
import io
import json
import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxplan
from jaxplan import cli
from jaxplan.errors import FileError, InputError
from jaxplan.io.export import FORMATS, SETPOINTS, ExportConfig, export_trajectory, north_east_down, read_trajectory
from jaxplan.io.plans import commanded, read_plans, write_plans
from jaxplan.io.septic import as_septic
from jaxplan.spline import PiecewisePolynomial
from tolerances import relative, tolerance


def flight(seed: int = 0, segments: int = 4) -> PiecewisePolynomial:
    """Minimum snap at some 5 m/s, turning."""
    rng = np.random.default_rng(seed)
    waypoints = np.cumsum(rng.uniform(-3.0, 3.0, (segments + 1, 3)), axis=0)
    durations = 0.4 + 0.2 * np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    return jaxplan.minimum_snap(waypoints, durations, yaw=rng.uniform(-2.0, 2.0, segments + 1))


SPLINE = flight()
TIMES = np.linspace(0.0, float(SPLINE.duration), 1000)


def by_pieces(durations: np.ndarray, coefficients: np.ndarray, times: np.ndarray, derivative: int = 0) -> np.ndarray:
    """Positions and yaw of polynomials (m, 4, n) in seconds, one after the other."""
    ends = np.cumsum(durations)
    found = []
    for time in times:
        piece = min(int(np.searchsorted(ends, time, side="right")), len(ends) - 1)
        local = time - (ends[piece] - durations[piece])
        found.append([np.polynomial.Polynomial(row).deriv(derivative)(local) for row in coefficients[piece]])
    return np.array(found)


def decoded_poly4d(content: bytes) -> tuple[np.ndarray, np.ndarray]:
    """``struct poly4d { float p[4][8]; float duration; }``, little-endian, without padding."""
    assert len(content) % 132 == 0
    rows = [struct.unpack("<33f", content[at : at + 132]) for at in range(0, len(content), 132)]
    table = np.array(rows)
    return table[:, 32], table[:, :32].reshape(-1, 4, 8)


def decoded_crazyswarm(content: bytes) -> tuple[np.ndarray, np.ndarray]:
    rows = list(csv.DictReader(io.StringIO(content.decode())))
    axes = [[[float(row[f"{axis}^{power}"]) for power in range(8)] for axis in ("x", "y", "z", "yaw")] for row in rows]
    return np.array([float(row["duration"]) for row in rows]), np.array(axes)


def decoded_yaml(content: bytes) -> tuple[np.ndarray, np.ndarray]:
    yaml = pytest.importorskip("yaml")
    segments = yaml.safe_load(content.decode())["segments"]
    assert all(len(s["coefficients"]) == s["D"] == 4 for s in segments)
    assert all(len(row) == s["N"] == 10 for s in segments for row in s["coefficients"])
    return np.array([s["time"] * 1e-9 for s in segments]), np.array([s["coefficients"] for s in segments])


DECODERS = {"poly4d": decoded_poly4d, "crazyswarm": decoded_crazyswarm, "mav-trajectory-generation": decoded_yaml}


@pytest.mark.parametrize("name", DECODERS)
def test_what_is_flown_is_what_was_planned(name: str) -> None:
    """Within a millimetre at degree 7, within what nanoseconds cost at degree 9; the error is said."""
    found = export_trajectory(SPLINE, name)
    durations, coefficients = DECODERS[name](found.content)
    wanted = np.asarray(SPLINE.evaluate(TIMES))
    flown = by_pieces(durations, coefficients, TIMES)
    off = np.linalg.norm(flown[:, :3] - wanted[:, :3], axis=1).max()
    assert off <= max(found.error, 1e-9) * 1.05 + 1e-9
    assert found.error <= (1e-8 if name.startswith("mav") else 1.01e-3)
    turned = tolerance("exact", np.float32) if name == "poly4d" else tolerance("solve")
    np.testing.assert_allclose(flown[:, 3], wanted[:, 3], **turned)
    assert found.pieces == len(durations)


@pytest.mark.parametrize("name", DECODERS)
def test_nothing_jumps_from_piece_to_piece(name: str) -> None:
    """Position to jerk, relative to their size: 1e-3, single precision included."""
    durations, coefficients = DECODERS[name](export_trajectory(SPLINE, name).content)
    for order in range(4):
        ends = [
            [np.polynomial.Polynomial(row).deriv(order)(duration) for row in rows[:3]]
            for duration, rows in zip(durations, coefficients, strict=True)
        ]
        begins = [[np.polynomial.Polynomial(row).deriv(order)(0.0) for row in rows[:3]] for rows in coefficients]
        size = np.abs(np.asarray(SPLINE.evaluate(TIMES, order))[:, :3]).max()
        assert np.abs(np.array(ends[:-1]) - np.array(begins[1:])).max() <= 1e-3 * size


@pytest.mark.parametrize("name", [name for name, form in FORMATS.items() if form.read is not None])
def test_our_own_reader_gives_it_back(name: str, tmp_path: Path) -> None:
    path = tmp_path / "plan"
    found = export_trajectory(SPLINE, name)
    path.write_bytes(found.content)
    again = read_trajectory(path, name)
    off = np.linalg.norm(np.asarray(again.evaluate(TIMES)) - np.asarray(SPLINE.evaluate(TIMES)), axis=1)
    assert off.max() <= found.error + 1e-5
    for damaged in (b"", b"\x00\xff\xfe", found.content[:-7], b'{"segments": [{"time": 1, "coefficients": [[1]]}]}'):
        path.write_bytes(damaged)
        with pytest.raises(FileError, match="plan"):
            read_trajectory(path, name)


def test_crazyswarms_own_lines_end_in_a_comma(tmp_path: Path) -> None:
    content = export_trajectory(SPLINE, "crazyswarm").content.decode()
    path = tmp_path / "figure8.csv"
    path.write_text(content.replace("\n", ",\n"))
    assert float(read_trajectory(path, "crazyswarm").duration) == pytest.approx(float(SPLINE.duration))


def test_a_crazyflies_own_library_packs_the_same() -> None:
    memory = pytest.importorskip("cflib.crazyflie.mem.trajectory_memory")
    content = export_trajectory(SPLINE, "poly4d").content
    durations, coefficients = decoded_poly4d(content)
    packed = b""
    for duration, rows in zip(durations, coefficients, strict=True):
        x, y, z, yaw = (memory.Poly4D.Poly(row.tolist()) for row in rows)
        packed += bytes(memory.Poly4D(float(duration), x, y, z, yaw).pack())
    assert packed == content


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), segments=st.integers(1, 8), exponent=st.floats(-6.0, -1.0))
def test_pieces_of_degree_7_are_as_near_as_they_say(seed: int, segments: int, exponent: float) -> None:
    spline = flight(seed, segments)
    found = as_septic(spline, 10.0**exponent)
    times = np.linspace(0.0, float(spline.duration), 2000)
    off = np.linalg.norm(np.asarray(found.spline.evaluate(times) - spline.evaluate(times))[:, :3], axis=1).max()
    assert off <= found.error * 1.05 + 1e-12
    assert found.error <= 10.0**exponent
    assert len(as_septic(spline, 10.0 ** (exponent - 1.0)).spline.durations) >= len(found.spline.durations)


def test_north_east_down_by_value() -> None:
    """East 1, north 2, up 3, looking east: north 2, east 1, down -3, looking east is yaw 90 degrees there."""
    spline = jaxplan.minimum_snap(np.array([[1.0, 2.0, 3.0], [2.0, 2.0, 3.0]]), [1.0], yaw=[0.0, 0.5 * np.pi])
    turned = north_east_down(spline)
    np.testing.assert_allclose(turned.evaluate(0.0), [2.0, 1.0, -3.0, 0.5 * np.pi], **tolerance("formula"))
    np.testing.assert_allclose(turned.evaluate(1.0), [2.0, 2.0, -3.0, 0.0], **tolerance("formula"))
    back = north_east_down(turned)
    np.testing.assert_allclose(back.evaluate(0.3), spline.evaluate(0.3), **tolerance("formula"))
    rows = table(export_trajectory(spline, "setpoints", ExportConfig(frame="ned", rate=10.0)).content)
    assert (rows["x"][0], rows["y"][0], rows["z"][0]) == (2.0, 1.0, -3.0)
    assert rows["vy"].max() > 1.0 > abs(rows["vx"]).max()
    assert rows["yaw_rate"].min() < -1.0


def table(content: bytes) -> dict[str, np.ndarray]:
    rows = list(csv.DictReader(io.StringIO(content.decode())))
    return {name: np.array([float(row[name]) for row in rows]) for name in SETPOINTS}


def test_setpoints_are_the_trajectory_and_its_derivatives() -> None:
    rows = table(export_trajectory(SPLINE, "setpoints", ExportConfig(rate=50.0)).content)
    assert np.diff(rows["t"])[:-1] == pytest.approx(0.02)
    assert rows["t"][-1] == pytest.approx(float(SPLINE.duration))
    for order, kind in enumerate(("", "v", "a", "j")):
        values = np.stack([rows[f"{kind}{axis}"] for axis in "xyz"], axis=1)
        np.testing.assert_allclose(values, np.asarray(SPLINE.evaluate(rows["t"], order))[:, :3], **tolerance("solve"))


def test_what_does_not_fit_is_refused_in_one_line() -> None:
    long = flight(1, 40)
    for call, said in (
        (lambda: export_trajectory(long, "poly4d"), "want at most 31"),
        (lambda: export_trajectory(SPLINE, "rosbag"), "want one of crazyswarm"),
        (lambda: export_trajectory(SPLINE, "poly4d", ExportConfig(frame="ned")), "want enu for poly4d"),
        (lambda: export_trajectory(SPLINE, "setpoints", ExportConfig(rate=0.0)), "--rate"),
        (lambda: export_trajectory(SPLINE, "setpoints", ExportConfig(rate=1e9)), "give a smaller --rate"),
        (lambda: export_trajectory(SPLINE.dilate(np.inf), "crazyswarm"), "export: durations"),
        (lambda: export_trajectory(SPLINE, "crazyswarm", ExportConfig(tolerance=np.nan)), "--tolerance"),
        (lambda: export_trajectory(SPLINE, "crazyswarm", ExportConfig(tolerance=1e-30)), "give a larger tolerance"),
        (lambda: read_trajectory(Path("x"), "setpoints"), "want one of"),
    ):
        with pytest.raises(InputError, match=said):
            call()


def committed(start: float, spline: PiecewisePolynomial) -> SimpleNamespace:
    return SimpleNamespace(
        start_time=start, spline=spline, goal=np.zeros(3), arrival_time=1.0, alpha=1.0, probability=0.9, status=1
    )


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """Three plans: the second takes over within the first, the third a while after the second has come to rest."""
    first = flight(2)
    state = first.state(0.7)
    onward = np.cumsum(np.concatenate([[np.asarray(state.pos)], np.ones((2, 3))]), axis=0)
    second = jaxplan.minimum_snap(
        onward,
        [0.8, 0.9],
        initial=state.derivatives[1:],
        yaw=[float(state.yaw[0]), 0.0, 0.5],
        initial_yaw=state.yaw[1:],
    )
    third = jaxplan.minimum_snap(np.stack([onward[-1], onward[-1] + 1.0]), [1.0], yaw=[0.5, 0.0])
    write_plans(tmp_path / "plans.npz", [committed(2.0, first), committed(2.7, second), committed(5.0, third)])
    return tmp_path


def test_what_was_commanded_goes_from_plan_to_plan(saved: Path) -> None:
    plans = read_plans(saved)
    start, spline = commanded(plans)
    assert start == 2.0
    assert float(spline.duration) == pytest.approx(4.0)
    for time, plan in ((2.3, 0), (2.71, 1), (4.0, 1), (5.4, 2)):
        wanted = plans[plan].spline.evaluate(time - plans[plan].start_time)
        np.testing.assert_allclose(spline.evaluate(time - start), wanted, **tolerance("formula"))
    rest = spline.evaluate(np.array([4.45, 4.95]) - start, 1)
    np.testing.assert_allclose(rest, 0.0, atol=tolerance("solve")["atol"])


@pytest.mark.parametrize("name", FORMATS)
def test_from_the_command_line(saved: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    out = saved / "flight.out"
    assert cli.run(["export", str(saved), "--format", name, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "4.000 s from 2.000 s on" in said
    assert "off by at most" in said
    if FORMATS[name].read is not None:
        assert float(read_trajectory(out, name).duration) == pytest.approx(4.0, **relative("exact", np.float32))
    assert cli.run(["export", str(saved / "plans.npz"), "--format", name, "--out", str(out), "--plan", "-1"]) == 0
    assert "1.000 s from 5.000 s on" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["absent"], 11, "absent: no such file"),
        (["."], 11, "no such file"),
        (["text.npz"], 11, "is no plans.npz"),
        (["none.npz"], 10, "holds no plan"),
        (["plans.npz", "--plan", "7"], 10, "--plan: have 7"),
        (["plans.npz", "--out", "nowhere/x"], 10, "--out"),
        (["plans.npz", "--frame", "ned"], 10, "--frame"),
    ],
)
def test_bad_arguments_end_in_one_line(
    saved: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    said: str,
) -> None:
    elsewhere = saved / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "plans.npz").write_bytes((saved / "plans.npz").read_bytes())
    (elsewhere / "text.npz").write_text("no archive")
    write_plans(elsewhere / "none.npz", [])
    monkeypatch.chdir(elsewhere if arguments != ["."] else saved.parent)
    out = [] if "--out" in arguments else ["--out", "x"]
    assert cli.run(["export", "--format", "poly4d", *arguments, *out]) == code
    printed = capsys.readouterr()
    assert said in printed.err
    assert printed.err.count("\n") == 1
    assert not Path("x").exists()


def test_json_is_yaml() -> None:
    """Flow style: any JSON reader takes it, too."""
    assert len(json.loads(export_trajectory(SPLINE, "mav-trajectory-generation").content)["segments"]) == 4


def test_degree_9_stays_the_same_path() -> None:
    """Share by share of every segment: nanoseconds move the knots in time, nothing else."""
    durations, coefficients = decoded_yaml(export_trajectory(SPLINE, "mav-trajectory-generation").content)
    np.testing.assert_allclose(durations, SPLINE.durations, rtol=0.0, atol=1e-9)  # whole nanoseconds
    shares = np.linspace(0.0, 1.0, 50)
    for number, duration in enumerate(durations):
        theirs = [np.polynomial.Polynomial(row)(shares * duration) for row in coefficients[number, :3]]
        ours = np.asarray(SPLINE.position)[number].T @ shares ** np.arange(10)[:, None]
        assert np.abs(np.array(theirs) - ours).max() <= 1e-9
