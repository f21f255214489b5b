"""Faults injected into the closed loop: what becomes of episodes, and whether anything is hit that need not be.

    jaxplan experiment faults --preset smoke|small|full [--faults NAME ...] [--workers N] [--out DIR] [--resume]

Table I's episodes are flown with one fault each: sensors (late by 0.3 s, half of it lost, noisy by 0.1 m, jumping by
5 m, told again and out of order), time (cycles of up to 0.5 s, whose late plans are dropped, stalls of up to 2 s, a
clock that goes back), the vehicle (a gust of 10 m/s, moved by 0.35 m, a rotor at 75 %), the room (a box on the
committed path, beyond a stop). The vehicle is measured in every cycle, and lost 1 m or a right angle about body z off
its reference. An episode hits something where its plant comes closer than its radius to an obstacle, or to a box from
when it appears, which is ``avoidable`` if one of the stops that were clear from where the vehicle was when a plan could
first take over after the event, flown from there in the same plant with the same fault, keeps clear. Of what blows,
pushes or weakens the vehicle nobody knows at the event: ``avoidable_once_felt`` asks for such a stop after the first
cycle in which the vehicle is ``FELT`` off its reference.
``reference_hits`` counts commanded positions that come closer.
"""

import dataclasses
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxplan import interception
from jaxplan.errors import InputError
from jaxplan.interception import Episode
from jaxplan.interception.judging import measured_state
from jaxplan.planner import HITS, Planner, sampled
from jaxplan.runner.definition import Experiment, Item, Report, Results, Row
from jaxplan.runner.statistics import wilson
from jaxplan.runner.tables import as_latex, as_markdown, number
from jaxplan.scenario import Scenario
from jaxplan.spline import FlatState
from jaxplan.status import PlanStatus
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.result import Thresholds
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.load import ENVIRONMENTS

from . import SUMMARIES, closed_loop, table1
from .closed_loop import EpisodeConfig
from .injection import FAULTS, ROOM, VEHICLE, Trouble, with_a_spare_box

LOST = Thresholds(position=1.0, yaw=np.pi / 2.0)
"""A vehicle that is blown or pushed off its reference for a moment is not lost."""
FELT = 0.2
"""m; a vehicle as near to its reference as that is where it should be."""
STOPPED = 3.0
"""s; after which every stop is over, and what blew is over, too."""
FINE = 0.01
"""s; between the commanded positions that are looked at."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """Which faults, in how many episodes."""

    faults: tuple[str, ...] = FAULTS
    """What goes wrong, one thing an episode."""

    worlds: tuple[str, ...] = ENVIRONMENTS
    """Stored worlds."""

    planner: str = "mfrl"
    """Who allots the times."""

    predictor: str = "fused"
    """What predicts the target from what is seen; ground-truth sees no sensor."""

    vehicle: str = closed_loop.VEHICLE
    """Who flies: a preset, or a file. What was learned flies the default one only; profile flies any."""

    padding: float = closed_loop.PADDING
    """Distance [m] that goals and paths keep from obstacles."""

    refine: bool = True
    """Whether chosen plans are made sooner, as jaxplan intercept does; --refine=no leaves them as they are."""

    episodes: int = 30
    """Of each fault, Table I's."""

    def __post_init__(self) -> None:
        closed_loop.check_names(self.worlds, (self.planner,), (self.predictor,))
        closed_loop.check_vehicle(self.vehicle, self.padding, (self.planner,))
        wrong = [name for name in self.faults if name not in FAULTS]
        if wrong or not self.faults:
            raise InputError(f"--faults: have {' '.join(wrong) or 'none'}, want some of {', '.join(FAULTS)}")
        if not 1 <= self.episodes <= 3000:
            raise InputError(f"--episodes: have {self.episodes}, want 1 to 3000")


def artefacts(config: Config) -> list[Path]:
    """Weights that the episodes use."""
    return table1.artefacts(table1.Config(planners=(config.planner,), predictors=(config.predictor,)))


