"""One closed-loop episode: the target flies, the defender replans at 10 Hz and flies what is committed."""

import time
from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Float

from jaxplan.compilation import compilations
from jaxplan.config import InterceptConfig
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.stream import ObservationStream
from jaxplan.replanner import CommittedPlan, Cycle, Measured, Replanner
from jaxplan.scenario import Scenario, build_scenario
from jaxplan.spline import FlatState
from jaxplan.tracking.plant import PlantState
from jaxplan.tracking.rollout import FlightLog
from jaxplan.vehicle.params import Vehicle

INTERCEPTION_RADIUS = 0.4
"""Distance [m] that counts as an interception (paper, Sec. IV)."""


@runtime_checkable
class Progress(Protocol):
    """Told how far an episode is."""

    def __call__(self, text: str, share: float, /) -> None:
        """What is being done, and the share of the longest possible episode that is over."""


@runtime_checkable
class Guide(Protocol):
    """What commands the defender: a ``Replanner``, or a baseline that stands in its place."""

    @property
    def ever_planned(self) -> bool:
        """Whether anything but the initial hover was commanded."""

    @property
    def plans(self) -> Sequence[CommittedPlan]:
        """The initial hover and every plan that was committed, in order; none at all where nothing is planned."""

    def reference(self, times: Float[np.ndarray, "n"]) -> FlatState:
        """The commanded flat state at ``times`` [s]."""

    def step(self, now: float, observations: Observations, measured: Measured | None = None) -> Cycle | None:
        """Decide at time ``now`` [s] from the newest observations; None where nothing is planned."""


@runtime_checkable
class Watch(Protocol):
    """What a sensor makes of the target."""

    def __call__(self, stream: ObservationStream, now: float, position: Float[np.ndarray, "3"], /) -> None:
        """Add to the stream what is seen at ``now`` [s] of a target that is there [m]."""


class Flight(NamedTuple):
    """What was flown: one row per control step (200 Hz), at the end of the step."""

    times: Float[np.ndarray, "n"]
    """Seconds."""
    position: Float[np.ndarray, "n 3"]
    """Metres, world."""
    velocity: Float[np.ndarray, "n 3"]
    """Metres per second, world."""
    quat_wxyz: Float[np.ndarray, "n 4"]
    """Body to world."""
    reference: Float[np.ndarray, "n 3"]
    """The commanded position [m, world]."""
    target: Float[np.ndarray, "n 3"]
    """The target's position [m, world]."""
    target_velocity: Float[np.ndarray, "n 3"]
    """Metres per second, world."""
    position_error: Float[np.ndarray, "n"]
    """Metres from the reference."""
    yaw_error: Float[np.ndarray, "n"]
    """Radians between the heading of body x and the reference's yaw, 0 to pi; says nothing near 90 degrees of tilt."""
    twist_error: Float[np.ndarray, "n"]
    """Radians about body z from the attitude that the reference demands, 0 to pi."""
    clearance: Float[np.ndarray, "n"]
    """Metres from the vehicle's centre to the nearest obstacle or face of the room."""


class Episode(NamedTuple):
    """The result of one interception."""

    outcome: str
    """intercepted, collision, tracking_lost, target_ended or no_plan."""
    flight: Flight
    replans: int
    """How many times the guide decided."""
    cycles: tuple[Cycle, ...]
    """What it did each time, where it plans."""
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
        """Whether the target was intercepted."""
        return self.outcome == "intercepted"


def run(config: InterceptConfig, progress: Progress | None = None) -> Episode:
    """Load, compile and fly one interception.

    Raises:
        InputError, FileError: the configuration, a file, the target or the start cannot be used.
    """
    report = progress or _tell_nobody
    began = time.perf_counter()
    report("loading", 0.0)
    scenario = build_scenario(config)
    report("compiling", 0.0)
    warm_up(scenario)
    return fly(scenario, report, warmup_s=time.perf_counter() - began)


def warm_up(scenario: Scenario) -> None:
    """Compile everything that an episode calls."""
    scenario.planner.warmup(scenario.start)
    count = scenario.stream.observations
    still = Observations(
        times=scenario.stream.dt * np.arange(count), positions=np.tile(np.asarray(scenario.start.pos), (count, 1))
    )
    scenario.predictor(still, 0)
    state = scenario.plant.reset(scenario.start, jax.random.key(scenario.seed))
    state, log = scenario.plant.fly(state, _replanner(scenario).reference(scenario.control_times(0.0)))
    scenario.clearance(np.asarray(log.pos, dtype=float))
    jax.block_until_ready(state)


