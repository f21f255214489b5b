"""What one closed-loop episode needs, loaded from its configuration and checked to fit together."""

import dataclasses
import functools
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Float

from jaxplan.arrival import ArrivalConfig
from jaxplan.compilation import uncollected
from jaxplan.config import InterceptConfig
from jaxplan.errors import InputError
from jaxplan.feasibility.checkpoint import load_classifier
from jaxplan.feasibility.classifier import Classifier
from jaxplan.io.log_columns import LogFormat
from jaxplan.io.targets import Target, load_target
from jaxplan.planner import Planner, PlannerConfig, RefinementConfig, build_planner
from jaxplan.policy.checkpoint import load_policy, policy_vehicle
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.policy.placing_checkpoint import load_placing
from jaxplan.policy.protocol import Policy
from jaxplan.prediction.mdn.checkpoint import load_network
from jaxplan.prediction.predictors import PREDICTORS, build_predictor
from jaxplan.prediction.protocol import PredictionConfig, Predictor, StepPredictor
from jaxplan.prediction.stream import StreamConfig
from jaxplan.prediction.target_model import load_model, shipped_model
from jaxplan.replanner import ReplannerConfig
from jaxplan.search.lattice import SearchConfig, build_lattices
from jaxplan.search.start_place import reachable_place
from jaxplan.spline import FlatState, hover
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.result import SUCCESS, Thresholds
from jaxplan.tracking.rollout import Plant, build_plant
from jaxplan.vehicle.identity import identify
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World

_FAR = 50.0
"""m; arbitrary: numbers of a flight in a room that are all smaller are hardly millimetres."""
POINTS_AT_ONCE = 1024
"""Points whose distance to the world is computed in one call (arbitrary)."""


@runtime_checkable
class DistanceFunction(Protocol):
    """Distance to the nearest obstacle or face of one room, from NumPy to NumPy."""

    def __call__(self, points: Float[np.ndarray, "n 3"], /) -> Float[np.ndarray, "n"]:
        """Metres from each point [m, world]."""


@dataclasses.dataclass(frozen=True)
class Scenario:
    """Everything an episode needs. Nothing in it changes while it is flown."""

    world: World
    target: Target
    vehicle: Vehicle
    planner: Planner
    predictor: Predictor
    plant: Plant
    start: FlatState
    """The defender hovers there until it departs."""
    departure: float
    """When the first cycle is planned [s]."""
    seed: int
    """Of the plant's noise."""
    clearance: DistanceFunction
    """Metres from the nearest obstacle or face of the room."""
    judged_by_heading: bool = False
    """Whether the heading of body x decides what counts as lost, as in the paper, or the turn about body z."""
    lost_beyond: Thresholds = SUCCESS
    """Errors with which a vehicle counts as lost."""
    replanning: ReplannerConfig = ReplannerConfig()
    stream: StreamConfig = StreamConfig()
    """How what is seen of the target becomes observations."""

    def control_times(self, now: float) -> Float[np.ndarray, "n"]:
        """Instants of the control steps from one replan to the next [s], both ends included."""
        steps = round(self.replanning.period * CONTROL_RATE)
        return now + np.arange(steps + 1) / CONTROL_RATE


@uncollected()
def build_scenario(config: InterceptConfig, *, exhaustive: bool = False, planner: Planner | None = None) -> Scenario:
    """Load everything a configuration names and check that it fits together.

    Args:
        config: what a user has chosen.
        exhaustive: evaluate every candidate of a cycle, as ``PlannerConfig`` says.
        planner: taken to this world, with what it has compiled, instead of building the one that is named.

    Raises:
        InputError, FileError: the configuration, a file, the target or the start cannot be used.
    """
    world = load_world(config.world)
    vehicle = load_vehicle(config.vehicle)
    config = with_a_planner(config, vehicle)
    how = LogFormat(config.time_unit, config.frame, config.columns)
    target = load_target(config.target, world=world.name, speed=config.speed, log=how)
    distance = distance_in(world)
    planning = planner_config(config, exhaustive)
    _check_target(target, world, distance)
    start = _start(config, world, target)
    _check_start(start, world, vehicle, distance)
    check_padding(config.padding, vehicle)
    planner = _planner(config, planning, world, vehicle) if planner is None else planner.in_world(world)
    prediction = PredictionConfig.for_world(world)
    return Scenario(
        world=world,
        target=target,
        vehicle=vehicle,
        planner=planner,
        predictor=predictor_for(config, world, target),
        plant=build_plant(vehicle),
        start=hover(start),
        departure=config.departure,
        seed=config.seed,
        clearance=distance,
        stream=StreamConfig.for_prediction(prediction),
    )


