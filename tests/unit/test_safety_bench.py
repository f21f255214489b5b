"""The benchmark of what safety costs runs, at its smallest."""

import json

import pytest

from benchmarks import bench_safety


@pytest.mark.slow
def test_looks_and_flights_are_part_of_a_cycle(tmp_path):
    out = tmp_path / "rows.json"
    bench_safety.main(["--worlds", "env1", "--departures", "0.5", "--targets", "1", "--json", str(out)])
    rows = {row["what"]: row for row in json.loads(out.read_text())["rows"]}
    assert set(rows) == {"looks", "flights", "both", "whole cycle"}
    assert all(row["cycles"] >= 5 for row in rows.values())
    assert 0.0 < rows["flights"]["p50_ms"] <= rows["both"]["p50_ms"] < rows["whole cycle"]["p50_ms"]
