"""Flying many trajectories in simulation: which of them the vehicle can follow, and how well.

A batch of ``FLIGHTS_AT_ONCE`` flights advances in blocks of one second, all by the same compiled program whatever their
lengths: a flight that is over flies on, unseen. Batches share the cores, one thread each. Flights are sorted by length
first, so that few fly on. The noise of a flight depends on the seed and its index alone, so neither order, batch
size nor neighbours change its result.
"""

import dataclasses
import functools
import os
from collections.abc import Sequence
from typing import Annotated, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, PRNGKeyArray, Shaped
from numpy.typing import ArrayLike

from jaxplan.arrays import AnyArray
from jaxplan.batching import at_fixed_width, fill
from jaxplan.errors import InputError
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.precision import float32_island
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.tracking.disturbance import SHAPES, Disturbance
from jaxplan.tracking.plant import PlantState
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.references import Splines, as_sequence, duration_of_each, padded, references_at
from jaxplan.tracking.result import TRAINING, Flaw, Thresholds, TrackingResult
from jaxplan.tracking.rollout import ControllerName, FlightLog, build_plant
from jaxplan.vehicle.fingerprint import fingerprint
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle

WIDTH = 128
"""Lanes that advance together (measured: throughput grows by a tenth beyond)."""
FLIGHTS_AT_ONCE = WIDTH - 8
"""Lanes that carry flights. XLA computes the last 8 in the remainder of its vector loops, where rounding differs in the
last bit (measured on AVX-512): a flight there would depend on its place in the batch."""
BLOCK_STEPS = CONTROL_RATE
"""Control steps of one call: 1 s."""
LONGEST_FLIGHT = 100.0
"""s; as in the MFRL evaluation."""


@dataclasses.dataclass(frozen=True)
class TrackConfig:
    """How trajectories are flown, and when they count as feasible."""

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
    """What is kept of flights while they are flown."""

    position_error: Float[AnyArray, "b"]
    """m, the largest so far."""
    yaw_error: Float[AnyArray, "b"]
    """rad, the largest so far."""
    first_violation: Float[AnyArray, "b"]
    """s from the start; inf while there is none."""
    rotor_speed: Float[AnyArray, "b"]
    """rad/s, of the fastest rotor so far."""
    saturated: Shaped[AnyArray, "b"]
    """Control steps whose command a limit changed; in the end their share."""


@runtime_checkable
class _Reset(Protocol):
    def __call__(self, references: FlatState, numbers: Int[AnyArray, "b"], key: PRNGKeyArray) -> PlantState:
        """Each flight on its reference; its noise is the stream of that number below ``key``."""


@runtime_checkable
class _Advance(Protocol):
    def __call__(
        self,
        state: PlantState,
        summary: _Summary,
        references: FlatState,
        left: Int[AnyArray, "b"],
        limits: Float[AnyArray, "2"],
        disturbance: Disturbance | None,
    ) -> tuple[PlantState, _Summary]:
        """One block along ``references`` (b, n + 1); ``left``: control steps until each flight's end.

        ``limits``: thresholds of position [m] and yaw [rad].
        """


class _Tracker(NamedTuple):
    """The compiled programs of one vehicle."""

    reset: _Reset
    advance: _Advance


@dataclasses.dataclass(frozen=True)
class _Flights:
    """What is flown, and how; one row a flight."""

    splines: Sequence[PiecewisePolynomial] | SplineBatch
    durations: Float[np.ndarray, "k"]
    numbers: Int[np.ndarray, "k"]
    start: FlatState | None
    disturbance: Disturbance | None
    config: TrackConfig


def track(
    splines: Splines,
    *,
    vehicle: Vehicle | None = None,
    config: TrackConfig | None = None,
    indices: Annotated[ArrayLike, "k"] | None = None,
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
    found = as_sequence(splines)
    chosen = TrackConfig() if config is None else config
    durations = duration_of_each(found)
    if len(durations) == 1 and not np.isfinite(durations[0]):
        raise InputError("splines: the spline has a coefficient or a duration that is not finite, want finite numbers")
    flights = _Flights(
        splines=found,
        durations=durations,
        numbers=_checked_indices(indices, len(durations)),
        start=start,
        disturbance=None if disturbance is None else _for_each(disturbance, len(durations)),
        config=chosen,
    )
    flyer = _default_vehicle() if vehicle is None else vehicle
    tracker = _tracker(_Numbers(fingerprint(flyer), flyer), chosen.noise, chosen.controller)
    flown = np.flatnonzero((durations > 0.0) & (durations <= LONGEST_FLIGHT))
    flown = flown[np.argsort(-durations[flown], kind="stable")]
    summary = None
    if len(flown):
        cores = os.cpu_count() or 1
        summary = at_fixed_width(lambda some: _fly(tracker, flights, some), flown, FLIGHTS_AT_ONCE, threads=cores)
    return _result(durations, flown, summary, chosen.thresholds)


def _fly(tracker: _Tracker, flights: _Flights, members: Int[np.ndarray, "b"]) -> _Summary:
    """``FLIGHTS_AT_ONCE`` flights to their ends; the share of saturated steps is in place of their number."""
    rows, config = fill(members, WIDTH), flights.config
    batch = padded(flights.splines, rows)
    steps = control_steps(flights.durations[rows])
    limits = np.array([config.thresholds.position, config.thresholds.yaw])
    times = np.arange(BLOCK_STEPS + 1) / CONTROL_RATE
    references = references_at(batch, times)
    first = jax.tree.map(lambda leaf: leaf[:, 0], references)
    if flights.start is not None:
        _check_start(flights.start, np.asarray(first.pos), rows, config.thresholds.position)
        first = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (WIDTH, *np.shape(leaf))), flights.start)
    around = jax.tree.map(lambda leaf: leaf[rows], flights.disturbance)
    state = tracker.reset(first, flights.numbers[rows].astype(np.int32), jax.random.key(config.seed))
    summary = _blank()
    for done in range(0, int(steps.max()), BLOCK_STEPS):
        if done:
            references = references_at(batch, done / CONTROL_RATE + times)
        state, summary = tracker.advance(state, summary, references, (steps - done).astype(np.int32), limits, around)
    host = _Summary(*map(np.asarray, summary))
    return host._replace(saturated=host.saturated / steps)


