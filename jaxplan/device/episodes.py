"""Closed loops as one traced step: predict, replan, commit, fly to the next cycle, judge.

One step is one period of one episode; ``vmap`` makes it that of a batch. A plan that is chosen takes over within the
period, one latency after its observations, as on the host. The committed plan is a rival, as
``jaxplan.replanner.incumbent`` has it: kept while the target is still expected where it is met, and nothing scores
better. Nothing is refined, nothing rolled out, and no stop is planned, since nothing in the room changes: every plan
ends at rest.
"""

import dataclasses
import enum
import functools
from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxplan.arrays import AnyArray
from jaxplan.device.predict import Predict, Seen
from jaxplan.device.replan import Decision, Replan
from jaxplan.device.room import Room
from jaxplan.device.stations import Goals
from jaxplan.errors import InputError
from jaxplan.interception.judging import INTERCEPTION_RADIUS
from jaxplan.knots import MAX_WAYPOINTS
from jaxplan.numerics import safe_norm
from jaxplan.prediction.mixture import ConditionalMixture
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.replanner.records import ReplannerConfig
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.tracking.plant import PlantState
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.result import SUCCESS, Thresholds
from jaxplan.tracking.rollout import FlightLog, Plant
from jaxplan.vehicle.params import Vehicle
from jaxplan.world.clearance import free_distance_at_once


class Ended(enum.IntEnum):
    """How an episode ended; names in lower case are the outcomes of ``jaxplan.interception``."""

    FLYING = 0
    """Not yet."""
    INTERCEPTED = 1
    COLLISION = 2
    TRACKING_LOST = 3
    TARGET_ENDED = 4
    NO_PLAN = 5


class Scene(NamedTuple):
    """What all episodes of a batch share, as arguments of what is traced."""

    room: Room
    start: Float[AnyArray, "3"]
    """Where the defender hovers until it departs [m, world]."""
    spacing: Int[AnyArray, ""]
    """Control steps between two observations, and between two steps that are predicted."""
    mixture: ConditionalMixture | None
    """For the predictor that draws from one (``predict.mixtures_for``)."""


class Episode(NamedTuple):
    """What is flown."""

    target: Float[AnyArray, "n 3"]
    """Where the target is at every control step [m, world]; it stays at the last one."""
    steps: Int[AnyArray, ""]
    """Control steps until the target's motion ends."""
    departure: Int[AnyArray, ""]
    """Control step from which on the defender plans."""
    predictor: Int[AnyArray, ""]
    """Number of its predictor among those of the loop."""
    key: PRNGKeyArray
    """Of all noise and draws."""


class Plan(NamedTuple):
    """A trajectory that is flown, or about to be."""

    begin: Int[Array, ""]
    """Control step at which it takes over."""
    spline: PiecewisePolynomial
    goal: Float[Array, "3"]
    """[m, world]"""
    arrival: Float[Array, ""]
    """When the target is met there [s since the episode began]."""
    meets: Bool[Array, ""]
    """Whether it meets the target, and does not only come nearer."""


class Tally(NamedTuple):
    """What an episode came to, up to the instant that decided it."""

    ended: Int[Array, ""]
    """An ``Ended``."""
    end: Float[Array, ""]
    """Instant of that [s]."""
    nearest: Float[Array, ""]
    """Least distance to the target [m]."""
    position_error: Float[Array, ""]
    """Largest [m]."""
    yaw_error: Float[Array, ""]
    """Largest [rad]."""
    clearance: Float[Array, ""]
    """Least distance to obstacles and faces [m], from the vehicle's centre."""
    cycles: Int[Array, ""]
    plans: Int[Array, ""]


class State(NamedTuple):
    """An episode under way."""

    step: Int[Array, ""]
    """Control steps since it began."""
    plant: PlantState
    plan: Plan
    tally: Tally


@runtime_checkable
class Begin(Protocol):
    """Puts the defender where it hovers."""

    def __call__(self, scene: Scene, episode: Episode) -> State:
        """Traced."""


@runtime_checkable
class Advance(Protocol):
    """One period."""

    def __call__(self, scene: Scene, episode: Episode, state: State) -> State:
        """Traced. An episode that has ended stays as it is but for its clock."""


@dataclasses.dataclass(frozen=True)
class LoopConfig:
    """Timing and judgement."""

    prediction: PredictionConfig
    likelihood_weight: float
    """Of ``PlannerConfig``."""
    replanner: ReplannerConfig = ReplannerConfig()
    lost_beyond: Thresholds = SUCCESS

    @property
    def period(self) -> int:
        """Control steps from one cycle to the next."""
        return round(self.replanner.period * CONTROL_RATE)

    @property
    def latency(self) -> int:
        """Control steps from a cycle until its plan takes over."""
        return round(self.replanner.latency * CONTROL_RATE)

    def __post_init__(self) -> None:
        """Raises InputError for plans that would take over in a later period."""
        if self.latency > self.period:
            raise InputError(
                f"device: have a latency of {self.replanner.latency} s, want one period, "
                f"{self.replanner.period} s, at most"
            )


