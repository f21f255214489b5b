"""Time allocation: the durations between waypoints that the planning policy learns to predict (paper eq. 2, 5, 6).

Three problems, all in the logarithms of the durations, for a whole batch at once:

    (a) minimise  rho * T + sigma            eq. 2: T the total time, sigma the smoothness (snap, yaw acceleration)
    (b) minimise  sigma  at a given T        eq. 5
    (c) minimise  T  within the limits of the vehicle    eq. 6

(a) and (b) minimise the logarithm of the cost by BFGS with the exact gradient, so that neither the size of the room
nor rho changes the iterations. (c) starts from (b): ``minimum_time``.
"""

import dataclasses
import functools
from typing import Annotated, Literal, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt32
from numpy.typing import ArrayLike

from jaxplan.arrays import AnyArray
from jaxplan.errors import InputError
from jaxplan.minsnap.bfgs import Minimum, Objective, minimise
from jaxplan.minsnap.layout import batch_last
from jaxplan.minsnap.minimum_time import (
    Margin,
    least_margin,
    margin_of_vehicle,
    shortest_alternated,
    with_traced_numbers,
)
from jaxplan.minsnap.quadratic_program import REST, Ends, gradient, knot_derivatives, make_problem
from jaxplan.minsnap.single import YAW_ORDER
from jaxplan.minsnap.status import UNSOLVED, SolveStatus, finite_problems, has_any, problem_status
from jaxplan.records import record, replace
from jaxplan.status import bit
from jaxplan.validation import as_numbers, require_at_least, require_positive
from jaxplan.vehicle.params import Vehicle

Kind = Literal["weighted", "fixed", "fastest"]
"""Which of the problems (a), (b), (c)."""
KINDS: tuple[Kind, ...] = ("weighted", "fixed", "fastest")


@dataclasses.dataclass(frozen=True)
class TimeAllocationConfig:
    """How hard to try."""

    tolerance: float = 1e-5
    """Relative decrease of the cost that is no longer worth an evaluation."""
    max_evaluations: int = 60
    """Evaluations of cost and gradient at most, for each optimisation."""
    instants: int = 256
    """Instants, evenly spread over the trajectory, at which the limits are tested (minimum time only)."""
    rounds: int = 2
    """Alternations of ratios and total time (minimum time only)."""
    bisections: int = 12
    """Halvings of the bracket of the total time, after a grid with steps of a factor 1.25 (minimum time only)."""
    yaw_weight: float = 1.0
    """mu_psi of the paper's eq. 3, with mu_r = 1 (the predecessors' choice)."""

    def __post_init__(self) -> None:
        require_positive("time_allocation", self, "tolerance")
        require_at_least("time_allocation", self, 1, "max_evaluations", "instants", "rounds", "bisections")
        require_at_least("time_allocation", self, 0, "yaw_weight")


@record
class TimeAllocation:
    """Optimised durations; the batch is the last axis, but where ``time_allocation`` was asked for the first."""

    durations: Float[AnyArray, "_ _"]
    """Seconds per segment, (m, b) or (b, m); 0 on padding and where there is no solution."""
    cost: Float[AnyArray, "b"]
    """The minimised quantity: rho * T + sigma, sigma, or T [s]; infinite where there is no solution."""
    evaluations: Int[AnyArray, "b"]
    """Evaluations of cost and gradient that each problem took."""
    status: UInt32[AnyArray, "b"]
    """``SolveStatus`` bits; 0 is a solution."""


