"""The soonest meeting that the simulated vehicle really flies (host).

Several starts are optimised at once. The best are flown; what a flight breaks is planned with more of a margin next
time (clearance, nearness to the target, and a body that could fly it faster than it is flown), from where the last
solution was, until no plan is left that could be sooner than the best flight.
"""

import dataclasses
import functools
import math
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.optimizer.interior_point import DescentConfig, descend
from jaxplan.optimizer.margins import linearise, values
from jaxplan.optimizer.problem import Limits, TargetTable, Task, flatten, splines, unflatten
from jaxplan.precision import in_float64
from jaxplan.records import replace
from jaxplan.reference.flight import Flown, Judge, Verdict, fly
from jaxplan.reference.starts import Sought, first_guesses
from jaxplan.spline import PiecewisePolynomial, hover
from jaxplan.tracking.rollout import Plant
from jaxplan.validation import require_at_least, require_positive, require_within
from jaxplan.vehicle.params import Vehicle

VIOLATION = 3e-3
"""A margin below 0 by less counts as kept: 1 mm of clearance, 0.3 % of a rotor's thrust."""
SLOWDOWNS = 1.2 ** np.arange(12.0)
"""By which the first guess's durations are multiplied until the rotors nearly suffice: from demands far beyond their
reach, where thrust turns over, no descent finds back."""
NEARLY = -0.35
"""The least margin of a first guess that is slow enough (arbitrary)."""
HORIZON, INTERVAL = 6.0, 0.02
"""s; how much of the target's motion is known to the optimiser, and how finely."""
SLOWER, MORE_CLEARANCE, NEARER = 1.02, 0.01, 0.03
"""By how much limits that a flight broke move in: share of time, and m (the clearance by what was missing besides)."""
MOST_SHORTFALL, LATE = 0.03, 0.02
"""m; of what was missing, that is believed at once: flights out of control say little. s; behind the planned meeting,
from which on a flight has missed it."""
MAX_TILT = math.radians(78.5)
"""Of the thrust from the vertical [rad]."""
LEAST_RADIUS = 0.05
"""m; of the meeting ball (arbitrary)."""
WORTHWHILE = 0.005
"""s; a plan that is not sooner than the best flight by more is not flown: one control step."""


@dataclasses.dataclass(frozen=True)
class ReferenceConfig:
    """How much is tried."""

    segments: int = 8
    """Of every trajectory, the one to the stop included."""
    starts: int = 8
    """Optimised at once."""
    rounds: int = 12
    """Of planning and flying."""
    clearance: float = 0.30
    """Metres from the vehicle's centre to obstacles and walls: the planner's 0.28 (radius and tracking margin), and
    0.02 for what lies between samples."""
    meet_radius: float = 0.39
    """Metres from the target at the meeting; the judge's 0.4 less 0.01."""
    latency: float = 0.1
    """Seconds from the departure until the vehicle may leave its hover, as in the closed loop."""
    descent: DescentConfig = DescentConfig()
    refinement: DescentConfig = DescentConfig(iterations=30, barrier=1e-3, rate=0.85, slack=0.02)

    def __post_init__(self) -> None:
        require_within("reference", self, 3, 16, "segments")
        require_within("reference", self, 1, 256, "starts")
        require_within("reference", self, 1, 100, "rounds")
        require_positive("reference", self, "clearance", "meet_radius")
        require_at_least("reference", self, 0.0, "latency")


@runtime_checkable
class Motion(Protocol):
    """A target's position [m] or velocity [m/s], world, at instants of the episode's clock [s]."""

    def __call__(self, times: Float[np.ndarray, "n"], /) -> Float[np.ndarray, "n 3"]:
        """One row an instant."""


class Interception(NamedTuple):
    """What is to be met, from where, by what."""

    sought: Sought
    """World, start, and where routes are searched."""
    vehicle: Vehicle
    plant: Plant
    judge: Judge
    position: Motion
    velocity: Motion
    departure: float
    """Seconds on the episode's clock."""
    seed: int
    """Of the plant's noise."""


class Reference(NamedTuple):
    """The soonest meeting that was found."""

    feasible: bool
    """Whether the plan keeps all margins."""
    seconds: float
    """From the departure to within the judge's radius of the target, in flight; inf where it was not met."""
    planned: float
    """The same of the plan, to its meeting point."""
    spline: PiecewisePolynomial
    """Begins ``latency`` after the departure."""
    flight: Flown
    verdict: Verdict
    rounds: int
    """How often plans were made until this one."""


@in_float64
def soonest(case: Interception, config: ReferenceConfig) -> Reference:
    """Search, optimise, fly and refine.

    The result is the soonest flight that meets the target, in control and clear; where there is none, the last one.
    """
    task, x = _opened(case, config)
    x, descent = _slowed(task, x), config.descent
    found: list[Reference] = []
    best = np.inf
    for turn in range(config.rounds):
        x, descent = _descend(task, x, descent), config.refinement
        tried = np.flatnonzero(_times(task, x) < best - config.latency - WORTHWHILE)
        if not len(tried):
            if np.isfinite(best):
                break
            continue
        batch = _splines(task, x)
        flights = [_flown(case, batch.spline(place), config, turn + 1) for place in tried]
        best = min(best, *(one.seconds for one in flights if one.verdict.accepted), np.inf)
        found += flights
        task, x = _tightened(task, x, tried, flights)
    if not found:
        found = [_flown(case, _splines(task, x).spline(0), config, config.rounds, feasible=False)]
    good = [one for one in found if one.verdict.accepted]
    return min(good, key=lambda one: one.seconds) if good else found[-1]