def build_loop(
    config: LoopConfig, vehicle: Vehicle, plant: Plant, predictors: Sequence[Predict], replan: Replan
) -> tuple[Begin, Advance]:
    """The two functions of an episode, pure, to be traced in float64; all ``predictors`` propose as many goals."""
    steps, latency = config.prediction.steps, config.replanner.latency

    def begin(scene: Scene, episode: Episode) -> State:
        start = jnp.asarray(scene.start, jnp.result_type(float))
        hover = FlatState(derivatives=jnp.zeros((5, 3), start.dtype).at[0].set(start), yaw=jnp.zeros(3, start.dtype))
        return State(jnp.int32(0), plant.reset(hover, episode.key), _hold(start), _no_tally(start.dtype))

    def advance(scene: Scene, episode: Episode, state: State) -> State:
        flying = state.tally.ended == Ended.FLYING
        takeover, later = state.step + config.latency, state.step + config.period
        active = flying & (state.step >= episode.departure)
        seen = _seen(scene, episode, state.step, config.prediction.observations)
        truth = _target_at(episode, state.step + jnp.arange(1, steps + 1, dtype=jnp.int32) * scene.spacing)
        key = jax.random.fold_in(jax.random.fold_in(episode.key, 1), state.step)
        asked = [functools.partial(predict, seen, truth, scene.mixture, key) for predict in predictors]
        goals = jax.lax.switch(episode.predictor, asked)
        goals = goals._replace(times=goals.times - latency)
        above = _incumbent(config, scene, state.plan, goals, takeover)
        decision = replan(scene.room, _references(state.plan, takeover), goals, above)
        plan, changed = _next(decision, goals, takeover, above)
        committed = active & changed
        kept = jax.tree.map(lambda new, old: jnp.where(committed, new, old), plan, state.plan)
        rows = state.step + jnp.arange(config.period + 1, dtype=jnp.int32)
        flown, log = plant.fly(state.plant, _spliced(state.plan, kept, takeover, rows))
        tally = _judged(config, vehicle, scene.room, episode, state.tally, rows[1:], log)
        counted = tally._replace(
            cycles=tally.cycles + active.astype(jnp.int32), plans=tally.plans + committed.astype(jnp.int32)
        )
        tally = jax.tree.map(lambda new, old: jnp.where(flying, new, old), counted, state.tally)
        return State(later, flown, kept, _timed_out(episode, later, tally))

    return begin, advance


def _no_tally(dtype: jnp.dtype) -> Tally:
    """Of an episode that begins."""
    zero, none = jnp.zeros((), dtype), jnp.int32(0)
    return Tally(jnp.int32(Ended.FLYING), zero, zero + jnp.inf, zero, zero, zero + jnp.inf, none, none)


def _hold(place: Float[Array, "3"]) -> Plan:
    """Hovering, for ever, in arrays as long as those of the trajectories that are planned."""
    segments = MAX_WAYPOINTS - 1
    position = jnp.zeros((segments, 10, 3), place.dtype).at[:, 0].set(place)
    durations = jnp.zeros(segments, place.dtype).at[0].set(1.0)
    spline = PiecewisePolynomial(durations=durations, position=position, yaw=jnp.zeros((segments, 6), place.dtype))
    return Plan(jnp.int32(0), spline, place, jnp.full((), -jnp.inf, place.dtype), jnp.zeros((), bool))


def _references(plan: Plan, steps: Int[Array, "*n"]) -> FlatState:
    """Of a plan at control steps."""
    return plan.spline.state(_seconds(steps - plan.begin, plan.goal.dtype))


def _spliced(before: Plan, after: Plan, takeover: Int[Array, ""], steps: Int[Array, "n"]) -> FlatState:
    """Of one plan until another takes over, and of that from then on."""
    mine, others = _references(after, steps), _references(before, steps)
    over = steps >= takeover
    return jax.tree.map(lambda new, old: jnp.where(over.reshape(-1, *[1] * (new.ndim - 1)), new, old), mine, others)


def _seconds(steps: Int[Array, "*n"], dtype: jnp.dtype) -> Float[Array, "*n"]:
    return steps.astype(dtype) / CONTROL_RATE


def _target_at(episode: Episode, steps: Int[Array, "*n"]) -> Float[Array, "*n 3"]:
    """Where the target is [m, world]."""
    target = jnp.asarray(episode.target)
    return target[jnp.clip(steps, 0, target.shape[0] - 1)].astype(jnp.result_type(float))