def items(config: Config) -> list[Item]:
    """All episodes; those with a box have a planner of their own."""
    flown = {"worlds": config.worlds, "episodes": config.episodes, "planners": (config.planner,)}
    chosen = table1.chosen(table1.Config(**flown, vehicle=config.vehicle, padding=config.padding, refine=config.refine))
    found = []
    for fault in sorted(config.faults, key=lambda name: (name in ROOM, FAULTS.index(name))):
        for episode in chosen:
            own = dataclasses.replace(episode, planner=config.planner, predictor=config.predictor)
            name = f"{fault}/{own.target}/{own.speed:g} m/s/{own.departure:g} s"
            group = "a changing room" if fault in ROOM else "a fixed room"
            found.append(Item(name, group, {"fault": fault, **dataclasses.asdict(own)}))
    return found


def prepare(config: Config, group: str) -> None:
    """Compile what the episodes call."""
    for world in config.worlds:
        defender = closed_loop.Defender(config.planner, "pass", config.vehicle, config.padding, config.refine)
        closed_loop.warm_up(world, defender)


def evaluate(config: Config, item: Item) -> Row:
    """Fly one episode with its fault."""
    values = dict(item.values)
    fault = values.pop("fault")
    episode = EpisodeConfig(**values)
    base = dataclasses.replace(closed_loop.scenario_of(episode), judged_by_heading=False, lost_beyond=LOST)
    trouble = Trouble(_with_room(base) if fault in ROOM else base, fault)
    flown = interception.fly(trouble.disturbed(), guide=trouble, watch=trouble.watch)
    return {"fault": fault, **values, **_found(flown, trouble)}


_PLANNERS: dict[Planner, Planner] = {}
"""With a spare box, by the planner without."""


def _with_room(base: Scenario) -> Scenario:
    """The scenario with a planner that knows a spare box, built once for each planner in each world."""
    if base.planner not in _PLANNERS:
        own = with_a_spare_box(base).planner
        own.warmup(base.start)
        _PLANNERS[base.planner] = own
    return dataclasses.replace(base, planner=_PLANNERS[base.planner])


def _found(episode: Episode, trouble: Trouble) -> Row:
    """What is told of an episode: plain values."""
    flight, cycles, radius = episode.flight, episode.cycles, float(episode.scenario.vehicle.radius)
    times = np.arange(episode.scenario.departure, float(flight.times[-1]), FINE)
    commanded = trouble.reference(times).pos
    clear = np.minimum(_free(trouble, times, commanded), episode.scenario.clearance(commanded))
    flown = np.minimum(_free(trouble, flight.times, flight.position), flight.clearance)
    jumps = [float(cycle.jump[:4].max()) for cycle in cycles if cycle.jump is not None]
    status = [cycle.status for cycle in cycles]
    touching, event = flown < radius, min(trouble.appeared, trouble.event)
    return {
        **closed_loop.numbers(episode),
        "hit": bool(touching.any()),
        "avoidable": bool(touching.any()) and _is_avoidable(episode, trouble, touching, event),
        "avoidable_once_felt": bool(touching.any())
        and _is_avoidable(episode, trouble, touching, _felt(episode, trouble.fault, event)),
        "reference_hits": int((clear < radius).sum()),
        "changed": trouble.world is not None,
        "largest_jump": max(jumps, default=0.0),
        "late": status.count(PlanStatus.LATE),
        "stops": status.count(PlanStatus.BRAKE) + status.count(PlanStatus.RECOVER),
        "blocked": status.count(PlanStatus.BLOCKED),
        "refused_plans": sum(cycle.refused for cycle in cycles),
        "refused_clocks": trouble.refused_clocks,
        "largest_deviation_m": max((cycle.deviation for cycle in cycles), default=0.0),
    }


def _felt(episode: Episode, fault: str, event: float) -> float:
    """When the loop can know of the event [s]; infinite where it never does."""
    off = (cycle.time for cycle in episode.cycles if cycle.time >= event and cycle.deviation > FELT)
    return next(off, np.inf) if fault in VEHICLE else event


