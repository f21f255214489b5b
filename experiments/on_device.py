"""Episodes by name, many at a time on one device (``jaxplan.device``): one program for all worlds and predictors."""

import contextlib
import functools
from collections.abc import Iterator, Sequence
from typing import Any, Literal, NamedTuple

import jax
import numpy as np

from jaxplan.device.episodes import LoopConfig, Scene, build_loop
from jaxplan.device.predict import PREDICTORS, build_predict, goals_of, mixtures_for
from jaxplan.device.replan import ReplanConfig, build_replan
from jaxplan.device.room import Room, alike, room_of
from jaxplan.device.runner import Flight, Outcome, Runner
from jaxplan.errors import InputError, ResourceError
from jaxplan.feasibility.checkpoint import load_classifier
from jaxplan.io.targets import Target, load_target
from jaxplan.planner import PlannerConfig
from jaxplan.policy.checkpoint import load_policy
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.target_model import shipped_model
from jaxplan.scenario import planner_config
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.rollout import build_plant
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import ENVIRONMENTS, load_world

from .closed_loop import Defender, EpisodeConfig, named_noise, settings_of

DeviceName = Literal["host", "cpu", "gpu"]
"""Where episodes are flown: "host" one after the other by the planner that users call, the others in batches."""
PLANNERS = ("no-policy", "pretrained", "mfrl")
"""Planners whose times a traced function allots."""
AT_ONCE_ON_GPU = 8
"""Places of a roadmap that are tried for each goal at a time there (arbitrary)."""


def device_named(name: DeviceName) -> jax.Device:
    """The device; raises InputError where this machine, or the JAX that is installed, has none."""
    try:
        return jax.devices(name)[0]
    except RuntimeError as error:
        raise InputError(
            f"--device: have {name!r}, and JAX finds none here ({' '.join(str(error).split())[:120]}); install "
            "jaxplan[gpu] on a machine with an NVIDIA GPU, or leave --device out"
        ) from error


def check_names(planners: Sequence[str], predictors: Sequence[str]) -> None:
    """Raise InputError for what is only flown on the host."""
    for planner in planners:
        if planner not in PLANNERS:
            raise InputError(f"--planners: have {planner!r}, and on a device only {', '.join(PLANNERS)} are flown")
    for predictor in predictors:
        if _kind(predictor) not in PREDICTORS:
            known = ", ".join(name for name in PREDICTORS if name != "noisy")
            raise InputError(f"--predictors: have {predictor!r}, and on a device only {known}, noisy-S are asked")


def fly_together(episodes: Sequence[EpisodeConfig], device: DeviceName, batch: int) -> list[dict[str, Any]]:
    """Fly episodes of one defender; rows as ``closed_loop.numbers`` has them, but what needs whole flights.

    Those of one world whose predictors propose as many goals are flown together, at most ``batch`` at a time.
    """
    rows: list[dict[str, Any]] = [{} for _ in episodes]
    defender = _defender(episodes[0])
    with jax.default_device(device_named(device)):
        for members in groups(episodes):
            some = [episodes[member] for member in members]
            predictors = tuple(dict.fromkeys(episode.predictor for episode in some))
            manned = crew(defender, _shared(predictors), min(batch, _widest(episodes)), device)
            flights = [_flight(episode, manned.predictors.index(episode.predictor)) for episode in some]
            with _explained(batch):
                outcomes = manned.runner.fly(scene(defender, some[0].world), flights)
            for member, episode, outcome in zip(members, some, outcomes, strict=True):
                rows[member] = _row(episode, outcome)
    return rows


@contextlib.contextmanager
def _explained(batch: int) -> Iterator[None]:
    """A device whose memory is full says what to do."""
    try:
        yield
    except jax.errors.JaxRuntimeError as error:
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        raise ResourceError(
            f"--batch: {batch} episodes at a time do not fit into the device's memory; take fewer"
        ) from error


class Crew(NamedTuple):
    """A runner, and the predictors that its flights name by their numbers."""

    runner: Runner
    predictors: tuple[str, ...]


_CERTAIN = ("none", "ground-truth", "constant-velocity")
"""Predictors that share a program with each other whether or not they are asked for."""


