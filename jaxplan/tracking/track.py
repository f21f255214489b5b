"""Flying many trajectories in simulation: which of them the vehicle can follow, and how well.

A chunk of ``LANES`` flights advances in blocks of one second, all by the same compiled program whatever their lengths:
a lane whose flight is over flies on, unseen. Chunks share the cores, one thread each. Flights are sorted by length
first, so that few lanes idle. The noise of a flight depends on the seed and its index alone, so neither order, batch
size nor neighbours change its result.
"""

import dataclasses
import functools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxplan.errors import InputError
from jaxplan.precision import float32_island
from jaxplan.spline import FlatState
from jaxplan.tracking.disturbance import SHAPES, Disturbance
from jaxplan.tracking.plant import PlantState
from jaxplan.tracking.references import Splines, as_sequence, duration_of_each, padded, references_at
from jaxplan.tracking.result import TRAINING, Flaw, Thresholds, TrackingResult
from jaxplan.tracking.rollout import CONTROL_RATE, ControllerName, FlightLog, build_plant
from jaxplan.vehicle.params import Vehicle, load_vehicle

WIDTH = 128
"""Lanes that advance together (measured: throughput grows by a tenth beyond)."""
LANES = WIDTH - 8
"""Lanes that carry flights. XLA computes the last 8 in the remainder of its vector loops, where rounding differs in the
last bit (measured on AVX-512): a flight there would depend on its place in the batch."""
BLOCK_STEPS = CONTROL_RATE
"""Control steps of one call: 1 s."""
LONGEST_FLIGHT = 100.0
"""s; as in the MFRL evaluation."""


@dataclasses.dataclass(frozen=True)
class TrackConfig:
    """How trajectories are flown and judged."""

    thresholds: Thresholds = TRAINING
    """Errors from which a flight counts as infeasible."""
    noise: bool = True
    """Process and sensor noise of the vehicle."""
    controller: ControllerName = "indi"
    """Who follows the trajectories, with the vehicle's gains."""
    seed: int = 0
    """Seed of the noise."""

    def __post_init__(self) -> None:
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or not 0 <= self.seed < 2**32:
            raise InputError(f"track: seed is {self.seed!r}, want a whole number from 0 to 4294967295")


class _Summary(NamedTuple):
    """What is kept of a flight while it is flown."""

    position_error: Float[Array, "b"]
    yaw_error: Float[Array, "b"]
    first_violation: Float[Array, "b"]
    rotor_speed: Float[Array, "b"]
    saturated: Int[Array, "b"]


class _Tracker(NamedTuple):
    """The compiled programs of one vehicle."""

    reset: Callable[[FlatState, Int[Array, "b"], PRNGKeyArray], PlantState]
    advance: Callable[..., tuple[PlantState, _Summary]]


def track(
    splines: Splines,
    *,
    vehicle: Vehicle | None = None,
    config: TrackConfig | None = None,
    indices: Int[np.ndarray, "k"] | None = None,
    start: FlatState | None = None,
    disturbance: Disturbance | None = None,
) -> TrackingResult:
    """Fly each trajectory in closed loop from its own start and report the errors.

    Args:
        splines: a list of splines, the planner's batch, or one spline.
        vehicle: the MFRL vehicle when omitted. The first flight with a vehicle compiles, about 10 s.
        config: thresholds, noise and seed.
        indices: numbers of the flights' noise streams, 0 .. 2^31 - 1; their places in the list when omitted.
        start: where the vehicle is when every flight begins; on each trajectory's own start when omitted.
        disturbance: wind, gust and thrust losses, the same for all flights or with a leading axis; calm when omitted.

    Raises:
        InputError: no splines; a single spline that is not finite (in a list it is infeasible instead, with its
            reason); an index out of range; a start as far from a trajectory as the position threshold; a disturbance
            for another number of flights.
    """
    flights = as_sequence(splines)
    chosen = TrackConfig() if config is None else config
    durations = duration_of_each(flights)
    numbers = _checked_indices(indices, len(durations))
    if len(durations) == 1 and not np.isfinite(durations[0]):
        raise InputError("splines: the spline has a coefficient or a duration that is not finite, want finite numbers")
    tracker = _tracker(_Content(_default_vehicle() if vehicle is None else vehicle), chosen.noise, chosen.controller)
    flown = np.flatnonzero((durations > 0.0) & (durations <= LONGEST_FLIGHT))
    flown = flown[np.argsort(-durations[flown], kind="stable")]
    inputs = None if disturbance is None else _for_each(disturbance, len(durations))

    def fly(begin: int) -> _Summary:
        return _fly_chunk(tracker, flights, durations, numbers, flown[begin : begin + LANES], chosen, start, inputs)

    begins = range(0, len(flown), LANES)
    with ThreadPoolExecutor(max(1, min(len(begins), os.cpu_count() or 1))) as pool:
        parts = list(pool.map(fly, begins))
    return _result(durations, flown, parts, chosen.thresholds)


