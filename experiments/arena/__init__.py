"""The arena: targets that are fast, evasive or half seen, in rooms known and unknown, and who meets them how soon.

    jaxplan experiment arena --preset smoke|small|full [--families ...] [--contestants ...] [--workers N] [--resume]

Every contestant flies the same episodes in the same simulated vehicle. Contestants are our planners with a predictor
each (mfrl/gmm), laws that plan nothing (pursuit, navigation, fast-navigation, routed-navigation, mpc), and the offline
reference, which knows the target's motion and is flown once. An episode is met within 0.4 m of the target; it is lost
where the vehicle leaves its reference by 0.4 m or turns about body z by 45 degrees, or hits something.
"""

import dataclasses
from pathlib import Path

import numpy as np

from jaxplan import interception
from jaxplan.errors import InputError
from jaxplan.interception import INTERCEPTION_RADIUS, Episode
from jaxplan.names import meant
from jaxplan.planner import Planner
from jaxplan.reference.flight import Judge
from jaxplan.reference.soonest import Interception, ReferenceConfig, soonest
from jaxplan.reference.starts import Sought
from jaxplan.runner.definition import Experiment, Item, Row
from jaxplan.scenario import Scenario, distance_in
from jaxplan.search.lattice import SearchConfig, build_lattices
from jaxplan.spline import hover
from jaxplan.status import PlanStatus
from jaxplan.world.load import ENVIRONMENTS
from jaxplan.world.obstacles import World
from jaxplan.world.occupancy import RESOLUTIONS, fitting_resolution

from .. import SUMMARIES, closed_loop, reference_times, table1
from .contestants import CONTESTANTS, REFERENCE, contestant
from .families import FAMILIES, LEVELS, MOST_SEEDS, Case, case
from .movers import Traffic
from .report import report

USUAL = ("reference", "navigation", "fast-navigation", "routed-navigation")
USUAL += ("mfrl/ground-truth", "mfrl/particles", "mfrl/fused", "mfrl/gmm", "mfrl/constant-velocity")
"""Contestants of the presets; mpc needs the extra ``peers``."""
SHORT = ReferenceConfig(segments=6, starts=4, rounds=5)
"""How much the reference tries: about 4 s a target."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """Who flies what."""

    families: tuple[str, ...] = tuple(name for name in FAMILIES if name != "recorded")
    """Kinds of episodes: stored, entry, rooms, evasive, half-seen, recorded, camera, moving, moving-seen,
    moving-abrupt."""

    levels: tuple[int, ...] = LEVELS
    """Of difficulty: 1, 2, 3."""

    contestants: tuple[str, ...] = USUAL
    """Who flies: PLANNER/PREDICTOR, pursuit, navigation, fast-navigation, routed-navigation, mpc, reference."""

    episodes: int = 10
    """Of each family on each level."""

    refine: bool = True
    """Whether our planners make chosen plans sooner, as jaxplan intercept does."""

    recordings: tuple[str, ...] = ()
    """Recorded flights for the family of that name: files, as --target of jaxplan intercept takes them."""

    seed: int = 0
    """Of all episodes, below 10,000: with another one they are other episodes, but for the stored flights."""

    def __post_init__(self) -> None:
        for kind, names, known in (("families", self.families, FAMILIES), ("levels", self.levels, LEVELS)):
            wrong = [name for name in names if name not in known]
            if wrong or not names or len(set(names)) != len(names):
                have = wrong[0] if wrong else names
                near = meant(str(have), [str(name) for name in known])
                raise InputError(f"--{kind}: have {have!r}, want some of {', '.join(map(str, known))}, each once{near}")
        if not self.contestants or len(set(self.contestants)) != len(self.contestants):
            raise InputError(f"--contestants: have {self.contestants}, want at least one, each once")
        for name in self.contestants:
            if name != REFERENCE:
                contestant(name)
        if not 1 <= self.episodes <= 1000:
            raise InputError(f"--episodes: have {self.episodes}, want 1 to 1000")
        if not 0 <= self.seed < MOST_SEEDS:
            raise InputError(f"--seed: have {self.seed}, want 0 or more, below {MOST_SEEDS}")
        if "recorded" in self.families and not self.recordings:
            raise InputError("--recordings: the family 'recorded' flies files of yours; name some, or leave it out")


def items(config: Config) -> list[Item]:
    """All episodes, those of one contestant together; the reference flies those whose target does not react."""
    found = []
    for name in config.contestants:
        for family in config.families:
            if name in (REFERENCE, "mfrl/ground-truth") and family == "evasive":
                continue
            for level in config.levels:
                for number in range(config.episodes):
                    values = {"contestant": name, "family": family, "level": level, "number": number}
                    found.append(Item(f"{name}/{family}/{level}/{number}", name, values))
    return found


def prepare(config: Config, group: str) -> None:
    """Compile what a contestant's episodes call."""
    _base(config, group)


