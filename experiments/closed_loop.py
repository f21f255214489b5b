"""Episodes by name, with everything that can be shared between them compiled once per process."""

import dataclasses
import functools
import re
from typing import Any, NamedTuple

import numpy as np

from jaxplan import config as intercept
from jaxplan import interception
from jaxplan.config import WITH_MODEL
from jaxplan.errors import InputError
from jaxplan.interception import Episode
from jaxplan.io.targets import Target, load_target, stored_targets
from jaxplan.planner import Planner, build_planner
from jaxplan.policy.checkpoint import WEIGHTS
from jaxplan.prediction.predictors import build_predictor
from jaxplan.prediction.protocol import PredictionConfig, StepPredictor
from jaxplan.prediction.target_model import shipped_model
from jaxplan.scenario import Scenario, build_scenario, check_padding
from jaxplan.tracking.result import SUCCESS
from jaxplan.tracking.rollout import Plant, build_plant
from jaxplan.vehicle.identity import identify
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import ENVIRONMENTS

from .guidance import LAWS, Guidance, law_named
from .optimiser import optimiser_policy
from .plan_audit import audit

LEARNED = tuple(name for name in intercept.PLANNERS if name != "no-policy")
PLANNERS = (*intercept.PLANNERS, "profile", "optimiser", *LAWS)
"""Who allots the times; ``profile`` is what a vehicle of one's own is flown with, which nothing was learned for."""
PREDICTORS = (
    "none",
    "ground-truth",
    "noisy-0.01",
    "noisy-0.05",
    "gmm",
    "particles",
    "constant-velocity",
    "imm",
    "fused",
    "mdn",
    "ensemble",
)
"""``noisy-S`` has the standard deviation S [m] after one step; any S will do."""
TIME_WEIGHT = 7.5e4
"""rho of the optimiser [m^2/s^8]: total times from rest are those of an earlier pretrained policy in the median of 200
random sequences."""
WARM_UP_PREDICTORS = ("noisy-0.05", "none")
"""Predictors whose episodes compile nearly all that any episode calls: many candidates and few, met and approached."""


VEHICLE, PADDING = intercept.InterceptConfig.vehicle, intercept.InterceptConfig.padding


class Defender(NamedTuple):
    """What a planner is built for, in whatever world."""

    planner: str
    meet: str = "pass"
    vehicle: str = VEHICLE
    padding: float = PADDING
    refine: bool = False


@dataclasses.dataclass(frozen=True, kw_only=True)
class EpisodeConfig:
    """One episode among many."""

    world: str
    planner: str
    predictor: str
    target: str
    speed: float
    """The target's maximum speed [m/s]."""
    departure: float
    seed: int
    meet: str = "pass"
    """How the target is met, as ``InterceptConfig`` says; "rest" is the paper's, with the heading along the path."""
    vehicle: str = VEHICLE
    """A preset, or a file."""
    padding: float = PADDING
    """Distance [m] that goals and paths keep from obstacles."""
    refine: bool = False
    """Whether chosen plans are made sooner and compared by capture, as ``InterceptConfig`` does; the paper does not."""


def available_planners() -> tuple[str, ...]:
    """Every planner whose weights are here."""
    return tuple(name for name in PLANNERS if name not in LEARNED or (WEIGHTS / f"{name}.npz").is_file())


def compared_planners() -> tuple[str, ...]:
    """Those of them that Table I compares."""
    return tuple(name for name in available_planners() if name != "profile")


def check_names(worlds: tuple[str, ...], planners: tuple[str, ...], predictors: tuple[str, ...]) -> None:
    """Raise ``InputError`` for a name that no episode can use."""
    for kind, names, known in (
        ("worlds", worlds, ENVIRONMENTS),
        ("planners", planners, available_planners()),
        ("predictors", predictors, PREDICTORS),
    ):
        if not names or len(set(names)) != len(names):
            raise InputError(f"--{kind}: have {' '.join(names) or 'none'}, want at least one, each once")
        wrong = [name for name in names if name not in known and not (kind == "predictors" and named_noise(name))]
        if wrong:
            raise InputError(f"--{kind}: have {wrong[0]!r}, want some of {', '.join(known)}")


def check_vehicle(vehicle: str, padding: float, planners: tuple[str, ...]) -> None:
    """Raise for a vehicle that cannot be read, or that some of the planners cannot fly."""
    intercept.InterceptConfig(vehicle=vehicle, padding=padding)
    own = load_vehicle(vehicle)
    check_padding(padding, own)
    if identify(own).fingerprint != identify(load_vehicle()).fingerprint:
        learned = [name for name in planners if name in LEARNED]
        if learned:
            raise InputError(
                f"--planners: have {learned[0]!r}, which learned to fly {VEHICLE!r} and not {own.name!r}; choose among "
                f"{', '.join(name for name in PLANNERS if name not in LEARNED)}"
            )