class Planning(NamedTuple):
    """What plans against a target that nobody knows but by observing it."""

    world: World
    planner: Planner
    predictor: Predictor
    start: FlatState
    """The defender hovers there until it departs."""


@uncollected()
def build_planning(config: InterceptConfig) -> Planning:
    """Load what a configuration names, but for the target and the simulated vehicle.

    Raises:
        InputError, FileError: the configuration, a file or the start cannot be used, or the predictor knows the truth.
    """
    world, vehicle = load_world(config.world), load_vehicle(config.vehicle)
    start = _hover(config, world, vehicle)
    config = with_a_planner(config, vehicle)
    planner = _planner(config, planner_config(config), world, vehicle)
    return Planning(world, planner, predictor_for(config, world, None), start)


def start_of(config: InterceptConfig) -> FlatState:
    """The hover at which ``build_planning`` starts, without building anything. Raises the same."""
    return _hover(config, load_world(config.world), load_vehicle(config.vehicle))


def _hover(config: InterceptConfig, world: World, vehicle: Vehicle) -> FlatState:
    """The start that was asked for or the world's own, where a target is only observed."""
    if config.predictor in ("ground-truth", "noisy"):
        raise InputError(f"--predictor: have {config.predictor!r}, which knows the truth; want one that observes")
    if config.start is None and world.start is None:
        raise InputError(f"world {world.name!r} has no place to start from; give --start")
    start = np.asarray(world.start if config.start is None else config.start, dtype=float)
    _check_start(start, world, vehicle, distance_in(world))
    check_padding(config.padding, vehicle)
    return hover(start)


def with_a_planner(config: InterceptConfig, vehicle: Vehicle) -> InterceptConfig:
    """The configuration with a planner, where none was asked for: mfrl if it was made for this vehicle, or a profile.

    A profile of speeds needs nothing that was learned; what the vehicle can follow is decided by its rotor limits.
    """
    if config.planner is not None or config.policy is not None:
        return config
    if policy_vehicle("mfrl").fingerprint == identify(vehicle).fingerprint:
        return dataclasses.replace(config, planner="mfrl")
    return dataclasses.replace(config, planner="no-policy", allocate=config.allocate or "profile")


def planner_config(config: InterceptConfig, exhaustive: bool = False) -> PlannerConfig:
    """What a configuration asks of the planner; one that stops at the target is no faster than its policy says."""
    usual = PlannerConfig(exhaustive=exhaustive, meet=config.meet, heading=config.heading, padding=config.padding)
    usual = dataclasses.replace(usual, selection=config.selection, resolution=config.resolution, place=config.place)
    alone = config.planner == "no-policy" or config.meet == "rest"
    usual = dataclasses.replace(usual, allocate=config.allocate or ("policy" if alone else "both"))
    if config.planner == "no-policy" and usual.allocate == "profile" and config.meet != "rest":
        usual = dataclasses.replace(usual, arrival=dataclasses.replace(usual.arrival, least_alpha=1.0))
    if config.refines:
        usual = dataclasses.replace(usual, refinement=RefinementConfig())
    return usual if config.meet != "rest" else dataclasses.replace(usual, arrival=ArrivalConfig())


def predictor_for(config: InterceptConfig, world: World, target: Target | None) -> StepPredictor:
    """The predictor that was asked for, with the mixture that belongs to the world if it needs one.

    Without a target only those that do not know the truth can be built; ``InputError`` for the others.
    """
    prediction, model, network = PredictionConfig.for_world(world), None, None
    own, kind = config.target_model, PREDICTORS[config.predictor]
    if kind.learned:
        model = shipped_model(config.world, prediction.dt) if own is None else load_model(own)
    if kind.network and own is not None:
        network = load_network(own)
    truth = None if target is None else target.position
    return build_predictor(config.predictor, prediction, truth, config.seed, model, world, network)


