"""The benchmark of whole cycles runs, at its smallest."""

import json

import pytest

from benchmarks import bench_cycle


@pytest.mark.slow
def test_stages_add_up_to_cycles_that_are_the_same_in_every_flight(tmp_path):
    out = tmp_path / "rows.json"
    sizes = ("--worlds", "env1", "--predictors", "fused", "--targets", "1", "--repeats", "2", "--draws", "20", "40")
    bench_cycle.main([*sizes, "--json", str(out)])
    every_row = json.loads(out.read_text())["rows"]
    assert {row["candidates"] for row in every_row} == {400, 800}
    rows = {row["what"]: row for row in every_row if row["candidates"] == 400}
    assert {"whole cycle", "whole cycle, least", "predict", "refine"} <= set(rows)
    assert all(row["cycles"] >= 5 and row["flights"] == 2 and row["candidates"] == 400 for row in rows.values())
    stages = sum(row["mean_ms"] for what, row in rows.items() if not what.startswith("whole"))
    least, every = rows["whole cycle, least"]["mean_ms"], rows["whole cycle"]["mean_ms"]
    assert stages <= least * (1.0 + 1e-9)
    assert least <= every
    assert stages == pytest.approx(least, rel=0.5), "no stage is missing"