def control_steps(durations: Float[np.ndarray, "k"]) -> Int[np.ndarray, "k"]:
    """Control steps that end within a flight, at least 1."""
    return np.maximum(np.floor(durations * CONTROL_RATE + 1e-6), 1).astype(np.int64)


def _result(
    durations: Float[np.ndarray, "k"], flown: Int[np.ndarray, "f"], summary: _Summary | None, thresholds: Thresholds
) -> TrackingResult:
    """The summary of those that were flown, in the order of all flights, and what follows from it."""
    columns = []
    for place, otherwise in enumerate((np.inf, np.inf, 0.0, np.nan, 0.0)):
        column = np.full(len(durations), otherwise)
        if summary is not None:
            column[flown] = summary[place]
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


@dataclasses.dataclass(frozen=True)
class _Numbers:
    """A vehicle compared by its numbers, so that loading a preset twice compiles once."""

    fingerprint: str
    vehicle: Vehicle = dataclasses.field(compare=False)


@functools.lru_cache(maxsize=8)
def _tracker(numbers: _Numbers, noise: bool, controller: ControllerName) -> _Tracker:
    """The programs that fly ``WIDTH`` lanes of one vehicle; kept, since they cost seconds to compile."""
    plant = build_plant(numbers.vehicle, noise=noise, controller=controller)

    def reset(references: FlatState, numbers: Int[AnyArray, "b"], key: PRNGKeyArray) -> PlantState:
        keys = jax.vmap(lambda number: jax.random.fold_in(key, number))(numbers)
        return jax.vmap(plant.reset)(references, keys)

    def advance(
        state: PlantState,
        summary: _Summary,
        references: FlatState,
        left: Int[AnyArray, "b"],
        limits: Float[AnyArray, "2"],
        disturbance: Disturbance | None,
    ) -> tuple[PlantState, _Summary]:
        begun = state.step
        state, log = jax.vmap(plant.fly)(state, references, disturbance)
        active = jnp.arange(BLOCK_STEPS)[None, :] < left[:, None]
        return state, _updated(summary, log, active, begun, limits)

    return _Tracker(reset=float32_island(reset), advance=float32_island(advance))


def _updated(
    summary: _Summary,
    log: FlightLog,
    active: Bool[AnyArray, "b n"],
    begun: Int[AnyArray, "b"],
    limits: Float[AnyArray, "2"],
) -> _Summary:
    """The summary after one more block; what is not finite counts as infinite."""
    position = jnp.where(jnp.isfinite(log.position_error), log.position_error, jnp.inf)
    yaw = jnp.where(jnp.isfinite(log.yaw_error), log.yaw_error, jnp.inf)
    broken = active & ~((position < limits[0]) & (yaw < limits[1]))
    step = begun + 1 + jnp.argmax(broken, axis=1)
    violation = jnp.where(jnp.any(broken, axis=1), step / CONTROL_RATE, jnp.inf).astype(jnp.float32)
    speeds = jnp.max(log.rotor_speeds, axis=2)
    speeds = jnp.where(active & jnp.isfinite(speeds), speeds, 0.0)
    return _Summary(
        position_error=jnp.maximum(summary.position_error, jnp.max(jnp.where(active, position, 0.0), axis=1)),
        yaw_error=jnp.maximum(summary.yaw_error, jnp.max(jnp.where(active, yaw, 0.0), axis=1)),
        first_violation=jnp.minimum(summary.first_violation, violation),
        rotor_speed=jnp.maximum(summary.rotor_speed, jnp.max(speeds, axis=1)),
        saturated=summary.saturated + jnp.sum(active & log.saturated, axis=1, dtype=jnp.int32),
    )


def _blank() -> _Summary:
    zeros = np.zeros(WIDTH, np.float32)
    return _Summary(zeros, zeros, np.full(WIDTH, np.inf, np.float32), zeros, np.zeros(WIDTH, np.int32))


def _checked_indices(indices: ArrayLike | None, count: int) -> Int[np.ndarray, "k"]:
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


def _check_start(start: FlatState, begin: Float[np.ndarray, "b 3"], rows: Int[np.ndarray, "b"], limit: float) -> None:
    apart = np.linalg.norm(begin - np.asarray(start.pos), axis=1)
    if not np.all(apart < limit):
        worst = int(np.argmax(np.where(np.isfinite(apart), apart, np.inf)))
        raise InputError(
            f"start: trajectory {rows[worst]} begins {apart[worst]:.2f} m from the vehicle, want less than the "
            f"position threshold of {limit:.2f} m; begin the trajectory where the vehicle is"
        )
