"""The replay of a run: what there is to see at an instant, from every kind of source, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from jaxplan.errors import FileError, InputError
from jaxplan.io.cycles import SavedCycle
from jaxplan.status import PlanStatus, Reason
from jaxplan.viz.replay import Replay, at, curves_at, groups_of, read_replay
from jaxplan.viz.words import GROUPS, REASONS, STATUSES
from made_up import FLEES, FLOWN, made_up_run
from tolerances import tolerance

ROUNDED = 1e-8
"""m; a TUM file has nine digits."""


@pytest.fixture
def run(tmp_path: Path) -> tuple[Path, list[SavedCycle]]:
    return tmp_path / "run", made_up_run(tmp_path / "run")


@pytest.fixture
def replay(run: tuple[Path, list[SavedCycle]]) -> Replay:
    return read_replay(run[0])


def start_at(time: float) -> np.ndarray:
    return np.array([-4.0, -4.0, 1.0]) + time * FLOWN


def test_a_run_is_read_whole(replay: Replay) -> None:
    assert (replay.title, replay.outcome, replay.padding) == ("Target intercepted", "intercepted", 0.4)
    assert replay.subtitle == "world env1, target a <b>fleeing</b> target, predictor noisy, vehicle mfrl"
    assert replay.world.name == "env1"
    assert len(replay.plans) == 2
    assert len(replay.cycles) == 3
    assert len(replay.times) == 101  # 50 a second, and the end
    assert replay.times[-1] == 2.0
    np.testing.assert_allclose(replay.position[-1], start_at(2.0), atol=ROUNDED)


@pytest.mark.parametrize(
    ("time", "cycle", "plan"), [(0.3, -1, -1), (0.5, 0, 0), (0.55, 0, 0), (0.6, 1, 1), (0.99, 1, 1), (1.5, 2, 1)]
)
def test_at_an_instant_the_newest_cycle_and_plan_are_seen(replay: Replay, time: float, cycle: int, plan: int) -> None:
    now = at(replay, time)
    assert (now.cycle, now.plan) == (cycle, plan)
    np.testing.assert_allclose(now.position, start_at(time), atol=1e-6)  # m, between rows of nine digits
    np.testing.assert_allclose(now.target, np.array([-4.0, 3.0, 1.0]) + time * FLEES, atol=1e-6)  # m, as above


def test_instants_outside_the_flight_are_its_ends(replay: Replay) -> None:
    assert at(replay, -5.0).time == replay.times[0]
    assert at(replay, 99.0).time == 2.0


def test_a_plan_is_cut_where_it_is_flown_and_where_the_next_one_takes_over(replay: Replay) -> None:
    curves = curves_at(replay, at(replay, 0.55))  # committed at 0.5 s, takes over at 0.6 s, until 0.7 s
    assert len(curves.plan_flown) == 0
    np.testing.assert_allclose(curves.ahead[[0, -1]], [start_at(0.6), start_at(0.7)], **tolerance("formula"))
    np.testing.assert_allclose(curves.rest[[0, -1]], [start_at(0.7), start_at(3.6)], **tolerance("formula"))
    curves = curves_at(replay, at(replay, 1.5))  # the second plan, from 0.7 s to 3.7 s
    np.testing.assert_allclose(curves.plan_flown[[0, -1]], [start_at(0.7), start_at(1.5)], **tolerance("formula"))
    np.testing.assert_allclose(curves.ahead[[0, -1]], [start_at(1.5), start_at(3.7)], **tolerance("formula"))
    assert len(curves.rest) == 0
    np.testing.assert_allclose(curves.meeting, [start_at(0.7 + 1.5)], **tolerance("formula"))
    np.testing.assert_allclose(curves.stop, [start_at(3.7)], **tolerance("formula"))


def test_before_any_plan_there_is_only_the_flight(replay: Replay) -> None:
    curves = curves_at(replay, at(replay, 0.2))
    assert [len(curve) > 0 for curve in curves] == [True, True, False, False, False, False, False]


def test_groups_cover_every_reason_and_the_first_one_counts() -> None:
    for reason in Reason:
        assert sum(bool(group.reasons & reason) for group in GROUPS) == 1
        assert GROUPS[groups_of(np.array([reason], dtype=np.uint32))[0]].reasons & reason
    several = np.array([0, Reason.OUTRANKED | Reason.LIMITS, Reason.CLEARANCE | Reason.OUT_OF_REACH], dtype=np.uint32)
    assert [GROUPS[index].name for index in groups_of(several)] == ["usable", "cannot be flown", "too late"]


def test_everything_has_a_name() -> None:
    assert set(REASONS) == set(Reason)
    assert set(STATUSES) == set(PlanStatus)


def test_a_run_without_cycles_or_target_opens_with_what_it_has(run: tuple[Path, list[SavedCycle]]) -> None:
    for name in ("cycles.npz", "target.csv", "metrics.json"):
        (run[0] / name).unlink()
    replay = read_replay(run[0])
    assert replay.cycles == ()
    assert np.isnan(replay.target).all()
    now = at(replay, 1.0)
    assert (now.cycle, now.plan) == (-1, 1)
    assert len(curves_at(replay, now).target) == 0


def test_plans_alone_are_flown_as_commanded(run: tuple[Path, list[SavedCycle]]) -> None:
    replay = read_replay(run[0] / "plans.npz")
    assert replay.times[0] == pytest.approx(0.6)
    assert replay.times[-1] == pytest.approx(3.7)
    np.testing.assert_allclose(at(replay, 1.0).position, start_at(1.0), atol=1e-6)  # m, between samples
    lower, upper = np.asarray(replay.world.bounds)
    assert (lower < replay.position.min(axis=0)).all()
    assert (upper > replay.position.max(axis=0)).all()


def damaged(folder: Path, name: str, text: str) -> None:
    (folder / name).write_text(text)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("config.json", "{", "cannot be read as JSON"),
        ("config.json", "[1]", "cannot be read as JSON"),
        ("metrics.json", "nothing", "cannot be read as JSON"),
        ("flown.csv", "1 2 3\n", "8 finite numbers"),
        ("flown.csv", "0 1 2 3 0 0 0 1\n0 1 2 3 0 0 0 1\n", "ascending"),
        ("flown.csv", "0 1 2 x 0 0 0 1\n", "cannot be read as a TUM trajectory"),
        ("target.csv", "0 nan 2 3 0 0 0 1\n", "8 finite numbers"),
        ("plans.npz", "PK", "is no plans.npz"),
        ("cycles.npz", "PK", "is no cycles.npz"),
        ("config.json", json.dumps({"world": "absent.stl"}), "absent.stl"),
    ],
)
def test_a_damaged_run_is_refused(run: tuple[Path, list[SavedCycle]], name: str, text: str, says: str) -> None:
    damaged(run[0], name, text)
    with pytest.raises(FileError) as refusal:
        read_replay(run[0])
    assert name in str(refusal.value) or name == "config.json"
    assert says in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"plans\.npz"):
        read_replay(tmp_path)


def test_a_run_without_flight_and_plans_is_refused(tmp_path: Path) -> None:
    from jaxplan.io.plans import write_plans

    write_plans(tmp_path / "plans.npz", [])
    with pytest.raises(InputError, match="holds no plan"):
        read_replay(tmp_path)
