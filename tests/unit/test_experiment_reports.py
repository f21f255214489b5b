"""The reports of the stored experiments on made-up rows: what stands in them, and what remains where items failed."""

import dataclasses
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from experiments import (
    closed_loop,
    faults,
    placing,
    plan_audit,
    policy_comparison,
    prediction_comparison,
    scale_factor,
    table1,
    table2,
    trajectories,
    vehicles,
)
from experiments.prediction_windows import as_seen
from experiments.reference_times_report import stored_references
from experiments.table1_report import PAPER, by_cell, report
from jaxplan import cli
from jaxplan import config as intercept
from jaxplan.errors import FileError, IncompleteError, InputError, ResourceError
from jaxplan.minsnap.single import minimum_snap
from jaxplan.prediction.observations import Observations
from jaxplan.runner.definition import Results
from jaxplan.runner.registry import experiment_names, load_experiment
from jaxplan.spline import PiecewisePolynomial
from tolerances import relative, tolerance


def test_what_the_tables_compare_is_what_an_interception_can_choose() -> None:
    """noisy-S stands for ``noisy`` with its own deviation; beyond the command's planners there are the baselines."""
    assert {re.sub(r"-[\d.]+$", "", name) for name in closed_loop.PREDICTORS} <= set(intercept.PREDICTORS)
    assert (*intercept.PLANNERS, "profile", "optimiser", "pursuit", "navigation") == closed_loop.PLANNERS
    assert set(closed_loop.PLANNERS) - set(closed_loop.compared_planners()) == {"profile"}
    assert closed_loop.LEARNED == ("pretrained", "mfrl")


def test_predictors_are_compared_on_every_flight_with_every_noise() -> None:
    config = prediction_comparison.Config(windows=20, noises=(0.0, 0.2), fast=(6.0,))
    titles = [item.name for item in prediction_comparison.items(config)]
    assert titles[:2] == ["env1", "env1, 0.2 m"]
    assert len(titles) == len(set(titles)) == 10
    assert "env2 at 6 m/s, 0.2 m" in titles
    more = prediction_comparison.items(dataclasses.replace(config, rooms=2))
    assert {item.name for item in more} - set(titles) == {
        f"new room {n}{noise}" for n in (0, 1) for noise in ("", ", 0.2 m")
    }
    for wrong in (
        {"rooms": -1},
        {"noises": (-0.1,)},
        {"noises": ()},
        {"dropouts": 1.0},
        {"fast": (0.0,)},
        {"noises": (np.nan,)},
    ):
        with pytest.raises(InputError, match="--"):
            prediction_comparison.Config(**wrong)


def test_what_flew_says_which_weights_it_used() -> None:
    one = table1.Config(planners=("mfrl",), predictors=("none",))
    without = {path.name for path in table1.artefacts(one)}
    assert without == {"mfrl.npz"}
    for predictor, names in (("fused", {"env1.npy", "env2.npy", "env3.npy"}), ("ensemble", {"rooms.npz"})):
        more = {path.name for path in table1.artefacts(dataclasses.replace(one, predictors=(predictor,)))}
        assert more - without == names


def test_a_new_room_is_a_column_of_its_own() -> None:
    """Nobody trained there, and nothing in it is hit; the network foretells its flights better than the filter."""
    config = prediction_comparison.Config(windows=20, rooms=2)
    item = next(item for item in prediction_comparison.items(config) if item.name == "new room 1")
    rows = {row["predictor"]: row for row in prediction_comparison.evaluate(config, item)["rows"]}
    assert tuple(rows) == intercept.PREDICTORS
    assert rows["mdn"]["windows"] == 20
    assert rows["mdn"]["ade_m"] < 0.9 * rows["imm"]["ade_m"]