def time_allocation(
    waypoints: Annotated[ArrayLike, "n 3 b"],
    *,
    time_weight: float | Annotated[ArrayLike, "b"] | None = None,
    total_time: float | Annotated[ArrayLike, "b"] | None = None,
    margin: Margin | None = None,
    vehicle: Vehicle | None = None,
    segments: Annotated[ArrayLike, "b"] | None = None,
    initial: Annotated[ArrayLike, "4 3 b or 4 3"] | None = None,
    yaw: Annotated[ArrayLike, "n b"] | None = None,
    config: TimeAllocationConfig | None = None,
    batch_axis: int = -1,
) -> TimeAllocation:
    """Optimal durations for b sequences of n = m + 1 waypoints at once, from ``initial`` derivatives to rest (host).

    Exactly one of the three problems is chosen by its parameter. Computed in float64, whatever the process's JAX
    flags; NumPy arrays come back. Compiled once per shape, and for (c) once per function ``margin``: the numbers that a
    ``functools.partial`` has bound are traced, so other vehicles compile nothing anew.

    Args:
        time_weight: (a) rho [m^2/s^8] of rho * T + sigma.
        total_time: (b) the time to distribute [s].
        vehicle: (c) whose rotors stay within their limits.
        margin: (c) any other limit on flat states, or ``functools.partial(rotor_limit_margin, vehicle)``.
        segments: how many segments of each sequence are real; all when omitted.
        initial: velocity to snap at the start; at rest when omitted.
        yaw: heading at the waypoints [rad, unwrapped]; ignored when omitted.
        batch_axis: 0 where the batch is the first axis of every array, given and returned: waypoints of (b, n, 3).

    Raises:
        InputError: none or several of the four parameters, one that is not positive, or a wrong shape.
    """
    if sum(value is not None for value in (time_weight, total_time, margin, vehicle)) != 1:
        raise InputError("time_allocation: give exactly one of time_weight, total_time, margin and vehicle")
    margin = margin if vehicle is None else margin_of_vehicle(vehicle)
    chosen = [value is not None for value in (time_weight, total_time, margin)]
    waypoints, yaw = batch_last("time_allocation", batch_axis, (waypoints, 3), (yaw, 2))
    (initial,) = batch_last("time_allocation", batch_axis, (initial, 3))
    points, counts, start, angles = _checked(waypoints, segments, initial, yaw)
    number = time_weight if total_time is None else total_time
    given = as_numbers("time_allocation: weight or total time", 1.0 if number is None else number)
    if given.shape not in ((), (1,), points.shape[-1:]):
        raise InputError(f"time_allocation: the time or its weight has shape {given.shape}, want one or one a sequence")
    amount = np.broadcast_to(given, points.shape[-1:])
    if not (amount > 0.0).all():
        raise InputError(f"time_allocation: the time or its weight is {amount.min()}, want it positive")
    kind = KINDS[chosen.index(True)]
    limit = None if margin is None else with_traced_numbers(margin)
    with jax.enable_x64(True):
        found = _compiled(kind, limit, config or TimeAllocationConfig(), points, counts, amount, start, angles)
        found = jax.tree.map(np.asarray, found)
    return found if batch_axis == -1 else replace(found, durations=found.durations.T)


def optimise_durations(
    kind: Kind,
    margin: Margin | None,
    config: TimeAllocationConfig,
    waypoints: Float[Array, "n 3 b"],
    counts: Int[Array, "b"],
    amount: Float[Array, "b"],
    initial: Float[Array, "4 3 b"],
    yaw: Float[Array, "n b"] | None,
) -> TimeAllocation:
    """The traced core of ``time_allocation``, for sequences of n = m + 1 waypoints.

    Args:
        margin: of kind "fastest".
        counts: real segments of each sequence.
        amount: rho [m^2/s^8] for kind "weighted", the total time [s] for "fixed".
    """
    real = jnp.arange(len(waypoints) - 1, dtype=counts.dtype)[:, None] < counts[None]
    marks = real.astype(waypoints.dtype)
    given = [initial] if yaw is None else [initial, yaw[:, None]]
    status = problem_status(waypoints, marks, *given)
    skip = has_any(status, UNSOLVED | SolveStatus.COINCIDENT)
    points, marks = finite_problems(waypoints, marks, skip)
    real = marks > 0.0
    start = jnp.where(skip[None, None], 0.0, initial)
    smoothness = _smoothness(points, start, yaw, config.yaw_weight)
    first = _first_guess(points, real)
    if kind == "weighted":
        found = _weighted(smoothness, first, real, amount, config)
    else:
        total = amount if kind == "fixed" else jnp.sum(first, axis=0)
        found = _fixed(smoothness, first, real, total, config)
    durations, value = found.durations, found.cost
    late = ~(found.decrement <= 10.0 * config.tolerance)
    if kind == "fastest":
        assert margin is not None
        least = functools.partial(least_margin, margin, points, start, yaw, instants=config.instants)
        reshare = functools.partial(_fixed, smoothness, real=real, config=config)
        durations, feasible = shortest_alternated(
            least, lambda best, total: reshare(best, total=total).durations, durations, config.rounds, config.bisections
        )
        value = jnp.sum(durations, axis=0)
        status |= bit(~feasible & ~skip, SolveStatus.INFEASIBLE)
        skip |= ~feasible
    status |= bit(late & ~skip, SolveStatus.NOT_CONVERGED)
    return TimeAllocation(
        durations=jnp.where(skip[None], 0.0, durations),
        cost=jnp.where(skip, jnp.inf, value),
        evaluations=found.evaluations,
        status=status,
    )