def distance_in(world: World) -> DistanceFunction:
    """The world is handed to the device once."""
    with jax.enable_x64(True):
        on_device = jax.device_put(world.nameless())
    return functools.partial(host_free_distance, on_device, width=POINTS_AT_ONCE)


def _planner(config: InterceptConfig, planning: PlannerConfig, world: World, vehicle: Vehicle) -> Planner:
    """With what was learned for it."""
    policy, classifier = _policy(config)
    placing = load_placing(config.placing) if config.refines and config.placing is not None else None
    return build_planner(planning, world=world, vehicle=vehicle, policy=policy, classifier=classifier, placing=placing)


def _policy(config: InterceptConfig) -> tuple[Policy, Classifier | None]:
    """The time allocation that was asked for, and the classifier that decides what it can fly, if any."""
    if config.policy is not None:
        return load_policy(config.policy), None if config.classifier is None else load_classifier(config.classifier)
    if config.planner in (None, "no-policy"):
        return constant_speed_policy(), None
    return load_policy(config.planner), load_classifier("mfrl") if config.planner == "mfrl" else None


def _start(config: InterceptConfig, world: World, target: Target) -> Float[np.ndarray, "3"]:
    """The start that was asked for, or the world's own, or a free place at some distance from the target."""
    if config.start is not None:
        return np.asarray(config.start, dtype=float)
    if world.start is not None:
        return np.asarray(world.start, dtype=float)
    resolutions = tuple(config.resolution * factor for factor in (1, 2, 5, 10))
    options = SearchConfig(method="multi-resolution", resolutions=resolutions, padding=config.padding)
    lattices = build_lattices(world, options)
    return reachable_place(lattices, world, target.position(np.array([0.0]))[0])


def _check_target(target: Target, world: World, distance: DistanceFunction) -> None:
    times = np.arange(0.0, target.duration, 0.05)
    free = distance(target.position(times))
    if not (free > 0.0).all():
        first = int(np.argmax(~(free > 0.0)))
        there = target.position(times[first : first + 1])[0]
        raise InputError(
            f"target {target.name!r}: at t = {times[first]:.2f} s it is at {_point(there)} m, {_lost(there, world)}; "
            f"give a target that flies in this world{_suspicion(target, distance)}"
        )


def _lost(place: Float[np.ndarray, "3"], world: World) -> str:
    """Why nobody can be at a place [m] that is not free."""
    lower, upper = np.asarray(world.bounds, dtype=float)
    if ((lower <= place) & (place <= upper)).all():
        return f"inside an obstacle of world {world.name!r}"
    return f"outside world {world.name!r}, which is from {_point(lower)} to {_point(upper)} m"


def _point(place: Float[np.ndarray, "3"]) -> str:
    return f"({', '.join(f'{value:.2f}' for value in place)})"


def _suspicion(target: Target, distance: DistanceFunction) -> str:
    """What the numbers of a target may be instead of metres with z up, if that would be in this world."""
    positions = target.position(np.linspace(0.0, target.duration, 50))
    if (distance(positions[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])) > 0.0).all():
        return "; its numbers look like north, east, down: --frame ned"
    if np.abs(positions).max() > _FAR and (distance(1e-3 * positions) > 0.0).all():
        return "; its numbers look like millimetres: write so into the header, as x [mm]"
    return ""


def check_padding(padding: float, vehicle: Vehicle) -> None:
    """Raise ``InputError`` for paths [m] closer to obstacles than the vehicle is wide."""
    radius = np.asarray(vehicle.radius).item()
    if not padding >= radius:
        raise InputError(
            f"--padding: have {padding:g} m, want at least the radius of vehicle {vehicle.name!r}, {radius:g} m"
        )


def _check_start(start: Float[np.ndarray, "3"], world: World, vehicle: Vehicle, distance: DistanceFunction) -> None:
    free, radius = float(distance(start[None])[0]), np.asarray(vehicle.radius).item()
    if not free >= radius:
        where = ", ".join(f"{value:.2f}" for value in start)
        raise InputError(
            f"start ({where}) m: its clearance in world {world.name!r} is {free:.2f} m, want at least the vehicle's "
            f"radius {radius:.2f} m; choose --start inside the room and away from obstacles"
        )