def _shared(predictors: tuple[str, ...]) -> tuple[str, ...]:
    return _CERTAIN if set(predictors) <= set(_CERTAIN) else tuple(sorted(predictors))


def _widest(episodes: Sequence[EpisodeConfig]) -> int:
    return max(len(members) for members in groups(episodes))


def groups(episodes: Sequence[EpisodeConfig]) -> list[list[int]]:
    """Numbers of the episodes that are flown together: in one world, with as many goals a cycle."""
    found: dict[tuple[str, int], list[int]] = {}
    for number, episode in enumerate(episodes):
        key = episode.world, goals_of(_kind(episode.predictor), PredictionConfig())
        found.setdefault(key, []).append(number)
    return list(found.values())


def _kind(predictor: str) -> str:
    return "noisy" if named_noise(predictor) else predictor


def _defender(episode: EpisodeConfig) -> Defender:
    return Defender(episode.planner, episode.meet, episode.vehicle, episode.padding)


@functools.lru_cache(maxsize=8)
def crew(defender: Defender, predictors: tuple[str, ...], width: int, device: DeviceName) -> Crew:
    """A runner for a defender and some predictors, compiled when it first flies."""
    vehicle, name = load_vehicle(defender.vehicle), defender.planner
    policy = constant_speed_policy() if name == "no-policy" else load_policy(name)
    config = ReplanConfig(planner=planner_config_of(defender), tried_at_once=AT_ONCE_ON_GPU if device == "gpu" else 1)
    replan = build_replan(config, vehicle, policy, load_classifier("mfrl") if name == "mfrl" else None)
    asked = []
    for predictor in predictors:
        sigma = named_noise(predictor)
        prediction = PredictionConfig() if sigma is None else PredictionConfig(sigma=sigma)
        asked.append(build_predict(_kind(predictor), prediction))
    loop = LoopConfig(prediction=PredictionConfig(), likelihood_weight=config.planner.likelihood_weight)
    begin, advance = build_loop(loop, vehicle, build_plant(vehicle), asked, replan)
    return Crew(Runner(begin, advance, width), predictors)


def planner_config_of(defender: Defender) -> PlannerConfig:
    """As the planner on the host has it; the same in every stored world."""
    return planner_config(settings_of("env1", defender))


@functools.lru_cache(maxsize=8)
def scene(defender: Defender, world: str) -> Scene:
    """A stored world, in arrays as large as those of all of them."""
    found = load_world(world)
    config = PredictionConfig.for_world(found)
    assert found.start is not None, "stored worlds have one"
    return Scene(
        room=_rooms(defender)[world],
        start=np.asarray(found.start, dtype=float),
        spacing=np.asarray(round(config.dt * CONTROL_RATE), np.int32),
        mixture=mixtures_for(config, shipped_model(world, config.dt)),
    )


@functools.lru_cache(maxsize=2)
def _rooms(defender: Defender) -> dict[str, Room]:
    config, radius = planner_config_of(defender), float(load_vehicle(defender.vehicle).radius)
    from_faces = min(config.padding, radius + config.checks.tracking_margin)
    rooms = alike([room_of(load_world(world), config.padding, from_faces) for world in ENVIRONMENTS])
    return dict(zip(ENVIRONMENTS, rooms, strict=True))


def _flight(episode: EpisodeConfig, predictor: int) -> Flight:
    return Flight(_target(episode.world, episode.target, episode.speed), episode.departure, episode.seed, predictor)


@functools.lru_cache(maxsize=512)
def _target(world: str, name: str, speed: float) -> Target:
    return load_target(name, world=world, speed=speed)


def _row(episode: EpisodeConfig, outcome: Outcome) -> dict[str, Any]:
    met = outcome.outcome == "intercepted"
    return {
        "outcome": outcome.outcome,
        "time_to_intercept_s": outcome.end_time - episode.departure if met else None,
        "end_time_s": outcome.end_time,
        "min_distance_m": outcome.min_distance,
        "max_position_error_m": outcome.max_position_error,
        "max_yaw_error_deg": float(np.degrees(outcome.max_yaw_error)),
        "min_clearance_m": outcome.min_clearance,
        "replans": outcome.cycles,
        "plans": outcome.plans,
    }
