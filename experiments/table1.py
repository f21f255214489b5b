"""Table I: shares of interceptions over worlds, trajectories, speeds and departures, for planners and predictors.

    jaxplan experiment table1 --preset smoke|small|full [--workers N | --scheduler ADDRESS] [--out DIR] [--resume]

An episode succeeds if the target is met (0.4 m) with the position error below 0.4 m and the yaw error below 45 degrees
throughout, and nothing is hit by exact geometry (paper, Sec. IV). All cells fly the same episodes with the same noise.
"""

import dataclasses
from pathlib import Path

import numpy as np

from jaxplan.config import WITH_MODEL, WITH_NETWORK, Meet
from jaxplan.errors import InputError
from jaxplan.feasibility.checkpoint import WEIGHTS as CLASSIFIERS
from jaxplan.io.targets import stored_targets
from jaxplan.names import SHIPPED
from jaxplan.policy.checkpoint import WEIGHTS
from jaxplan.prediction import target_model
from jaxplan.prediction.mdn.checkpoint import SHIPPED_NETWORK
from jaxplan.runner.definition import Experiment, Item, Row
from jaxplan.world.load import ENVIRONMENTS

from . import SUMMARIES, closed_loop, on_device, table1_report
from .closed_loop import PREDICTORS, EpisodeConfig, compared_planners
from .guidance import LAWS

SPEEDS = tuple(float(speed) for speed in np.round(np.linspace(0.5, 5.5, 10), 4))
"""m/s. The paper names ten speeds from 0.5 to 5.5 in steps of 0.5, which would be eleven: ten, both ends included
(docs/decisions/0012-experiments.md)."""
DEPARTURES = tuple(float(time) for time in np.round(np.linspace(0.5, 2.5, 10), 4))
"""s."""
FOR_OTHERS = ("imm", "fused", "mdn", "ensemble")
"""Predictors that the paper has nothing like: flown where they are named."""
COMPARED = tuple(name for name in PREDICTORS if name not in FOR_OTHERS)
"""Predictors of the presets."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """Which episodes are flown, by whom."""

    planners: tuple[str, ...] = dataclasses.field(default_factory=compared_planners)
    """Who allots the times: no-policy, pretrained, mfrl, profile, optimiser; or pursuit, navigation, which plan
    nothing."""

    predictors: tuple[str, ...] = COMPARED
    """What is known of the target's future; noisy-S has the standard deviation S [m] after one step. imm, fused,
    mdn and ensemble are for targets that are seen badly or that nobody knows: name them."""

    worlds: tuple[str, ...] = ENVIRONMENTS
    """Stored worlds."""

    targets: int = 10
    """Trajectories of each world."""

    speeds: tuple[float, ...] = SPEEDS
    """Maximum speeds of the target [m/s]."""

    departures: tuple[float, ...] = DEPARTURES
    """Times at which the defender leaves its hover [s]."""

    episodes: int = 300
    """Episodes of a cell, chosen evenly among all combinations."""

    meet: Meet = "pass"
    """How targets are met: pass flies through them, match at their velocity; rest stops at them, as in the paper."""

    refine: bool = False
    """Whether chosen plans are made sooner by optimising waypoints and times together; the paper does not."""

    vehicle: str = closed_loop.VEHICLE
    """Who flies: a preset, or a file. What was learned flies the default one only; profile flies any."""

    padding: float = closed_loop.PADDING
    """Distance [m] that goals and paths keep from obstacles."""

    seed: int = 0
    """Added to every episode's index to seed its noise."""

    device: on_device.DeviceName = "host"
    """Where episodes are flown: host, one after the other by the planner that users call; cpu or gpu, many at a time by
    the programs of jaxplan.device, which search the same roadmaps, choose by eq. 9 and refine nothing."""

    batch: int = 1024
    """Episodes that a device flies at a time at most."""

    def __post_init__(self) -> None:
        closed_loop.check_names(self.worlds, self.planners, self.predictors)
        closed_loop.check_vehicle(self.vehicle, self.padding, self.planners)
        for name in ("speeds", "departures"):
            values = getattr(self, name)
            if not values or not all(0.0 < value <= 50.0 for value in values) or len(set(values)) != len(values):
                raise InputError(f"--{name}: have {values}, want numbers above 0 and at most 50, each once")
        if self.refine and self.meet != "pass":
            raise InputError(f"--refine: have --meet {self.meet}, want --meet pass")
        if not 1 <= self.targets <= 10:
            raise InputError(f"--targets: have {self.targets}, want 1 to 10")
        most = len(self.worlds) * self.targets * len(self.speeds) * len(self.departures)
        if not 1 <= self.episodes <= most:
            raise InputError(f"--episodes: have {self.episodes}, want 1 to {most}, the number of combinations")
        if self.seed < 0:
            raise InputError(f"--seed: have {self.seed}, want 0 or more")
        if not 1 <= self.batch <= 65536:
            raise InputError(f"--batch: have {self.batch}, want 1 to 65536")
        if self.device != "host":
            on_device.check_names(self.planners, self.predictors)
            if self.refine:
                raise InputError("--refine: have it, and nothing is refined on a device; leave --device out")