def _seen(scene: Scene, episode: Episode, step: Int[Array, ""], most: int) -> Seen:
    """The newest positions, the last one now."""
    spacing = jnp.asarray(scene.spacing)
    back = jnp.arange(most - 1, -1, -1, dtype=jnp.int32) * spacing
    interval = _seconds(spacing, jnp.result_type(float))
    return Seen(_target_at(episode, step - back), jnp.minimum(step // spacing + 1, most), interval)


def _incumbent(
    config: LoopConfig, scene: Scene, plan: Plan, goals: Goals, takeover: Int[Array, ""]
) -> Float[Array, ""]:
    """What the committed plan is worth [s] among today's goals; -inf where it does not meet the target any more."""
    steps, replanner = config.prediction.steps, config.replanner
    positions, times = jnp.asarray(goals.positions), jnp.asarray(goals.times)
    remaining = plan.arrival - _seconds(takeover, plan.arrival.dtype)
    instants, means = times.reshape(steps, -1)[:, 0], positions.reshape(steps, -1, 3).mean(axis=1)
    then = jnp.stack([jnp.interp(remaining, instants, means[:, axis]) for axis in range(3)])
    draws = positions.shape[0] // steps
    expected = positions + then[None] - jnp.repeat(means, draws, axis=0)
    interval = _seconds(jnp.asarray(scene.spacing), times.dtype)
    tolerance = 0.5 * jnp.maximum(replanner.period, interval) + 1e-6
    apart = safe_norm(expected - plan.goal[None])
    there = plan.spline.evaluate(plan.arrival - _seconds(plan.begin, plan.arrival.dtype))[:3]
    missed = safe_norm(expected - there[None])
    same = (
        (jnp.abs(times - remaining) <= tolerance)
        & (apart <= replanner.keep_radius)
        & (missed <= max(replanner.reach, replanner.keep_radius))
    )
    nearest = jnp.argmin(jnp.where(same, apart, jnp.inf))
    worth = config.likelihood_weight * jnp.asarray(goals.likelihood)[nearest] - remaining
    return jnp.where(plan.meets & (remaining > 0.0) & jnp.any(same), worth, -jnp.inf)


def _next(
    decision: Decision, goals: Goals, takeover: Int[Array, ""], above: Float[Array, ""]
) -> tuple[Plan, Bool[Array, ""]]:
    """The plan from the next cycle on, and whether it is another one: a better meeting, or an approach without any."""
    changed = decision.found | (decision.approaches & ~(above > -jnp.inf))
    spline = PiecewisePolynomial(
        durations=decision.spline.durations[:, 0],
        position=decision.spline.position[..., 0],
        yaw=decision.spline.yaw[:, :, 0, 0],
    )
    arrival = _seconds(takeover, decision.arrival_time.dtype) + decision.arrival_time
    return Plan(takeover, spline, jnp.asarray(goals.positions)[decision.candidate], arrival, decision.found), changed


def _judged(
    config: LoopConfig,
    vehicle: Vehicle,
    room: Room,
    episode: Episode,
    tally: Tally,
    steps: Int[Array, "n"],
    log: FlightLog,
) -> Tally:
    """The tally after one period's rows, up to the first that decides; failure comes before success."""
    dtype = tally.end.dtype
    apart = safe_norm(jnp.asarray(log.pos, dtype) - _target_at(episode, steps))
    free = free_distance_at_once(room.world, jnp.asarray(log.pos, jnp.float32)).astype(dtype)
    off, turned = jnp.asarray(log.position_error, dtype), jnp.asarray(log.yaw_error, dtype)
    tracked = (off < config.lost_beyond.position) & (turned < config.lost_beyond.yaw)
    clear = free >= jnp.asarray(vehicle.radius, dtype)
    met = (apart < INTERCEPTION_RADIUS) & (steps >= episode.departure)
    decides = ~tracked | ~clear | met
    first = jnp.argmax(decides)
    last = jnp.where(jnp.any(decides), first, len(steps) - 1)
    counts = jnp.arange(len(steps)) <= last
    how = jnp.where(~clear[first], Ended.COLLISION, jnp.where(tracked[first], Ended.INTERCEPTED, Ended.TRACKING_LOST))
    return tally._replace(
        ended=jnp.where(jnp.any(decides), how, Ended.FLYING).astype(jnp.int32),
        end=_seconds(steps[last], dtype),
        nearest=jnp.minimum(tally.nearest, jnp.min(jnp.where(counts, apart, jnp.inf))),
        position_error=jnp.maximum(tally.position_error, jnp.max(jnp.where(counts, off, 0.0))),
        yaw_error=jnp.maximum(tally.yaw_error, jnp.max(jnp.where(counts, turned, 0.0))),
        clearance=jnp.minimum(tally.clearance, jnp.min(jnp.where(counts, free, jnp.inf))),
    )


def _timed_out(episode: Episode, step: Int[Array, ""], tally: Tally) -> Tally:
    """The target's motion is over."""
    over = (tally.ended == Ended.FLYING) & (step >= episode.steps)
    how = jnp.where(tally.plans > 0, Ended.TARGET_ENDED, Ended.NO_PLAN)
    return tally._replace(ended=jnp.where(over, how, tally.ended).astype(jnp.int32))