def test_what_is_not_seen_is_interpolated_and_the_newest_is_always_there() -> None:
    times = 0.1 * np.arange(10)
    line = Observations(times=times, positions=times[:, None] * np.array([3.0, -1.0, 0.5]))
    rng, counts = np.random.default_rng(0), []
    for seen in as_seen([line] * 50, 0.0, 0.5, rng):
        counts.append(len(seen.times))
        np.testing.assert_allclose(seen.times, times[-counts[-1] :])
        np.testing.assert_allclose(seen.positions, line.positions[-counts[-1] :], **tolerance("formula"))
    assert 1 <= min(counts) < 10 == max(counts)
    noisy = np.array([one.positions for one in as_seen([line] * 500, 0.2, 0.0, rng)]) - line.positions
    assert noisy.std() == pytest.approx(0.2, rel=0.02)


def test_a_vehicle_of_ones_own_flies_the_experiments(tmp_path: Path) -> None:
    """What was learned for another one is refused before anything is flown; there are no references for it."""
    mine = tmp_path / "mine.toml"
    mine.write_text("mass = 0.8\narm = 0.12\nthrust_to_weight = 4.0\n")
    for kind, names in ((table1.Config, {"planners": ("profile",)}), (faults.Config, {"planner": "profile"})):
        config = kind(episodes=3, vehicle=str(mine), padding=0.4, **names)
        for item in (table1 if kind is table1.Config else faults).items(config):
            assert (item.values["vehicle"], item.values["padding"]) == (str(mine), 0.4)
    trajectories.Config(vehicle=str(mine), padding=0.4)
    with pytest.raises(InputError, match="'mfrl', which learned to fly 'mfrl' and not 'mine'"):
        table1.Config(vehicle=str(mine), planners=("no-policy", "mfrl"))
    with pytest.raises(InputError, match="at least the radius"):
        table1.Config(padding=0.1)
    with pytest.raises(FileError, match="absent"):
        faults.Config(vehicle=str(tmp_path / "absent.toml"))
    config = table1.Config(episodes=1, planners=("profile",), predictors=("ground-truth",), vehicle=str(mine))
    (item,) = table1.items(config)
    row = {**item.values, "outcome": "intercepted", "time_to_intercept_s": 2.0}
    found = report(Results(config, [item], [row], [2.0], [False], {}, {}))
    assert "| 2.00 | - | - |" in found.markdown


def test_vehicles_are_spread_over_the_range_and_told_apart(tmp_path: Path) -> None:
    config = vehicles.Config(count=8)
    items = vehicles.items(config)
    spread = [item.values for item in items if item.values["vehicle"] is None]
    assert len(spread) == len(items) - 5 == 8
    for name, (low, high) in (
        ("mass", (0.03, 5.0)),
        ("thrust_to_weight", (1.6, 8.0)),
        ("motor_time_constant", (0.015, 0.05)),
    ):
        eighths = 8.0 * np.log([values[name] / low for values in spread]) / np.log(high / low)
        assert sorted(np.floor(eighths)) == list(range(8)), name
    rows = [
        {
            "name": item.name,
            "preset": item.values["vehicle"] is not None,
            "mass": 0.5,
            "thrust_to_weight": 3.0,
            "motor_time_constant": 0.02,
            "acceleration": 7.0,
            "least_time": 2.0,
            "usable": 10 * (nth > 0),
            "tracked": 9 * (nth > 0),
            "limit": 0.2,
            "error_p90": 0.1 if nth else None,
        }
        for nth, item in enumerate(items)
    ]
    found = vehicles.report(Results(config, items, rows, [2.0] * 13, [False] * 13, {}, {}))
    assert "| cf21 | 0.5 | 3.0 | 20 | 7.0 | 2.00 | 0 | - | - | 0.20 |" in found.markdown
    assert "13 vehicles; of the usable plans of each at least 0.90 were tracked" in found.summary
    found.figures["vehicles.png"](tmp_path / "vehicles.png")
    assert (tmp_path / "vehicles.png").stat().st_size > 10_000
    with pytest.raises(InputError, match="--count"):
        vehicles.Config(count=-1)
    with pytest.raises(InputError, match="--world"):
        vehicles.Config(world="moon")


