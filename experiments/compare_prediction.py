"""Compare the predictors: the paper's figure of its prediction models, and how far each is from what happens.

    python -m experiments.compare_prediction --out out/prediction

Windows of ten observed and twenty future positions are cut from the ten stored targets of each environment, at ten
maximum speeds from 0.5 to 5.5 m/s each; none of these flights was used to fit a mixture. Recorded flights are resampled
to 0.1 s and predicted with the generic mixture; those are skipped where the folder is absent. The table goes to
``prediction.json`` and ``prediction.md``, the picture to ``prediction.png``.
"""

import json
import time
from pathlib import Path

import cyclopts
import jax
import numpy as np

from jaxplan.io.target_log import read_target_log, resample
from jaxplan.io.targets import load_target, stored_targets
from jaxplan.numerics import in_float64
from jaxplan.prediction.candidates import reject_early
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.predictors import PREDICTORS, PredictionConfig, build_predictor
from jaxplan.prediction.scores import observe_windows, score
from jaxplan.prediction.target_model import shipped_model
from jaxplan.viz.prediction import PredictionPanel, draw_predictions
from jaxplan.world.scene import load_world

INTERVALS = {"env1": 0.1, "env2": 0.2, "env3": 0.2}
"""Seconds between predictions (paper, Sec. IV)."""
SPEEDS = np.linspace(0.5, 5.5, 10)
FLIGHT_INTERVAL = 0.1
MOMENTS = {"env1": ("env1-05", 2.5, 9.4), "env2": ("env2-07", 3.0, 17.8), "env3": ("env3-06", 3.0, 24.8)}
"""Target, maximum speed [m/s] and time [s] that the picture shows."""
SHOWN = ("constant-velocity", "ground-truth", "noisy", "gmm")
PADDING, MAX_SPEED = 0.5, 8.0
"""As in ``PlannerConfig``: clearance of goals [m], and the speed [m/s] that says what is out of reach."""


def stored_windows(world, dt, count, rng, length=30):
    """``count`` windows of the stored targets, the same number at every speed."""
    windows = []
    for speed in SPEEDS:
        cuts = []
        for name in stored_targets(world):
            target = load_target(name, world=world, speed=float(speed))
            starts = np.arange(0.0, target.duration - (length - 1) * dt, 0.1)
            times = starts[:, None] + dt * np.arange(length)
            cuts.append(target.position(times.reshape(-1)).reshape(-1, length, 3))
        cuts = np.concatenate(cuts)
        windows.append(cuts[rng.permutation(len(cuts))[: count // len(SPEEDS)]])
    return np.concatenate(windows)


def recorded_windows(path, count, rng, length=30):
    """``count`` windows of a recorded flight, or all there are."""
    even = resample(read_target_log(path), FLIGHT_INTERVAL).positions
    starts = rng.permutation(max(0, len(even) - length + 1))[:count]
    return even[starts[:, None] + np.arange(length)]


def rows_of(name, windows, dt, model, world):
    """Every predictor on the windows of one column."""
    config = PredictionConfig(dt=dt)
    future = {}
    seen, futures = observe_windows(windows, config.observations, dt)
    for kind in PREDICTORS:
        predictor = build_predictor(kind, config, lambda times: future["positions"], model=model, world=world)
        predictions, spent = [], []
        future["positions"] = futures[0]
        predictor(seen[0], 0)  # compile
        for index, observations in enumerate(seen):
            future["positions"] = futures[index]
            began = time.perf_counter()
            predictor(observations, index)
            spent.append(1e3 * (time.perf_counter() - began))
            predictions.append(predictor.predict(observations))
        summary = score(predictions, futures).summary()
        yield {"column": name, "predictor": kind, "windows": len(windows), **summary, "ms": float(np.median(spent))}


def panels(world, dt):
    """What the predictors propose at the moment shown, for a defender where the world's defender starts."""
    name, speed, now = MOMENTS[world]
    room, config = load_world(world), PredictionConfig(dt=dt)
    target = load_target(name, world=world, speed=speed)
    times = now + dt * np.arange(1 - config.observations, 1)
    seen = Observations(times=times, positions=target.position(times))
    future = target.position(now + np.linspace(0.0, config.offsets[-1], 100))
    rejected = in_float64(jax.jit(reject_early, static_argnums=(3, 4)))
    for kind in SHOWN:
        model = shipped_model(world, dt) if kind == "gmm" else None
        candidates = build_predictor(kind, config, target.position, model=model, world=room)(seen, 0)
        reasons = np.asarray(rejected(candidates, room, np.asarray(room.start), PADDING, MAX_SPEED).reasons)
        title = f"{world}, {kind}: {np.count_nonzero(reasons == 0)} of {len(reasons)} usable"
        yield PredictionPanel(title, candidates.goals, candidates.arrival_times, reasons == 0, seen.positions, future)


def as_markdown(rows):
    """Two tables, predictors by columns: how far off, and how honest."""
    columns = {row["column"]: row["windows"] for row in rows}
    cells = {(row["predictor"], row["column"]): row for row in rows}
    predictors = dict.fromkeys(row["predictor"] for row in rows)
    lines = []
    for title, keys, digits in (
        ("ADE / FDE [m]", ("ade_m", "fde_m"), 2),
        ("NLL / share in the 50 % region / in the 90 % region", ("nll", "coverage_50", "coverage_90"), 2),
    ):
        lines += [f"| {title} | {' | '.join(f'{name} ({count})' for name, count in columns.items())} | ms |"]
        lines += ["|---" * (len(columns) + 2) + "|"]
        for kind in predictors:
            mine = [cells[kind, column] for column in columns]
            text = [" / ".join("-" if row[key] is None else f"{row[key]:.{digits}f}" for key in keys) for row in mine]
            spent = np.median([row["ms"] for row in mine])
            lines.append(f"| {kind} | {' | '.join(text)} | {spent:.2f} |")
        lines.append("")
    return "\n".join(lines)


app = cyclopts.App(name="compare_prediction", help=__doc__)


@app.default
def main(
    *,
    windows: int = 1000,
    seed: int = 0,
    flights: Path = Path("../shared/examples/flights"),
    out: Path = Path("out/prediction"),
) -> None:
    """Write the table and the picture."""
    rng = np.random.default_rng(seed)
    rows = []
    for world, dt in INTERVALS.items():
        cut = stored_windows(world, dt, windows, rng)
        rows += rows_of(world, cut, dt, shipped_model(world, dt), load_world(world))
    generic = shipped_model("generic", FLIGHT_INTERVAL)
    for path in sorted(flights.glob("*.csv")) if flights.is_dir() else []:
        if "obstacles" not in path.stem:
            rows += rows_of(path.stem, recorded_windows(path, windows, rng), FLIGHT_INTERVAL, generic, None)
    out.mkdir(parents=True, exist_ok=True)
    command = f"python -m experiments.compare_prediction --windows {windows} --seed {seed}"
    (out / "prediction.json").write_text(json.dumps({"command": command, "rows": rows}, indent=1) + "\n")
    (out / "prediction.md").write_text(as_markdown(rows))
    print(as_markdown(rows))
    draw_predictions(
        [(load_world(world), list(panels(world, dt))) for world, dt in INTERVALS.items()], out / "prediction.png"
    )
    print(f"picture in {out / 'prediction.png'}")


if __name__ == "__main__":
    app()