def evaluate(config: Config, item: Item) -> Row:
    """Fly one episode."""
    name, family, level, number = (item.values[key] for key in ("contestant", "family", "level", "number"))
    one = case(family, level, number, config.seed, config.recordings)
    common = {**item.values, "world": one.world.name, "target": one.target.name, "departure_s": one.departure}
    if name == REFERENCE:
        return {**common, **_reference(config, one)}
    scenario = settled(_base(config, name), one)
    guide = contestant(name).build(scenario, one)
    flown = interception.fly(scenario, guide=guide, watch=one.watch, react=one.react)
    return {**common, **numbers(flown), **(_among(flown, one.traffic) if one.traffic else {})}


def _among(episode: Episode, traffic: Traffic) -> Row:
    """How near the vehicle came to what moves; who touches it has collided, whatever came after that."""
    free = traffic.distances(episode.flight.times, episode.flight.position)
    touched = (free < float(episode.scenario.vehicle.radius)).any()
    hit: Row = {"outcome": "collision", "time_s": None} if touched else {}
    return {**hit, "moving_clearance_m": float(free.min())}


def numbers(episode: Episode) -> Row:
    """What is kept of an episode: plain values."""
    flight = episode.flight
    begun = flight.times >= episode.scenario.departure
    apart = np.linalg.norm(flight.position - flight.target, axis=1)[begun]
    relative = np.linalg.norm(flight.velocity[-1] - flight.target_velocity[-1])
    new = sum(cycle.status in (PlanStatus.INTERCEPT, PlanStatus.APPROACH) for cycle in episode.cycles)
    return {
        "outcome": episode.outcome,
        "time_s": float(flight.times[-1]) - episode.scenario.departure if episode.success else None,
        "closest_m": float(apart.min()) if len(apart) else None,
        "relative_speed_m_s": float(relative) if episode.success else None,
        "energy_hover_s": _energy(episode),
        "clearance_m": float(flight.clearance.min()),
        "position_error_m": float(flight.position_error.max()),
        "cycles": len(episode.cycles),
        "committed": new,
        "changes": max(new - 1, 0),
        "outside": sum(cycle.rejected.get("goal_outside", 0) for cycle in episode.cycles),
        "candidates": sum(cycle.generated for cycle in episode.cycles),
    }


def _energy(episode: Episode) -> float:
    """What the flight takes as a multiple of a second's hover: by momentum theory power goes with thrust^1.5."""
    flight, vehicle = episode.flight, episode.scenario.vehicle
    begun = flight.times >= episode.scenario.departure
    if begun.sum() < 3:
        return 0.0
    times, velocity = flight.times[begun], flight.velocity[begun]
    drag = float(vehicle.drag_coefficient) / float(vehicle.mass)
    gravity = float(vehicle.gravity)
    acceleration = np.gradient(velocity, times, axis=0) + np.array([0.0, 0.0, gravity])
    thrust = np.linalg.norm(acceleration + drag * np.linalg.norm(velocity, axis=1, keepdims=True) * velocity, axis=1)
    return float(np.trapezoid((thrust / gravity) ** 1.5, times))


