"""Betaflight's rate loop and mixer in place of our controller: references, and interceptions that it flies replanned.

    jaxplan experiment firmware --preset smoke|small|full [--workers N] [--out DIR] [--resume]

Needs gcc and make: the firmware is built from the package index's source the first time (docs/firmware.md). References
are a hover and eights by minimum snap, from rest to rest, named by their top speed. Interceptions are Table I's, the
loop that plans them is the one that always does, and its vehicle is the firmware's. Everything is flown twice, and by
our own controller too.
"""

import dataclasses
import functools
import hashlib
import time
from typing import NamedTuple

import jax
import numpy as np

from jaxplan import interception
from jaxplan.errors import InputError
from jaxplan.minsnap.single import minimum_snap
from jaxplan.precision import in_float64
from jaxplan.runner.definition import Experiment, Item, Row
from jaxplan.scenario import Scenario
from jaxplan.spline import FlatState, PiecewisePolynomial, hover
from jaxplan.tracking.disturbance import Disturbance
from jaxplan.tracking.plant import PlantState
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.rollout import FlightLog, Plant, build_plant
from jaxplan.vehicle.load import load_vehicle

from . import SUMMARIES, closed_loop, table1
from .betaflight.build import require_buildable
from .betaflight.plant import FirmwarePlant
from .betaflight.process import has_own_network
from .closed_loop import EpisodeConfig
from .firmware_report import KEPT_RATE, report

REFERENCES = "references"
"""The group of the items that follow a reference."""
HALF_LENGTH, HEIGHT, HOVERED = 3.0, 1.5, 10.0
"""m, of the eights; m, where everything but an interception is flown; s, of a hover (arbitrary)."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """How much is flown."""

    episodes: int = 10
    """Of Table I, chosen evenly."""

    worlds: tuple[str, ...] = ("env1", "env2", "env3")
    """Stored worlds."""

    speeds: tuple[float, ...] = (0.0, 2.3, 3.5, 5.0, 7.0)
    """Top speeds of the references [m/s]; 0 hovers."""

    planner: str = "mfrl"
    """Who allots the times."""

    predictor: str = "ground-truth"
    """What predicts the target."""

    refine: bool = True
    """Whether chosen plans are made sooner, as jaxplan intercept does; --refine=no leaves them as they are."""

    seed: int = 0
    """Of the plant's noise along the references."""

    def __post_init__(self) -> None:
        closed_loop.check_names(self.worlds, (self.planner,), (self.predictor,))
        if not 1 <= self.episodes <= 3000 or self.seed < 0:
            raise InputError(f"--episodes {self.episodes} --seed {self.seed}: want 1 to 3000, and a seed from 0")
        if not all(0.0 <= speed <= 15.0 for speed in self.speeds) or len(set(self.speeds)) != len(self.speeds):
            raise InputError(f"--speeds: have {' '.join(map(str, self.speeds))}, want m/s from 0 to 15, each once")


def items(config: Config) -> list[Item]:
    """The references, then the episodes of each world.

    Raises:
        ResourceError: the firmware is not built yet, and there is no compiler.
    """
    require_buildable()
    found = [Item(f"reference {speed:g} m/s", REFERENCES, {"speed": speed}) for speed in config.speeds]
    names = {"worlds": config.worlds, "episodes": config.episodes, "planners": (config.planner,)}
    chosen = table1.chosen(table1.Config(**names, refine=config.refine))
    for episode in sorted(chosen, key=lambda episode: config.worlds.index(episode.world)):
        own = dataclasses.replace(episode, planner=config.planner, predictor=config.predictor)
        name = f"{own.world}/{own.target}/{own.speed:.2f} m/s/{own.departure:.2f} s"
        found.append(Item(name, own.world, dataclasses.asdict(own)))
    return found


def prepare(config: Config, group: str) -> None:
    """Build the firmware where it is not yet, and compile what the episodes of a world call."""
    _firmware()
    if group != REFERENCES:
        closed_loop.warm_up(group, closed_loop.Defender(config.planner, refine=config.refine))


@functools.cache
def _firmware() -> FirmwarePlant:
    return FirmwarePlant(load_vehicle())


def evaluate(config: Config, item: Item) -> Row:
    """Fly one reference or one episode, twice by the firmware and once by our own controller."""
    if item.group == REFERENCES:
        return _follow(item.values["speed"], config.seed)
    return _intercept(EpisodeConfig(**item.values))


class Recorded(NamedTuple):
    """A plant, and what it logs."""

    plant: Plant
    logs: list[FlightLog]
    """One for each call, since the last reset."""

    def log(self) -> FlightLog:
        """All rows."""
        return jax.tree.map(lambda *rows: np.concatenate(rows), *self.logs)


def recorded(plant: Plant) -> Recorded:
    """A plant whose logs are kept."""
    logs: list[FlightLog] = []

    def reset(reference: FlatState, key: jax.Array) -> PlantState:
        logs.clear()
        return plant.reset(reference, key)

    def fly(
        state: PlantState, references: FlatState, disturbance: Disturbance | None = None
    ) -> tuple[PlantState, FlightLog]:
        state, log = plant.fly(state, references, disturbance)
        logs.append(log)
        return state, log

    return Recorded(Plant(reset=reset, fly=fly), logs)


