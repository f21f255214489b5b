"""The experiment and the benchmark of the plant, at their smallest."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.figures.scale_factor import draw_scale_factor


def test_the_picture_is_drawn_from_the_rows(tmp_path: Path) -> None:
    keys = ("position_mean_m", "position_std_m", "yaw_mean_deg", "yaw_std_deg", "feasible_share", "lost_share")
    rows = [{"alpha": alpha, **dict.fromkeys(keys, 1.0 / alpha)} for alpha in (0.7, 1.0, 2.0)]
    draw_scale_factor(rows, tmp_path / "a.png", position=0.2, yaw=15.0)
    assert (tmp_path / "a.png").stat().st_size > 10_000


@pytest.mark.slow
def test_slower_flights_have_smaller_errors() -> None:
    from experiments.scale_factor import EXPERIMENT, Config

    rows = EXPERIMENT.evaluate(Config(count=8), EXPERIMENT.items(Config(count=8))[0])["rows"]
    errors = {row["alpha"]: row["position_mean_m"] for row in rows}
    assert errors[0.7] > errors[1.0] > errors[1.4] > errors[2.0]
    assert rows[-1]["feasible_share"] == 1.0


@pytest.mark.slow
def test_the_benchmark_runs(tmp_path: Path) -> None:
    from benchmarks.bench_plant import main

    assert (
        main(["--batches", "4", "--seconds", "0.5", "--repeats", "1", "--peers", "0", "--json", f"{tmp_path}/a.json"])
        == 0
    )
    report = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert [row["flights_per_s"] > 0.0 for row in report["rows"] if "flights_per_s" in row] == [True] * 3
    assert [row["steps_per_s"] > 0.0 for row in report["rows"] if "steps_per_s" in row] == [True] * 2


_GROWTH = """
import resource
import numpy as np
from jaxplan.minsnap.single import minimum_snap
from jaxplan.tracking.track import track

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

spline = minimum_snap(np.array([[0.0, 0.0, 1.0], [1.0, 0.5, 1.0]]), np.array([1.5]))
for count in (256, 512, 4096):
    result = track([spline] * count)
    assert result.feasible.all() and len(result.feasible) == count
    print(peak())
"""


@pytest.mark.slow
def test_memory_does_not_grow_with_the_number_of_flights() -> None:
    """Peak memory [MiB] of a process of its own, after 256, 512 and 4096 flights."""
    done = subprocess.run([sys.executable, "-c", _GROWTH], capture_output=True, text=True, timeout=500, check=True)
    few, more, many = map(float, done.stdout.split())
    print(f"peak memory {few:.0f} MiB after 256 flights, {more:.0f} MiB after 512, {many:.0f} MiB after 4096")
    assert many - few < 32.0  # the logs of 3840 more flights of 300 steps would take 85 MiB
