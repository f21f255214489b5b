"""The experiment and the benchmark of the plant, at their smallest."""

import json
from pathlib import Path

import pytest

from jaxplan.viz.scale_factor import draw_scale_factor


def test_the_picture_is_drawn_from_the_rows(tmp_path: Path) -> None:
    keys = ("position_mean_m", "position_std_m", "yaw_mean_deg", "yaw_std_deg", "feasible_share", "lost_share")
    rows = [{"alpha": alpha, **dict.fromkeys(keys, 1.0 / alpha)} for alpha in (0.7, 1.0, 2.0)]
    draw_scale_factor(rows, tmp_path / "a.png", position=0.2, yaw=15.0)
    assert (tmp_path / "a.png").stat().st_size > 10_000


@pytest.mark.slow
def test_slower_flights_have_smaller_errors(tmp_path: Path) -> None:
    from experiments.scale_factor import main

    main(count=8, out=tmp_path)
    rows = json.loads((tmp_path / "scale_factor.json").read_text(encoding="utf-8"))["rows"]
    errors = {row["alpha"]: row["position_mean_m"] for row in rows}
    assert errors[0.7] > errors[1.0] > errors[1.4] > errors[2.0]
    assert rows[-1]["feasible_share"] == 1.0
    assert (tmp_path / "scale_factor.png").is_file()


@pytest.mark.slow
def test_the_benchmark_runs(tmp_path: Path) -> None:
    from benchmarks.bench_plant import main

    assert (
        main(["--batches", "4", "--seconds", "0.5", "--repeats", "1", "--peers", "0", "--json", f"{tmp_path}/a.json"])
        == 0
    )
    report = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert [row["flights_per_s"] > 0.0 for row in report["rows"] if "flights_per_s" in row] == [True] * 3