def _follow(speed: float, seed: int) -> Row:
    references = references_of(speed)

    def follow(plant: Plant) -> FlightLog:
        first = jax.tree.map(lambda rows: rows[0], references)
        return plant.fly(plant.reset(first, jax.random.key(seed)), references)[1]

    with _firmware() as plant:
        log, again = follow(plant), follow(plant)
    own = follow(build_plant(load_vehicle()))
    acceleration = float(np.linalg.norm(references.acc, axis=1).max())
    return {"kind": "reference", "speed": speed, "acceleration": acceleration, **_told(log, again, own)}


def references_of(speed: float) -> FlatState:
    """A hover, or an eight of minimum snap from rest to rest with this top speed [m/s], every control step."""
    if speed == 0.0:
        still, count = hover([0.0, 0.0, HEIGHT]), round(HOVERED * CONTROL_RATE) + 1
        return jax.tree.map(lambda leaf: np.broadcast_to(leaf, (count, *np.shape(leaf))), still)
    return _sampled(_eight(speed))


@in_float64
def _eight(speed: float) -> PiecewisePolynomial:
    phase = np.linspace(0.0, 2.0 * np.pi, 9)
    along, across = HALF_LENGTH * np.sin(phase), 0.5 * HALF_LENGTH * np.sin(2.0 * phase)
    waypoints = np.stack([along, across, np.full_like(phase, HEIGHT)], axis=1)
    unit = minimum_snap(waypoints, np.ones(8))
    fastest = np.linalg.norm(unit.evaluate(np.linspace(0.0, 8.0, 4001), 1)[:, :3], axis=1).max()
    return minimum_snap(waypoints, np.full(8, fastest / speed))  # time alone is stretched: speeds scale with it


@in_float64
def _sampled(spline: PiecewisePolynomial) -> FlatState:
    times = np.arange(int(float(spline.duration) * CONTROL_RATE) + 1) / CONTROL_RATE
    return jax.tree.map(np.asarray, spline.state(times))


def _intercept(episode: EpisodeConfig) -> Row:
    scenario = dataclasses.replace(closed_loop.scenario_of(episode), judged_by_heading=False)

    def flown(plant: Plant) -> tuple[interception.Episode, FlightLog]:
        kept = recorded(plant)
        found = interception.fly(_with(scenario, kept.plant))
        rows = len(found.flight.times)
        return found, jax.tree.map(lambda leaf: leaf[:rows], kept.log())

    began = time.perf_counter()
    with _firmware() as plant:
        met, log = flown(plant)
        wall = time.perf_counter() - began
        _, again = flown(plant)
    ours, own = flown(scenario.plant)
    numbers = closed_loop.numbers(met)
    kept = ("outcome", "time_to_intercept_s", "min_distance_m", "min_clearance_m", "replans")
    return {
        "kind": "interception",
        "speed": float(np.linalg.norm(met.flight.velocity, axis=1).max()),
        "thrust_g": _most_thrust(log),
        "plans": len(met.plans),
        "wall_s": wall,
        "own_outcome": ours.outcome,
        **{name: numbers[name] for name in kept},
        **_told(log, again, own),
    }


def _with(scenario: Scenario, plant: Plant) -> Scenario:
    return dataclasses.replace(scenario, plant=plant)


def _most_thrust(log: FlightLog) -> float:
    """The largest thrust in weights."""
    vehicle = load_vehicle()
    lift = float(vehicle.thrust_coefficient) * (np.asarray(log.rotor_speeds, dtype=float) ** 2).sum(axis=1).max()
    return lift / float(vehicle.mass * vehicle.gravity)


def _told(log: FlightLog, again: FlightLog, own: FlightLog) -> Row:
    """What is kept of a flight by the firmware, its repetition, and the same by our own controller."""
    error = np.asarray(log.position_error, dtype=float)
    kept = slice(None, None, CONTROL_RATE // KEPT_RATE)
    fastest = float(load_vehicle().rotor_speed_max)
    return {
        "rms": _rms(error),
        "worst": float(error.max()),
        "twist_deg": float(np.degrees(np.asarray(log.twist_error).max())),
        "saturated": float(np.asarray(log.saturated).mean()),
        "identical": digest(log) == digest(again),
        "digest": digest(log),
        "own_rms": _rms(np.asarray(own.position_error, dtype=float)),
        "own_worst": float(np.asarray(own.position_error).max()),
        "own_network": has_own_network(),
        "trace": {
            "error": error[kept].tolist(),
            "rotors": (np.asarray(log.rotor_speeds, dtype=float)[kept] / fastest).round(4).tolist(),
        },
    }


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt((error**2).mean()))


def digest(log: FlightLog) -> str:
    """A hash of every bit of a flight."""
    found = hashlib.sha256()
    for leaf in jax.tree.leaves(log):
        found.update(np.ascontiguousarray(leaf).tobytes())
    return found.hexdigest()[:16]


EXPERIMENT = Experiment(
    summary=SUMMARIES["firmware"],
    presets={
        "smoke": Config(episodes=1, worlds=("env1",), speeds=(0.0, 3.5)),
        "small": Config(),
        "full": Config(episodes=60),
    },
    items=items,
    evaluate=evaluate,
    report=report,
    prepare=prepare,
    artefacts=lambda config: table1.artefacts(
        table1.Config(planners=(config.planner,), predictors=(config.predictor,))
    ),
)