def warm_up(world: str, defender: Defender) -> None:
    """Load a world and a planner, and fly the episodes that compile most of what theirs call."""
    for predictor in WARM_UP_PREDICTORS[:1] if defender.planner in LAWS else WARM_UP_PREDICTORS:
        names = {"world": world, "predictor": predictor, "target": stored_targets(world)[0]}
        fly(EpisodeConfig(**names, **defender._asdict(), speed=3.0, departure=0.5, seed=0))


def fly(episode: EpisodeConfig) -> Episode:
    """Fly an episode; its result depends on nothing but ``episode``."""
    scenario = scenario_of(episode)
    guide = Guidance(law_named(episode.planner), scenario.start) if episode.planner in LAWS else None
    return interception.fly(scenario, guide=guide)


def numbers(episode: Episode) -> dict[str, Any]:
    """What a table needs of an episode: plain values."""
    flight = episode.flight
    apart = np.linalg.norm(flight.position - flight.target, axis=1)
    end = float(flight.times[-1])
    return {
        "outcome": episode.outcome,
        "singular": _is_singular(episode),
        "time_to_intercept_s": end - episode.scenario.departure if episode.success else None,
        "end_time_s": end,
        "min_distance_m": float(apart.min()),
        "max_position_error_m": float(flight.position_error.max()),
        "max_yaw_error_deg": float(np.degrees(flight.yaw_error.max())),
        "min_clearance_m": float(flight.clearance.min()),
        "replans": episode.replans,
        **audit(episode),
    }


def _is_singular(episode: Episode) -> bool:
    """Whether an episode is lost by its heading alone, on a flight whose position and turn about body z are kept."""
    flight = episode.flight
    kept = flight.position_error[-1] < SUCCESS.position and flight.twist_error[-1] < SUCCESS.yaw
    return episode.outcome == "tracking_lost" and bool(kept)


def scenario_of(episode: EpisodeConfig) -> Scenario:
    """What an episode flies, for those that change some of it."""
    target = load_target(episode.target, world=episode.world, speed=episode.speed)
    defender = Defender(episode.planner, episode.meet, episode.vehicle, episode.padding, episode.refine)
    scenario = scenario_in(episode.world, defender)
    predictor = scenario.predictor if episode.planner in LAWS else _predictor(scenario, episode, target)
    return dataclasses.replace(
        scenario, target=target, departure=episode.departure, seed=episode.seed, predictor=predictor
    )


def _predictor(scenario: Scenario, episode: EpisodeConfig, target: Target) -> StepPredictor:
    config, name = PredictionConfig.for_world(scenario.world), episode.predictor
    sigma = named_noise(name)
    if sigma:
        config, name = dataclasses.replace(config, sigma=sigma), "noisy"
    model = shipped_model(episode.world, config.dt) if name in WITH_MODEL else None
    return build_predictor(name, config, target.position, episode.seed, model, scenario.world)


def named_noise(predictor: str) -> float | None:
    """S of the predictor noisy-S [m]; None for the others."""
    found = re.fullmatch(r"noisy-(\d+(?:\.\d+)?)", predictor)
    return float(found.group(1)) if found else None


def scenario_in(world: str, defender: Defender) -> Scenario:
    """The planner in a stored world, with what it has compiled in others; target and predictor are anyone's."""
    known = _scenarios(defender)
    if world not in known:
        other = next(iter(known.values()), None)
        known[world] = _load(world, defender, None if other is None else other.planner)
    return known[world]


@functools.lru_cache(maxsize=1)
def _scenarios(defender: Defender) -> dict[str, Scenario]:
    """By world. Only the newest planner's are kept: its programs are large, and episodes come sorted by planner."""
    return {}


def settings_of(world: str, defender: Defender) -> intercept.InterceptConfig:
    """What a defender comes to in a stored world, as ``jaxplan intercept`` would be told."""
    planner = defender.planner
    known: intercept.Planner = next((name for name in intercept.PLANNERS if name == planner), "no-policy")
    way: intercept.Meet = next(name for name in intercept.MEETINGS if name == defender.meet)
    return intercept.InterceptConfig(
        world=world,
        planner=known,
        predictor="noisy",
        meet=way,
        heading="path" if way == "rest" else "hold",
        allocate="profile" if planner == "profile" else None,
        vehicle=defender.vehicle,
        padding=defender.padding,
        refine=defender.refine,
        selection="capture" if defender.refine else "paper",
    )


def _load(world: str, defender: Defender, elsewhere: Planner | None) -> Scenario:
    base = build_scenario(settings_of(world, defender), planner=elsewhere)
    if defender.planner == "optimiser" and elsewhere is None:
        policy, settings = optimiser_policy(TIME_WEIGHT), base.planner.config
        own = build_planner(settings, world=base.world, vehicle=base.vehicle, policy=policy)
        base = dataclasses.replace(base, planner=own)
    return dataclasses.replace(base, plant=_plant(defender.vehicle), judged_by_heading=True)


@functools.lru_cache(maxsize=1)
def _plant(vehicle: str) -> Plant:
    """The simulated vehicle, compiled once for all worlds."""
    return build_plant(load_vehicle(vehicle))
