"""Poses of a plan as other programs read them: attitudes against their definition, frames by value."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_io_export import SPLINE, committed, flight

from jaxplan import cli
from jaxplan.errors import InputError
from jaxplan.io.export import ExportConfig, export_trajectory
from jaxplan.io.plans import read_plans, write_plans
from jaxplan.io.sampled import north_east_down_quat
from jaxplan.io.target_log import read_target_log
from jaxplan.spline import PiecewisePolynomial
from tolerances import relative, tolerance

NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD_FROM_FLU = np.diag([1.0, -1.0, -1.0])
DIGITS = {"rtol": 0.0, "atol": 2e-9}  # nine decimals are written


def poses(content: bytes) -> tuple[np.ndarray, np.ndarray, Rotation]:
    """Times, positions and attitudes of a TUM file."""
    table = np.array([[float(word) for word in line.split(" ")] for line in content.decode().splitlines()[1:]])
    return table[:, 0], table[:, 1:4], Rotation.from_quat(table[:, 4:])


def test_a_plan_as_poses() -> None:
    found = export_trajectory(SPLINE, "tum", ExportConfig(rate=50.0, start=2.5))
    times, positions, attitudes = poses(found.content)
    assert found.pieces == len(times)
    assert times[0] == 2.5
    assert times[-1] == pytest.approx(2.5 + float(SPLINE.duration), abs=1e-9)  # digits written
    np.testing.assert_allclose(positions, np.asarray(SPLINE.evaluate(times - 2.5))[:, :3], rtol=0.0, atol=1e-7)  # 1 ns
    force = np.asarray(SPLINE.evaluate(times - 2.5, 2))[:, :3] + [0.0, 0.0, 9.81]
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    axes = attitudes.as_matrix()
    np.testing.assert_allclose(axes[:, :, 2], up, rtol=0.0, atol=1e-6)  # digits written, thrust of some m/s^2
    ahead, yaw = axes[:, :2, 0], np.asarray(SPLINE.evaluate(times - 2.5))[:, 3]
    across = ahead[:, 0] * np.sin(yaw) - ahead[:, 1] * np.cos(yaw)
    assert np.abs(across).max() < 1e-6  # as above
    assert (np.sign(ahead[:, 0] * np.cos(yaw) + ahead[:, 1] * np.sin(yaw)) == np.sign(axes[:, 2, 2])).all()


def test_north_east_down_poses_by_value() -> None:
    """Hovering 3 m up, 1 m east and 2 m north, looking east: yaw 90 degrees from north, and level."""
    still = PiecewisePolynomial(durations=np.ones(1), position=np.array([[[1.0, 2.0, 3.0]]]), yaw=np.zeros((1, 1)))
    _, position, attitude = poses(export_trajectory(still, "tum", ExportConfig(frame="ned", rate=1.0)).content)
    np.testing.assert_allclose(position[0], [2.0, 1.0, -3.0], **DIGITS)
    np.testing.assert_allclose(attitude[0].as_euler("ZYX"), [0.5 * np.pi, 0.0, 0.0], **DIGITS)
    _, position, attitude = poses(export_trajectory(still, "tum", ExportConfig(rate=1.0)).content)
    np.testing.assert_allclose(position[0], [1.0, 2.0, 3.0], **DIGITS)
    np.testing.assert_allclose(attitude[0].as_euler("ZYX"), np.zeros(3), **DIGITS)


def test_north_east_down_attitudes_turn_both_frames() -> None:
    _, _, ours = poses(export_trajectory(SPLINE, "tum").content)
    _, _, theirs = poses(export_trajectory(SPLINE, "tum", ExportConfig(frame="ned")).content)
    turned = NED_FROM_ENU @ ours.as_matrix() @ FRD_FROM_FLU
    np.testing.assert_allclose(theirs.as_matrix(), turned, rtol=0.0, atol=1e-8)  # digits written
    back = north_east_down_quat(north_east_down_quat(ours.as_quat(scalar_first=True)))
    np.testing.assert_allclose(Rotation.from_quat(back, scalar_first=True).as_matrix(), ours.as_matrix(), **DIGITS)


def test_too_many_poses_are_refused() -> None:
    with pytest.raises(InputError, match="tum: have .* give a smaller --rate"):
        export_trajectory(SPLINE, "tum", ExportConfig(rate=1e9))


def test_poses_lie_over_what_was_flown(tmp_path: Path) -> None:
    """On the episode's clock; any reader of TUM takes them, the target's log among them."""
    write_plans(tmp_path / "plans.npz", [committed(2.0, flight(2))])
    out = tmp_path / "commanded.tum"
    assert cli.run(["export", str(tmp_path), "--format", "tum", "--out", str(out)]) == 0
    log = read_target_log(out)
    assert log.times[0] == 2.0
    assert log.report.rate_hz == pytest.approx(100.0, **relative("solve"))


def test_saved_plans_keep_their_yaw(tmp_path: Path) -> None:
    """Value by value, also where a shorter plan is padded to the longest."""
    splines = [flight(3, segments=2), flight(4, segments=6), flight(5, segments=1)]
    write_plans(tmp_path / "plans.npz", [committed(1.0 * i, spline) for i, spline in enumerate(splines)])
    for saved, spline in zip(read_plans(tmp_path), splines, strict=True):
        assert saved.spline.yaw.shape == np.asarray(spline.yaw).shape
        times = np.linspace(0.0, float(spline.duration), 200)
        for derivative in range(4):
            found, wanted = (each.evaluate(times, derivative) for each in (saved.spline, spline))
            np.testing.assert_allclose(found, wanted, **tolerance("exact"))
        assert np.ptp(np.asarray(spline.evaluate(times))[:, 3]) > 0.1
