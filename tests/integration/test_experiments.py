"""Experiments over dask, with workers that die, and the stored experiments at their smallest."""

import contextlib
import csv
import itertools
import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from experiments import closed_loop, guidance, policy_comparison, scale_factor, table1, table2
from experiments.closed_loop import EpisodeConfig
from experiments.optimiser import optimiser_policy
from experiments.table1_report import PAPER, by_cell, report
from jaxplan import cli
from jaxplan.errors import IncompleteError, ResourceError
from jaxplan.minsnap.time_allocation import time_allocation
from jaxplan.precision import in_float64
from jaxplan.prediction.observations import Observations
from jaxplan.runner import cluster, connection
from jaxplan.runner.definition import Results
from jaxplan.runner.ledger import Ledger
from jaxplan.runner.registry import experiment_names, load_experiment
from jaxplan.runner.shards import cut
from jaxplan.spline import FlatStateBatch, hover

NAME = "oracles.experiment_samples"
TESTS = Path(__file__).resolve().parent.parent
BASELINES = ("table1", "--planners", "pursuit", "navigation", "--worlds", "env1")


def started(*arguments: object) -> subprocess.Popen:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS.parent), str(TESTS)])}
    line = [sys.executable, "-m", "jaxplan.cli", "experiment", *map(str, arguments)]
    return subprocess.Popen(line, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finished(process: subprocess.Popen, code: int = 0) -> tuple[str, str]:
    out, said = process.communicate(timeout=500)
    assert process.returncode == code, said
    return out, said


def table(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "results.csv").read_text().splitlines()))


def workers_of(process: subprocess.Popen) -> list[int]:
    """The worker processes that a run has spawned."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(path.read_text().rsplit(")", 1)[1].split()[1])
            line = (path.parent / "cmdline").read_text()
        except (OSError, ValueError):
            continue
        if parent == process.pid and "spawn_main" in line:
            found.append(int(path.parent.name))
    return found


def test_workers_that_die_are_replaced_and_poison_is_named(tmp_path: Path) -> None:
    """Item 2 kills its worker each time, item 7 once, item 9 raises: all the others are there, each once."""
    (tmp_path / "marks").mkdir()
    options = ("--dying", 2, "--dying-once", 7, "--raising", 9, "--marks", tmp_path / "marks")
    run = started(NAME, "--preset", "small", *options, "--out", tmp_path / "out", "--workers", 2)
    _, said = finished(run, code=14)
    assert "quarantined number 2: its worker died" in said
    assert "quarantined number 9: ValueError: no root of 9" in said
    assert "Traceback" not in said
    assert [int(row["number"]) for row in table(tmp_path / "out")] == [n for n in range(12) if n not in (2, 9)]


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "CONNECT_SECONDS", 1.0)
    began = time.monotonic()
    with pytest.raises(ResourceError, match=r"tcp://127.0.0.1:9: no answer within 1 s"):
        cluster.run_on_cluster(NAME, {}, Ledger([]), lambda shard, found: None, 0, "tcp://127.0.0.1:9")
    assert time.monotonic() - began < 10.0


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ResourceError, match=r"pip install 'jaxplan\[cluster\]'.*--workers 0"):
        cluster.run_on_cluster(NAME, {}, Ledger([]), lambda shard, found: None, 2, None)


def test_episodes_are_chosen_evenly_and_without_repetition() -> None:
    """300 of 3000: every value of an axis equally often, every pair of two axes but the worlds' once in a world."""
    chosen = table1.chosen(table1.Config(episodes=300))
    for axis, each in (("world", 100), ("target", 10), ("speed", 30), ("departure", 30)):
        values, counts = np.unique([getattr(episode, axis) for episode in chosen], return_counts=True)
        assert set(counts) == {each}, axis
        assert len(values) == 300 // each
    for first, second in (("target", "speed"), ("target", "departure"), ("speed", "departure")):
        pairs = {(e.world, getattr(e, first), getattr(e, second)) for e in chosen}
        assert len(pairs) == 300
    full = table1.chosen(table1.Config(episodes=3000))
    assert len(set(full)) == 3000
    assert set(chosen) < set(full)
    assert [episode.seed for episode in full] == list(range(3000))
    assert len(set(table1.even_choice((2, 3, 4, 5), 120))) == 120


def test_every_cell_flies_the_same_episodes_and_groups_are_together() -> None:
    config = table1.Config(episodes=5, planners=("no-policy", "pursuit"))
    items = table1.items(config)
    assert len(items) == 5 * (len(config.predictors) + 1)
    assert len({item.name for item in items}) == len(items)
    groups = [item.group for item in items]
    assert len(set(groups)) == sum(a != b for a, b in itertools.pairwise(groups)) + 1
    keys = {(i.values["planner"], i.values["predictor"]): [] for i in items}
    for item in items:
        keys[item.values["planner"], item.values["predictor"]].append((item.values["target"], item.values["seed"]))
    assert len({tuple(sorted(flown)) for flown in keys.values()}) == 1


