"""The command line: exit codes, one-line errors, and what a run writes. The flight itself is made up here."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_viz_episode import made_up_episode

from jaxplan import cli
from jaxplan.cli.intercept import summary
from jaxplan.config import InterceptConfig
from jaxplan.errors import FileError, InputError, InternalError, ResourceError, UnsupportedVersion
from jaxplan.io.cycles import read_cycles
from jaxplan.io.target_log import read_target_log
from jaxplan.spline import PiecewisePolynomial
from jaxplan.status import PlanStatus
from jaxplan.world.load import load_world
from made_up import cycle, planned

FILES = ["config.json", "cycles.npz", "episode.png", "flown.csv", "metrics.json", "plans.npz", "target.csv"]


def made_up_metrics(success: bool = True) -> dict[str, Any]:
    return {
        "success": success,
        "outcome": "intercepted" if success else "target_ended",
        "time_to_intercept_s": 3.5 if success else None,
        "min_distance_m": 0.39,
        "max_position_error_m": 0.08,
        "max_yaw_error_deg": 11.0,
        "min_clearance_m": 0.4,
        "replans": 30,
        "real_time": None,
        "replan_ms": {"total": {"p50": 12.0, "p99": 20.0, "max": 25.0}, "search": {"p50": 3.0, "p99": 4.0, "max": 5.0}},
        "target": {"name": "made up", "warnings": ["1 gaps, the longest 0.500 s at t = 1.000 s"]},
        "vehicle": {"name": "mine", "warnings": ["mass is 9 kg"]},
    }


def flight(config: InterceptConfig, success: bool = True) -> Any:
    """An episode with everything that the files need."""
    episode = made_up_episode(load_world("env1"), "intercepted" if success else "target_ended")
    count = len(episode.flight.times)
    episode.flight.quat_wxyz = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    spline = PiecewisePolynomial(durations=np.ones(2), position=np.ones((2, 10, 3)), yaw=np.zeros((2, 6)))
    goal = np.zeros(3)
    plan = SimpleNamespace(
        start_time=0.6,
        spline=spline,
        goal=goal,
        arrival_time=2.0,
        alpha=1.1,
        probability=0.9,
        status=PlanStatus.INTERCEPT,
    )
    episode.plans = (plan,)
    episode.cycles, episode.observations = (cycle(0.5, planned(np.random.default_rng(0))), cycle(0.6, None)), ()
    episode.scenario.predictor = None
    return episode


@pytest.fixture
def pretend(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Replace the flight by ``run`` and its metrics by made-up ones."""
    import jaxplan

    def replace(run: Callable[[InterceptConfig, Any], Any], success: bool = True) -> None:
        modules = {"interception": ModuleType("interception"), "metrics": ModuleType("metrics")}
        modules["interception"].run = lambda config, progress: run(config, progress)  # type: ignore[attr-defined]
        modules["metrics"].episode_metrics = lambda episode: made_up_metrics(success)  # type: ignore[attr-defined]
        for name, module in modules.items():
            monkeypatch.setitem(sys.modules, f"jaxplan.{name}", module)
            monkeypatch.setattr(jaxplan, name, module, raising=False)

    return replace