_compiled = jax.jit(optimise_durations, static_argnums=(0, 2))


@runtime_checkable
class Smoothness(Protocol):
    """The cost of the best trajectory as a function of its durations."""

    def __call__(self, durations: Float[Array, "m b"], /) -> tuple[Float[Array, "b"], Float[Array, "m b"]]:
        """sigma [m^2/s^7], and its gradient by the durations [s]."""
        ...


class _Optimum(NamedTuple):
    """Where an optimisation of durations ended."""

    durations: Float[Array, "m b"]
    cost: Float[Array, "b"]
    decrement: Float[Array, "b"]
    """The further relative decrease of the cost that the model predicts."""
    evaluations: Int[Array, "b"]


def _smoothness(
    points: Float[Array, "n 3 b"],
    initial: Float[Array, "4 3 b"],
    yaw: Float[Array, "n b"] | None,
    yaw_weight: float,
) -> Smoothness:
    ends = Ends(YAW_ORDER)

    def sigma(durations: Float[Array, "m b"]) -> tuple[Float[Array, "b"], Float[Array, "m b"]]:
        problem = make_problem(durations, points, initial, None, REST)
        value, partials, _ = gradient(problem, knot_derivatives(problem, REST), REST)
        if yaw is None:
            return value, partials.durations
        turning = make_problem(durations, yaw[:, None], jnp.zeros((YAW_ORDER, 1, yaw.shape[-1]), yaw.dtype), None, ends)
        yaw_value, yaw_partials, _ = gradient(turning, knot_derivatives(turning, ends), ends)
        return value + yaw_weight * yaw_value, partials.durations + yaw_weight * yaw_partials.durations

    return sigma


def _first_guess(points: Float[Array, "n 3 b"], real: Bool[Array, "m b"]) -> Float[Array, "m b"]:
    """Typical shares, 1 s in the mean: a power of the distance, longer where the flight starts and stops.

    Power and factor are fitted to the optima of random waypoints in a room (least squares in the logarithms).
    """
    squares = jnp.sum(jnp.diff(points, axis=0) ** 2, axis=1)
    count = jnp.maximum(jnp.sum(real, axis=0), 1).astype(points.dtype)
    mean = jnp.sum(jnp.where(real, squares, 0.0), axis=0) / count
    share = (squares / jnp.where(mean > 0.0, mean, 1.0)[None] + 0.02) ** 0.28
    index = jnp.arange(len(real), dtype=points.dtype)[:, None]
    share = jnp.where(real, jnp.where((index == 0) | (index == count[None] - 1), 1.57, 1.0) * share, 0.0)
    whole = jnp.sum(share, axis=0)
    return share * (count / jnp.where(whole > 0.0, whole, 1.0))[None]


def _first_inverse(real: Bool[Array, "m b"], dtype: jnp.dtype) -> Float[Array, "m m b"]:
    """The inverse of a typical Hessian of a log cost in log durations, for each lane's number of segments.

    Hessians at the optima of random waypoints are banded, and their bands hardly vary; they fall with 1 / count.
    """
    m = len(real)
    table = np.zeros((m + 1, m, m))
    for count in range(1, m + 1):
        bands = np.full(count, 2.6), np.full(count - 1, 1.25), np.full(max(count - 2, 0), 0.42)
        bands[0][[0, -1]] = 7.2
        bands[1][:1] = bands[1][-1:] = 2.0
        upper = sum(np.diag(band, k) for k, band in enumerate(bands[:count]))
        table[count, :count, :count] = count * np.linalg.inv(upper + np.triu(upper, 1).T)
    return jnp.moveaxis(jnp.asarray(table, dtype)[jnp.sum(real, axis=0)], 0, -1)


