"""The benchmark of the search runs, at a tiny size."""

import json
from pathlib import Path

import pytest

from benchmarks.bench_search import main


def test_benchmark_runs_and_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("skimage")
    out = tmp_path / "search.json"
    main(["--cycles", "2", "--peers", "1", "--worlds", "env1", "--out", str(out)])
    rows = json.loads(out.read_text())["worlds"]["env1"]["ms"]
    assert set(rows) == {"routes", "knots", "routes + knots", "scipy", "skimage"}
    assert "routes + knots" in capsys.readouterr().out