def test_the_report_of_made_up_rows_says_what_is_below_the_paper() -> None:
    config = table1.Config(episodes=4, planners=("pretrained",), predictors=("ground-truth", "constant-velocity"))
    items, rows = table1.items(config), []
    for item in items:
        nth = sum(row["predictor"] == item.values["predictor"] for row in rows)
        lost = item.values["predictor"] == "ground-truth" and nth % 2 == 0
        numbers = {"outcome": "collision" if lost else "intercepted", "time_to_intercept_s": None if lost else 2.0}
        rows.append({**item.values, **numbers})
    results = Results(config, items, rows, [2.0] * 8, [False] * 8, {}, {"env1/pretrained": 30.0})
    found = report(results)
    assert by_cell(rows)[0].paper == PAPER["pretrained"]["ground-truth"] == 0.78
    assert "| pretrained, ground-truth | 0.500 | 0.15 to 0.85 | 0.78 | -0.28 | 2 |" in found.markdown
    assert "0.28 below 0.78 (within the interval); 2 failures: 2 collision" in found.markdown
    assert "| pretrained, constant-velocity | 1.000 | 0.51 to 1.00 | - | - | 0 |" in found.markdown
    assert "Extrapolated to 3000 episodes a cell: 3.3 h with one worker, 1.7 h with 2" in found.summary
    assert r"\begin{tabular}" in found.latex
    cold = report(results._replace(compiled=[True] * 8))
    assert "Every episode compiled something (46 s in all): nothing can be extrapolated." in cold.summary


def test_guidance_is_continuous_and_heads_for_the_target() -> None:
    for law in guidance.LAWS:
        pilot = guidance.Guidance(law, hover(np.array([0.0, 0.0, 1.0])))
        now, target = 0.0, np.array([6.0, 3.0, 1.5])
        for cycle in range(12):
            now = 0.1 * cycle
            times = now + 0.1 * np.arange(-9, 1)
            seen = Observations(times=times, positions=target + times[:, None] * [0.0, 1.0, 0.0])
            before = pilot.reference(np.array([now - 1e-7])).derivatives[0, :3]
            pilot.step(now, seen)
            after = pilot.reference(np.array([now])).derivatives[0, :3]
            np.testing.assert_allclose(after, before, atol=1e-4)
        state = pilot.reference(np.array([now + 0.1])).derivatives[0]
        apart = target + (now + 0.1) * np.array([0.0, 1.0, 0.0]) - state[0]
        assert state[1] @ apart / np.linalg.norm(apart) > 2.0, law
        assert np.linalg.norm(state[2]) <= guidance.MOST_ACCELERATION + 1e-6


@pytest.mark.parametrize("name", experiment_names())
def test_an_experiment_of_which_nothing_is_left_names_the_first_failure(name: str) -> None:
    """Every stored report, where all of its items failed."""
    found = load_experiment(name)
    config = found.presets["smoke"]
    items = found.items(config)
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


@pytest.mark.slow
@in_float64
def test_the_optimiser_as_a_policy_is_the_optimiser() -> None:
    rng = np.random.default_rng(0)
    waypoints = np.cumsum(rng.uniform(-2.0, 2.0, (5, 3, 3)), axis=0)
    derivatives = np.concatenate([waypoints[:1], rng.normal(size=(4, 3, 3))])
    policy = optimiser_policy(100.0)
    state = FlatStateBatch(derivatives=derivatives, yaw=np.zeros((3, 3)))
    allot = jax.jit(lambda points: policy.decode(policy.encode(points, np.full(3, 5)), state))
    durations = np.asarray(allot(waypoints))
    known = time_allocation(waypoints, time_weight=100.0, initial=derivatives[1:]).durations
    np.testing.assert_allclose(durations.sum(axis=0), known.sum(axis=0), rtol=0.02)
    assert np.isinf(np.asarray(allot(waypoints * np.nan)).sum(axis=0)).all()


@pytest.mark.slow
def test_an_episode_does_not_depend_on_those_before_it() -> None:
    name = {"world": "env1", "target": "env1-02", "speed": 1.5, "departure": 0.5, "seed": 7}
    config = EpisodeConfig(planner="no-policy", predictor="gmm", **name)
    first = closed_loop.numbers(closed_loop.fly(config))
    closed_loop.fly(EpisodeConfig(planner="no-policy", predictor="noisy-0.05", **{**name, "target": "env1-05"}))
    assert closed_loop.numbers(closed_loop.fly(config)) == first


@pytest.mark.slow
def test_results_do_not_depend_on_the_number_of_workers(tmp_path: Path) -> None:
    for workers in (1, 2):
        finished(started(*BASELINES, "--episodes", 24, "--out", tmp_path / str(workers), "--workers", workers))
    assert len(table(tmp_path / "1")) == 48
    assert (tmp_path / "1" / "results.csv").read_bytes() == (tmp_path / "2" / "results.csv").read_bytes()


