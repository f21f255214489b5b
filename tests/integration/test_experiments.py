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

import jax
import numpy as np
import pytest

from experiments import closed_loop, guidance, table1
from experiments.closed_loop import EpisodeConfig
from experiments.optimiser import optimiser_policy
from jaxplan.errors import ResourceError
from jaxplan.minsnap.time_allocation import time_allocation
from jaxplan.precision import in_float64
from jaxplan.prediction.observations import Observations
from jaxplan.runner import cluster, connection
from jaxplan.runner.ledger import Ledger
from jaxplan.runner.registry import experiment_names, load_experiment
from jaxplan.runner.shards import cut
from jaxplan.spline import FlatStateBatch, hover
from tolerances import tolerance

NAME = "oracles.experiment_samples"
TESTS = Path(__file__).resolve().parent.parent
BASELINES = ("table1", "--planners", "pursuit", "navigation", "--worlds", "env1")


FLOWN_ELSEWHERE = ("table1", "table2", "firmware")
"""Their smoke presets are in tests of their own."""
NEEDS = {"foreign-plants": "rotorpy"}
TABLES_ALONE = ("faults",)
"""Experiments that draw nothing."""
LONGEST = 1500
"""Seconds that an experiment may take; the longest needs some minutes of one quiet core."""


def started(*arguments: object) -> subprocess.Popen:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS.parent), str(TESTS)])}
    line = [sys.executable, "-m", "jaxplan.cli", "experiment", *map(str, arguments)]
    return subprocess.Popen(line, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finished(process: subprocess.Popen, code: int = 0) -> tuple[str, str]:
    try:
        out, said = process.communicate(timeout=LONGEST)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()  # else the next tests hear of it
        raise
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


def test_guidance_is_continuous_and_heads_for_the_target() -> None:
    for law in guidance.LAWS:
        pilot = guidance.Guidance(guidance.law_named(law), hover(np.array([0.0, 0.0, 1.0])))
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
    assert first["plans"] > 0 < first["plan_clearance_m"]
    assert first["plan_end_speed_m_s"] < tolerance("solve")["atol"]


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
@pytest.mark.parametrize("name", [name for name in experiment_names() if name not in FLOWN_ELSEWHERE])
def test_every_figure_is_drawn(name: str, tmp_path: Path) -> None:
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    finished(started(name, "--preset", "smoke", "--out", tmp_path, "--workers", 0))
    written = json.loads((tmp_path / "provenance.json").read_text())["results"]
    pictures = [tmp_path / file for file in written if file.endswith(".png")]
    assert bool(pictures) == (name not in TABLES_ALONE)
    assert all(path.stat().st_size > 10_000 for path in pictures)
    assert table(tmp_path)
    shards = cut(load_experiment(name).items(load_experiment(name).presets["smoke"]), 1)
    assert len(list((tmp_path / "shards").glob("[0-9]*.json"))) <= len(shards)