def _fly_chunk(
    tracker: _Tracker,
    flights: Splines,
    durations: Float[np.ndarray, "k"],
    numbers: Int[np.ndarray, "k"],
    members: Int[np.ndarray, "b"],
    config: TrackConfig,
    start: FlatState | None,
    inputs: Disturbance | None,
) -> _Summary:
    """At most ``LANES`` flights to their ends; the first one fills the lanes that are over."""
    lanes = np.concatenate([members, np.repeat(members[:1], WIDTH - len(members))])
    batch = padded(as_sequence(flights), lanes)
    steps = control_steps(durations[lanes])
    limits = np.array([config.thresholds.position, config.thresholds.yaw])
    times = np.arange(BLOCK_STEPS + 1) / CONTROL_RATE
    references = references_at(batch, times)
    first = jax.tree.map(lambda leaf: leaf[0], references)
    if start is not None:
        _check_start(start, np.asarray(first.derivatives[0]).T, members, config.thresholds.position)
        first = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[..., None], WIDTH, axis=-1), start)
    around = jax.tree.map(lambda leaf: np.moveaxis(leaf[lanes], 0, -1), inputs)
    state = tracker.reset(first, numbers[lanes].astype(np.int32), jax.random.key(config.seed))
    summary = _blank()
    for done in range(0, int(steps.max()), BLOCK_STEPS):
        if done:
            references = references_at(batch, done / CONTROL_RATE + times)
        state, summary = tracker.advance(state, summary, references, (steps - done).astype(np.int32), limits, around)
    host = _Summary(*(np.asarray(leaf)[: len(members)] for leaf in summary))
    share = host.saturated / steps[: len(members)]
    return host._replace(saturated=share)


def control_steps(durations: Float[np.ndarray, "k"]) -> Int[np.ndarray, "k"]:
    """Control steps that end within a flight, at least 1."""
    return np.maximum(np.floor(durations * CONTROL_RATE + 1e-6), 1).astype(np.int64)


def _result(
    durations: Float[np.ndarray, "k"], flown: Int[np.ndarray, "f"], parts: list[_Summary], thresholds: Thresholds
) -> TrackingResult:
    """The summaries of the chunks in the order of the flights, and what follows from them."""
    columns = []
    for place, otherwise in enumerate((np.inf, np.inf, 0.0, np.nan, 0.0)):
        column = np.full(len(durations), otherwise)
        if parts:
            column[flown] = np.concatenate([part[place] for part in parts])
        columns.append(column)
    position, yaw, first, speed, saturated = columns
    finite = np.isfinite(durations)
    in_time = finite & (durations > 0.0) & (durations <= LONGEST_FLIGHT)
    diverged = in_time & ~(np.isfinite(position) & np.isfinite(yaw))
    reasons = (
        np.where(finite, 0, int(Flaw.NONFINITE))
        | np.where(finite & ~in_time, int(Flaw.DURATION), 0)
        | np.where(diverged, int(Flaw.DIVERGED), 0)
        | np.where(in_time & ~(position < thresholds.position), int(Flaw.POSITION), 0)
        | np.where(in_time & ~(yaw < thresholds.yaw), int(Flaw.YAW), 0)
    ).astype(np.uint32)
    return TrackingResult(
        max_position_error=position,
        max_yaw_error=yaw,
        time_of_first_violation=first,
        peak_rotor_speed=speed,
        saturation_share=saturated,
        duration=durations,
        feasible=reasons == 0,
        reasons=reasons,
    )


@functools.lru_cache(maxsize=1)
def _default_vehicle() -> Vehicle:
    return load_vehicle()