def test_a_run_writes_every_file(
    tmp_path: Path, pretend: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    seen: list[InterceptConfig] = []

    def run(config: InterceptConfig, progress: Any) -> Any:
        seen.append(config)
        progress("flying", 0.5)
        return flight(config)

    pretend(run)
    out = tmp_path / "a b" / "ü"
    arguments = ["intercept", "--start", "-1", "-2.5", "1e0", "--speed", "2", "--seed", "3", "--out", str(out)]
    assert cli.run([*arguments, "--predictor", "constant-velocity", "--require-success"]) == 0
    assert sorted(path.name for path in out.iterdir()) == FILES
    assert seen[0].start == (-1.0, -2.5, 1.0)
    config = json.loads((out / "config.json").read_text())
    assert config["predictor"] == "constant-velocity"
    assert InterceptConfig(**{**config, "start": tuple(config["start"])}) == seen[0]
    assert json.loads((out / "metrics.json").read_text())["success"] is True
    assert len(read_target_log(out / "flown.csv").times) == 800
    assert len(read_target_log(out / "target.csv").times) == 800
    with np.load(out / "plans.npz", allow_pickle=False) as plans:
        assert plans["position"].shape == (1, 2, 10, 3)
    assert [len(each.goals) for each in read_cycles(out / "cycles.npz", plans=1)] == [90, 0]
    printed = capsys.readouterr()
    assert "intercepted" in printed.out
    assert "replan search, p50 / p99" in printed.out
    assert printed.err.splitlines() == [
        "jaxplan: warning: target: 1 gaps, the longest 0.500 s at t = 1.000 s",
        "jaxplan: warning: vehicle: mass is 9 kg",
    ]


def test_no_interception_is_a_valid_run(tmp_path: Path, pretend: Callable[..., None]) -> None:
    pretend(lambda config, progress: flight(config, success=False), success=False)
    arguments = ["intercept", "--out", str(tmp_path)]
    assert cli.run(arguments) == 0
    assert cli.run([*arguments, "--overwrite", "--require-success"]) == 13
    assert sorted(path.name for path in tmp_path.iterdir()) == FILES


def test_a_saved_configuration_repeats_a_run(tmp_path: Path, pretend: Callable[..., None]) -> None:
    seen: list[InterceptConfig] = []

    def run(config: InterceptConfig, progress: Any) -> Any:
        seen.append(config)
        return flight(config)

    pretend(run)
    first = ["--world", "env2", "--vehicle", "cf21", "--start", "-1", "-2.5", "1", "--speed", "2", "--meet", "rest"]
    assert cli.run(["intercept", *first, "--out", str(tmp_path / "a")]) == 0
    saved = ["intercept", "--config", str(tmp_path / "a" / "config.json"), "--out", str(tmp_path / "b")]
    assert cli.run(saved) == 0
    assert cli.run([*saved, "--overwrite", "--speed", "3", "--start", "0", "0", "1"]) == 0
    assert [config.out for config in seen] == [str(tmp_path / "a"), *2 * [str(tmp_path / "b")]]
    assert replace(seen[1], out=seen[0].out) == seen[0]
    assert replace(seen[2], speed=2.0, start=seen[1].start) == seen[1]
    assert (seen[2].speed, seen[2].start) == (3.0, (0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        ('{"experiment": "table1"}', 10, "is not of jaxplan intercept"),
        ("[1]", 10, "is not of jaxplan intercept"),
        ('{"speed": "fast"}', 10, "--speed: have 'fast', want"),
        ('{"start": [1, 2]}', 10, "--start"),
        ("{", 11, "cannot be read as a config.json"),
        (100_000 * "[", 11, "cannot be read as a config.json"),
        (None, 11, "cannot be read as a config.json"),
    ],
    ids=lambda value: str(value)[:20],
)
def test_saved_configurations_that_are_none(
    tmp_path: Path,
    pretend: Callable[..., None],
    capsys: pytest.CaptureFixture[str],
    text: str | None,
    code: int,
    said: str,
) -> None:
    pretend(lambda config, progress: pytest.fail("must not be flown"))
    path = tmp_path / "config.json"
    if text is not None:
        path.write_text(text)
    assert cli.run(["intercept", "--config", str(path), "--out", str(tmp_path / "out")]) == code
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_a_run_is_not_overwritten_unless_that_is_asked_for(
    tmp_path: Path, pretend: Callable[..., None], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pretend(lambda config, progress: flight(config))
    monkeypatch.chdir(tmp_path)
    assert cli.run(["intercept", "--out", "mine", "--seed", "1"]) == 0
    before = {path.name: path.read_bytes() for path in (tmp_path / "mine").iterdir()}
    capsys.readouterr()
    assert cli.run(["intercept", "--out", "mine/"]) == 10
    assert capsys.readouterr().err == (
        "jaxplan: --out: 'mine' holds a run already; choose another folder or give --overwrite\n"
    )
    assert {path.name: path.read_bytes() for path in (tmp_path / "mine").iterdir()} == before
    assert cli.run(["intercept", "--out", "mine", "--overwrite"]) == 0
    assert json.loads((tmp_path / "mine" / "config.json").read_text())["seed"] == 0
    for seed in ("1", "2"):  # the default folder is replaced by every run
        assert cli.run(["intercept", "--seed", seed]) == 0
        assert json.loads((tmp_path / "out" / "intercept" / "config.json").read_text())["seed"] == int(seed)


ERRORS = [
    (InputError("start: have\n(9, 9, 9), want inside"), 10, "start: have (9, 9, 9), want inside"),
    (FileError("no such file"), 11, "no such file"),
    (ResourceError("disk full"), 12, "disk full"),
    (UnsupportedVersion("jax 0.10.2 is bad"), 12, "jax 0.10.2 is bad"),
    (InternalError("a bug"), 70, "a bug"),
    (ZeroDivisionError("oops"), 70, "internal error: ZeroDivisionError: oops"),
    (KeyboardInterrupt(), 130, "interrupted"),
]


@pytest.mark.parametrize(("error", "code", "text"), ERRORS, ids=lambda value: type(value).__name__)
def test_errors_are_one_line_and_leave_nothing(
    tmp_path: Path,
    pretend: Callable[..., None],
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    text: str,
) -> None:
    def fail(config: InterceptConfig, progress: Any) -> Any:
        raise error

    pretend(fail)
    assert cli.run(["intercept", "--out", str(tmp_path / "new")]) == code
    printed = capsys.readouterr()
    assert printed.err.startswith(f"jaxplan: {text}")
    assert printed.err.count("\n") == 1
    assert printed.out == ""
    assert list(tmp_path.iterdir()) == []
    cli.run(["intercept", "--debug", "--out", str(tmp_path / "new")])
    assert "Traceback" in capsys.readouterr().err


USAGE = [
    (["bogus"], 2, "bogus"),
    (["intercept", "--bogus", "1"], 2, "--bogus"),
    (["intercept", "env1"], 2, "env1"),
    (["intercept", "--speed", "fast"], 2, "--speed"),
    (["intercept", "--predictor", "oracle"], 2, "--predictor"),
    (["intercept", "--planner", "policy"], 2, "--planner"),
    (["intercept", "--start", "1", "2"], 2, "--start"),
    (["intercept", "--seed", "1.5"], 2, "--seed"),
    (["intercept", "--speed", "nan"], 10, "--speed: have nan, want"),
    (["intercept", "--speed", "0"], 10, "--speed: have 0.0, want"),
    (["intercept", "--departure", "inf"], 10, "--departure: have inf, want"),
    (["intercept", "--start", "1", "2", "nan"], 10, "--start: have nan, want"),
    (["intercept", "--seed", "-1"], 10, "--seed: have -1, want"),
    (["intercept", "--selection", "best"], 2, "--selection"),
    (
        ["intercept", "--predictor", "none", "--target-model", "mine.npy"],
        10,
        "--target-model: have 'mine.npy', want none unless",
    ),
    (["intercept", "--classifier", "mine.npz"], 10, "--classifier: have 'mine.npz', want none without --policy"),
    (
        ["intercept", "--policy", "mine.npz", "--planner", "mfrl"],
        10,
        "--planner: have 'mfrl', want none beside --policy",
    ),
    (["intercept", "--policy", ""], 10, "--policy: have '', want"),
    (["intercept", "--world", ""], 10, "--world: have '', want"),
    (["intercept", "--out", "/proc/jaxplan"], 12, "cannot write '/proc/jaxplan'"),
    (["intercept", "--out", "/dev/null/x"], 12, "cannot write '/dev/null/x'"),
]


@pytest.mark.parametrize(("arguments", "code", "text"), USAGE, ids=str)
def test_wrong_arguments(
    pretend: Callable[..., None], capsys: pytest.CaptureFixture[str], arguments: list[str], code: int, text: str
) -> None:
    pretend(lambda config, progress: pytest.fail("must not be flown"))
    assert cli.run(arguments) == code
    printed = capsys.readouterr()
    assert text in printed.err
    assert printed.err.count("\n") == 1
    assert printed.out == ""


def test_a_bad_jax_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from jaxplan import versions

    monkeypatch.setattr(versions, "_version", lambda package: "0.10.2")
    assert cli.run(["intercept", "--out", str(tmp_path / "new")]) == 12
    assert "jax 0.10.2 hangs" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_help_names_every_option(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["intercept", "--help"]) == 0
    text = capsys.readouterr().out
    options = "world target time-unit frame columns predictor target-model planner policy classifier speed departure"
    options += " start seed out config require-success debug"
    assert [name for name in options.split() if f"--{name}" not in text] == []
    assert "--empty" not in text
    assert "--no-" not in text.replace("no-policy", "")


def test_the_table_shows_what_is_missing_as_a_dash() -> None:
    lines = summary(made_up_metrics(success=False)).splitlines()
    assert lines[1].split() == ["time", "to", "intercept", "-", "s"]


def test_the_table_of_a_run_in_real_time_says_how_it_kept_its_times() -> None:
    kept = {"setpoint_us": {"p50": 41.7, "p99": 99.9}, "late_plans": 2}
    lines = summary(made_up_metrics() | {"real_time": kept}).splitlines()
    assert [line.split() for line in lines[-2:]] == [
        ["setpoint,", "p50", "/", "p99", "42", "/", "100", "us"],
        ["late", "plans", "2"],
    ]


def test_terminated_runs_leave_nothing(tmp_path: Path) -> None:
    code = f"""
import sys, time
from types import ModuleType
import jaxplan
from jaxplan import cli
for name in ("interception", "metrics"):
    module = sys.modules["jaxplan." + name] = ModuleType(name)
    setattr(jaxplan, name, module)
def run(config, progress):
    print("started", flush=True)
    time.sleep(30)
jaxplan.interception.run = run
jaxplan.metrics.episode_metrics = None
cli.main(["intercept", "--out", {str(tmp_path / "new")!r}])
"""
    for number, want in ((signal.SIGTERM, 143), (signal.SIGINT, 130)):
        child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        assert child.stdout is not None
        assert child.stdout.readline() == b"started\n"
        began = time.monotonic()
        os.kill(child.pid, number)
        _, stderr = child.communicate(timeout=20)
        assert child.returncode == want
        assert time.monotonic() - began < 10.0
        assert b"Traceback" not in stderr
        assert list(tmp_path.iterdir()) == []