def _is_avoidable(episode: Episode, trouble: Trouble, touching: Bool[np.ndarray, "n"], event: float) -> bool:
    """Whether a stop that was clear when a plan could first take over after ``event`` [s] would have kept it from that.

    The stops are flown from the state that the vehicle was in then, in the same plant with the same fault.
    """
    scenario = episode.scenario
    after = [cycle.time for cycle in episode.cycles if cycle.time >= event]
    first = round((after[0] + scenario.replanning.latency) * CONTROL_RATE) if after else len(touching)
    state = None if first >= len(touching) or touching[:first].any() else trouble.state_at(first)
    if state is None:
        return False
    measured = measured_state(state, scenario.vehicle)
    derivatives = np.stack([measured.position, measured.velocity, measured.acceleration, np.zeros(3), np.zeros(3)])
    yaw = trouble.reference(np.array([first / CONTROL_RATE])).yaw[0]
    stops = trouble.planner.brake(FlatState(derivatives=derivatives, yaw=yaw))
    references = sampled(stops.splines, np.arange(round(STOPPED * CONTROL_RATE) + 1) / CONTROL_RATE)
    room = trouble.world or scenario.world
    for index in np.flatnonzero(stops.reasons & np.uint32(HITS) == 0):
        log = trouble.flown_along(state, jax.tree.map(lambda rows, index=index: rows[index], references))
        if (host_free_distance(room, np.asarray(log.pos, float), 1024) >= float(scenario.vehicle.radius)).all():
            return True
    return False


def _free(trouble: Trouble, times: Float[np.ndarray, "n"], points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """Distance to what has appeared in the room, from when it did; infinite where nothing has."""
    if trouble.world is None:
        return np.full(len(times), np.inf)
    free = host_free_distance(trouble.world, points, 1024)
    return np.where(times >= trouble.appeared, free, np.inf)


HEADER = (
    "fault",
    "episodes",
    "met",
    "95 %",
    "mean s",
    "lost",
    "hit",
    "avoidable",
    "once felt",
    "reference hit",
    "largest jump",
    "late",
    "stops",
)
HEADER += ("blocked", "boxes", "clocks refused", "plans refused")


def report(results: Results[Config]) -> Report:
    """One row a fault: how many met the target, how many hit something, and what was dropped, stopped or refused."""
    rows = results.finished_rows()
    cells = [_cells(fault, [row for row in rows if row["fault"] == fault]) for fault in dict.fromkeys(_faults(rows))]
    hits = sum(row["hit"] for row in rows)
    caption = "Faults injected into the closed loop."
    return Report(
        markdown=as_markdown(HEADER, cells),
        table=rows,
        latex=as_latex(HEADER, cells, caption),
        figures={},
        summary=f"{len(rows)} episodes with faults; {hits} of them hit something",
    )


def _faults(rows: list[Row]) -> list[str]:
    return [row["fault"] for row in rows]


def _cells(fault: str, rows: list[Row]) -> list[str]:
    """One row of the table."""
    met = [row["time_to_intercept_s"] for row in rows if row["outcome"] == "intercepted"]
    low, high = wilson(len(met), len(rows))

    def total(name: str) -> str:
        return str(sum(row[name] for row in rows))

    return [
        fault,
        str(len(rows)),
        number(len(met) / len(rows)),
        f"{number(low)} to {number(high)}",
        number(float(np.mean(met)) if met else None, ".2f"),
        str(sum(row["outcome"] == "tracking_lost" for row in rows)),
        total("hit"),
        total("avoidable"),
        total("avoidable_once_felt"),
        str(sum(row["reference_hits"] > 0 for row in rows)),
        f"{max(row['largest_jump'] for row in rows):.0e}",
        *(total(name) for name in ("late", "stops", "blocked", "changed", "refused_clocks", "refused_plans")),
    ]


EXPERIMENT = Experiment(
    summary=SUMMARIES["faults"],
    presets={"smoke": Config(episodes=1, worlds=("env1",)), "small": Config(episodes=30), "full": Config(episodes=300)},
    items=items,
    evaluate=evaluate,
    report=report,
    prepare=prepare,
    shard_size=10,
    artefacts=artefacts,
)