def chosen(config: Config) -> list[EpisodeConfig]:
    """The episodes of a cell, without planner and predictor, in the order of the full grid."""
    worlds, speeds, departures = config.worlds, config.speeds, config.departures
    names = {world: stored_targets(world)[: config.targets] for world in worlds}
    sizes = len(worlds), config.targets, len(speeds), len(departures)
    episodes = []
    for index in sorted(even_choice(sizes, config.episodes)):
        world, target, speed, departure = np.unravel_index(index, sizes)
        episodes.append(
            EpisodeConfig(
                world=worlds[world],
                planner="",
                predictor="",
                target=names[worlds[world]][target],
                speed=speeds[speed],
                departure=departures[departure],
                seed=config.seed + index,
                meet=config.meet,
                vehicle=config.vehicle,
                padding=config.padding,
                refine=config.refine,
            )
        )
    return episodes


def even_choice(sizes: tuple[int, int, int, int], count: int) -> list[int]:
    """Indices of ``count`` cells of a grid, evenly over every axis: worlds in turn, Latin squares over the others.

    A whole square has each pair of values of two axes once; the first cell is in the middle of the third axis.
    """
    worlds, targets, speeds, departures = sizes
    found = []
    for place in range(count):
        world, rest = place % worlds, place // worlds
        target, row = rest % targets, rest // targets
        square = row // speeds
        speed = (target + row + speeds // 2) % speeds
        departure = (2 * target + row % speeds + square) % departures
        found.append(int(np.ravel_multi_index((world, target, speed, departure), sizes)))
    return found


def cells(config: Config) -> list[tuple[str, str]]:
    """Planner and predictor of every cell; what plans nothing has no use for a prediction."""
    return [
        (planner, predictor)
        for planner in config.planners
        for predictor in (("none",) if planner in LAWS else config.predictors)
    ]


def items(config: Config) -> list[Item]:
    """All episodes, those of one planner together."""
    episodes, found = chosen(config), []
    for planner, predictor in cells(config):
        for episode in episodes:
            own = dataclasses.replace(episode, planner=planner, predictor=predictor)
            name = f"{planner}/{predictor}/{own.target}/{own.speed:g} m/s/{own.departure:g} s"
            found.append(Item(name, planner, dataclasses.asdict(own)))
    return found


def prepare(config: Config, group: str) -> None:
    """Compile what the episodes of one planner call, in every world."""
    for world in dict.fromkeys(episode.world for episode in chosen(config)):
        defender = closed_loop.Defender(group, config.meet, config.vehicle, config.padding, config.refine)
        closed_loop.warm_up(world, defender)


def evaluate(config: Config, item: Item) -> Row:
    """Fly one episode."""
    episode = EpisodeConfig(**item.values)
    return {**item.values, **closed_loop.numbers(closed_loop.fly(episode))}


def together(config: Config, items: list[Item]) -> list[Row]:
    """Fly episodes of one planner on a device."""
    episodes = [EpisodeConfig(**item.values) for item in items]
    rows = on_device.fly_together(episodes, config.device, config.batch)
    return [{**item.values, **row} for item, row in zip(items, rows, strict=True)]


def at_once(config: Config, /) -> int:
    """All of a planner, on a device; 2 at least, so that a single one is flown there, too."""
    return 1 if config.device == "host" else max(2, len(config.predictors) * config.episodes)


def artefacts(config: Config) -> list[Path]:
    """Weights, mixtures and networks that the cells use."""
    models = Path(target_model.__file__).parent / "models"
    files = [folder / f"{planner}.npz" for planner in config.planners for folder in (WEIGHTS, CLASSIFIERS)]
    if set(WITH_MODEL) & set(config.predictors):
        files += [models / f"{world}.npy" for world in config.worlds]
    if set(WITH_NETWORK) & set(config.predictors):
        files.append(SHIPPED["flight network"] / f"{SHIPPED_NETWORK}.npz")
    return [path for path in files if path.is_file()]


SMOKE = tuple(planner for planner in compared_planners() if planner != "optimiser")
"""The optimiser takes longest to compile."""

EXPERIMENT = Experiment(
    summary=SUMMARIES["table1"],
    presets={"smoke": Config(episodes=1, planners=SMOKE), "small": Config(episodes=300), "full": Config(episodes=3000)},
    items=items,
    evaluate=evaluate,
    report=table1_report.report,
    prepare=prepare,
    shard_size=10,
    artefacts=artefacts,
    together=together,
    at_once=at_once,
)