def _weighted(
    sigma: Smoothness,
    first: Float[Array, "m b"],
    real: Bool[Array, "m b"],
    weight: Float[Array, "b"],
    config: TimeAllocationConfig,
) -> _Optimum:
    """(a): started where the total time would be optimal for a trajectory that scales (at rest, sigma ~ T^-7)."""
    total = jnp.sum(first, axis=0)
    factor = (7.0 * sigma(first)[0] / (weight * jnp.where(total > 0.0, total, 1.0))) ** 0.125

    def objective(logs: Float[Array, "m b"]) -> tuple[Float[Array, "b"], Float[Array, "m b"]]:
        durations = jnp.where(real, jnp.exp(logs), 0.0)
        value, slope = sigma(durations)
        cost = value + weight * jnp.sum(durations, axis=0)
        safe = jnp.where(cost > 0.0, cost, 1.0)
        return jnp.log(safe), durations * (slope + weight[None]) / safe[None]

    found = _minimise(objective, first * factor[None], real, config)
    return _optimum(jnp.where(real, jnp.exp(found.x), 0.0), found)


def _fixed(
    sigma: Smoothness,
    first: Float[Array, "m b"],
    real: Bool[Array, "m b"],
    total: Float[Array, "b"],
    config: TimeAllocationConfig,
) -> _Optimum:
    """(b): the unknowns are the logarithms of the shares of the total time, up to a common factor."""

    def shared(logs: Float[Array, "m b"]) -> Float[Array, "m b"]:
        sizes = jnp.where(real, jnp.exp(logs), 0.0)
        whole = jnp.sum(sizes, axis=0)
        return sizes * (total / jnp.where(whole > 0.0, whole, 1.0))[None]

    def objective(logs: Float[Array, "m b"]) -> tuple[Float[Array, "b"], Float[Array, "m b"]]:
        durations = shared(logs)
        value, slope = sigma(durations)
        safe = jnp.where(value > 0.0, value, 1.0)
        pull = durations * slope
        return jnp.log(safe), (pull - durations / total[None] * jnp.sum(pull, axis=0)[None]) / safe[None]

    found = _minimise(objective, first, real, config)
    return _optimum(shared(found.x), found)


def _minimise(
    objective: Objective, first: Float[Array, "m b"], real: Bool[Array, "m b"], config: TimeAllocationConfig
) -> Minimum:
    """The minimum over the logarithms of the real durations, from the ``first`` ones [s]."""
    logs = jnp.where(real, jnp.log(jnp.where(real & (first > 0.0), first, 1.0)), 0.0)
    return minimise(objective, logs, _first_inverse(real, first.dtype), config.tolerance, config.max_evaluations)


def _optimum(durations: Float[Array, "m b"], found: Minimum) -> _Optimum:
    """The durations at the minimum of the logarithm of the cost."""
    return _Optimum(durations, jnp.exp(found.value), found.decrement, found.evaluations)


def _checked(
    waypoints: ArrayLike, segments: ArrayLike | None, initial: ArrayLike | None, yaw: ArrayLike | None
) -> tuple[
    Float[np.ndarray, "n 3 b"],
    Int[np.ndarray, "b"],
    Float[np.ndarray, "4 3 b"],
    Float[np.ndarray, "n b"] | None,
]:
    """Waypoints, numbers of segments, initial derivatives and yaw of every sequence."""
    points = as_numbers("time_allocation: waypoints", waypoints)
    if points.ndim != 3 or points.shape[1] != 3 or len(points) < 2:
        raise InputError(f"time_allocation: waypoints have shape {points.shape}, want (m+1, 3, b) with the batch last")
    m, width = len(points) - 1, points.shape[-1]
    counts = np.full(width, m) if segments is None else as_numbers("time_allocation: segments", segments)
    if counts.shape != (width,) or not ((counts >= 1) & (counts <= m)).all():
        raise InputError(f"time_allocation: segments must be {width} numbers from 1 to {m}")
    start = np.zeros((4, 3, 1)) if initial is None else as_numbers("time_allocation: initial", initial)
    start = start[..., None] if start.ndim == 2 else start
    if start.shape not in ((4, 3, 1), (4, 3, width)):
        raise InputError(f"time_allocation: initial has shape {start.shape}, want (4, 3) or {(4, 3, width)}")
    angles = None if yaw is None else as_numbers("time_allocation: yaw", yaw)
    if angles is not None and angles.shape != (m + 1, width):
        raise InputError(f"time_allocation: yaw has shape {angles.shape}, want {(m + 1, width)}")
    return points, counts.astype(np.int64), np.broadcast_to(start, (4, 3, width)), angles