def fly(
    scenario: Scenario,
    progress: Progress | None = None,
    *,
    guide: Guide | None = None,
    watch: Watch | None = None,
    warmup_s: float = 0.0,
) -> Episode:
    """Fly a scenario until it is decided.

    Args:
        scenario: what is flown; nothing compiles where ``warm_up`` has seen it.
        progress: told after every cycle.
        guide: what commands the defender instead of a ``Replanner`` with the scenario's planner and predictor.
        watch: what sees the target, instead of a sensor that sees it exactly and at once.
        warmup_s: wall time spent before, for the record.
    """
    compiled, began = compilations(), time.perf_counter()
    report, guide, watch = progress or _tell_nobody, guide or _replanner(scenario), watch or _see
    target, period = scenario.target, scenario.replanning.period
    state = scenario.plant.reset(scenario.start, jax.random.key(scenario.seed))
    stream, cycles, flights, outcome = ObservationStream(scenario.stream), [], [], None
    for index in range(int(np.ceil(target.duration / period))):
        now = index * period
        watch(stream, now, target.position(np.array([now]))[0])
        observations = stream.observe(now)
        if observations is not None and now >= scenario.departure - 1e-9:
            cycles.append(guide.step(now, observations, _measured(state, scenario.vehicle)))
        times = scenario.control_times(now)
        state, log = scenario.plant.fly(state, guide.reference(times))
        flight, outcome = _until_decided(_flight(times[1:], log, guide, scenario), scenario)
        flights.append(flight)
        report("flying", (now + period) / target.duration)
        if outcome:
            break
    return Episode(
        outcome=outcome or ("target_ended" if guide.ever_planned else "no_plan"),
        flight=Flight(*(np.concatenate(rows) for rows in zip(*flights, strict=True))),
        replans=len(cycles),
        cycles=tuple(cycle for cycle in cycles if cycle is not None),
        plans=tuple(guide.plans[1:]),
        scenario=scenario,
        warmup_s=warmup_s,
        wall_s=time.perf_counter() - began,
        compilations_after_warmup=compilations() - compiled,
    )


def _see(stream: ObservationStream, now: float, position: Float[np.ndarray, "3"]) -> None:
    """A sensor without faults."""
    stream.add(now, position, now)


def _measured(state: PlantState, vehicle: Vehicle) -> Measured:
    """The vehicle as its estimator sees it: where it is, and the acceleration of its thrust in still air."""
    velocity, (w, x, y, z) = np.asarray(state.vel, dtype=float), np.asarray(state.quat_wxyz, dtype=float)
    up = np.array([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)])
    mass, lift = float(vehicle.mass), float(vehicle.thrust_coefficient)
    thrust = lift * float((np.asarray(state.rotor_speeds, dtype=float) ** 2).sum())
    drag = float(vehicle.drag_coefficient) * float(np.linalg.norm(velocity)) * velocity
    acceleration = (thrust * up - drag) / mass - np.array([0.0, 0.0, float(vehicle.gravity)])
    return Measured(np.asarray(state.pos, dtype=float), velocity, acceleration)


def _replanner(scenario: Scenario) -> Replanner:
    """A new one, which has committed nothing but the hover at the start."""
    return Replanner(scenario.planner, scenario.predictor, scenario.start, scenario.replanning)


def _flight(ends: Float[np.ndarray, "n"], log: FlightLog, guide: Guide, scenario: Scenario) -> Flight:
    """The rows of one cycle: what the plant logged, beside reference and target at the same instants."""
    position = np.asarray(log.pos, dtype=float)
    return Flight(
        times=ends,
        position=position,
        velocity=np.asarray(log.vel, dtype=float),
        quat_wxyz=np.asarray(log.quat_wxyz, dtype=float),
        reference=np.asarray(guide.reference(ends).pos),
        target=scenario.target.position(ends),
        target_velocity=scenario.target.velocity(ends),
        position_error=np.asarray(log.position_error, dtype=float),
        yaw_error=np.asarray(log.yaw_error, dtype=float),
        twist_error=np.asarray(log.twist_error, dtype=float),
        clearance=scenario.clearance(position),
    )


def _until_decided(flight: Flight, scenario: Scenario) -> tuple[Flight, str | None]:
    """The rows up to what decided the episode, and its outcome, if anything did. Failure comes before success."""
    apart = np.linalg.norm(flight.position - flight.target, axis=1)
    turned = flight.yaw_error if scenario.judged_by_heading else flight.twist_error
    tracked = (flight.position_error < scenario.lost_beyond.position) & (turned < scenario.lost_beyond.yaw)
    free = flight.clearance >= np.asarray(scenario.vehicle.radius).item()
    met = (apart < INTERCEPTION_RADIUS) & (flight.times >= scenario.departure)
    decided = ~tracked | ~free | met
    if not decided.any():
        return flight, None
    row = int(np.argmax(decided))
    outcome = "collision" if not free[row] else "intercepted" if tracked[row] else "tracking_lost"
    return Flight(*(values[: row + 1] for values in flight)), outcome


def _tell_nobody(text: str, share: float, /) -> None:
    """Progress that nobody asked for."""
