"""Interceptions and policy flights in other people's simulators: rotorpy, and drone-models' dynamics.

    jaxplan experiment foreign-plants --preset smoke|small|full [--workers N] [--out DIR] [--resume]

Three kinds of trajectories are flown, without noise: all that was commanded in an interception, from its first plan
until the target is met (``interception``); the plan that met it, alone, to its stop (``plan``); and usable plans from
hover to random goals (``policy``). Table I's episodes are flown in our own plant first. Each trajectory is flown by
rotorpy's ``SE3Control`` with its own gains, with ours, and with the feed-forward (``foreign_flight``). It counts as
flown within 0.4 m and, about body z, 45 degrees. What fails with the feed-forward is flown again without the rotors'
upper limit, without the motors' lag, and without both: the first with which it succeeds is the cause.
"""

import dataclasses
import importlib.util
from collections.abc import Sequence

import numpy as np

from jaxplan.errors import InputError, ResourceError
from jaxplan.io.plans import SavedPlan, commanded
from jaxplan.prediction.candidates import candidates_from
from jaxplan.replanner.records import CommittedPlan
from jaxplan.runner.definition import Experiment, Item, Report, Results, Row
from jaxplan.runner.statistics import wilson
from jaxplan.runner.tables import as_latex, as_markdown, number
from jaxplan.spline import PiecewisePolynomial, hover
from jaxplan.tracking.result import SUCCESS
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle
from jaxplan.world.load import ENVIRONMENTS

from . import SUMMARIES, closed_loop, table1
from .closed_loop import EpisodeConfig
from .figures.foreign_plants import draw_foreign_plants
from .foreign_flight import CONTROLS, PLANTS, Flown, fly, without

KINDS = ("interception", "plan", "policy")
AT_ONCE = 5
"""Policy flights of an item."""
TRIED = 4
"""Random goals for each of them; most have a usable plan."""
SOONEST, LATEST = 1.0, 6.0
"""s; targets are at the random goals in between, as in ``vehicles``."""
SPARED = (("rotor limits",), ("motor lag",), ("rotor limits", "motor lag"))
"""What a failed flight is flown again without, in this order."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """How much is flown."""

    episodes: int = 60
    """Of Table I, chosen evenly."""

    policy_flights: int = 200
    """Over all rooms."""

    worlds: tuple[str, ...] = ENVIRONMENTS
    """Stored worlds."""

    plants: tuple[str, ...] = PLANTS
    """Other people's simulators."""

    planner: str = "mfrl"
    """Who allots the times."""

    predictor: str = "ground-truth"
    """What predicts the target."""

    refine: bool = True
    """Whether chosen plans are made sooner, as jaxplan intercept does; --refine=no leaves them as they are."""

    seed: int = 0
    """Of the random goals."""

    def __post_init__(self) -> None:
        closed_loop.check_names(self.worlds, (self.planner,), (self.predictor,))
        wrong = [name for name in self.plants if name not in PLANTS]
        if wrong or not self.plants:
            raise InputError(f"--plants: have {' '.join(wrong) or 'none'}, want some of {', '.join(PLANTS)}")
        if not 1 <= self.episodes <= 3000 or not 0 <= self.policy_flights <= 100_000 or self.seed < 0:
            have = f"--episodes {self.episodes} --policy-flights {self.policy_flights} --seed {self.seed}"
            raise InputError(f"{have}: want 1 to 3000, 0 to 100000, and a seed from 0")