def _opened(case: Interception, config: ReferenceConfig) -> tuple[Task, Float[Array, "k v"]]:
    """The task and its starts."""
    begin = case.departure + config.latency
    clock = begin + np.arange(0.0, HORIZON + 0.5 * INTERVAL, INTERVAL)
    beside = np.zeros((3, config.starts))
    path = {"position": case.position(clock), "velocity": case.velocity(clock), "offset": beside}
    table = TargetTable(interval=np.asarray(INTERVAL), **path)
    own = float(case.judge.clearance(case.sought.start[None])[0]) - 0.01  # a start nearer to obstacles is allowed
    limits = (min(config.clearance, own), 0.0, 0.0, 0.0, config.meet_radius, 1.0)
    each = Limits(**dict(zip(Limits.__dataclass_fields__, (np.full(config.starts, v) for v in limits), strict=True)))
    task = Task(
        start=hover(case.sought.start),
        target=table,
        world=case.sought.world,
        vehicle=case.vehicle,
        limits=each,
        max_tilt=np.asarray(MAX_TILT),
        max_pitch=np.asarray(MAX_TILT),
        max_body_rate=np.asarray(np.inf),
    )
    task = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), task)
    guesses = first_guesses(case.sought, lambda times: case.position(begin + times), config.segments, config.starts)
    return task, jnp.asarray(flatten(guesses).T)


@jax.jit
def _slowed(task: Task, x: Float[Array, "k v"]) -> Float[Array, "k v"]:
    """The starts with the least of the ``SLOWDOWNS`` that suffices, or with the best."""
    logs = unflatten(x.T).log_durations.shape[0]
    tried = jnp.log(jnp.asarray(SLOWDOWNS, x.dtype))
    slower = jax.vmap(lambda log: x.at[:, :logs].add(log))(tried)
    margins = jax.lax.map(lambda one: jnp.min(values(task, one)[1], axis=1), slower)
    enough = margins > NEARLY
    chosen = jnp.where(jnp.any(enough, axis=0), jnp.argmax(enough, axis=0), jnp.argmax(margins, axis=0))
    return slower[chosen, jnp.arange(len(x))]


@jax.jit
def _descend(task: Task, x: Float[Array, "k v"], config: DescentConfig) -> Float[Array, "k v"]:
    """Local minima near k points."""
    return descend(functools.partial(values, task), functools.partial(linearise, task), x, config).x


@jax.jit
def _splines(task: Task, x: Float[Array, "k v"]) -> SplineBatch:
    """The trajectories of k points."""
    return splines(task, unflatten(x.T))


_values = jax.jit(values)


def _times(task: Task, x: Float[Array, "k v"]) -> Float[np.ndarray, "k"]:
    """Meeting times [s] from the plan's start; inf where a margin is not kept."""
    times, margins = _values(task, x)
    return np.where(np.asarray(margins).min(axis=1) > -VIOLATION, np.asarray(times), np.inf)


def _flown(
    case: Interception, spline: PiecewisePolynomial, config: ReferenceConfig, turn: int, feasible: bool = True
) -> Reference:
    """One plan and its flight."""
    begin = case.departure + config.latency
    flight = fly(case.plant, hover(case.sought.start), spline, begin, case.seed)
    verdict = case.judge.verdict(flight, case.position(flight.times), case.departure)
    planned = config.latency + float(np.asarray(spline.durations)[:-1].sum())
    return Reference(feasible, verdict.met - case.departure, planned, spline, flight, verdict, turn)


def _tightened(
    task: Task, x: Float[Array, "k v"], places: Int[np.ndarray, "f"], flown: list[Reference]
) -> tuple[Task, Float[Array, "k v"]]:
    """Limits further in where a flight broke one, and the plans that are to keep them."""
    limits, plans = {name: np.array(leaf) for name, leaf in vars(task.limits).items()}, np.array(x)
    segments = plans.shape[1] // 4
    for place, one in zip(places, flown, strict=True):
        verdict = one.verdict
        if verdict.shortfall > 0.0:
            limits["clearance"][place] += min(verdict.shortfall, MOST_SHORTFALL) + MORE_CLEARANCE
        if not verdict.tracked:
            limits["dilation"][place] *= SLOWER
            plans[place, :segments] += math.log(SLOWER)
        if verdict.tracked and one.seconds > one.planned + LATE:
            limits["meet_radius"][place] = max(limits["meet_radius"][place] - NEARER, LEAST_RADIUS)
    return replace(task, limits=Limits(**jax.tree.map(jnp.asarray, limits))), jnp.asarray(plans)
