"""Configurations, shards, the ledger, resuming and bad input, with a made-up experiment; no dask here."""

import csv
import dataclasses
import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from jaxplan.errors import FileError, IncompleteError, InputError, ResourceError
from jaxplan.runner import run as runs
from jaxplan.runner.configuration import as_plain, from_plain, read_config
from jaxplan.runner.definition import Item, Report, Results
from jaxplan.runner.ledger import ATTEMPTS, Ledger
from jaxplan.runner.registry import load_experiment
from jaxplan.runner.run import Request
from jaxplan.runner.shards import Outcome, Store, cut
from jaxplan.runner.statistics import wilson
from jaxplan.runner.tables import as_csv, as_latex, as_markdown, duration
from oracles.experiment_samples import EXPERIMENT, Config

NAME = "oracles.experiment_samples"
TESTS = Path(__file__).resolve().parent.parent


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "jaxplan.cli", "experiment", *map(str, arguments)]


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS.parent), str(TESTS)])}


def called(*arguments: object, prefix: str = "") -> subprocess.CompletedProcess:
    line = command(*arguments)
    if prefix:
        line = ["bash", "-c", f'{prefix}; exec "$@"', "bash", *line]
    return subprocess.run(line, env=environment(), capture_output=True, text=True, timeout=120, check=False)


def request(out: Path, config: Config | None = None, **options: object) -> Request:
    return Request(name=NAME, config=config or Config(), out=out, workers=0, **options)  # type: ignore[arg-type]


def table(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "results.csv").read_text().splitlines()))


def test_wilson_against_published_intervals() -> None:
    """Newcombe (1998), table I, method 3: 81 of 263, 15 of 148, 0 of 20, 1 of 29."""
    for successes, count, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ):
        assert wilson(successes, count) == pytest.approx((low, high), abs=5e-5)
    assert wilson(0, 0) == (0.0, 1.0)


def test_tables_as_text() -> None:
    assert as_csv([{"a": 0.1, "b": "x, y"}, {"a": 2}]) == 'a,b\n0.1,"x, y"\n2,\n'
    assert as_markdown(["a", "b"], [["1", "2"]]) == "| a | b |\n| --- | ---: |\n| 1 | 2 |\n"
    assert r"5 \% \& a\_b & 2 \\" in as_latex(["", "n"], [["5 % & a_b", "2"]], "x_y")
    assert r"\caption{x\_y}" in as_latex(["", "n"], [], "x_y")
    assert [duration(s) for s in (42.0, 130.0, 20_000.0)] == ["42 s", "2 min", "5.6 h"]


def test_configurations_survive_json(tmp_path: Path) -> None:
    config = Config(count=5, raising=(1, 2), marks="a")
    assert from_plain(Config, as_plain(config)) == config
    with pytest.raises(InputError, match="unknown nosuch"):
        from_plain(Config, {"nosuch": 1})
    path = tmp_path / "config.json"
    path.write_text(json.dumps({"experiment": "table1", "preset": "small", "config": {}}))
    with pytest.raises(InputError, match="is of experiment 'table1'"):
        read_config(path, "table2")
    for text in ("", "[]", '{"config": 3}', "\x00"):
        path.write_text(text)
        with pytest.raises(FileError, match="cannot be read"):
            read_config(path, "table1")


def test_shards_keep_to_a_group() -> None:
    shards = cut(EXPERIMENT.items(Config(count=10)), 4)
    assert [[item.values["number"] for item in shard.items] for shard in shards] == [[0, 1, 2, 3], [4, 5], [6, 7, 8, 9]]
    assert [shard.number for shard in shards] == [0, 1, 2]


def ledger_of(count: int, size: int) -> tuple[Ledger, list]:
    shards = cut([Item(f"{n}", "group", {}) for n in range(count)], size)
    return Ledger(shards), shards


