"""Compare the predictors: the paper's figure of its prediction models, and how far each is from what happens.

    jaxplan experiment prediction-comparison --preset smoke|small|full [--flights FOLDER]

Windows of ten observed and twenty future positions are cut from the ten stored targets of each environment, at ten
maximum speeds from 0.5 to 5.5 m/s each; none of these flights was used to fit a mixture. Recorded flights are resampled
to 0.1 s and predicted with the generic mixture.
"""

import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float

from jaxplan.config import WITH_MODEL
from jaxplan.errors import InputError
from jaxplan.io.target_log import read_target_log, resample
from jaxplan.io.targets import load_target, stored_targets
from jaxplan.precision import in_float64
from jaxplan.prediction.candidates import reject_early
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.predictors import PREDICTORS, build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.scores import observe_windows, score
from jaxplan.prediction.target_model import TargetModel, shipped_model
from jaxplan.runner.definition import Experiment, Item, Report, Results, Row
from jaxplan.runner.tables import as_latex, number
from jaxplan.runner.tables import as_markdown as markdown_table
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.reach import reach
from jaxplan.world.load import ENVIRONMENTS, load_world
from jaxplan.world.obstacles import World

from .figures.prediction import PredictionPanel, draw_predictions

SPEEDS = np.linspace(0.5, 5.5, 10)
FLIGHT_INTERVAL = 0.1
MOMENTS = {"env1": ("env1-05", 2.5, 9.4), "env2": ("env2-07", 3.0, 17.8), "env3": ("env3-06", 3.0, 24.8)}
"""Target, maximum speed [m/s] and time [s] that the picture shows."""
SHOWN = ("constant-velocity", "ground-truth", "noisy", "gmm", "particles")
PADDING = 0.5
"""As in ``PlannerConfig``: clearance of goals [m]."""


def stored_windows(
    world: str, dt: float, count: int, rng: np.random.Generator, length: int = 30
) -> Float[np.ndarray, "k length 3"]:
    """``count`` windows of the stored targets, the same number at every speed."""
    windows = []
    for speed in SPEEDS:
        cuts = []
        for name in stored_targets(world):
            target = load_target(name, world=world, speed=float(speed))
            starts = np.arange(0.0, target.duration - (length - 1) * dt, 0.1)
            times = starts[:, None] + dt * np.arange(length)
            cuts.append(target.position(times.reshape(-1)).reshape(-1, length, 3))
        joined = np.concatenate(cuts)
        windows.append(joined[rng.permutation(len(joined))[: count // len(SPEEDS)]])
    return np.concatenate(windows)


def recorded_windows(
    path: Path, count: int, rng: np.random.Generator, length: int = 30
) -> Float[np.ndarray, "k length 3"]:
    """``count`` windows of a recorded flight, or all there are."""
    even = resample(read_target_log(path), FLIGHT_INTERVAL).positions
    starts = rng.permutation(max(0, len(even) - length + 1))[:count]
    return even[starts[:, None] + np.arange(length)]


def rows_of(
    name: str, windows: Float[np.ndarray, "k length 3"], dt: float, model: TargetModel, world: World | None
) -> Iterator[Row]:
    """Every predictor on the windows of one column."""
    config = PredictionConfig(dt=dt)
    future: dict[str, Float[np.ndarray, "steps 3"]] = {}
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


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """How many windows are predicted, of which flights."""

    windows: int = 1000
    """Windows of each column; a tenth of them at each speed."""

    flights: str | None = None
    """A folder with recorded flights (.csv). Default: stored targets only."""

    seed: int = 0
    """Seed of the choice of windows."""

    def __post_init__(self) -> None:
        if self.windows < len(SPEEDS) or self.seed < 0:
            raise InputError(f"--windows {self.windows} --seed {self.seed}: want at least {len(SPEEDS)} and at least 0")
        if self.flights is not None and not Path(self.flights).is_dir():
            raise InputError(f"--flights: have {self.flights!r}, want a folder that exists")


def items(config: Config) -> list[Item]:
    """A column each: the environments and the recorded flights."""
    paths = sorted(Path(config.flights).glob("*.csv")) if config.flights else []
    columns = [*ENVIRONMENTS, *(str(path) for path in paths if "obstacles" not in path.stem)]
    return [Item(column, column, {"column": column}) for column in columns]


def evaluate(config: Config, item: Item) -> Row:
    """Errors of every predictor on one column."""
    column, rng = item.values["column"], np.random.default_rng(config.seed)
    if column in ENVIRONMENTS:
        world = load_world(column)
        dt = PredictionConfig.for_world(world).dt
        cut = stored_windows(column, dt, config.windows, rng)
        return {"rows": list(rows_of(column, cut, dt, shipped_model(column, dt), world))}
    path, generic = Path(column), shipped_model("generic", FLIGHT_INTERVAL)
    cut = recorded_windows(path, config.windows, rng)
    return {"rows": list(rows_of(path.stem, cut, FLIGHT_INTERVAL, generic, None))}


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
    summary="Fig. 6: what the predictors propose, and how far each is from what happens",
    presets={"smoke": Config(windows=20), "small": Config(), "full": Config(windows=10000)},
    items=items,
    evaluate=evaluate,
    report=report,
)
