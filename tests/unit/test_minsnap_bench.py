"""The benchmarks run at a tiny size, so that they cannot rot."""

import json

import pytest

from benchmarks import bench_minsnap, bench_time_allocation


@pytest.mark.slow
def test_minsnap_benchmark(tmp_path):
    result, picture = tmp_path / "rows.json", tmp_path / "picture.png"
    bench_minsnap.main(
        ["--waypoints", "3", "--batches", "2", "--repeats", "1", "--json", str(result), "--picture", str(picture)]
    )
    written = json.loads(result.read_text())
    assert {"processor", "versions", "commit"} <= set(written["machine"])
    assert any("times faster than scipy banded" in row for row in written["rows"])
    assert picture.stat().st_size > 1000


@pytest.mark.slow
def test_time_allocation_benchmark(tmp_path):
    result = tmp_path / "rows.json"
    bench_time_allocation.main(["--waypoints", "3", "--batches", "2", "--repeats", "1", "--json", str(result)])
    assert {row["method"] for row in json.loads(result.read_text())["rows"]} >= {"weighted", "fixed", "fastest"}
