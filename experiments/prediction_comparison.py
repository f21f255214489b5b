"""Compare the predictors: the paper's figure of its prediction models, and how far each is from what happens.

    jaxplan experiment prediction-comparison --preset smoke|small|full [--flights FOLDER] [--noises 0 0.1]

Windows of ten observed and twenty future positions are cut from the ten stored targets of each environment, at ten
maximum speeds from 0.5 to 5.5 m/s each, and a tenth as many of new, fast flights; none was used to fit a mixture.
Recorded flights are resampled to 0.1 s and predicted with the generic mixture.
"""

import dataclasses
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from jaxplan.config import WITH_MODEL
from jaxplan.errors import InputError
from jaxplan.io.targets import load_target
from jaxplan.precision import in_float64
from jaxplan.prediction.candidates import reject_early
from jaxplan.prediction.mixture import Prediction
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.predictors import PREDICTORS, build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.scores import observe_windows, score
from jaxplan.prediction.target_model import TargetModel, shipped_model
from jaxplan.records import replace
from jaxplan.runner.definition import Experiment, Item, Report, Results, Row
from jaxplan.runner.tables import as_latex, number
from jaxplan.runner.tables import as_markdown as markdown_table
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.reach import reach
from jaxplan.world.load import ENVIRONMENTS, load_world
from jaxplan.world.obstacles import World

from . import SUMMARIES
from .figures.prediction import PredictionPanel, draw_predictions
from .prediction_windows import (
    FLIGHT_INTERVAL,
    SPEEDS,
    as_seen,
    fast_windows,
    new_room,
    recorded_windows,
    room_windows,
    stored_windows,
)

AHEAD = (0.4, 1.0, 2.0)
"""Seconds ahead at which the errors are told."""
MOMENTS = {"env1": ("env1-05", 2.5, 9.4), "env2": ("env2-07", 3.0, 17.8), "env3": ("env3-06", 3.0, 24.8)}
"""Target, maximum speed [m/s] and time [s] that the picture shows."""
SHOWN = ("constant-velocity", "ground-truth", "noisy", "gmm", "particles", "fused")
NEW_ROOM = "new room "
"""And a number: a column."""
PADDING = 0.5
"""As in ``PlannerConfig``: clearance of goals [m]."""


def rows_of(
    name: str,
    windows: Float[np.ndarray, "k length 3"],
    dt: float,
    model: TargetModel,
    world: World | None,
    *,
    observed: int = 10,
    noise: float = 0.0,
    dropouts: float = 0.0,
    kinds: Sequence[str] = tuple(PREDICTORS),
) -> Iterator[Row]:
    """Predictors of these ``kinds`` on the windows of a column; of each the first ``observed`` positions were seen."""
    config = PredictionConfig(dt=dt)
    future: dict[str, Float[np.ndarray, "steps 3"]] = {}
    seen, futures = observe_windows(windows, observed, dt)
    seen = as_seen(seen, noise, dropouts, np.random.default_rng(0))
    steps = futures.shape[1]
    whole = np.concatenate([futures, np.repeat(futures[:, -1:], config.steps - steps, axis=1)], axis=1)
    for kind in kinds:
        predictor = build_predictor(kind, config, lambda times: future["positions"], model=model, world=world)
        predictions, spent = [], []
        future["positions"] = whole[0]
        predictor(seen[0], 0)  # compile
        for index, observations in enumerate(seen):
            future["positions"] = whole[index]
            began = time.perf_counter()
            predictor(observations, index)
            spent.append(1e3 * (time.perf_counter() - began))
            predictions.append(_first(predictor.predict(observations), steps))
        scores = score(predictions, futures)
        ahead = {f"error_{at:g}s_m": float(scores.errors[:, round(at / dt) - 1].mean()) for at in AHEAD}
        told = {"windows": len(windows), "noise_m": noise, "dropouts": dropouts}
        timing = {"ms": float(np.median(spent))}
        yield {"column": name, "predictor": kind, **told, **scores.summary(), **ahead, **timing}


def _first(prediction: Prediction, steps: int) -> Prediction:
    """Its first steps."""
    return replace(
        prediction,
        offsets=prediction.offsets[:steps],
        means=prediction.means[:steps],
        factors=prediction.factors[:steps],
    )


def panels(world: str) -> Iterator[PredictionPanel]:
    """What the predictors propose at the moment shown, for a defender where the world's defender starts."""
    name, speed, now = MOMENTS[world]
    room = load_world(world)
    config = PredictionConfig.for_world(room)
    target = load_target(name, world=world, speed=speed)
    times = now + config.dt * np.arange(1 - config.observations, 1)
    seen = Observations(times=times, positions=target.position(times))
    future = target.position(now + np.linspace(0.0, config.offsets[-1], 100))
    rejected, farthest = in_float64(jax.jit(reject_early, static_argnums=3)), in_float64(jax.jit(reach))
    for kind in SHOWN:
        model = shipped_model(world, config.dt) if kind in WITH_MODEL else None
        candidates = build_predictor(kind, config, target.position, model=model, world=room)(seen, 0)
        within = farthest(load_vehicle(), np.float64(0.0), np.asarray(candidates.arrival_times))
        reasons = np.asarray(rejected(candidates, room, np.asarray(room.start), PADDING, within).reasons)
        title = f"{world}, {kind}: {np.count_nonzero(reasons == 0)} of {len(reasons)} usable"
        goals, times = np.asarray(candidates.goals), np.asarray(candidates.arrival_times)
        yield PredictionPanel(title, goals, times, reasons == 0, seen.positions, future)


