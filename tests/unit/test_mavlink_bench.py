"""The benchmark of the MAVLink streamer runs, and finds that all of it arrives."""

import json
from pathlib import Path

import pytest

from benchmarks import bench_mavlink

pytest.importorskip("pymavlink")


@pytest.mark.slow
def test_the_stream_is_measured(tmp_path: Path) -> None:
    out = tmp_path / "mavlink.json"
    bench_mavlink.main(["--seconds", "2", "--json", str(out)])
    (row,) = json.loads(out.read_text())["rows"]
    assert row["decoded"] == row["exact"] == 1.0
    assert row["came"] == row["sent"] > 80