def test_a_shard_that_kills_workers_is_split_and_its_poison_named() -> None:
    """Item 1 kills whoever evaluates it; the others are evaluated, and nothing is tried for ever."""
    ledger, _ = ledger_of(4, 2)
    deaths, complete = 0, []
    while job := ledger.take():
        if any(item.name == "1" for item in job.items):
            deaths += 1
            found = ledger.died(job, "its worker died")
        else:
            found = ledger.done(job, {item.name: Outcome({"x": 1}, "", 0.1) for item in job.items})
        complete += [found] if found else []
    assert deaths == 2 * ATTEMPTS
    assert ledger.items_left == 0
    assert {name: outcome.row is None for found in complete for name, outcome in found.items()} == {
        "0": False,
        "1": True,
        "2": False,
        "3": False,
    }


def test_a_single_death_costs_an_attempt_and_nothing_else() -> None:
    ledger, _ = ledger_of(2, 2)
    assert ledger.died(ledger.take(), "") is None
    job = ledger.take()
    assert len(job.items) == 2
    complete = ledger.done(job, {item.name: Outcome({}, "", 0.0) for item in job.items})
    assert set(complete) == {"0", "1"}


def test_an_item_that_raises_is_tried_alone_and_then_given_up(tmp_path: Path) -> None:
    marks = tmp_path / "marks"
    marks.mkdir()
    done = runs.run(request(tmp_path / "out", Config(raising=(4,), marks=str(marks))))
    assert done.quarantined == {"number 4": "ValueError: no root of 4"}
    assert len(table(tmp_path / "out")) == 11
    counts = {int(path.stem): len(path.read_text().splitlines()) for path in marks.iterdir()}
    assert counts == {n: ATTEMPTS if n == 4 else 1 for n in range(12)}
    assert "`number 4`: ValueError: no root of 4" in (tmp_path / "out" / "report.md").read_text()