@pytest.mark.slow
def test_kill_9_of_random_workers_changes_nothing(tmp_path: Path) -> None:
    """Every few seconds a random worker is killed, until three were; the results are those of a quiet run."""
    arguments = (*BASELINES, "--episodes", 60, "--workers", 2)
    process, rng, killed = started(*arguments, "--out", tmp_path / "shot"), random.Random(0), 0
    while process.poll() is None and killed < 3:
        time.sleep(6.0)
        alive = workers_of(process)
        if alive:
            os.kill(rng.choice(alive), signal.SIGKILL)
            killed += 1
    finished(process)
    assert killed >= 1
    finished(started(*arguments, "--out", tmp_path / "quiet"))
    assert (tmp_path / "shot" / "results.csv").read_bytes() == (tmp_path / "quiet" / "results.csv").read_bytes()


@pytest.mark.slow
def test_kill_9_of_the_whole_run_redoes_at_most_a_shard_per_worker(tmp_path: Path) -> None:
    (tmp_path / "marks").mkdir()
    options = (NAME, "--preset", "full", "--sleep", 0.2, "--marks", tmp_path / "marks", "--workers", 2)
    process = started(*options, "--out", tmp_path / "out")
    while len(list((tmp_path / "out" / "shards").glob("[0-9]*.json"))) < 5:
        assert process.poll() is None
        time.sleep(0.05)
    process.kill()
    process.communicate()
    time.sleep(3.0)  # the workers notice that they are orphans
    finished(started(NAME, "--resume", "--out", tmp_path / "out", "--workers", 2))
    counts = [len((tmp_path / "marks" / f"{n}.txt").read_text().splitlines()) for n in range(48)]
    assert sum(counts) - 48 <= 2 * 3
    assert [int(row["number"]) for row in table(tmp_path / "out")] == list(range(48))


@pytest.mark.slow
def test_ctrl_c_over_workers_is_quiet_and_resumable(tmp_path: Path) -> None:
    process = started(NAME, "--preset", "full", "--sleep", 0.2, "--out", tmp_path, "--workers", 2)
    while len(list((tmp_path / "shards").glob("[0-9]*.json"))) < 2:
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, said = finished(process, code=130)
    assert "Traceback" not in said
    assert "--resume" in said
    finished(started(NAME, "--resume", "--out", tmp_path))
    assert len(table(tmp_path)) == 48


@pytest.mark.slow
def test_a_scheduler_of_ones_own_and_its_loss(tmp_path: Path) -> None:
    """The same results over somebody else's workers; when the scheduler dies, the run says so and can go on."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS.parent), str(TESTS)])}
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    parts = (["scheduler", "--port", str(port), "--host", "127.0.0.1"], ["worker", address, "--nthreads", "1"])
    with contextlib.ExitStack() as stack:
        running = []
        for name, *options in parts:
            line = [sys.executable, "-m", f"distributed.cli.dask_{name}", *options, "--no-dashboard"]
            running.append(subprocess.Popen(line, env=environment, cwd=tmp_path, stderr=subprocess.DEVNULL))
            stack.callback(running[-1].wait)
            stack.callback(running[-1].terminate)
            time.sleep(4.0)
        finished(started(NAME, "--preset", "small", "--scheduler", address, "--out", tmp_path / "all"))
        assert len(table(tmp_path / "all")) == 12
        run = started(NAME, "--preset", "full", "--sleep", 0.3, "--scheduler", address, "--out", tmp_path / "cut")
        while len(list((tmp_path / "cut" / "shards").glob("[0-9]*.json"))) < 2:
            assert run.poll() is None
            time.sleep(0.05)
        running[0].kill()
        _, said = finished(run, code=12)
    assert "the scheduler is gone; what is finished stays valid" in said
    assert "Traceback" not in said
    finished(started(NAME, "--resume", "--out", tmp_path / "cut", "--workers", 0))
    assert [int(row["number"]) for row in table(tmp_path / "cut")] == list(range(48))


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in experiment_names() if name not in ("table1", "table2")])
def test_every_figure_is_drawn(name: str, tmp_path: Path) -> None:
    finished(started(name, "--preset", "smoke", "--out", tmp_path, "--workers", 0))
    written = json.loads((tmp_path / "provenance.json").read_text())["results"]
    pictures = [tmp_path / file for file in written if file.endswith(".png")]
    assert pictures
    assert all(path.stat().st_size > 10_000 for path in pictures)
    assert table(tmp_path)
    shards = cut(load_experiment(name).items(load_experiment(name).presets["smoke"]), 1)
    assert len(list((tmp_path / "shards").glob("[0-9]*.json"))) <= len(shards)


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
