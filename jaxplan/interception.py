"""One closed-loop episode: the target flies, the defender replans at 10 Hz and flies what is committed."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxplan.batching import in_portions
from jaxplan.compilation import compilations
from jaxplan.config import InterceptConfig
from jaxplan.errors import InputError
from jaxplan.feasibility.checkpoint import load_classifier
from jaxplan.io.targets import Target, load_target
from jaxplan.planner import Planner, PlannerConfig, build_planner
from jaxplan.policy.checkpoint import load_policy
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.precision import in_float64
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.predictors import PREDICTORS, build_predictor
from jaxplan.prediction.protocol import PredictionConfig, StepPredictor
from jaxplan.prediction.stream import ObservationStream, StreamConfig
from jaxplan.prediction.target_model import load_model, shipped_model
from jaxplan.replanner import CommittedPlan, Cycle, Replanner, ReplannerConfig
from jaxplan.search.lattice import SearchConfig, build_lattices
from jaxplan.search.start_place import reachable_place
from jaxplan.spline import FlatState, hover
from jaxplan.tracking.rollout import CONTROL_RATE, FlightLog, Plant, build_plant
from jaxplan.vehicle.params import Vehicle, load_vehicle
from jaxplan.world.clearance import clearance, wall_clearance
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World

INTERCEPTION_RADIUS = 0.4
"""Distance [m] that counts as an interception (paper, Sec. IV)."""
POSITION_ERROR_LIMIT = 0.4
YAW_ERROR_LIMIT = np.deg2rad(45.0)
"""Tracking errors [m, rad] from which the defender counts as lost (paper, Sec. IV)."""

POINTS_AT_ONCE = 1024
"""Points whose distance to the world is computed in one call (arbitrary)."""

Progress = Callable[[str, float], None]
"""Called with what is being done and the share of the longest possible episode that is over."""


@dataclasses.dataclass(frozen=True)
class Scenario:
    """Everything an episode needs, loaded and checked."""

    world: World
    target: Target
    vehicle: Vehicle
    replanner: Replanner
    plant: Plant
    start: FlatState
    departure: float
    seed: int
    stream: StreamConfig
    """How what is seen of the target becomes observations."""
    clearance: Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, "n"]]
    """Metres from the nearest obstacle or face of the room, of at least one point."""

    def control_times(self, now: float) -> Float[np.ndarray, "n+1"]:
        """Instants of the control steps from one replan to the next [s], both ends included."""
        steps = round(self.replanner.config.period * CONTROL_RATE)
        return now + np.arange(steps + 1) / CONTROL_RATE


class Flight(NamedTuple):
    """What was flown: one row per control step (200 Hz), at the end of the step."""

    times: Float[np.ndarray, "n"]
    position: Float[np.ndarray, "n 3"]
    velocity: Float[np.ndarray, "n 3"]
    quat_wxyz: Float[np.ndarray, "n 4"]
    reference: Float[np.ndarray, "n 3"]
    target: Float[np.ndarray, "n 3"]
    target_velocity: Float[np.ndarray, "n 3"]
    position_error: Float[np.ndarray, "n"]
    """Metres from the reference."""
    yaw_error: Float[np.ndarray, "n"]
    """Radians from the reference, 0 to pi."""
    clearance: Float[np.ndarray, "n"]
    """Metres from the vehicle's centre to the nearest obstacle or face of the room."""


class Episode(NamedTuple):
    """The result of one interception."""

    outcome: str
    """intercepted, collision, tracking_lost, target_ended or no_plan."""
    flight: Flight
    cycles: tuple[Cycle, ...]
    plans: tuple[CommittedPlan, ...]
    """Every plan that was committed, in order."""
    scenario: Scenario
    warmup_s: float
    """Wall time of building and compiling."""
    wall_s: float
    """Wall time of the episode itself."""
    compilations_after_warmup: int

    @property
    def success(self) -> bool:
        return self.outcome == "intercepted"


def run(config: InterceptConfig, progress: Progress | None = None) -> Episode:
    """Load, compile and fly one interception.

    Raises:
        InputError, FileError: the configuration, a file, the target or the start cannot be used.
    """
    report = progress or (lambda text, share: None)
    began = time.perf_counter()
    report("loading", 0.0)
    scenario = prepare(config)
    report("compiling", 0.0)
    warm_up(scenario)
    return fly(scenario, report, warmup_s=time.perf_counter() - began)