def settled(base: Scenario, one: Case) -> Scenario:
    """A scenario with the world, target and start of an episode."""
    planner = base.planner if _room(one.world) == _room(base.world) else _planner_in(base.planner, one)
    return dataclasses.replace(
        base,
        world=one.world,
        target=one.target,
        planner=planner,
        start=hover(one.start),
        departure=one.departure,
        seed=one.seed,
        clearance=distance_in(one.world),
        stream=one.stream,
    )


_PLANNERS: dict[tuple[int, str, int], Planner] = {}
"""By planner and room; the newest few."""
MOST_ROOMS = 6


def _room(world: World) -> tuple[str, int]:
    """Its name, and how many boxes it has: spare ones make it another room."""
    return world.name, len(world.boxes.center)


def _planner_in(planner: Planner, one: Case) -> Planner:
    """The planner in a room, from the last time if it was there."""
    key = (id(planner.plan_batch), *_room(one.world))
    if key not in _PLANNERS:
        while len(_PLANNERS) >= MOST_ROOMS:
            del _PLANNERS[next(iter(_PLANNERS))]
        own = planner.in_world(one.world, fitting_resolution(one.world, planner.config.resolution))
        own.warmup(hover(one.start))
        _PLANNERS[key] = own
    return _PLANNERS[key]


def _base(config: Config, name: str) -> Scenario:
    """What a contestant's episodes have in common, compiled in the first stored room."""
    planner = "no-policy" if name == REFERENCE else contestant(name).planner
    defender = closed_loop.Defender(planner, refine=config.refine and name not in CONTESTANTS and name != REFERENCE)
    base = closed_loop.scenario_in(ENVIRONMENTS[0], defender)
    if name not in CONTESTANTS and name != REFERENCE and defender not in _WARM:
        base.planner.warmup(base.start)
        _WARM.add(defender)
    return dataclasses.replace(base, judged_by_heading=False)


_WARM: set[closed_loop.Defender] = set()


def _reference(config: Config, one: Case) -> Row:
    """The soonest flight that an optimiser finds which knows the target's motion."""
    base = _base(config, REFERENCE)
    cells = tuple(fitting_resolution(one.world) / RESOLUTIONS[0] * side for side in RESOLUTIONS)
    lattices = build_lattices(one.world, SearchConfig(padding=reference_times.PADDING, resolutions=cells))
    radius = float(np.asarray(base.vehicle.radius))
    judge = Judge(distance_in(one.world), radius, INTERCEPTION_RADIUS, one.target.duration)
    sought = Sought(lattices, one.world, one.start)
    position, velocity = one.target.position, one.target.velocity
    asked = Interception(sought, base.vehicle, base.plant, judge, position, velocity, one.departure, one.seed)
    found = soonest(asked, SHORT)
    met = found.verdict.accepted
    return {"outcome": "intercepted" if met else "target_ended", "time_s": found.seconds if met else None}


def artefacts(config: Config) -> list[Path]:
    """Weights and mixtures that the contestants use."""
    ours = [name.split("/") for name in config.contestants if "/" in name]
    if not ours:
        return []
    planners, predictors = (tuple(dict.fromkeys(names)) for names in zip(*ours, strict=True))
    known = tuple(name for name in predictors if name in closed_loop.PREDICTORS) or ("none",)
    return table1.artefacts(table1.Config(planners=planners, predictors=known))


EXPERIMENT = Experiment(
    summary=SUMMARIES["arena"],
    presets={"smoke": Config(episodes=1), "small": Config(episodes=10), "full": Config(episodes=40)},
    items=items,
    evaluate=evaluate,
    report=report,
    prepare=prepare,
    shard_size=10,
    artefacts=artefacts,
)