def test_the_report_of_made_up_rows_says_what_is_below_the_paper() -> None:
    config = table1.Config(episodes=4, planners=("pretrained",), predictors=("ground-truth", "constant-velocity"))
    items, rows = table1.items(config), []
    for item in items:
        nth = sum(row["predictor"] == item.values["predictor"] for row in rows)
        lost = item.values["predictor"] == "ground-truth" and nth % 2 == 0
        numbers = {"outcome": "collision" if lost else "intercepted", "time_to_intercept_s": None if lost else 2.0}
        flown = {"hesitated": lost, "cycles_without_plan": int(lost), "replans": 8, "plans": 3}
        ends = {"plan_clearance_m": 0.05 + nth, "plan_end_speed_m_s": 1e-9 * nth, "plan_end_acceleration_m_s2": 1e-8}
        rows.append({**item.values, **numbers, **flown, **ends})
    results = Results(config, items, rows, [2.0] * 8, [False] * 8, {}, {"env1/pretrained": 30.0})
    found = report(results)
    assert by_cell(rows)[0].paper == PAPER["pretrained"]["ground-truth"] == 0.78
    assert "| pretrained, ground-truth | 0.500 | 0.15 to 0.85 | 0.78 | -0.28 | 2 |" in found.markdown
    assert "0.28 below 0.78 (within the interval); 2 failures: 2 collision" in found.markdown
    assert "| pretrained, constant-velocity | 1.000 | 0.51 to 1.00 | - | - | 0 |" in found.markdown
    assert "| pretrained, ground-truth | 12 | 0.050 | 3.0e-09 | 1.0e-08 | 50.0 % | 6.25 % |" in found.markdown
    assert "Extrapolated to 3000 episodes a cell: 3.3 h with one worker, 1.7 h with 2" in found.summary
    assert r"\begin{tabular}" in found.latex
    cold = report(dataclasses.replace(results, compiled=[True] * 8))
    assert "Every episode compiled something (46 s in all): nothing can be extrapolated." in cold.summary


def test_plans_are_sampled_over_their_whole_length() -> None:
    waypoints = np.array([[0.0, 0.0, 1.0], [1.0, 0.5, 1.0], [2.0, 0.0, 1.5]])
    spline = minimum_snap(waypoints, np.array([1.0, 0.7]))
    points, speed, acceleration = plan_audit.sampled(spline)
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() < plan_audit.INTERVAL * 5.0
    np.testing.assert_allclose(points[[0, -1]], waypoints[[0, 2]], **tolerance("formula"))
    assert np.abs(points - np.asarray(spline.evaluate(0.7))).sum(axis=1).min() < plan_audit.INTERVAL * 5.0
    assert max(speed, acceleration) < tolerance("solve")["atol"]
    cut = PiecewisePolynomial(durations=spline.durations[:1], position=spline.position[:1])
    _, speed, acceleration = plan_audit.sampled(cut)
    assert speed == pytest.approx(np.linalg.norm(spline.evaluate(1.0, 1)), **relative("formula"))
    assert acceleration == pytest.approx(np.linalg.norm(spline.evaluate(1.0, 2)), **relative("formula"))


def test_times_are_compared_with_the_references_of_the_same_episodes(tmp_path: Path) -> None:
    rows = table1.items(table1.Config(episodes=4, planners=("pretrained",), predictors=("ground-truth",)))
    met = [{**item.values, "outcome": "intercepted", "time_to_intercept_s": 3.0} for item in rows]
    names = ("world", "target", "speed", "departure", "reference_s")
    lines = [",".join(names)]
    for row, reference in zip(met, ("1.5", "2.0", "", "3.0"), strict=True):
        lines.append(",".join([*(str(row[name]) for name in names[:-1]), reference]))
    stored = tmp_path / "results.csv"
    stored.write_text("\n".join(lines) + "\n")
    (cell,) = by_cell(met)
    np.testing.assert_allclose(cell.over_reference(stored_references(stored)), [2.0, 1.5, 1.0], **tolerance("exact"))
    assert len(cell.over_reference(stored_references(tmp_path / "absent.csv"))) == 0
    stored.write_text("nothing\n1\n")
    with pytest.raises(FileError, match="is not a results.csv of reference-times"):
        stored_references(stored)