def prepare(config: InterceptConfig, *, exhaustive: bool = False, planner: Planner | None = None) -> Scenario:
    """Load everything a configuration names and check that it fits together.

    Args:
        exhaustive: evaluate every candidate of a cycle, as ``PlannerConfig`` says.
        planner: taken to this world, with what it has compiled, instead of building the one that is named.
    """
    world = load_world(config.world)
    vehicle = load_vehicle()
    target = load_target(config.target, world=world.name, speed=config.speed)
    distance = _distance_function(world)
    prediction = PredictionConfig.for_world(world)
    planner_config = PlannerConfig(exhaustive=exhaustive)
    _check_target(target, world, distance)
    position = _start(config, world, target, planner_config.padding)
    _check_start(position, world, vehicle, distance)
    start = hover(position)
    if planner is None:
        planner = build_planner(planner_config, world=world, vehicle=vehicle, **_policy(config.planner))
    else:
        planner = planner.in_world(world)
    predictor = predictor_for(config, world, target)
    return Scenario(
        world=world,
        target=target,
        vehicle=vehicle,
        replanner=Replanner(planner, predictor, start, ReplannerConfig()),
        plant=build_plant(vehicle),
        start=start,
        departure=config.departure,
        seed=config.seed,
        stream=StreamConfig(observations=prediction.observations, dt=prediction.dt),
        clearance=distance,
    )


def predictor_for(config: InterceptConfig, world: World, target: Target) -> StepPredictor:
    """The predictor that was asked for, with the mixture that belongs to the world if it needs one."""
    prediction, model = PredictionConfig.for_world(world), None
    if PREDICTORS[config.predictor].learned:
        own = config.target_model
        model = shipped_model(config.world, prediction.dt) if own is None else load_model(own)
    return build_predictor(config.predictor, prediction, target.position, config.seed, model, world)


def warm_up(scenario: Scenario) -> None:
    """Compile everything that an episode calls."""
    scenario.replanner.planner.warmup(scenario.start)
    count = scenario.stream.observations
    still = Observations(
        times=scenario.stream.dt * np.arange(count), positions=np.tile(np.asarray(scenario.start.pos), (count, 1))
    )
    scenario.replanner.warm_up(still)
    key = jax.random.key(scenario.seed)
    state = scenario.plant.reset(scenario.start, key)
    state, log = scenario.plant.fly(state, scenario.replanner.reference(scenario.control_times(0.0)))
    scenario.clearance(np.asarray(log.pos, dtype=float))
    jax.block_until_ready(state)


def fly(scenario: Scenario, progress: Progress, warmup_s: float = 0.0) -> Episode:
    """Fly a prepared scenario until it is decided."""
    compiled, began = compilations(), time.perf_counter()
    replanner, target, period = scenario.replanner, scenario.target, scenario.replanner.config.period
    state = scenario.plant.reset(scenario.start, jax.random.key(scenario.seed))
    stream, cycles, flights, outcome = ObservationStream(scenario.stream), [], [], None
    for index in range(int(np.ceil(target.duration / period))):
        now = index * period
        stream.add(now, target.position(np.array([now]))[0], now)
        observations = stream.observe(now)
        if observations is not None and now >= scenario.departure - 1e-9:
            cycles.append(replanner.step(now, observations))
        times = scenario.control_times(now)
        state, log = scenario.plant.fly(state, replanner.reference(times))
        flight, outcome = _judge(_flight(times, log, scenario), scenario)
        flights.append(flight)
        progress("flying", (now + period) / target.duration)
        if outcome:
            break
    return Episode(
        outcome=outcome or ("target_ended" if replanner.ever_planned else "no_plan"),
        flight=Flight(*(np.concatenate(rows) for rows in zip(*flights, strict=True))),
        cycles=tuple(cycles),
        plans=tuple(replanner.plans[1:]),
        scenario=scenario,
        warmup_s=warmup_s,
        wall_s=time.perf_counter() - began,
        compilations_after_warmup=compilations() - compiled,
    )