def as_markdown(rows: list[Row]) -> str:
    """Tables, predictors by columns: how far off, at the end and on the way, and how honest."""
    columns = {row["column"]: row["windows"] for row in rows}
    cells = {(row["predictor"], row["column"]): row for row in rows}
    predictors = dict.fromkeys(row["predictor"] for row in rows)
    lines = []
    for title, keys, digits in (
        ("ADE / FDE [m]", ("ade_m", "fde_m"), 2),
        (
            "Mean error [m] 0.4, 1 and 2 s ahead",
            tuple(f"error_{at:g}s_m" for at in AHEAD),
            2,
        ),
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


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """How many windows are predicted, of which flights."""

    windows: int = 1000
    """Windows of each column; a tenth of them at each speed."""

    fast: tuple[float, ...] = (4.0, 6.0, 8.0)
    """Maximum speeds [m/s] of new flights through the first two environments; none: stored targets only."""

    rooms: int = 0
    """Random rooms that nobody trained in, with new flights at up to 8 m/s."""

    noises: tuple[float, ...] = (0.0,)
    """Standard deviations [m] of the positions seen."""

    dropouts: float = 0.0
    """Share of the positions that is missing, but for the newest."""

    flights: str | None = None
    """A folder with recorded flights (.csv). Default: stored targets only."""

    seed: int = 0
    """Seed of the choice of windows."""

    def __post_init__(self) -> None:
        if self.windows < len(SPEEDS) or self.seed < 0:
            raise InputError(f"--windows {self.windows} --seed {self.seed}: want at least {len(SPEEDS)} and at least 0")
        if not self.noises or not all(0.0 <= noise < np.inf for noise in self.noises) or not 0.0 <= self.dropouts < 1.0:
            have = f"--noises {' '.join(map(str, self.noises))} --dropouts {self.dropouts}"
            raise InputError(f"{have}: want standard deviations of 0 m or more, and a share below 1")
        if not all(0.0 < speed <= 50.0 for speed in self.fast):
            raise InputError(f"--fast {' '.join(map(str, self.fast))}: want speeds above 0 and up to 50 m/s")
        if self.rooms < 0:
            raise InputError(f"--rooms {self.rooms}: want 0 or more")
        if self.flights is not None and not Path(self.flights).is_dir():
            raise InputError(f"--flights: have {self.flights!r}, want a folder that exists")


def items(config: Config) -> list[Item]:
    """A column each: the environments, fast flights in them, new rooms and recorded flights, with every noise."""
    paths = sorted(Path(config.flights).glob("*.csv")) if config.flights else []
    places = [(name, None) for name in ENVIRONMENTS]
    places += [(name, speed) for name in ENVIRONMENTS[:2] for speed in config.fast]
    places += [(f"{NEW_ROOM}{number}", None) for number in range(config.rooms)]
    places += [(str(path), None) for path in paths if "obstacles" not in path.stem]
    found = []
    for place, speed in places:
        for noise in config.noises:
            title = Path(place).stem + (f" at {speed:g} m/s" if speed else "") + (f", {noise:g} m" if noise else "")
            found.append(Item(title, title, {"column": place, "title": title, "speed": speed, "noise": noise}))
    return found


def evaluate(config: Config, item: Item) -> Row:
    """Errors of every predictor on one column."""
    column, speed = item.values["column"], item.values["speed"]
    title, rng = item.values["title"], np.random.default_rng(config.seed)
    seen: dict[str, Any] = {"noise": item.values["noise"], "dropouts": config.dropouts}
    if column.startswith(NEW_ROOM):
        number = int(column.removeprefix(NEW_ROOM))
        world = new_room(number)
        dt = PredictionConfig.for_world(world).dt
        cut = room_windows(world, dt, number, config.windows)
        return {"rows": list(rows_of(title, cut, dt, shipped_model("generic", dt), world, **seen))}
    if column not in ENVIRONMENTS:
        cut, generic = recorded_windows(Path(column), config.windows, rng), shipped_model("generic", FLIGHT_INTERVAL)
        return {"rows": list(rows_of(title, cut, FLIGHT_INTERVAL, generic, None, **seen))}
    world = load_world(column)
    dt = PredictionConfig.for_world(world).dt
    if speed is None:
        cut = stored_windows(column, dt, config.windows, rng)
    else:
        cut, seen["observed"] = fast_windows(world, dt, speed, max(1, config.windows // len(SPEEDS)), rng)
    return {"rows": list(rows_of(title, cut, dt, shipped_model(column, dt), world, **seen))}


def report(results: Results[Config]) -> Report:
    """Two tables, and the picture of what each predictor proposes."""
    rows = [line for row in results.finished_rows() for line in row["rows"]]
    shown = [(load_world(world), list(panels(world))) for world in ENVIRONMENTS]
    header = ["column, predictor", "ADE [m]", "FDE [m]"]
    errors = [[f"{r['column']}, {r['predictor']}", number(r["ade_m"], ".2f"), number(r["fde_m"], ".2f")] for r in rows]
    return Report(
        markdown=as_markdown(rows) + "\n![what the predictors propose](prediction.png)\n",
        table=rows,
        latex=as_latex(header, errors, "Mean and final errors of the predictors"),
        figures={"prediction.png": lambda path: draw_predictions(shown, path)},
        summary=markdown_table(header, errors),
    )


EXPERIMENT = Experiment(
    summary=SUMMARIES["prediction-comparison"],
    presets={"smoke": Config(windows=20, fast=(6.0,)), "small": Config(), "full": Config(windows=10000)},
    items=items,
    evaluate=evaluate,
    report=report,
)