@pytest.mark.parametrize("options", [{"raising": (0, 1, 2, 3)}, {"raising": (1,), "needs": 1}], ids=["all", "needed"])
def test_a_report_that_lacks_what_it_needs_says_what_failed_first(
    tmp_path: Path, options: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    """Not that the report stumbled over what is missing; nothing that was finished is lost."""
    from jaxplan import cli

    config, out = Config(count=4, **options), tmp_path / "out"
    failed = config.raising
    with pytest.raises(IncompleteError, match=rf"{len(failed)} of 4 items failed.*'number {failed[0]}': ValueError"):
        runs.run(request(out, config))
    assert len(list((out / "shards").glob("[0-9]*.json"))) == 2
    assert not (out / "report.md").exists()
    assert cli.run(["experiment", NAME, "--out", str(out), "--resume", "--workers", "0"]) == 14
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith(f"jaxplan: experiment: {len(failed)} of 4 items failed")
    assert f"no root of {failed[0]}" in said


def test_a_fault_of_the_report_itself_is_not_hidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(results: Results[Config]) -> Report:
        raise ZeroDivisionError("a bug")

    found = load_experiment(NAME)
    monkeypatch.setattr(runs, "load_experiment", lambda name: dataclasses.replace(found, report=broken))
    with pytest.raises(ZeroDivisionError, match="a bug"):
        runs.run(request(tmp_path))


def test_a_group_that_cannot_be_prepared_is_tried_once_and_left_out(tmp_path: Path) -> None:
    marks = tmp_path / "marks"
    marks.mkdir()
    done = runs.run(request(tmp_path / "out", Config(unprepared=(1,), marks=str(marks))))
    why = "NotImplementedError: group 1 is not for this machine (while preparing 'group 1')"
    assert done.quarantined == {f"number {n}": why for n in range(6, 12)}
    assert [int(row["number"]) for row in table(tmp_path / "out")] == list(range(6))
    assert f"`number 6`: {why}" in (tmp_path / "out" / "report.md").read_text()
    assert (marks / "preparations.log").read_text() == "group 1\n"


def test_results_have_their_origin_beside_them(tmp_path: Path) -> None:
    runs.run(request(tmp_path / "out", command=("jaxplan", "experiment", NAME)))
    assert [float(row["root"]) for row in table(tmp_path / "out")] == [math.sqrt(n) for n in range(12)]
    found = json.loads((tmp_path / "out" / "provenance.json").read_text())
    assert found["seed"] == 0
    assert [run["command"] for run in found["runs"]] == [f"jaxplan experiment {NAME}"]
    assert found["runs"][0]["versions"]["jax"]
    assert set(found["results"]) == {"results.csv", "table.tex", "report.md"}
    assert found["results"]["results.csv"] == runs.sha256(tmp_path / "out" / "results.csv")


def test_a_folder_that_holds_something_else_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "out"
    runs.run(request(out))
    kept = (out / "results.csv").read_bytes()
    with pytest.raises(InputError, match="holds results already; go on with --resume"):
        runs.run(request(out))
    with pytest.raises(InputError, match="another configuration .count is 12 there and 5 here"):
        runs.run(request(out, Config(count=5), resume=True))
    with pytest.raises(
        InputError, match=r"another configuration .experiment is 'oracles.experiment_samples' there and 'table1' here"
    ):
        Store(out, "table1", "small", {}, resume=True)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("")
    with pytest.raises(InputError, match="holds other files"):
        runs.run(request(tmp_path / "other"))
    with pytest.raises(InputError, match="is a file"):
        runs.run(request(tmp_path / "other" / "thesis.tex"))
    runs.run(request(out, resume=True))
    assert (out / "results.csv").read_bytes() == kept


def test_two_runs_do_not_share_a_folder(tmp_path: Path) -> None:
    with Store(tmp_path, NAME, "smoke", {}, resume=False), pytest.raises(ResourceError, match="another run"):
        Store(tmp_path, NAME, "smoke", {}, resume=True)


def test_a_damaged_shard_is_named(tmp_path: Path) -> None:
    runs.run(request(tmp_path))
    path = tmp_path / "shards" / "000001.json"
    path.write_text(path.read_text()[:50])
    with pytest.raises(FileError, match=r"000001.json: is damaged; delete it"):
        runs.run(request(tmp_path, resume=True))
    path.unlink()
    runs.run(request(tmp_path, resume=True))
    assert len(table(tmp_path)) == 12
    assert len(json.loads((tmp_path / "provenance.json").read_text())["runs"]) == 2


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_an_interrupted_run_goes_on(tmp_path: Path, how: signal.Signals) -> None:
    """kill -9 and Ctrl-C: what was finished is not evaluated again, and the results are those of a quiet run."""
    marks, out = tmp_path / "marks", tmp_path / "out"
    marks.mkdir()
    line = command(NAME, "--preset", "small", "--sleep", 0.15, "--marks", marks, "--out", out, "--workers", 0)
    with subprocess.Popen(line, env=environment(), stderr=subprocess.PIPE, text=True) as process:
        while len(list((out / "shards").glob("[0-9]*.json"))) < 2:
            assert process.poll() is None
            time.sleep(0.02)
        process.send_signal(how)
        _, said = process.communicate(timeout=60)
    assert process.returncode == (-9 if how == signal.SIGKILL else 130)
    assert how == signal.SIGKILL or f"go on with: jaxplan experiment {NAME} --out {out} --resume" in said
    assert not (out / "results.csv").exists()
    done = called(NAME, "--out", out, "--resume", "--workers", 0)
    assert done.returncode == 0, done.stderr
    counts = [len((marks / f"{n}.txt").read_text().splitlines()) for n in range(12)]
    assert counts[:6] == [1] * 6
    assert sum(counts) - 12 <= EXPERIMENT.shard_size
    quiet = tmp_path / "quiet"
    runs.run(request(quiet))
    assert (out / "results.csv").read_bytes() == (quiet / "results.csv").read_bytes()


def test_a_full_disk_is_said_and_what_is_finished_stays(tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = (NAME, "--preset", "small", "--padding", 9000, "--out", out, "--workers", 0)
    done = called(*arguments, prefix="export PYTHONDONTWRITEBYTECODE=1; ulimit -f 8")
    assert done.returncode == 12
    assert "cannot write in" in done.stderr
    assert "what is finished there stays valid" in done.stderr
    assert len(done.stderr.strip().splitlines()[-1].splitlines()) == 1
    assert len(list((out / "shards").glob("[0-9]*.json"))) == 2
    assert called(*arguments, "--resume").returncode == 0
    assert len(table(out)) == 12


BAD = [
    (["nosuch"], 10, "unknown name 'nosuch', want one of table1"),
    (["no.such"], 10, "'no.such' is no module with an EXPERIMENT"),
    (["--preset", "smoke"], 10, "want a name; see: jaxplan experiment --list"),
    ([NAME, "--preset", "huge"], 10, "--preset: have 'huge', want one of smoke, small, full"),
    ([NAME, "--nosuch", "1"], 2, "--nosuch"),
    ([NAME, "--count", "1.5"], 2, "--count"),
    ([NAME, "--count", "0"], 10, "--count: have 0, want at least 1"),
    ([NAME, "--workers", "-1"], 10, "--workers: have -1, want 0 or more"),
    ([NAME, "--workers", "2", "--scheduler", "tcp://a:1"], 10, "have both, want one"),
    ([NAME, "--preset", "smoke", "--config", "x.json"], 10, "have both, want one"),
    ([NAME, "--config", "nosuch.json"], 11, "nosuch.json: cannot be read"),
    (["table1", "--planners", "nosuch"], 10, "--planners: have 'nosuch', want some of no-policy"),
    (["table1", "--predictors", "noisy-x"], 10, "--predictors: have 'noisy-x'"),
    (["table1", "--worlds", "env9"], 10, "--worlds: have 'env9', want some of env1, env2, env3"),
    (["table1", "--episodes", "3001"], 10, "want 1 to 3000"),
    (["table1", "--speeds", "-1"], 10, "--speeds: have (-1.0,)"),
    (["table2", "--cycles", "0"], 10, "want at least one, of at least 1"),
    (["trajectories", "--moments", "0"], 10, "want 1 to 24"),
]


@pytest.mark.parametrize(("arguments", "code", "text"), BAD, ids=lambda value: str(value)[:40])
def test_bad_input_is_one_line(
    arguments: list[str],
    code: int,
    text: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    from jaxplan import cli

    monkeypatch.chdir(tmp_path)
    assert cli.run(["experiment", *arguments]) == code
    said = capsys.readouterr()
    assert text in said.err
    assert len(said.err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_flags_change_fields_of_the_preset(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    from jaxplan import cli

    out, again = tmp_path / "out", tmp_path / "again"
    line = ["experiment", NAME, "--workers", "0"]
    assert cli.run([*line, "--preset", "full", "--raising", "1", "2", "--out", str(tmp_path / "b")]) == 14
    assert len(table(tmp_path / "b")) == 46
    assert cli.run([*line, "--preset", "full", "--seed", "3", "--out", str(out)]) == 0
    saved = json.loads((out / "config.json").read_text())
    assert (saved["preset"], saved["config"]["count"], saved["config"]["seed"]) == ("full", 48, 3)
    assert cli.run([*line, "--config", str(out / "config.json"), "--out", str(again)]) == 0
    assert (again / "results.csv").read_bytes() == (out / "results.csv").read_bytes()
    assert cli.run([*line, "--config", str(out / "config.json"), "--seed", "4", "--out", str(tmp_path / "c")]) == 0
    assert (tmp_path / "c" / "results.csv").read_bytes() != (out / "results.csv").read_bytes()
    assert "sum " in capsys.readouterr().out


def test_the_list_names_every_experiment_and_each_explains_its_fields(capsys: pytest.CaptureFixture) -> None:
    from jaxplan import cli
    from jaxplan.runner.registry import experiment_names

    assert cli.run(["experiment", "--list"]) == 0
    said = capsys.readouterr().out
    for name in experiment_names():
        found = load_experiment(name)
        assert f"  {name} " in said
        assert found.summary in said
        assert set(found.presets) == {"smoke", "small", "full"}
        reserved = {"preset", "config", "workers", "scheduler", "out", "resume", "debug"}
        assert not reserved & set(as_plain(found.presets["smoke"]))
    assert cli.run(["experiment", "table1", "--help"]) == 0
    assert "--episodes" in capsys.readouterr().out
