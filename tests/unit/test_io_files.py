"""JSON, TUM and plans as other programs read them."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxplan.errors import InternalError
from jaxplan.io.files import write_json, write_tum
from jaxplan.io.plans import write_plans
from jaxplan.io.target_log import read_target_log
from jaxplan.spline import PiecewisePolynomial
from jaxplan.status import PlanStatus
from tolerances import tolerance


def test_json_is_strict_and_plain(tmp_path: Path) -> None:
    value = {
        "time": np.float64(1.5),
        "none": None,
        "nan": float("nan"),
        "inf": np.float32("inf"),
        "list": np.arange(3),
        "deep": {"flag": np.bool_(True), 3: (1, 2), "path": Path("a/b")},
        "unicode": "Zürich",
    }
    write_json(tmp_path / "x.json", value)
    read = json.loads((tmp_path / "x.json").read_text(encoding="utf-8"), parse_constant=lambda name: pytest.fail(name))
    assert read == {
        "time": 1.5,
        "none": None,
        "nan": None,
        "inf": None,
        "list": [0, 1, 2],
        "deep": {"flag": True, "3": [1, 2], "path": "a/b"},
        "unicode": "Zürich",
    }


def test_tum_has_the_quaternion_as_xyzw(tmp_path: Path) -> None:
    rotation = Rotation.from_euler("ZYX", [[0.3, -0.2, 0.1], [2.0, 0.4, -0.5]])
    times, positions = np.array([1.0, 1.1]), np.array([[1.0, -2.0, 3.123456789], [4.0, 5.0, 6.0]])
    write_tum(tmp_path / "flown.csv", times, positions, rotation.as_quat(scalar_first=True))
    first, *rest = (tmp_path / "flown.csv").read_text().splitlines()
    assert first == "# timestamp tx ty tz qx qy qz qw"
    assert len(rest) == 2
    table = np.loadtxt(tmp_path / "flown.csv")
    np.testing.assert_allclose(table[:, :4], np.column_stack([times, positions]), **tolerance("formula"))
    np.testing.assert_allclose(table[:, 4:], rotation.as_quat(scalar_first=False), atol=1e-9)  # digits written
    np.testing.assert_allclose(read_target_log(tmp_path / "flown.csv").positions, positions, **tolerance("formula"))


def test_tum_refuses_nan(tmp_path: Path) -> None:
    with pytest.raises(InternalError, match=r"flown\.csv"):
        write_tum(tmp_path / "flown.csv", np.zeros(1), np.full((1, 3), np.nan), np.array([[1.0, 0.0, 0.0, 0.0]]))
    assert not (tmp_path / "flown.csv").exists()


@dataclass
class Plan:
    """What write_plans needs of a committed plan."""

    start_time: float
    spline: PiecewisePolynomial
    goal: np.ndarray
    arrival_time: float
    alpha: float
    status: PlanStatus
    probability: float = 0.9


def random_plan(seed: int, segments: int) -> Plan:
    random = np.random.default_rng(seed)
    spline = PiecewisePolynomial(
        durations=random.uniform(0.5, 1.5, segments),
        position=random.normal(size=(segments, 10, 3)),
        yaw=random.normal(size=(segments, 6)),
    )
    return Plan(0.1 * seed, spline, random.normal(size=3), 2.0, 1.2, PlanStatus.INTERCEPT)


@pytest.mark.usefixtures("x64")
def test_plans_come_back_as_the_same_splines(tmp_path: Path) -> None:
    plans = [random_plan(seed, segments) for seed, segments in enumerate((1, 4, 2))]
    write_plans(tmp_path / "plans.npz", plans)
    with np.load(tmp_path / "plans.npz", allow_pickle=False) as read:
        arrays = dict(read)
    assert arrays["durations"].shape == (3, 4)
    assert arrays["status"].tolist() == [1, 1, 1]
    for i, plan in enumerate(plans):
        fields = {name: arrays[name][i] for name in ("durations", "position", "yaw")}
        again = PiecewisePolynomial(**fields)
        t = np.linspace(-0.1, float(plan.spline.duration) + 0.1, 17)
        np.testing.assert_array_equal(again.evaluate(t, 2), plan.spline.evaluate(t, 2))


def test_no_plans_is_a_valid_file(tmp_path: Path) -> None:
    write_plans(tmp_path / "plans.npz", [])
    with np.load(tmp_path / "plans.npz", allow_pickle=False) as read:
        assert read["durations"].shape == (0, 0)
        assert read["goal"].shape == (0, 3)
