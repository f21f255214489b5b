"""Arrival matching: slow every candidate down until it meets the target (paper, Sec. III-B).

A time allocation pi(p, D) gives the least durations for waypoints p from the initial derivatives D. Slowed by
alpha it becomes alpha * pi(p, alpha D), where alpha D scales the k-th derivative by alpha^k: the same path, flown
alpha times as slowly. The arrival time T_goal is met at the root of

    f(x) = x + log sum pi(p, e^x D) - log T_goal,        x = log alpha,

where the sum goes up to the waypoint at which the target is met. What follows behind it ends at rest.

The paper takes alpha >= 1. What a policy allots is not the least that can be flown, from flight least of all: the
search may begin at a smaller ``least_alpha``, where something else decides what can be flown.

The paper iterates x <- x - f(x), which oscillates or diverges when pi shrinks as fast as alpha grows. Here steps
follow the slope of f between the last two points, safeguarded by a bracket, for all candidates in one
``lax.while_loop``.
"""

import dataclasses
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from jaxplan.arrays import AnyArray, Scalar, namespace
from jaxplan.spline import FlatState, FlatStateBatch
from jaxplan.status import Reason, bit
from jaxplan.validation import require_between, require_within

RISE, HALFWAY = 0.7, 1.4
"""Of f's slope in flight over that at rest, and the speed [m/s] at which half of it is there: medians by speed are 1.0
below 0.5 m/s, 1.1 below 1, 1.3 to 1.5 up to 4 (docs/decisions/0063)."""
SLOPES = (0.8, 8.0)
"""Least and largest slope that is believed; f rises by 1.1 to 5 for each unit of x there (1st and 99th percentile)."""
PATIENCE = 6
"""Calls after which steps grow, or brackets are halved (arbitrary)."""


@runtime_checkable
class Decode(Protocol):
    """A time allocation for known waypoints."""

    def __call__(self, initial: FlatStateBatch, /) -> Float[Array, "m k"]:
        """Durations [s] of every candidate from its initial state (SI units, world frame)."""
        ...


@dataclasses.dataclass(frozen=True)
class ArrivalConfig:
    """Stopping rule of the alpha iteration."""

    least_alpha: float = 1.0
    """Smallest scale factor that is looked at (the paper's: 1)."""
    tolerance: float = 1e-3
    """Largest relative error of the arrival time."""
    max_calls: int = 16
    """Largest number of calls of the time allocation."""

    def __post_init__(self) -> None:
        require_between("arrival", self, 0, 1, "tolerance")
        require_within("arrival", self, 0.1, 1, "least_alpha")
        require_within("arrival", self, 2, 1000, "max_calls")


class Arrival(NamedTuple):
    """Time allocations that arrive at T_goal, one lane per candidate."""

    durations: Float[AnyArray, "m k"]
    """Seconds per segment, summing to T_goal exactly up to the meeting where converged."""
    alpha: Float[AnyArray, "k"]
    """Scale factor; at least the least one where the candidate is reachable, else in proportion to T_goal."""
    least_durations: Float[AnyArray, "m k"]
    """Seconds per segment at the least alpha."""
    reasons: UInt32[AnyArray, "k"]
    """ALPHA_LT_1 or ALPHA_NOT_CONVERGED; 0 where the arrival time is met."""
    calls: Int[AnyArray, "k"]
    """Calls of the time allocation until the lane was done."""


class _Search(NamedTuple):
    """Carry of the root search; every field has one lane per candidate."""

    x: Float[Array, "k"]
    f: Float[Array, "k"]
    slope: Float[Array, "k"]
    durations: Float[Array, "m k"]
    below: Float[Array, "k"]
    f_below: Float[Array, "k"]
    above: Float[Array, "k"]
    f_above: Float[Array, "k"]
    calls: Int[Array, "k"]
    trips: Int[Array, ""]


def match_arrival(
    decode: Decode,
    initial: FlatState | FlatStateBatch,
    arrival_times: Float[Array, "k"],
    config: ArrivalConfig,
    meet: Int[Array, "k"] | None = None,
    least_alpha: Float[Array, "k"] | None = None,
) -> Arrival:
    """Find alpha for every candidate; candidates that need less than the least one are done after the first call.

    Args:
        decode: the time allocation.
        initial: one state for all candidates, or one for each.
        arrival_times: T_goal of every candidate [s from the initial state].
        config: when to stop.
        meet: number of the waypoint at which each target is met; the last one when omitted.
        least_alpha: of each candidate, instead of the configuration's.
    """
    log_goal = jnp.log(arrival_times)

    def allocate(x: Float[Array, "k"]) -> tuple[Float[Array, "m k"], Float[Array, "k"]]:
        durations = decode(sped_up(initial, jnp.exp(x)))
        return durations, x + jnp.log(time_to(durations, meet)) - log_goal

    def unfinished(search: _Search) -> Bool[Array, ""]:
        return (search.trips < config.max_calls) & jnp.any(_active(search, config))

    def step(search: _Search) -> _Search:
        active = _active(search, config)
        x = jnp.where(active, _propose(search), search.x)
        durations, f = allocate(x)
        return _keep(active, search, _narrow(search, x, f, durations))

    first = jnp.full_like(arrival_times, jnp.log(config.least_alpha)) if least_alpha is None else jnp.log(least_alpha)
    least, f = allocate(first)
    nan, slope = jnp.full_like(first, jnp.nan), jnp.broadcast_to(first_slope(_squared_speed(initial)), first.shape)
    once = jnp.ones(first.shape, jnp.int32)
    start = _Search(first, f, slope, least, first, f, nan, nan, once, jnp.int32(1))
    end = jax.lax.while_loop(unfinished, step, start)
    reachable = f <= config.tolerance
    met = jnp.abs(end.f) <= config.tolerance
    alpha = jnp.where(reachable, jnp.exp(end.x), jnp.exp(first - f))
    exact = end.durations * jnp.exp(end.x)[None] * jnp.exp(-end.f)[None]
    reasons = bit(~reachable, Reason.ALPHA_LT_1) | bit(reachable & ~met, Reason.ALPHA_NOT_CONVERGED)
    return Arrival(jnp.where(met[None], exact, end.durations), alpha, least * jnp.exp(first)[None], reasons, end.calls)