def _flight(times: Float[np.ndarray, "n+1"], log: FlightLog, scenario: Scenario) -> Flight:
    """The rows of one cycle: what the plant logged, beside reference and target at the same instants."""
    ends = times[1:]
    position = np.asarray(log.pos, dtype=float)
    return Flight(
        times=ends,
        position=position,
        velocity=np.asarray(log.vel, dtype=float),
        quat_wxyz=np.asarray(log.quat_wxyz, dtype=float),
        reference=scenario.replanner.reference(ends).pos,
        target=scenario.target.position(ends),
        target_velocity=scenario.target.velocity(ends),
        position_error=np.asarray(log.position_error, dtype=float),
        yaw_error=np.asarray(log.yaw_error, dtype=float),
        clearance=scenario.clearance(position),
    )


def _judge(flight: Flight, scenario: Scenario) -> tuple[Flight, str | None]:
    """What decided the episode in these rows, if anything, and the rows up to then. Failure comes before success."""
    apart = np.linalg.norm(flight.position - flight.target, axis=1)
    tracked = (flight.position_error < POSITION_ERROR_LIMIT) & (flight.yaw_error < YAW_ERROR_LIMIT)
    free = flight.clearance >= float(scenario.vehicle.radius)
    met = (apart < INTERCEPTION_RADIUS) & (flight.times >= scenario.departure)
    decided = ~tracked | ~free | met
    if not decided.any():
        return flight, None
    row = int(np.argmax(decided))
    outcome = "collision" if not free[row] else "intercepted" if tracked[row] else "tracking_lost"
    return Flight(*(values[: row + 1] for values in flight)), outcome


def _distance_function(world: World) -> Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, "n"]]:
    """Distance to the nearest obstacle or face of the room, compiled once, from NumPy to NumPy."""

    @in_float64
    def on_host(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        points = np.asarray(points, dtype=float)
        return in_portions(lambda some: _distance(on_device, points[some]), np.arange(len(points)), POINTS_AT_ONCE)

    with jax.enable_x64(True):
        on_device = jax.device_put(world)
    return on_host


@jax.jit
def _distance(world: World, points: Float[Array, "n 3"]) -> Float[Array, "n"]:
    return jax.numpy.minimum(clearance(world, points), wall_clearance(world, points))


def _check_target(target: Target, world: World, distance: Callable) -> None:
    times = np.arange(0.0, target.duration, 0.05)
    free = distance(target.position(times))
    if not (free > 0.0).all():
        first = int(np.argmax(~(free > 0.0)))
        where = ", ".join(f"{value:.2f}" for value in target.position(times[first : first + 1])[0])
        raise InputError(
            f"target {target.name!r}: at t = {times[first]:.2f} s it is at ({where}) m, outside world {world.name!r} "
            "or inside an obstacle; give a target that flies in this world"
        )


def _check_start(position: Float[np.ndarray, "3"], world: World, vehicle: Vehicle, distance: Callable) -> None:
    free = float(distance(np.asarray(position)[None])[0])
    if not free >= float(vehicle.radius):
        where = ", ".join(f"{value:.2f}" for value in position)
        raise InputError(
            f"start ({where}) m: its clearance in world {world.name!r} is {free:.2f} m, want at least the vehicle's "
            f"radius {float(vehicle.radius):.2f} m; choose --start inside the room and away from obstacles"
        )


def _policy(planner: str) -> dict[str, Any]:
    """The time allocation that ``--planner`` names, and what judges its flights."""
    if planner == "no-policy":
        return {"policy": constant_speed_policy()}
    return {"policy": load_policy(planner), "classifier": load_classifier("mfrl") if planner == "mfrl" else None}


def _start(config: InterceptConfig, world: World, target: Target, padding: float) -> Float[np.ndarray, "3"]:
    """The start that was asked for, or the world's own, or a free place at some distance from the target."""
    if config.start is not None:
        return np.asarray(config.start, dtype=float)
    if world.start is not None:
        return np.asarray(world.start, dtype=float)
    lattices = build_lattices(world, SearchConfig(padding=padding))
    return reachable_place(lattices, world, target.position(np.array([0.0]))[0])
