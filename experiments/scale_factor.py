"""Tracking error against scale factor: the vehicle on random minimum-snap trajectories, slowed from their limit.

    jaxplan experiment scale-factor --preset smoke|small|full

Each trajectory (rest to rest through random waypoints, durations proportional to distance) is brought to its
feasibility boundary: the fastest dilation whose rotor speeds, by flatness, stay within limits. It is then slowed by
alpha from 0.7 (faster than the boundary) to 2.0 and flown with noise. The picture shows mean and standard deviation of
the largest position and yaw error of a flight; flights 5 m off or not finite are counted beside it, not averaged.
"""

import dataclasses
from typing import Literal

import numpy as np

from jaxplan.errors import InputError
from jaxplan.minsnap.single import minimum_snap
from jaxplan.runner.definition import Experiment, Item, Report, Results, Row
from jaxplan.runner.tables import as_latex, as_markdown, number
from jaxplan.spline import PiecewisePolynomial
from jaxplan.tracking.fidelity import build_labeller
from jaxplan.tracking.result import TRAINING, TrackingResult
from jaxplan.tracking.track import TrackConfig, track

from . import SUMMARIES
from .figures.scale_factor import draw_scale_factor

ALPHAS = np.round(np.arange(0.7, 2.01, 0.1), 2)
BISECTIONS = 12
"""Halvings of log alpha over a range of 100: the boundary is found to 0.1 %."""


def random_trajectories(count: int, waypoints: int, rng: np.random.Generator) -> list[PiecewisePolynomial]:
    """Rest to rest through ``waypoints`` points with steps of up to 3 m an axis, yaw along with chance."""
    chains = np.cumsum(rng.uniform(-3.0, 3.0, (count, waypoints, 3)), axis=1)
    headings = np.cumsum(rng.uniform(-0.5, 0.5, (count, waypoints)), axis=1)
    steps = np.linalg.norm(np.diff(chains, axis=1), axis=2)
    return [minimum_snap(c, step, yaw=yaw) for c, step, yaw in zip(chains, steps, headings, strict=True)]


def at_the_boundary(splines: list[PiecewisePolynomial]) -> list[PiecewisePolynomial]:
    """Each spline at the fastest dilation that the rotors allow; feasible stays feasible when slowed, nearly always."""
    within = build_labeller("rotor-limits")
    low, high = np.full(len(splines), -np.log(10.0)), np.full(len(splines), np.log(10.0))
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        feasible = within([s.dilate(a) for s, a in zip(splines, np.exp(middle), strict=True)]).feasible
        low, high = np.where(feasible, low, middle), np.where(feasible, middle, high)
    return [spline.dilate(alpha) for spline, alpha in zip(splines, np.exp(high), strict=True)]


def statistics(result: TrackingResult) -> Row:
    """Mean and standard deviation over the flights that were not lost, and how many were; None over no flights."""
    flown = np.isfinite(result.max_position_error) & np.isfinite(result.max_yaw_error)
    flown &= result.max_position_error < 5.0  # lost: its error says only how far it fell
    position, yaw = result.max_position_error[flown], np.degrees(result.max_yaw_error[flown])
    any_flown = bool(flown.any())
    return {
        "position_mean_m": position.mean() if any_flown else None,
        "position_std_m": position.std() if any_flown else None,
        "yaw_mean_deg": yaw.mean() if any_flown else None,
        "yaw_std_deg": yaw.std() if any_flown else None,
        "feasible_share": result.feasible.mean(),
        "lost_share": 1.0 - flown.mean(),
    }


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """Which trajectories are flown, and how."""

    count: int = 64
    """Trajectories."""

    waypoints: int = 5
    """Of each trajectory."""

    controller: Literal["indi", "se3"] = "indi"
    """Who flies them."""

    seed: int = 0
    """Seed of the trajectories and of the noise."""

    def __post_init__(self) -> None:
        if self.count < 1 or self.waypoints < 2 or self.seed < 0:
            have = f"--count {self.count} --waypoints {self.waypoints} --seed {self.seed}"
            raise InputError(f"{have}: want at least 1, 2 and 0")


def items(config: Config) -> list[Item]:
    """One item: all flights are tracked at once."""
    return [Item("flights", config.controller, {})]


def evaluate(config: Config, item: Item) -> Row:
    """All trajectories at every alpha, flown at once."""
    splines = at_the_boundary(random_trajectories(config.count, config.waypoints, np.random.default_rng(config.seed)))
    settings = TrackConfig(controller=config.controller, seed=config.seed)
    result = track([spline.dilate(alpha) for alpha in ALPHAS for spline in splines], config=settings)
    rows = []
    for index, alpha in enumerate(ALPHAS):
        part = slice(index * config.count, (index + 1) * config.count)
        rows.append({"alpha": float(alpha), **statistics(_part(result, part))})
    return {"rows": rows}


def _part(result: TrackingResult, part: slice) -> TrackingResult:
    """Some of the flights."""
    return type(result)(**{name: values[part] for name, values in vars(result).items()})


def report(results: Results[Config]) -> Report:
    """A line for each alpha, and the picture."""
    (found,) = results.finished_rows()
    rows = found["rows"]
    header = [name.replace("_", " ") for name in rows[0]]
    lines = [[number(value) for value in row.values()] for row in rows]
    markdown, limits = (
        as_markdown(header, lines),
        {"position": TRAINING.position, "yaw": float(np.degrees(TRAINING.yaw))},
    )
    return Report(
        markdown=markdown + "\n![tracking error against the scale factor](scale_factor.png)\n",
        table=rows,
        latex=as_latex(header, lines, "Tracking error against the scale factor; 1: the rotors' limits"),
        figures={"scale_factor.png": lambda path: draw_scale_factor(rows, path, **limits)},
        summary=markdown,
    )


EXPERIMENT = Experiment(
    summary=SUMMARIES["scale-factor"],
    presets={"smoke": Config(count=4), "small": Config(), "full": Config(count=1000)},
    items=items,
    evaluate=evaluate,
    report=report,
    parallel=False,
)
