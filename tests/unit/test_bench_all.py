"""All benchmarks in one go: what is compared, when it fails, what the page says; two real ones at a tiny size."""

import json
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

from benchmarks import _page, _ratios, bench_all
from jaxplan.cli import bench as cli_bench
from jaxplan.cli import run
from jaxplan.errors import FileError, InputError

MACHINE = {"processor": "made up", "cores": 2, "python": "3.11", "versions": {"jax": "0"}, "commit": "c" * 40}
MACHINE["load_average"] = 0.5


def made_up(ours: float = 2.0, later: float = 5.0) -> dict[str, Any]:
    """A run of three benchmarks."""
    row = {"waypoints": 14, "batch": 400}
    rows = {
        "minsnap": [
            {"method": "scipy banded", "waypoints": 14, "ms_per_problem": 10.0},
            {"method": "solve", **row, "dtype": "float32", "ms_per_problem": 9.0},
            {"method": "solve", **row, "dtype": "float64", "ms_per_problem": ours},
        ],
        "plant": [
            {"method": "track, indi", "batch": 256, "flights_per_s": 30.0},
            {"method": "C MuJoCo, body only, 2 threads", "batch": 256, "flights_per_s": 10.0},
        ],
        "start": [
            {"start": kind, "cpu_s": cpu, "wall_s": cpu, "memory_mb": 1.0, "peak_mb": 2.0}
            for kind, cpu in (("first", 50.0), ("later", later))
        ],
    }
    benchmarks = {
        name: {"rows": of, "seconds": 1.0, "load_average": 0.5, "sizes": ["--size", "1"]} for name, of in rows.items()
    }
    return {"machine": MACHINE, "benchmarks": benchmarks, "history": []}


def test_ratios_say_how_many_times_as_fast() -> None:
    found = bench_all.ratios_of(made_up())
    assert sorted(found.values()) == [3.0, 5.0, 10.0]  # a rate, a time, processor time
    rows = {"minsnap": made_up()["benchmarks"]["minsnap"]["rows"][:1]}
    assert _ratios.measured(rows) == []  # without ours there is no ratio


def test_names_of_ratios_are_not_shared_and_belong_to_benchmarks() -> None:
    assert len({_ratios.key(ratio) for ratio in _ratios.RATIOS}) == len(_ratios.RATIOS)
    assert {ratio.benchmark for ratio in _ratios.RATIOS} <= set(bench_all.SIZES)


def test_every_benchmark_is_run_and_known_to_the_command(repository: Path) -> None:
    files = {
        path.stem.removeprefix("bench_").replace("_", "-") for path in (repository / "benchmarks").glob("bench_*.py")
    }
    assert files == {*bench_all.SIZES, "all"} == set(get_args(get_type_hints(cli_bench)["name"]))


def test_what_fell_by_more_than_half_is_a_regression() -> None:
    then = bench_all.ratios_of(made_up(ours=2.0))
    assert bench_all.regressions(bench_all.ratios_of(made_up(ours=3.9)), then) == []
    (fallen,) = bench_all.regressions(bench_all.ratios_of(made_up(ours=4.1)), then)
    assert fallen.startswith("minimum snap")
    assert "was 5 times as fast, now 2.44" in fallen
    assert len(bench_all.regressions({}, then)) == 3
    assert len(bench_all.regressions(dict.fromkeys(then, float("nan")), then)) == 3


def test_the_page_tells_numbers_history_and_failures() -> None:
    first = made_up()
    second = {**made_up(ours=4.0), "history": bench_all.remembered(first)}
    second["benchmarks"]["runtime"] = {
        "rows": [], "seconds": 1.0, "load_average": 9.5, "sizes": [], "failed": "no such peer"
    }  # fmt: skip
    text = _page.page(second)
    assert "| **2.5** | 5 |" in text
    assert "at a load of 0.5 to 9.5" in text
    assert "| first | 50.0 |" in text
    assert "no such peer" in text
    assert "The figure to beat" not in text  # what it compares was not measured
    assert len(bench_all.remembered({**first, "history": bench_all.remembered(first) * 40})) == bench_all.KEPT_RUNS


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = {
        "prediction": ("--repeats", "3"), "minsnap": ("--waypoints", "3", "--batches", "2", "--repeats", "1")
    }  # fmt: skip
    monkeypatch.setattr(bench_all, "SIZES", sizes)


@pytest.mark.slow
def test_it_runs_real_ones_and_compares(tmp_path: Path, tiny: None, capsys: pytest.CaptureFixture[str]) -> None:
    kept, page = tmp_path / "all.json", tmp_path / "page.md"
    for runs in (0, 1):
        assert bench_all.main(["--json", str(kept), "--page", str(page)]) == 0
        written = json.loads(kept.read_text())
        assert len(written["history"]) == runs
    assert set(written["benchmarks"]) == {"prediction", "minsnap"}
    assert page.read_text() == _page.page(written)
    (name,) = bench_all.ratios_of(written)
    rows = written["benchmarks"]["prediction"]["rows"]
    rows[:] = [{**row, "median_ms": row["median_ms"] * (1e9 if row["way"] == "scipy" else 1.0)} for row in rows]
    kept.write_text(json.dumps(written))
    assert bench_all.main(["--against", str(kept), "--only", "prediction"]) == bench_all.EXIT_REGRESSION
    assert name in capsys.readouterr().err


def test_a_benchmark_that_fails_is_said_and_the_others_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench_all, "SIZES", {"mavlink": ("--seconds", "nonsense"), "plant": ("--batches",)})
    assert bench_all.main(["--json", str(tmp_path / "all.json")]) == bench_all.EXIT_REGRESSION
    assert capsys.readouterr().err.count("failed: ") == 2
    assert "invalid" in (tmp_path / "all.md").read_text()


def test_bad_arguments_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "rows.json").write_text('{"rows": []}')
    for path in ("missing.json", "rows.json"):
        assert run(["bench", "all", "--against", str(tmp_path / path)]) == FileError.exit_code
    assert run(["bench", "all", "--page", str(tmp_path / "page.md")]) == InputError.exit_code
    assert run(["bench", "minsnap", "--page", str(tmp_path / "page.md")]) == InputError.exit_code
    assert capsys.readouterr().err.count("\n") == 4