class _Content:
    """A vehicle compared by its numbers, so that loading a preset twice compiles once."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        leaves, structure = jax.tree.flatten(vehicle)
        self.key = (str(structure), *(np.asarray(leaf, dtype=np.float64).tobytes() for leaf in leaves))

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Content) and self.key == other.key


@functools.lru_cache(maxsize=8)
def _tracker(content: _Content, noise: bool, controller: ControllerName) -> _Tracker:
    """The programs that fly ``WIDTH`` lanes of one vehicle; kept, since they cost seconds to compile."""
    plant = build_plant(content.vehicle, noise=noise, controller=controller)

    def reset(references: FlatState, numbers: Int[Array, "b"], key: PRNGKeyArray) -> PlantState:
        keys = jax.vmap(lambda number: jax.random.fold_in(key, number))(numbers)
        return jax.vmap(plant.reset, (-1, 0), -1)(references, keys)

    def advance(
        state: PlantState,
        summary: _Summary,
        references: FlatState,
        left: Int[Array, "b"],
        limits: Float[Array, "2"],
        disturbance: Disturbance | None,
    ) -> tuple[PlantState, _Summary]:
        begun = state.step
        state, log = plant.fly_lanes(state, references, disturbance)
        active = jnp.arange(BLOCK_STEPS)[:, None] < left
        return state, _updated(summary, log, active, begun, limits)

    return _Tracker(reset=float32_island(reset), advance=float32_island(advance))


def _updated(
    summary: _Summary, log: FlightLog, active: Bool[Array, "n b"], begun: Int[Array, "b"], limits: Float[Array, "2"]
) -> _Summary:
    """The summary after one more block; what is not finite counts as infinite."""
    position = jnp.where(jnp.isfinite(log.position_error), log.position_error, jnp.inf)
    yaw = jnp.where(jnp.isfinite(log.yaw_error), log.yaw_error, jnp.inf)
    broken = active & ~((position < limits[0]) & (yaw < limits[1]))
    step = begun + 1 + jnp.argmax(broken, axis=0)
    violation = jnp.where(jnp.any(broken, axis=0), step / CONTROL_RATE, jnp.inf).astype(jnp.float32)
    speeds = jnp.max(log.rotor_speeds, axis=1)
    speeds = jnp.where(active & jnp.isfinite(speeds), speeds, 0.0)
    return _Summary(
        position_error=jnp.maximum(summary.position_error, jnp.max(jnp.where(active, position, 0.0), axis=0)),
        yaw_error=jnp.maximum(summary.yaw_error, jnp.max(jnp.where(active, yaw, 0.0), axis=0)),
        first_violation=jnp.minimum(summary.first_violation, violation),
        rotor_speed=jnp.maximum(summary.rotor_speed, jnp.max(speeds, axis=0)),
        saturated=summary.saturated + jnp.sum(active & log.saturated, axis=0, dtype=jnp.int32),
    )


def _blank() -> _Summary:
    zeros = np.zeros(WIDTH, np.float32)
    return _Summary(zeros, zeros, np.full(WIDTH, np.inf, np.float32), zeros, np.zeros(WIDTH, np.int32))


def _checked_indices(indices: Int[np.ndarray, "k"] | None, count: int) -> Int[np.ndarray, "k"]:
    numbers = np.arange(count) if indices is None else np.asarray(indices)
    if numbers.shape != (count,) or numbers.dtype.kind not in "iu" or np.any(numbers < 0) or np.any(numbers >= 2**31):
        raise InputError(
            f"indices: have shape {numbers.shape} and type {numbers.dtype}, want {count} whole numbers from 0 to 2^31-1"
        )
    return numbers


def _for_each(disturbance: Disturbance, count: int) -> Disturbance:
    """One row a flight."""

    def rows(leaf: Float[np.ndarray, "..."], size: tuple[int, ...]) -> Float[np.ndarray, "k ..."]:
        if np.shape(leaf) not in (size, (count, *size)):
            raise InputError(f"disturbance: have shape {np.shape(leaf)}, want {size} or {(count, *size)}")
        return np.broadcast_to(leaf, (count, *size))

    return Disturbance(**{name: rows(getattr(disturbance, name), size) for name, size in SHAPES.items()})


def _check_start(
    start: FlatState, begin: Float[np.ndarray, "b 3"], members: Int[np.ndarray, "b"], limit: float
) -> None:
    apart = np.linalg.norm(begin[: len(members)] - np.asarray(start.pos), axis=1)
    if not np.all(apart < limit):
        worst = int(np.argmax(np.where(np.isfinite(apart), apart, np.inf)))
        raise InputError(
            f"start: trajectory {members[worst]} begins {apart[worst]:.2f} m from the vehicle, want less than the "
            f"position threshold of {limit:.2f} m; begin the trajectory where the vehicle is"
        )
