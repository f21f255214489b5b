"""Labels: the durations that a policy should give, from the optimiser at the vehicle's boundary (paper eq. 4 to 6).

The ratios are those of the smoothest trajectory for a total time (``minsnap.allocation``, problem b), the total time is
the least at which no rotor leaves its range (rotor-limit label), yaw included as the planner flies it. A second number
says how much slower the flight must be for the simulated vehicle to just follow it (rollout label).
"""

import dataclasses
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxplan.arrays import AnyArray
from jaxplan.minsnap.spline_batch import SplineBatch, fit_each
from jaxplan.minsnap.time_allocation import TimeAllocationConfig, optimise_durations
from jaxplan.spline import FlatStateBatch
from jaxplan.tracking.track import track
from jaxplan.vehicle.limits import least_rotor_margin, rotor_limit_margin
from jaxplan.vehicle.params import Vehicle

SLOWDOWNS = (1.0, 1.05, 1.1, 1.2, 1.35, 1.6, 2.0)
"""Factors of the rotor-limit durations that are flown, one after the other, until the vehicle keeps up."""


@dataclasses.dataclass(frozen=True)
class LabelConfig:
    """How the boundary is searched."""

    reserve: float = 20.0
    """Rotor speed [rad/s] that a label stays away from the limits, so that a policy that imitates it passes them."""
    instants: int = 256
    """Instants of each flight at which the rotors are looked at. Excesses may last a few milliseconds: with 13 of each
    segment, three quarters of the labels exceeded the limits between them."""
    rounds: int = 2
    """Alternations of ratios and total time."""
    grid: int = 16
    """Factors tried first, from ``slowest`` down in equal ratios."""
    bisections: int = 8
    """Halvings of the bracket that the grid leaves."""
    span: tuple[float, float] = (0.35, 6.0)
    """Least and largest factor of the first guess."""
    max_yaw_rate: float = 1.5
    """As the planner's (``PlannerConfig.max_yaw_rate``) [rad/s]."""


class Queries(NamedTuple):
    """What a policy is asked, batch axis last."""

    waypoints: Float[AnyArray, "n 3 b"]
    """The first is where the vehicle is [m]; behind the last real one the goal is repeated."""
    count: Int[AnyArray, "b"]  # type: ignore[assignment]  # hides tuple.count, which nobody calls
    """Waypoints in use."""
    derivatives: Float[AnyArray, "4 3 b"]
    """Velocity to snap at the start [SI]."""
    yaw: Float[AnyArray, "3 b"]
    """Yaw, yaw rate and yaw acceleration at the start [rad, s]."""


@runtime_checkable
class Fly(Protocol):
    """The planner's trajectories for given durations, on the host."""

    def __call__(self, queries: Queries, durations: Float[np.ndarray, "m b"], /) -> SplineBatch:
        """Trajectories of NumPy arrays, to rest at the goal, for durations [s]."""


@runtime_checkable
class _Inside(Protocol):
    def __call__(self, durations: Float[Array, "m b"], /) -> Bool[Array, "b"]:
        """Whether no rotor leaves its range in flights of these durations [s]."""


def initial_states(queries: Queries) -> FlatStateBatch:
    """The states that the sequences begin in."""
    return FlatStateBatch(derivatives=jnp.concatenate([queries.waypoints[:1], queries.derivatives]), yaw=queries.yaw)


def sped_up(queries: Queries, alpha: Float[AnyArray, "b"] | float) -> Queries:
    """The same sequences from alpha D: derivatives of order k times alpha^k (``jaxplan.arrival``; host)."""
    powers = np.broadcast_to(alpha, np.shape(queries.count)) ** np.arange(5)[:, None]
    return queries._replace(derivatives=queries.derivatives * powers[1:, None], yaw=queries.yaw * powers[:3])


def trajectories(queries: Queries, durations: Float[AnyArray, "m b"], max_yaw_rate: float) -> SplineBatch:
    """The planner's trajectories for these durations [s], to rest at the goal, at most at ``max_yaw_rate`` [rad/s]."""
    return fit_each(initial_states(queries), jnp.asarray(queries.waypoints), jnp.asarray(durations), max_yaw_rate)