def first_slope(squared_speed: Scalar | Float[AnyArray, "k"]) -> Scalar | Float[AnyArray, "k"]:
    """The slope of f before two points are known, by the start's speed [m^2/s^2]; exact at rest: pi does not change."""
    return 1.0 + RISE * squared_speed / (squared_speed + HALFWAY**2)


def _squared_speed(initial: FlatState | FlatStateBatch) -> Float[Array, "k"]:
    return jnp.sum(jnp.asarray(initial.derivatives).reshape(5, 3, -1)[1] ** 2, axis=0)


def time_to(durations: Float[AnyArray, "m k"], meet: Int[AnyArray, "k"] | None) -> Float[AnyArray, "k"]:
    """Seconds from the start to waypoint number ``meet`` of each sequence; to the last one without any."""
    xp = namespace(durations, meet)
    if meet is None:
        return xp.sum(durations, axis=0)
    before = xp.arange(durations.shape[0], dtype=meet.dtype)[:, None] < meet[None]
    return xp.sum(xp.where(before, durations, 0.0), axis=0)


def sped_up(initial: FlatState | FlatStateBatch, alpha: Float[Array, "k"]) -> FlatStateBatch:
    """alpha D: the k-th derivative times alpha^k (paper eq. 8), of position and yaw.

    Args:
        initial: one state for all alpha, or a batch with one for each.
    """
    powers = alpha[None] ** jnp.arange(5, dtype=alpha.dtype)[:, None]
    derivatives, yaw = initial.derivatives.reshape(5, 3, -1), initial.yaw.reshape(3, -1)
    return FlatStateBatch(derivatives=derivatives * powers[:, None], yaw=yaw * powers[:3])


def _active(search: _Search, config: ArrivalConfig) -> Bool[Array, "k"]:
    """Lanes still looking for their root: early so far or overshot, and finite."""
    reachable = (search.f_below <= config.tolerance) & jnp.isfinite(search.f)
    return reachable & (jnp.abs(search.f) > config.tolerance)


def _propose(search: _Search) -> Float[Array, "k"]:
    """The step along the slope; where that leads out of the bracket its secant, and its middle now and then."""
    step = search.x - search.f / search.slope
    bracketed = jnp.isfinite(search.above)
    rise = (search.f_above - search.f_below) / (search.above - search.below)
    secant = search.below - search.f_below / rise
    middle = 0.5 * (search.below + search.above)
    patient = (search.trips <= PATIENCE) | (search.trips % 3 != 2)
    trusted = jnp.where(_within(step, search), step, jnp.where(_within(secant, search), secant, middle))
    onwards = search.x - search.f / search.slope * _stretch(search.trips, search.f.dtype)
    return jnp.where(bracketed, jnp.where(patient, trusted, middle), onwards)


def _within(x: Float[Array, "k"], search: _Search) -> Bool[Array, "k"]:
    return (x > search.below) & (x < search.above)


def _stretch(trips: Int[Array, ""], dtype: jnp.dtype) -> Float[Array, ""]:
    """Widen the unbracketed steps as they repeat, so that a slow approach still ends."""
    return jnp.where(trips <= PATIENCE, 1.0, 2.0 ** jnp.minimum(trips - PATIENCE, 10).astype(dtype))


def _narrow(search: _Search, x: Float[Array, "k"], f: Float[Array, "k"], durations: Float[Array, "m k"]) -> _Search:
    early, moved = f < 0.0, x != search.x
    slope = (f - search.f) / jnp.where(moved, x - search.x, 1.0)
    believed = moved & (slope > SLOPES[0] / 10.0) & jnp.isfinite(slope)
    return _Search(
        x=x,
        f=f,
        slope=jnp.where(believed, jnp.clip(slope, *SLOPES), search.slope),
        durations=durations,
        below=jnp.where(early, x, search.below),
        f_below=jnp.where(early, f, search.f_below),
        above=jnp.where(early, search.above, x),
        f_above=jnp.where(early, search.f_above, f),
        calls=search.calls + 1,
        trips=search.trips + 1,
    )


def _keep(active: Bool[Array, "k"], old: _Search, new: _Search) -> _Search:
    """Take the new values of the active lanes; the loop counter always moves on."""

    def kept(old: Array, new: Array) -> Array:
        return new if old.ndim == 0 else jnp.where(jnp.expand_dims(active, range(old.ndim - 1)), new, old)

    return jax.tree.map(kept, old, new)
