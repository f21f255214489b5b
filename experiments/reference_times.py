"""How soon the target could be met: an offline optimum for Table I's episodes, each proved by a flight.

    jaxplan experiment reference-times --preset smoke|small|full [--workers N] [--out DIR] [--resume]

The target's motion is known from the start, as to the ground-truth predictor, and one trajectory from hover through the
meeting to rest is optimised in waypoints and durations (``jaxplan.reference``) until the simulated vehicle flies it as
Table I demands: within 0.4 m of the target, in control, clear of everything.
"""

import dataclasses
import functools
from pathlib import Path

import numpy as np

from jaxplan.config import InterceptConfig
from jaxplan.errors import InputError
from jaxplan.interception import INTERCEPTION_RADIUS
from jaxplan.io.targets import load_target, stored_targets
from jaxplan.reference.flight import Judge
from jaxplan.reference.soonest import Interception, Reference, ReferenceConfig, soonest
from jaxplan.reference.starts import Sought
from jaxplan.runner.definition import Experiment, Item, Row
from jaxplan.scenario import Scenario, build_scenario
from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices
from jaxplan.world.load import ENVIRONMENTS

from . import SUMMARIES, reference_times_report, table1
from .closed_loop import EpisodeConfig

PADDING = 0.35
"""m; from obstacles that the routes keep from which the optimisation begins: a little more than it keeps itself."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """Which episodes, and how much is tried."""

    worlds: tuple[str, ...] = ENVIRONMENTS
    """Stored worlds."""

    episodes: int = 300
    """Chosen evenly among all combinations, as in Table I."""

    seed: int = 0
    """Added to every episode's index to seed its noise, as in Table I."""

    segments: int = 8
    """Of every trajectory."""

    starts: int = 8
    """Trajectories that are optimised at once, on different routes."""

    rounds: int = 14
    """Of planning and flying at most."""

    compare: str | None = None
    """Table I's results.csv to compare with, of which --planner and --predictor are taken; default: the one in docs."""

    planner: str = "mfrl"
    """Of the episodes that are compared."""

    predictor: str = "ground-truth"
    """Of the episodes that are compared."""

    def __post_init__(self) -> None:
        self.reference()
        chosen(self)
        if self.compare is not None and not Path(self.compare).is_file():
            raise InputError(f"--compare: have {self.compare!r}, want a results.csv of table1")
        wrong = [world for world in self.worlds if world not in ENVIRONMENTS]
        if wrong:
            raise InputError(f"--worlds: have {wrong[0]!r}, want some of {', '.join(ENVIRONMENTS)}")

    def reference(self) -> ReferenceConfig:
        """The optimiser's options, checked."""
        return ReferenceConfig(segments=self.segments, starts=self.starts, rounds=self.rounds)


def chosen(config: Config) -> list[EpisodeConfig]:
    """Table I's episodes, those of a world together."""
    table = table1.Config(planners=("no-policy",), worlds=config.worlds, episodes=config.episodes, seed=config.seed)
    return table1.chosen(table)


def items(config: Config) -> list[Item]:
    """The episodes; their group is the world, for which everything is compiled."""
    found = []
    for episode in chosen(config):
        name = f"{episode.target}/{episode.speed:g} m/s/{episode.departure:g} s"
        names = ("world", "target", "speed", "departure", "seed")
        found.append(Item(name, episode.world, {key: getattr(episode, key) for key in names}))
    return found


def prepare(config: Config, group: str) -> None:
    """Load a world and find one reference, which compiles everything."""
    names = {"world": group, "target": stored_targets(group)[0], "speed": 0.5, "departure": 0.5, "seed": 0}
    soonest(_case(names), dataclasses.replace(config.reference(), rounds=2))


def evaluate(config: Config, item: Item) -> Row:
    """The reference of one episode."""
    case = _case(item.values)
    return {**item.values, **_numbers(case, soonest(case, config.reference()))}


def _numbers(case: Interception, found: Reference) -> Row:
    """What is kept of a reference: plain values."""
    durations = np.asarray(found.spline.durations)
    ends = np.r_[0.0, np.cumsum(durations)]
    speeds = np.linalg.norm(found.flight.velocity, axis=1)
    clearances = case.judge.clearance(np.asarray(found.spline.sample(1000)[1])[:, :3])
    flown = found.verdict.accepted
    return {
        "feasible": found.feasible,
        "flown": flown,
        "reference_s": found.seconds if flown else None,
        "planned_s": found.planned,
        "rounds": found.rounds,
        "top_speed_m_s": float(speeds.max()),
        "clearance_m": float(clearances.min()),
        "flown_clearance_m": float(case.judge.clearance(found.flight.position).min()),
        "position_error_m": float(found.flight.position_error.max()),
        "segments": len(durations),
        "waypoints_m": np.round(np.asarray(found.spline.evaluate(ends))[:, :3], 4).tolist(),
        "durations_s": np.round(durations, 5).tolist(),
    }


def _case(values: Row) -> Interception:
    """An episode as the optimiser sees it."""
    world, departure = values["world"], values["departure"]
    target = load_target(values["target"], world=world, speed=values["speed"])
    base = _scenario(world)
    judge = Judge(base.clearance, np.asarray(base.vehicle.radius).item(), INTERCEPTION_RADIUS, target.duration)
    sought = Sought(_lattices(world), base.world, np.asarray(base.start.pos))
    return Interception(
        sought, base.vehicle, base.plant, judge, target.position, target.velocity, departure, values["seed"]
    )


@functools.cache
def _scenario(world: str) -> Scenario:
    return build_scenario(InterceptConfig(world=world, planner="no-policy"))


@functools.cache
def _lattices(world: str) -> Lattices:
    return build_lattices(_scenario(world).world, SearchConfig(padding=PADDING))


def artefacts(config: Config) -> list[Path]:
    """What the results are compared with."""
    path = reference_times_report.compared_file(config.compare)
    return [] if path is None else [path]


EXPERIMENT = Experiment(
    summary=SUMMARIES["reference-times"],
    presets={
        "smoke": Config(worlds=("env1",), episodes=2, starts=4, rounds=6),
        "small": Config(),
        "full": Config(episodes=3000),
    },
    items=items,
    evaluate=evaluate,
    report=reference_times_report.report,
    prepare=prepare,
    shard_size=5,
    artefacts=artefacts,
)