def items(config: Config) -> list[Item]:
    """The episodes of each room, then its policy flights.

    Raises:
        ResourceError: a simulator is not installed.
    """
    missing = [name for name in config.plants if importlib.util.find_spec(name.replace("-", "_")) is None]
    if missing:
        raise ResourceError(f"foreign-plants: {missing[0]} is not installed; pip install 'jaxplan[peers]'")
    names = {"worlds": config.worlds, "episodes": config.episodes, "planners": (config.planner,)}
    chosen = table1.chosen(table1.Config(**names, refine=config.refine))
    batches = -(-config.policy_flights // AT_ONCE)
    found = []
    for place, world in enumerate(config.worlds):
        for episode in (episode for episode in chosen if episode.world == world):
            own = dataclasses.replace(episode, planner=config.planner, predictor=config.predictor)
            name = f"{world}/{own.target}/{own.speed:g} m/s/{own.departure:g} s"
            found.append(Item(name, world, {"kind": "interception", **dataclasses.asdict(own)}))
        for batch in range(place, batches, len(config.worlds)):
            count = min(AT_ONCE, config.policy_flights - AT_ONCE * batch)
            found.append(Item(f"{world}/policy {batch}", world, {"kind": "policy", "batch": batch, "count": count}))
    return found


def prepare(config: Config, group: str) -> None:
    """Compile what the episodes of a room call."""
    closed_loop.warm_up(group, closed_loop.Defender(config.planner, refine=config.refine))


def evaluate(config: Config, item: Item) -> Row:
    """Fly one episode here and its plans elsewhere, or some policy flights."""
    vehicle, values = load_vehicle(), dict(item.values)
    if values.pop("kind") == "policy":
        plans = _usable(config, item.group, **values)
        return {"met": True, "flights": [_everywhere(config, vehicle, "policy", plan) for plan in plans]}
    episode = closed_loop.fly(EpisodeConfig(**values))
    if not episode.success:
        return {"met": False, "flights": []}
    plans = [plan for plan in episode.plans if plan.start_time < episode.flight.times[-1]]
    start, whole = commanded([_saved(plan) for plan in plans])
    until = float(episode.flight.times[-1]) - start
    last = _saved(plans[-1]).spline
    flights = [
        _everywhere(config, vehicle, "interception", whole, until),
        _everywhere(config, vehicle, "plan", last),
    ]
    return {"met": True, "flights": flights}


def _saved(plan: CommittedPlan) -> SavedPlan:
    """Without padding, in NumPy."""
    real = np.asarray(plan.spline.durations) > 0.0
    parts = {name: np.asarray(getattr(plan.spline, name))[real] for name in ("durations", "position", "yaw")}
    return SavedPlan(float(plan.start_time), PiecewisePolynomial(**parts))


def _usable(config: Config, world: str, batch: int, count: int) -> list[PiecewisePolynomial]:
    """Up to ``count`` usable plans from hover to random goals."""
    episode = EpisodeConfig(
        world=world,
        planner=config.planner,
        predictor="ground-truth",
        target=closed_loop.stored_targets(world)[0],
        refine=config.refine,
        speed=3.0,
        departure=0.5,
        seed=0,
    )
    scenario = closed_loop.scenario_of(episode)
    rng = np.random.default_rng([config.seed, batch])
    goals = rng.uniform(*np.asarray(scenario.world.bounds), (TRIED * AT_ONCE, 3))
    times = rng.uniform(SOONEST, LATEST, len(goals))
    candidates = candidates_from(goals[0], goals, times, np.zeros(len(goals)))
    plans = scenario.planner.plan_batch(hover(scenario.world.start), candidates)
    return [plans.spline(int(index)) for index in np.flatnonzero(plans.reasons == 0)[:count]]


def _everywhere(
    config: Config, vehicle: Vehicle, kind: str, spline: PiecewisePolynomial, until: float | None = None
) -> Row:
    """One trajectory in every plant by every controller, and why the feed-forward failed."""
    whole = float(spline.duration)
    duration = whole if until is None else min(until, whole)
    times = np.linspace(0.0, duration, 200)
    row: Row = {
        "kind": kind,
        "duration": duration,
        "speed": float(np.linalg.norm(np.asarray(spline.evaluate(times, 1))[:, :3], axis=1).max()),
        "acceleration": float(np.linalg.norm(np.asarray(spline.evaluate(times, 2))[:, :3], axis=1).max()),
    }
    for plant in config.plants:
        for control in CONTROLS:
            flown = fly(vehicle, spline, duration, plant, control)
            row[f"{plant}, {control}"] = _told(flown)
        row[f"{plant}, cause"] = "" if _is_good(flown) else _cause(vehicle, spline, duration, plant)
    return row


def _told(flown: Flown) -> dict[str, float | bool]:
    return {
        "good": _is_good(flown),
        "error": float(flown.position_error.max()),
        "twist_deg": float(np.degrees(flown.twist_error.max())),
        "heading_deg": float(np.degrees(flown.heading_error.max())),
        "saturated": float(flown.saturated.mean()),
    }


def _is_good(flown: Flown) -> bool:
    return bool(flown.position_error.max() < SUCCESS.position and flown.twist_error.max() < SUCCESS.yaw)


def _cause(vehicle: Vehicle, spline: PiecewisePolynomial, duration: float, plant: str) -> str:
    """What a failed flight with the feed-forward succeeds without."""
    for bounds in SPARED:
        if _is_good(fly(without(vehicle, *bounds), spline, duration, plant)):
            return " and ".join(bounds)
    return "neither"


HEADER = ("flights", "plant", "control", "count", "within", "95 %", "median m", "90 % m", "worst m", "worst twist deg")
HEADER += ("by heading", "saturated")


def report(results: Results[Config]) -> Report:
    """A line for each kind of flight, plant and controller; the causes; the picture."""
    rows = results.finished_rows()
    flights = [flight for row in rows for flight in row["flights"]]
    kinds = [kind for kind in KINDS if any(flight["kind"] == kind for flight in flights)]
    ways = [(plant, control) for plant in results.config.plants for control in CONTROLS]
    lines = [_cells(flights, kind, *way) for kind in kinds for way in ways]
    unmet = sum(not row["met"] for row in rows)
    causes = _causes(flights, kinds, results.config.plants)
    text = f"{as_markdown(HEADER, lines)}\n{causes}\n{unmet} episodes did not meet their target here.\n"
    best = [_share(flights, "interception", plant, CONTROLS[-1]) for plant in results.config.plants]
    shares = ", ".join(f"{plant} {share:.0%}" for plant, share in zip(results.config.plants, best, strict=True))
    return Report(
        markdown=f"{text}\n![foreign plants](foreign-plants.png)\n",
        table=[_flat(flight) for flight in flights],
        latex=as_latex(HEADER, lines, "Flights in other people's simulators"),
        figures={"foreign-plants.png": lambda path: draw_foreign_plants(flights, ways, kinds, path)},
        summary=f"{len(flights)} trajectories; interceptions with the feed-forward: {shares}",
    )


def _flat(flight: Row) -> Row:
    """Plain columns."""
    found: Row = {}
    for name, value in flight.items():
        found |= {f"{name}, {key}": v for key, v in value.items()} if isinstance(value, dict) else {name: value}
    return found


def _of(flights: Sequence[Row], kind: str, plant: str, control: str) -> list[Row]:
    return [flight[f"{plant}, {control}"] for flight in flights if flight["kind"] == kind]


def _share(flights: Sequence[Row], kind: str, plant: str, control: str) -> float:
    told = _of(flights, kind, plant, control)
    return float(np.mean([row["good"] for row in told])) if told else float("nan")


def _cells(flights: Sequence[Row], kind: str, plant: str, control: str) -> list[str]:
    """One row of the table."""
    told = _of(flights, kind, plant, control)
    good, errors = sum(row["good"] for row in told), np.array([row["error"] for row in told])
    low, high = wilson(good, len(told))
    limit = np.degrees(SUCCESS.yaw)
    heading = [row["error"] < SUCCESS.position and row["heading_deg"] < limit for row in told]
    return [
        kind,
        plant,
        control,
        str(len(told)),
        number(good / len(told)),
        f"{number(low)} to {number(high)}",
        number(float(np.median(errors))),
        number(float(np.quantile(errors, 0.9))),
        number(float(errors.max())),
        number(max(row["twist_deg"] for row in told), ".0f"),
        number(float(np.mean(heading))),
        number(float(np.mean([row["saturated"] for row in told]))),
    ]


def _causes(flights: Sequence[Row], kinds: Sequence[str], plants: Sequence[str]) -> str:
    """How many failures with the feed-forward each cause has."""
    lines = []
    for kind in kinds:
        for plant in plants:
            found = [row[f"{plant}, cause"] for row in flights if row["kind"] == kind and row[f"{plant}, cause"]]
            counts = ", ".join(f"{found.count(name)} by {name}" for name in sorted(set(found))) or "none"
            lines.append([kind, plant, counts])
    return as_markdown(("flights", "plant", "failures with the feed-forward, by what they succeed without"), lines)


EXPERIMENT = Experiment(
    summary=SUMMARIES["foreign-plants"],
    presets={
        "smoke": Config(episodes=1, policy_flights=1, worlds=("env1",)),
        "small": Config(),
        "full": Config(episodes=300, policy_flights=1000),
    },
    items=items,
    evaluate=evaluate,
    report=report,
    prepare=prepare,
    shard_size=3,
    artefacts=lambda config: table1.artefacts(
        table1.Config(planners=(config.planner,), predictors=(config.predictor,))
    ),
)
