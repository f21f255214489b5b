"""The page: what is embedded in it is the episode, and nothing of it comes from elsewhere."""

import base64
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxplan.io.cycles import SavedCycle
from jaxplan.viz.html import encoded, replay_page
from jaxplan.viz.replay import Replay, groups_of, read_replay
from made_up import made_up_run


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Replay, list[SavedCycle], str, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("html") / "run"
    cycles = made_up_run(folder)
    replay = read_replay(folder)
    page = replay_page(replay)
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, flags=re.DOTALL)
    assert found is not None
    return replay, cycles, page, json.loads(found[1])


def decoded(data: dict[str, Any], name: str) -> np.ndarray:
    array = data["arrays"][name]
    flat = np.frombuffer(base64.b64decode(array["base64"]), dtype=np.dtype(array["dtype"]).newbyteorder("<"))
    return flat.reshape(array["shape"])


def test_the_flight_is_embedded(made: tuple[Replay, list[SavedCycle], str, dict[str, Any]]) -> None:
    replay, _, _, data = made
    for name, wanted in (("times", replay.times), ("position", replay.position), ("target", replay.target)):
        np.testing.assert_array_equal(decoded(data, name), wanted.astype(np.float32))
    assert data["title"] == "Target intercepted"
    assert data["bounds"] == np.asarray(replay.world.bounds).tolist()


def test_every_cycle_finds_its_candidates(made: tuple[Replay, list[SavedCycle], str, dict[str, Any]]) -> None:
    replay, _, _, data = made
    goals, groups, curves = (decoded(data, name) for name in ("goals", "goal_groups", "curves"))
    assert len(data["cycles"]) == 3
    for shown, cycle in zip(data["cycles"], replay.cycles, strict=True):
        first, count = shown["goals"]
        np.testing.assert_array_equal(goals[first : first + count], cycle.goals.astype(np.float32))
        np.testing.assert_array_equal(groups[first : first + count], groups_of(cycle.reasons))
        assert shown["groups"] == np.bincount(groups_of(cycle.reasons), minlength=len(data["groups"])).tolist()
        first, count = shown["curves"]
        np.testing.assert_array_equal(curves[first : first + count], cycle.curves.astype(np.float32))
        assert shown["rejected"] == cycle.rejected
        assert shown["stages"] == pytest.approx(cycle.stage_ms)


def test_ellipsoids_are_the_covariances(made: tuple[Replay, list[SavedCycle], str, dict[str, Any]]) -> None:
    """Columns A of the half axes at two deviations: A A^T = 4 covariance."""
    replay, _, _, data = made
    rows = decoded(data, "ellipsoids")
    for shown, cycle in zip(data["cycles"], replay.cycles, strict=True):
        assert cycle.prediction is not None
        first, count = shown["ellipsoids"]
        assert count == cycle.prediction.means[..., 0].size
        axes = rows[first : first + count, :9].reshape(-1, 3, 3)
        covariances = np.einsum("eka,ekb->eab", axes, axes) / 4.0
        wanted = cycle.prediction.covariances.reshape(-1, 3, 3)
        np.testing.assert_allclose(covariances, wanted, atol=1e-6)  # m^2, single precision
        means = cycle.prediction.means.reshape(-1, 3)
        np.testing.assert_allclose(rows[first : first + count, 9:], means, atol=1e-6)  # m, single precision


def test_plans_are_sampled_evenly(made: tuple[Replay, list[SavedCycle], str, dict[str, Any]]) -> None:
    replay, _, _, data = made
    points = decoded(data, "plan_points").reshape(2, 100, 3)
    for shown, plan, row in zip(data["plans"], replay.plans, points, strict=True):
        times = np.linspace(0.0, shown["end"] - shown["start"], 100)
        np.testing.assert_allclose(row, np.asarray(plan.spline.evaluate(times))[:, :3], atol=1e-6)  # m, single
        assert shown["meets"]
        assert shown["probability"] == 0.9


def test_the_page_needs_nothing_else_and_runs_nothing_foreign(
    made: tuple[Replay, list[SavedCycle], str, dict[str, Any]],
) -> None:
    _, _, page, data = made
    assert not re.search(r"""(src|href)\s*=|https?://|@import|import\s*\(|fetch\(|XMLHttpRequest|eval\(""", page)
    assert len(page) < 3_000_000
    assert "<b>fleeing" not in page  # a target's name is no markup
    assert "a <b>fleeing</b> target" in data["subtitle"]


def test_a_world_alone_has_a_page(made: tuple[Replay, list[SavedCycle], str, dict[str, Any]], tmp_path: Path) -> None:
    made_up_run(tmp_path / "run")
    page = replay_page(read_replay(tmp_path / "run" / "plans.npz"))
    assert '"cycles":[]' in page


def test_arrays_are_little_endian() -> None:
    array = encoded(np.array([1.0], dtype=">f8"))
    assert array["dtype"] == "float32"
    assert base64.b64decode(array["base64"]) == b"\x00\x00\x80\x3f"
