"""What the shipped mixtures are worth: on stored targets, on recorded flights, in the loop."""

import json

import numpy as np
import pytest

from benchmarks import bench_prediction
from experiments.figures.prediction import draw_predictions
from experiments.prediction_comparison import AHEAD, as_markdown, panels, rows_of
from experiments.prediction_windows import recorded_windows, stored_windows
from jaxplan import interception
from jaxplan.config import InterceptConfig
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.target_model import shipped_model
from jaxplan.world.load import ENVIRONMENTS, load_world


def compared(column, windows, dt, model, world):
    kinds = ("gmm", "constant-velocity", "ground-truth")
    return {row["predictor"]: row for row in rows_of(column, windows, dt, model, world, kinds=kinds)}


@pytest.mark.parametrize("world", ENVIRONMENTS)
def test_mixtures_beat_constant_velocity_on_held_out_targets(world):
    """A final error at least 30 % smaller; the 90 % region honest, within what 150 windows can tell."""
    dt = PredictionConfig.for_world(load_world(world)).dt
    windows = stored_windows(world, dt, 150, np.random.default_rng(0))
    rows = compared(world, windows, dt, shipped_model(world, dt), load_world(world))
    assert rows["gmm"]["fde_m"] < 0.7 * rows["constant-velocity"]["fde_m"]
    assert rows["gmm"]["ade_m"] < 0.7 * rows["constant-velocity"]["ade_m"]
    assert rows["gmm"]["nll"] < rows["constant-velocity"]["nll"]
    assert 0.80 < rows["gmm"]["coverage_90"] < 0.99
    assert rows["ground-truth"]["fde_m"] == 0.0


def test_recorded_flights_are_predicted(examples):
    """Figure eights of a real vehicle, with the generic mixture."""
    windows = recorded_windows(examples / "flights" / "cs2_log202.csv", 60, np.random.default_rng(0))
    rows = compared("cs2", windows, 0.1, shipped_model("generic", 0.1), None)
    assert rows["gmm"]["ade_m"] <= rows["constant-velocity"]["ade_m"]


def test_the_table_and_the_picture(tmp_path):
    rows = [{"column": "env1", "predictor": "none", "windows": 3, "ade_m": 1.0, "fde_m": 2.0, "nll": None}]
    rows[0] |= {"coverage_50": None, "coverage_90": None, "ms": 0.1} | {f"error_{at:g}s_m": at for at in AHEAD}
    assert "| ADE / FDE [m] | env1 (3) | ms |\n|---|---|---|\n| none | 1.00 / 2.00 | 0.10 |" in as_markdown(rows)
    assert "| none | - / - / - | 0.10 |" in as_markdown(rows)
    shown = list(panels("env1"))
    assert [len(panel.goals) for panel in shown] == [20, 20, 400, 400, 400, 400]
    assert all(panel.usable.any() for panel in shown)
    draw_predictions([(load_world("env1"), shown)], tmp_path / "p.png")
    assert (tmp_path / "p.png").stat().st_size > 20_000


def test_the_benchmark_runs_and_compiles_nothing_after_the_first_call(tmp_path, capsys):
    bench_prediction.main(["--repeats", "3", "--json", str(tmp_path / "rows.json")])
    rows = json.loads((tmp_path / "rows.json").read_text())["rows"]
    ways = ("compiled", "predictor", "scipy", "fused", "imm", "particles", "mdn", "ensemble")
    assert {row["way"]: row["compilations"] for row in rows} == dict.fromkeys(ways, 0)
    assert "predictor" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("world", ENVIRONMENTS)
def test_the_mixture_intercepts(world):
    result = interception.run(InterceptConfig(world=world, predictor="gmm"))
    assert result.outcome == "intercepted"
    assert result.compilations_after_warmup == 0
