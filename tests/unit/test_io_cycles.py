"""cycles.npz: what is read is what was written, within the digits that are kept, and damaged files are refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxplan.errors import FileError
from jaxplan.io.cycles import (
    CURVE_POINTS,
    MOST_COMPONENTS,
    MOST_CURVES,
    MOST_STEPS,
    SavedCycle,
    read_cycles,
    saved_cycles,
    write_cycles,
)
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.predictors import build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.records import replace
from jaxplan.status import Note
from made_up import committed, cycle, planned

DIGITS = 6e-5
"""m; four digits are kept."""


@pytest.fixture
def cycles() -> list[SavedCycle]:
    """Three cycles that differ: with a plan, without candidates, and with fewer of them and another station."""
    rng = np.random.default_rng(0)
    first = planned(rng)
    chosen = int(np.flatnonzero(first.reasons == 0)[0])
    flown = [
        cycle(0.5, first, chosen, sooner=0.03),
        cycle(0.6, None, note=Note.PREDICTOR_FALLBACK, rejected={"outranked": 7}, generated=9),
        cycle(0.7, planned(rng, 6), stage_ms={"predict": 1.0, "refine": 30.0}),
    ]
    seen = [
        Observations(times=np.arange(5) * 0.1 + index * 0.1, positions=rng.normal(size=(5, 3)), age=0.05)
        for index in range(3)
    ]
    predictor = build_predictor("noisy", PredictionConfig(), truth=lambda t: np.stack([t, 2.0 * t, 0.0 * t], axis=-1))
    return saved_cycles(flown, seen, [committed(0.6)], predictor)


def test_what_is_read_is_what_was_written(tmp_path: Path, cycles: list[SavedCycle]) -> None:
    write_cycles(tmp_path / "cycles.npz", cycles)
    read = read_cycles(tmp_path / "cycles.npz", plans=1)
    assert len(read) == 3
    for have, want in zip(read, cycles, strict=True):
        for name in ("time", "status", "plan", "latency", "deviation", "sooner", "note", "generated", "chosen"):
            assert getattr(have, name) == getattr(want, name), name
        assert have.rejected == want.rejected
        assert have.stage_ms == pytest.approx(want.stage_ms)
        np.testing.assert_array_equal(have.reasons, want.reasons)
        np.testing.assert_array_equal(have.curve_of, want.curve_of)
        np.testing.assert_allclose(have.goals, want.goals, atol=DIGITS)
        np.testing.assert_allclose(have.curves, want.curves, atol=DIGITS)
        assert have.prediction is not None
        assert want.prediction is not None
        for mine, theirs in zip(have.prediction, want.prediction, strict=True):
            np.testing.assert_allclose(mine, theirs, atol=DIGITS)


def test_the_chosen_trajectory_is_kept_with_its_points(cycles: list[SavedCycle]) -> None:
    plans = planned(np.random.default_rng(0))
    first = cycles[0]
    assert first.plan == 0
    assert first.chosen in first.curve_of
    assert first.curves.shape[0] <= MOST_CURVES + 1
    spline = plans.spline(first.chosen)
    times = np.linspace(0.0, float(np.sum(spline.durations)), CURVE_POINTS)
    points = np.asarray(spline.evaluate(times))[:, :3]
    np.testing.assert_allclose(first.curves[first.curve_of.tolist().index(first.chosen)], points, atol=DIGITS)


def test_the_prediction_is_that_of_the_flight(cycles: list[SavedCycle]) -> None:
    """The noisy predictor: the truth, with variances that grow with the step (paper, Sec. IV)."""
    found = cycles[0].prediction
    assert found is not None
    assert len(found.instants) == MOST_STEPS <= 20
    assert len(found.weights) == 1 <= MOST_COMPONENTS
    np.testing.assert_allclose(found.instants[[0, -1]], [0.45 + 0.1, 0.45 + 2.0])
    truth = found.instants - 0.45 + 0.4  # from the newest observation, at 0.4 s
    np.testing.assert_allclose(found.means[:, 0], np.stack([truth, 2.0 * truth, 0.0 * truth], axis=-1), atol=1e-9)  # m
    np.testing.assert_allclose(found.covariances[-1, 0], 20 * 0.05**2 * np.eye(3), atol=1e-9)  # m^2


def test_cycles_of_another_process_have_no_candidates(cycles: list[SavedCycle]) -> None:
    assert cycles[1].goals.shape == (0, 3)
    assert cycles[1].rejected == {"outranked": 7}
    assert cycles[1].plan == -1


def test_a_trajectory_that_came_out_wrong_is_left_out() -> None:
    plans = planned(np.random.default_rng(0), 9)
    position = np.array(plans.splines.position)
    position[..., 1], position[..., 2] = np.nan, 1e30
    wrong = SplineBatch(durations=plans.splines.durations, position=position, yaw=plans.splines.yaw)
    found = saved_cycles([cycle(0.5, replace(plans, splines=wrong))], [], [], None)
    assert set(found[0].curve_of.tolist()).isdisjoint({1, 2})


def test_an_episode_without_cycles_is_one(tmp_path: Path) -> None:
    write_cycles(tmp_path / "cycles.npz", [])
    assert read_cycles(tmp_path / "cycles.npz", plans=0) == []


def changed(path: Path, **arrays: Any) -> None:
    with np.load(path) as data:
        np.savez_compressed(path, **{**data, **arrays})


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"version": np.int32(2)}, "has form 2, want 1"),
        ({"sizes": np.full((3, 4), 10**6, dtype=np.int32)}, "want (1000000"),
        ({"sizes": np.full((3, 4), -1, dtype=np.int32)}, "is no cycles.npz"),
        ({"curve_of": np.full((3, MOST_CURVES + 1), 5000, dtype=np.int32)}, "that are not there"),
        ({"numbers": np.full((3, 4), np.nan)}, "that are not there"),
        ({"decisions": np.full((3, 6), 77, dtype=np.int32)}, "77"),
    ],
)
def test_a_file_that_does_not_fit_together_is_refused(
    tmp_path: Path, cycles: list[SavedCycle], change: dict[str, Any], says: str
) -> None:
    path = tmp_path / "cycles.npz"
    write_cycles(path, cycles)
    changed(path, **change)
    with pytest.raises(FileError, match=r"cycles\.npz") as refusal:
        read_cycles(path, plans=1)
    assert says in str(refusal.value)
    assert "fly again" in str(refusal.value)


def test_a_truncated_file_is_refused(tmp_path: Path, cycles: list[SavedCycle]) -> None:
    path = tmp_path / "cycles.npz"
    write_cycles(path, cycles)
    path.write_bytes(path.read_bytes()[:-400])
    with pytest.raises(FileError, match="is no cycles"):
        read_cycles(path, plans=1)


def test_more_than_there_are_plans_is_refused(tmp_path: Path, cycles: list[SavedCycle]) -> None:
    write_cycles(tmp_path / "cycles.npz", cycles)
    with pytest.raises(FileError, match="plans that are not there"):
        read_cycles(tmp_path / "cycles.npz", plans=0)
