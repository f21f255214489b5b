"""Vehicles of all sizes that nothing was learned for: how soon they get to the same goals, and whether they can follow.

    jaxplan experiment vehicles --preset smoke|small|full [--count N] [--goals N] [--workers N] [--out DIR] [--resume]

Masses of 30 g to 5 kg, thrust-to-weight ratios of 1.6 to 8 and lags of the motors of 15 to 50 ms are spread evenly,
each vehicle a file of four lines; the presets stand beside them. Each plans from hover to the same random goals of one
room, every plan that is called usable is flown in the plant, and counts as tracked within the error of the trial
flights of ``jaxplan vehicle``: 0.2 m, less for small vehicles in proportion to their radius.
"""

import dataclasses
import tempfile
from pathlib import Path

import numpy as np

from jaxplan.config import InterceptConfig
from jaxplan.errors import InputError
from jaxplan.planner import build_planner
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.runner.definition import Experiment, Item, Report, Results, Row
from jaxplan.runner.tables import as_latex, as_markdown, number
from jaxplan.scenario import planner_config
from jaxplan.spline import PiecewisePolynomial, hover
from jaxplan.tracking.result import held_error
from jaxplan.tracking.track import track
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.reach import sideways_acceleration
from jaxplan.vehicle.report import LAGS, MASSES, RATIOS, thrust_to_weight, usual_arm
from jaxplan.vehicle.toml import list_presets
from jaxplan.world.load import ENVIRONMENTS, load_world
from jaxplan.world.obstacles import World

from . import SUMMARIES
from .figures.vehicles import draw_vehicles

BESIDE = 0.15
"""m; goals and paths keep so much more than the vehicle's radius, and at least what an interception keeps."""
SOONEST, LATEST = 1.0, 6.0
"""s; the targets are at their goals in between."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """How many vehicles, and how many goals each."""

    count: int = 12
    """Vehicles spread over the range, beside the presets."""

    goals: int = 300
    """Each vehicle's, the same for all."""

    world: str = "env1"
    """A stored world."""

    seed: int = 5
    """Of the goals and of how the vehicles are spread."""

    def __post_init__(self) -> None:
        if not 0 <= self.count <= 1000 or not 1 <= self.goals <= 100_000:
            raise InputError(
                f"--count {self.count} --goals {self.goals}: want up to 1000 vehicles and 1 to 100000 goals"
            )
        if self.world not in ENVIRONMENTS:
            raise InputError(f"--world: have {self.world!r}, want one of {', '.join(ENVIRONMENTS)}")


def items(config: Config) -> list[Item]:
    """The presets, then the vehicles of the range, each a Latin hypercube's cell."""
    rng = np.random.default_rng(config.seed)
    ranks = [(rng.permutation(config.count) + 0.5) / max(config.count, 1) for _ in range(2)]
    found = [Item(name, "vehicles", {"vehicle": name}) for name in list_presets()]
    for nth in range(config.count):
        mass = _between(MASSES, (nth + 0.5) / config.count)
        values = {"mass": mass, "arm": usual_arm(mass)}
        values |= {"thrust_to_weight": _between(RATIOS, ranks[0][nth])}
        values |= {"motor_time_constant": _between(LAGS, ranks[1][nth])}
        found.append(Item(f"{mass:.2f} kg", "vehicles", {"vehicle": None, **values}))
    return found


def _between(limits: tuple[float, float], share: float) -> float:
    """On a logarithmic scale."""
    return float(limits[0] * (limits[1] / limits[0]) ** share)


def evaluate(config: Config, item: Item) -> Row:
    """Plan for one vehicle, and fly what is usable."""
    vehicle, world = _vehicle(item), load_world(config.world)
    usable, least = _planned(config, vehicle, world)
    limit = held_error(vehicle)
    errors = np.asarray(track(usable, vehicle=vehicle).max_position_error) if usable else np.zeros(0)
    return {
        "name": item.name,
        "preset": item.values["vehicle"] is not None,
        "mass": float(vehicle.mass),
        "thrust_to_weight": thrust_to_weight(vehicle),
        "motor_time_constant": float(vehicle.motor_time_constant),
        "acceleration": sideways_acceleration(vehicle),
        "least_time": float(np.median(least)) if len(least) else None,
        "usable": len(usable),
        "tracked": int((errors < limit).sum()),
        "limit": limit,
        "error_p90": float(np.quantile(errors, 0.9)) if len(errors) else None,
    }


def _vehicle(item: Item) -> Vehicle:
    """As a user would write it."""
    values = dict(item.values)
    preset = values.pop("vehicle")
    if preset is not None:
        return load_vehicle(preset)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "drone.toml"
        file.write_text("".join(f"{name} = {value!r}\n" for name, value in values.items()))
        return load_vehicle(file)


def _planned(config: Config, vehicle: Vehicle, world: World) -> tuple[list[PiecewisePolynomial], list[float]]:
    """All usable trajectories, and the least time to every goal that there is a path to [s]."""
    rng = np.random.default_rng(config.seed)
    goals = rng.uniform(*np.asarray(world.bounds), (config.goals, 3))
    times = rng.uniform(SOONEST, LATEST, config.goals)
    padding = max(InterceptConfig.padding, float(vehicle.radius) + BESIDE)
    chosen = InterceptConfig(planner="no-policy", allocate="profile", padding=padding)
    settings = planner_config(chosen, exhaustive=True)
    planner = build_planner(settings, world=world, vehicle=vehicle, policy=constant_speed_policy())
    plans = planner.plan_batch(hover(world.start), candidates_from(goals[0], goals, times, np.zeros(len(goals))))
    known = np.isfinite(plans.alpha) & (plans.alpha > 0.0)
    least = (plans.arrival_times[known] / plans.alpha[known]).tolist()
    return [plans.spline(index) for index in np.flatnonzero(plans.reasons == 0)], least


HEADER = ["vehicle", "mass [kg]", "thrust to weight", "lag [ms]", "asked for [m/s^2]", "median least time [s]"]
HEADER += ["usable", "tracked", "90 % within [m]", "limit [m]"]


def report(results: Results[Config]) -> Report:
    """A line for each vehicle, and the picture."""
    rows = results.finished_rows()
    lines = [
        [
            row["name"],
            f"{row['mass']:.3g}",
            f"{row['thrust_to_weight']:.1f}",
            f"{1e3 * row['motor_time_constant']:.0f}",
            f"{row['acceleration']:.1f}",
            number(row["least_time"], ".2f"),
            str(row["usable"]),
            number(row["tracked"] / row["usable"] if row["usable"] else None),
            number(row["error_p90"]),
            f"{row['limit']:.2f}",
        ]
        for row in rows
    ]
    table = as_markdown(HEADER, lines)
    low = min((row["tracked"] / row["usable"] for row in rows if row["usable"]), default=0.0)
    return Report(
        markdown=f"{table}\n![vehicles](vehicles.png)\n",
        table=rows,
        latex=as_latex(HEADER, lines, "Vehicles that nothing was learned for"),
        figures={"vehicles.png": lambda path: draw_vehicles(rows, path)},
        summary=f"{len(rows)} vehicles; of the usable plans of each at least {low:.2f} were tracked",
    )


EXPERIMENT = Experiment(
    summary=SUMMARIES["vehicles"],
    presets={"smoke": Config(count=1, goals=20), "small": Config(), "full": Config(count=100, goals=1000)},
    items=items,
    evaluate=evaluate,
    report=report,
    shard_size=1,
)
