"""The picture of success over speed: every line stands apart from the others, with its own intervals."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from experiments.figures.success import Line, draw_success_by_speed
from experiments.table1_report import _lines, by_cell
from jaxplan.runner.statistics import wilson


def test_equal_shares_stand_apart_with_their_intervals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **options: saved.append(figure))
    speeds, shares = np.array([1.0, 2.0, 3.0]), np.array([1.0, 0.9, 0.5])
    intervals = np.stack([shares - 0.1, np.minimum(shares + 0.05, 1.0)], axis=1)
    lines = [Line("mfrl", name, speeds, shares, intervals) for name in ("none", "gmm", "noisy")]
    draw_success_by_speed(lines, tmp_path / "speeds.png")
    drawn = saved[0].axes[0].containers
    places = np.array([container.lines[0].get_xdata() for container in drawn])
    assert len(drawn) == 3
    assert np.ptp(places, axis=0) == pytest.approx(0.4)  # three lines on 0.6 of the way between two speeds
    np.testing.assert_allclose(places.mean(axis=0), speeds)
    for container in drawn:
        bars = np.array(container.lines[2][0].get_segments())
        np.testing.assert_allclose(bars[..., 1], intervals)


def test_the_intervals_are_wilsons() -> None:
    rows = [
        {"planner": "mfrl", "predictor": "gmm", "speed": speed, "outcome": "intercepted" if index < met else "no_plan"}
        for speed, met in ((1.0, 10), (2.0, 7))
        for index in range(10)
    ]
    (line,) = _lines(by_cell(rows))
    np.testing.assert_allclose(line.speeds, [1.0, 2.0])
    np.testing.assert_allclose(line.shares, [1.0, 0.7])
    np.testing.assert_allclose(line.intervals, [wilson(10, 10), wilson(7, 10)])
