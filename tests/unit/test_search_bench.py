"""The benchmark of the search runs, at a tiny size, from the command line too."""

import json
from pathlib import Path

import pytest

from benchmarks import bench_search
from jaxplan.cli import run


def test_benchmark_runs_and_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "search.json"
    bench_search.main(["--cycles", "2", "--peers", "1", "--worlds", "env1", "--pairs", "100", "--json", str(out)])
    written = json.loads(out.read_text())
    methods = {row["method"] for row in written["rows"]}
    assert methods >= {"quality", "prepare", "routes", "knots", "routes + knots", "scipy", "update"}
    quality = {row["search"]: row for row in written["rows"] if row["method"] == "quality"}
    assert quality["roadmap"]["excess_mean_percent"] < min(3.0, quality["multi-resolution"]["excess_mean_percent"])
    assert quality["roadmap"]["missed"].startswith("0 of ")
    assert {"processor", "versions", "commit"} <= set(written["machine"])
    assert "routes + knots" in capsys.readouterr().out


def test_the_command_line_starts_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command hands the file on; what runs is above."""
    asked: list[list[str]] = []
    monkeypatch.setattr(bench_search, "main", lambda arguments: asked.append(arguments))
    assert run(["bench", "search", "--json", str(tmp_path / "rows.json")]) == 0
    assert asked == [["--json", str(tmp_path / "rows.json")]]