@pytest.mark.parametrize("name", experiment_names())
def test_an_experiment_of_which_nothing_is_left_names_the_first_failure(name: str) -> None:
    """Every stored report, where all of its items failed."""
    found = load_experiment(name)
    config = found.presets["smoke"]
    try:
        items = found.items(config)
    except ResourceError as error:  # it flies in what an extra installs
        pytest.skip(str(error))
    why = {item.name: f"NotImplementedError: number {place}" for place, item in enumerate(items)}
    lost = Results(config, items, [None] * len(items), [0.0] * len(items), [False] * len(items), why, {})
    with pytest.raises(IncompleteError, match="items failed.*NotImplementedError: number 0; what is finished is kept"):
        found.report(lost)


def test_a_run_whose_only_item_raises_ends_with_its_cause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(*arguments: object, **options: object) -> None:
        raise NotImplementedError("MJX knows no such plant")

    monkeypatch.setattr(scale_factor, "at_the_boundary", refused)
    assert cli.run(["experiment", "scale-factor", "--out", str(tmp_path), "--workers", "0"]) == 14
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert "1 of 1 items failed" in said
    assert "'flights': NotImplementedError: MJX knows no such plant" in said
    assert (tmp_path / "shards" / "000000.json").is_file()


def test_flights_that_were_all_lost_are_dashes(tmp_path: Path) -> None:
    """A mean over no flights is None on the disk: a dash in the table, a gap in the picture."""
    config, lost = scale_factor.Config(), {"position_mean_m": None, "position_std_m": None}
    known = {"position_mean_m": 0.1, "position_std_m": 0.02}
    shared = {"yaw_mean_deg": 2.0, "yaw_std_deg": 1.0, "feasible_share": 0.5, "lost_share": 0.5}
    rows = [{"alpha": 0.7, **lost, **shared}, {"alpha": 1.0, **known, **shared}]
    items = scale_factor.items(config)
    found = scale_factor.report(Results(config, items, [{"rows": rows}], [1.0], [False], {}, {}))
    assert "| 0.700 | - | - | 2.000 |" in found.markdown
    found.figures["scale_factor.png"](tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 10_000
    nobody = SimpleNamespace(
        max_position_error=np.array([9.0, np.nan]), max_yaw_error=np.zeros(2), feasible=np.zeros(2)
    )
    assert scale_factor.statistics(nobody)["position_mean_m"] is None


def test_the_report_of_made_up_times_has_the_papers_beside_them(tmp_path: Path) -> None:
    config = table2.Config(worlds=("env1",))
    rows = [
        {"device": "cpu", "world": "env1", "candidates": 400, "stage": stage, "p50_ms": 2.0 + n, "p99_ms": 4.0 + n}
        for n, stage in enumerate(table2.STAGES)
    ]
    items = table2.items(config)
    found = table2.report(Results(config, items[:1], [{"rows": rows}], [1.0], [True], {}, {}))
    assert "| cpu, env1, 400 | 2.00 / 4.00 | 3.00 / 5.00 |" in found.markdown
    assert "| paper, Titan Xp, 400 | 18.7 | - | 9.5 | 71.2 | - | - | 99.4 |" in found.markdown
    found.figures["stages.png"](tmp_path / "stages.png")
    assert (tmp_path / "stages.png").stat().st_size > 10_000


def test_the_report_of_made_up_flights_says_how_many_rollouts_the_margins_save() -> None:
    config = policy_comparison.Config(policies=("mine",), labels=(100, 200, 400), shards=1, repeats=2)
    flights = {"time": [2.0, 8.0], "error": [0.1, 0.3], "tracked": [True, False]}
    flown = {"waypoints": [3, 9], "label": flights, "mine": {**flights, "time": [2.0, 6.0], "tracked": [True, True]}}
    found = {"rollouts alone": (0.6, 0.8, 0.849), "with rotor margins": (0.75, 0.85, 0.84)}
    items, rows = policy_comparison.items(config), []
    for item in items:
        if item.group == "flights":
            rows.append(flown)
            continue
        name, shift = item.values["kind"], 0.02 * item.values["draw"] - 0.01
        auc = found[name][config.labels.index(item.values["labels"])] + shift
        rows.append({"labels": item.values["labels"], "auc": auc, "margin_alone": 0.7})
    seen = policy_comparison.report(Results(config, items, rows, [1.0] * len(rows), [True], {}, {}))
    (label, mine), text = seen.table, seen.markdown
    assert (label["failed"], mine["failed"]) == (0.5, 0.0)
    assert (mine["T_over_T_MS"], mine["mean_T_over_mean_T_MS"]) == pytest.approx((0.875, 0.8))
    assert "| 100 | 0.600 | 0.750 | < 100 (1.00) |" in text
    assert "| 200 | 0.800 | 0.850 | 141 (0.71) |" in text
    assert "| 400 | 0.849 | 0.840 | 199 (0.50) |" in text


def test_placed_plans_are_counted_by_start_vehicle_and_room(tmp_path: Path) -> None:
    """Two vehicles with a course each: shares of what is kept, of that what is tracked, times over the best one's."""

    def plan(time: float | None, tracked: bool | None = None) -> dict:
        return {"time": time, "tracked": tracked}

    def flown(name: str, placed: dict, best: dict, filled: float) -> dict:
        plans = {"profile": plan(None), "placed": placed, "placed, refined": placed, "optimiser": best}
        course = {"start": "from flight", "filled": filled, "plans": plans}
        return {"name": name, "mass": 0.5, "thrust_to_weight": 3.0, "motor_time_constant": 0.02, "courses": [course]}

    rows = [
        flown("mfrl", plan(1.2, True), plan(1.0, True), 0.02),
        flown("random vehicle 0", plan(1.5, False), plan(1.0, True), 0.3),
        flown("random vehicle 1", plan(None), plan(None), 0.3),
    ]
    config = placing.Config(vehicles=2)
    items = placing.items(config)
    assert [item.values["number"] for item in items] == [None, 0, 1]
    found = placing.report(Results(config, items, rows, [1.0] * 3, [True] * 3, {}, {}))
    assert "| mfrl | from flight | placed | 1 | 1.000 | 1.000 | 1.200 |" in found.markdown
    assert "| others | from flight | placed | 2 | 0.500 | 0.000 | 1.500 |" in found.markdown
    assert "| others | from flight | profile | 2 | 0.000 | - | - |" in found.markdown
    assert "| mfrl | 0.50 | 3.0 | 20 | - | - | - | 1.000 | 1.000 | 1.200 |" in found.markdown
    assert "| 12% to 100% | from flight | 2 | 0.500 | 0.000 | 1.500 |" in found.markdown
    found.figures["placing.png"](tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 10_000
    with pytest.raises(InputError, match="--rooms 40"):
        placing.Config(rooms=40)


def test_the_policies_are_compared_on_what_is_left(tmp_path: Path) -> None:
    """One shard and the whole learning curve failed: the other shard's flights are reported."""
    config = policy_comparison.Config(policies=("mine",), labels=(100,), shards=2, repeats=1)
    flights = {"time": [2.0, 8.0], "error": [0.1, 0.3], "tracked": [True, False]}
    items, rows = policy_comparison.items(config), [None, {"waypoints": [3, 9], "label": flights, "mine": flights}]
    rows += [None] * (len(items) - 2)
    why = {item.name: "no memory" for item, row in zip(items, rows, strict=True) if row is None}
    found = policy_comparison.report(Results(config, items, rows, [1.0] * len(rows), [False] * len(rows), why, {}))
    assert found.table[1]["flights"] == 2
    assert "| 100 | - | - | - |" in found.markdown
    found.figures["policy_comparison.png"](tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 10_000


@pytest.mark.parametrize("folder", ["experiments", "benchmarks"])
def test_what_a_wheel_carries_imports_its_own_folder_relatively(folder: str, repository: Path) -> None:
    """A wheel has the folder as ``jaxplan/_<folder>``, where no package of its own name is found."""
    absolute = re.compile(rf"^\s*(?:from|import) {folder}\b", re.MULTILINE)
    files = sorted((repository / folder).rglob("*.py"))
    assert len(files) > 5
    assert [path.name for path in files if absolute.search(path.read_text(encoding="utf-8"))] == []