def rotor_limit_labels(
    vehicle: Vehicle, queries: Queries, config: LabelConfig = LabelConfig()
) -> tuple[Float[Array, "m b"], Bool[Array, "b"]]:
    """Durations [s] of the fastest flights found within the rotors' limits, and whether there is one (traced).

    There is none from a state that is itself beyond the limits, as one that alpha has sped up may be. From one that is
    near them, the flight may use half of what is left.
    """
    count = queries.waypoints.shape[0] - 1
    real = jnp.arange(count, dtype=queries.count.dtype)[:, None] < (queries.count - 1)[None]
    durations = jnp.where(real, _first_guess(queries), 0.0)
    initial = _initial_margin(vehicle, queries)
    threshold = jnp.minimum(config.reserve, 0.5 * initial)

    def inside(durations: Float[Array, "m b"]) -> Bool[Array, "b"]:
        splines = trajectories(queries, durations, config.max_yaw_rate)
        return least_rotor_margin(vehicle, splines.states(config.instants)) >= threshold

    feasible = jnp.zeros(queries.count.shape, bool)
    for _ in range(config.rounds):
        ratios = _smoothest(queries, jnp.sum(durations, axis=0))
        shorter, found = _shortest(inside, jnp.where(real, ratios, 0.0), config)
        better = found & ~(feasible & (jnp.sum(durations, axis=0) <= jnp.sum(shorter, axis=0)))
        durations, feasible = jnp.where(better[None], shorter, durations), feasible | found
    return durations, feasible & (initial > 0.0)


def rollout_slowdown(
    vehicle: Vehicle,
    queries: Queries,
    durations: Float[np.ndarray, "m b"],
    feasible: Bool[np.ndarray, "b"],
    fly: Fly,
) -> Float[np.ndarray, "b"]:
    """The least of ``SLOWDOWNS`` by which ``durations`` are multiplied for the vehicle to track the flight (host).

    Thresholds of training (0.20 m, 15 degrees), default noise. Infinite where even the last one is too fast; NaN
    where there is no label to begin with.

    Args:
        vehicle: that is simulated.
        queries: the sequences.
        durations: their labels at the rotors' limits [s].
        feasible: whether there is a label.
        fly: solves them.
    """
    slowdown = np.where(feasible, np.inf, np.nan)
    for factor in SLOWDOWNS:
        left = np.flatnonzero(slowdown == np.inf)
        if len(left) == 0:
            break
        flights = fly(queries, factor * durations)
        some = jax.tree.map(lambda leaf, members=left: np.asarray(leaf)[..., members], flights)
        tracked = track(some, vehicle=vehicle, indices=left).feasible
        slowdown[left[tracked]] = factor
    return slowdown


def _first_guess(queries: Queries) -> Float[Array, "m b"]:
    """Durations [s] of the right size: to speed up and slow down on a path of this length, and to stop from now."""
    lengths = jnp.sqrt(jnp.sum(jnp.diff(queries.waypoints, axis=0) ** 2, axis=1)) + 0.02
    whole = jnp.sum(lengths, axis=0)
    speed = jnp.sqrt(jnp.sum(queries.derivatives[0] ** 2, axis=0))
    total = whole / 8.0 + jnp.sqrt(whole / 4.0) + speed / 8.0
    return total[None] * lengths / whole[None]


def _initial_margin(vehicle: Vehicle, queries: Queries) -> Float[Array, "b"]:
    return rotor_limit_margin(vehicle, initial_states(queries))


def _smoothest(queries: Queries, total: Float[Array, "b"]) -> Float[Array, "m b"]:
    """Durations of least snap that add up to ``total``."""
    settings = TimeAllocationConfig(tolerance=1e-4, max_evaluations=40)
    waypoints, segments, start = (jnp.asarray(a) for a in (queries.waypoints, queries.count - 1, queries.derivatives))
    found = optimise_durations("fixed", None, settings, waypoints, segments, total, start, None)
    return jnp.asarray(found.durations)


def _shortest(
    inside: _Inside, durations: Float[Array, "m b"], config: LabelConfig
) -> tuple[Float[Array, "m b"], Bool[Array, "b"]]:
    """The least feasible multiple: a grid, then bisection below its first success (not monotone when moving)."""
    factors = jnp.asarray(np.geomspace(*config.span, config.grid), durations.dtype)
    step = float((config.span[1] / config.span[0]) ** (1.0 / (config.grid - 1)))
    passed = jax.lax.map(lambda factor: inside(factor * durations), factors)
    high = factors[jnp.argmax(passed, axis=0)]

    def halve(_: Int[Array, ""], bracket: _Bracket) -> _Bracket:
        low, high = bracket
        middle = jnp.sqrt(low * high)
        good = inside(middle[None] * durations)
        return _Bracket(jnp.where(good, low, middle), jnp.where(good, middle, high))

    _, high = jax.lax.fori_loop(0, config.bisections, halve, _Bracket(high / step, high))
    return high[None] * durations, jnp.any(passed, axis=0)


class _Bracket(NamedTuple):
    """Factors between which the boundary lies: too fast, and slow enough."""

    low: Float[Array, "b"]
    high: Float[Array, "b"]
