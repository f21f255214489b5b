"""``minimum_snap_batch``: many minimum-snap problems of mixed length at once, each with a status of its own."""

import functools
from typing import Annotated, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt32
from numpy.typing import ArrayLike

from jaxplan.arrays import AnyArray, is_numpy, namespace
from jaxplan.batching import in_threads
from jaxplan.errors import InputError
from jaxplan.minsnap.layout import batch_last
from jaxplan.minsnap.quadratic_program import Ends, cost, knot_derivatives, make_problem, segment_coefficients
from jaxplan.minsnap.single import POSITION_ORDER, YAW_ORDER, Terminal, ends_of, interpolate, yaw_ends
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.minsnap.status import (
    RESIDUAL_LIMIT,
    UNSOLVED,
    SolveStatus,
    finite_problems,
    has_any,
    problem_status,
)
from jaxplan.precision import float64_island
from jaxplan.records import record
from jaxplan.status import bit
from jaxplan.validation import as_numbers


@record
class MinimumSnapBatch:
    """The solutions of a batch; the batch is the last axis everywhere."""

    splines: SplineBatch
    """Position and yaw; yaw is 0 where none was asked for."""
    cost: Float[AnyArray, "b"]
    """Integral of the squared snap [m^2/s^7]; infinite where the problem was not attempted."""
    yaw_cost: Float[AnyArray, "b"]
    """Integral of the squared yaw acceleration [rad^2/s^3]."""
    residual: Float[AnyArray, "b"]
    """Largest slope of the cost in a free knot derivative, relative to its bound; 1e-15 to 1e-11 is usual."""
    status: UInt32[AnyArray, "b"]
    """``SolveStatus`` bits; 0 is a solution."""


def minimum_snap_batch(
    waypoints: Annotated[ArrayLike, "n 3 b"],
    durations: Annotated[ArrayLike, "m b"],
    *,
    initial: Annotated[ArrayLike, "fixed_order 3 b, or without b"] | None = None,
    terminal: Terminal | Annotated[ArrayLike, "fixed_order 3 b, or without b"] = "rest",
    fixed_order: int = 4,
    yaw: Annotated[ArrayLike, "n b, or without b"] | None = None,
    initial_yaw: Annotated[ArrayLike, "2 b, or without b"] | None = None,
    batch_axis: int = -1,
) -> MinimumSnapBatch:
    """``minimum_snap`` for b problems at once: the batch is the **last** axis, for speed.

    A problem has n = m + 1 waypoints [m] and m durations [s]. One of fewer segments is padded: durations of 0 behind
    the last real one, and any waypoints there. The work is linear in m. A bad problem gets a status, an infinite cost
    and an empty spline, and changes nothing in the others. May stand inside ``jit``, ``vmap`` and ``grad``, with and
    without 64-bit types: the solve is in float64 and the results have the precision of the arguments. NumPy in gives
    NumPy out, in float64, compiled once per shape, large batches in parts on all cores.

    The gradient of ``cost`` follows the envelope theorem, that of the splines a second solve: about the price of the
    first, at any order. (Forward mode needs a process with 64-bit types.)

    Args:
        initial, terminal, fixed_order, yaw, initial_yaw: as in ``minimum_snap``; one for all problems, or with the
            batch as last axis.
        batch_axis: 0 where the batch is the first axis of every array that is given, waypoints of (b, n, 3) and
            durations of (b, m); they are transposed, and ``splines`` has it last all the same.

    Raises:
        InputError: shapes that do not fit, or an unknown ``terminal`` or ``fixed_order``.
    """
    ends = ends_of("minimum_snap_batch", terminal, fixed_order)
    given = (waypoints, 3), (durations, 2), (initial, 3), (yaw, 2), (initial_yaw, 2)
    waypoints, durations, initial, yaw, initial_yaw = batch_last("minimum_snap_batch", batch_axis, *given)
    if ends.goal_moves:
        (terminal,) = batch_last("minimum_snap_batch", batch_axis, (terminal, 3))
    waypoints, durations = _numbers("waypoints", waypoints), _numbers("durations", durations)
    segments, width = _shape(waypoints, durations)
    arrays = (
        waypoints,
        durations,
        _for_each("initial", initial, (POSITION_ORDER, 3), fixed_order, width),
        _for_each("terminal", terminal if ends.goal_moves else None, (POSITION_ORDER, 3), fixed_order, width),
        _for_each("yaw", yaw, (segments + 1,), segments + 1, width),
        _for_each("initial_yaw", initial_yaw, (YAW_ORDER,), YAW_ORDER, width),
    )
    if not is_numpy(arrays):
        return _in_float64(ends)(*arrays)
    wide = tuple(None if a is None else a.astype(np.float64, copy=False) for a in arrays)
    return in_threads(lambda part: _compiled(ends, *part), wide, width)


@runtime_checkable
class _Solver(Protocol):
    """``solve_batch`` for known ends."""

    def __call__(
        self,
        waypoints: ArrayLike,
        durations: ArrayLike,
        initial: AnyArray | None,
        terminal: AnyArray | None,
        yaw: AnyArray | None,
        initial_yaw: AnyArray | None,
        /,
    ) -> MinimumSnapBatch:
        """Solutions in the precision of the arrays, whose shapes and units are those of ``solve_batch``."""
        ...


@functools.cache
def _in_float64(ends: Ends) -> _Solver:
    """The solver for the ends, compiled once per shape."""
    return float64_island(functools.partial(solve_batch, ends))


def solve_batch(
    ends: Ends,
    waypoints: Float[Array, "n 3 b"],
    durations: Float[Array, "m b"],
    initial: Float[Array, "4 3 b"] | None,
    terminal: Float[Array, "4 3 b"] | None,
    yaw: Float[Array, "n b"] | None,
    initial_yaw: Float[Array, "2 b"] | None,
) -> MinimumSnapBatch:
    """The traced core of ``minimum_snap_batch``, through n = m + 1 waypoints, in the precision of its arguments."""
    width, dtype = durations.shape[-1], durations.dtype
    given = [a[: ends.fixed] for a in (initial, terminal) if a is not None]
    given += [a[:, None] for a in (yaw, initial_yaw) if a is not None]
    initial = jnp.zeros((POSITION_ORDER, 3, width), dtype) if initial is None else initial
    status = problem_status(waypoints, durations, *given)
    skip = has_any(status, UNSOLVED)
    points, times = finite_problems(waypoints, durations, skip)
    start = jnp.where(skip[None, None], 0.0, initial)
    goal = None if terminal is None else jnp.where(skip[None, None], 0.0, terminal)
    problem = make_problem(times, points, start, goal, ends)
    knots = knot_derivatives(problem, ends)
    position = segment_coefficients(problem, points[:-1], knots)
    value, residual = cost(problem, ends)
    status |= bit(~jnp.isfinite(position).all(axis=(0, 1, 2)), SolveStatus.NONFINITE)
    value = jnp.where(skip, jnp.inf, value)
    heading, yaw_value = _solve_yaw(times, yaw, initial_yaw, skip, ends)
    status |= bit(~(residual <= RESIDUAL_LIMIT), SolveStatus.ILL_CONDITIONED)
    splines = SplineBatch(durations=times, position=position, yaw=heading)
    return MinimumSnapBatch(splines=splines, cost=value, yaw_cost=yaw_value, residual=residual, status=status)


def _solve_yaw(
    times: Float[Array, "m b"],
    yaw: Float[Array, "n b"] | None,
    initial_yaw: Float[Array, "2 b"] | None,
    skip: Bool[Array, "b"],
    ends: Ends,
) -> tuple[Float[Array, "m 6 1 b"], Float[Array, "b"]]:
    """Yaw splines and their cost: 0 where no yaw was asked for."""
    segments, width = times.shape
    if yaw is None and initial_yaw is None:
        return jnp.zeros((segments, 6, 1, width), times.dtype), jnp.zeros(width, times.dtype)
    angles = jnp.zeros((segments + 1, width), times.dtype) if yaw is None else yaw
    rates = jnp.zeros((YAW_ORDER, width), times.dtype) if initial_yaw is None else initial_yaw
    rates = jnp.where(skip[None], 0.0, rates)[:, None]
    angles, _ = finite_problems(angles[:, None], times, skip)
    ends = yaw_ends(ends)
    coefficients, _ = interpolate(times, angles, rates, None, ends)
    return coefficients, cost(make_problem(times, angles, rates, None, ends), ends)[0]


_compiled = jax.jit(solve_batch, static_argnums=0)


def _numbers(name: str, value: ArrayLike) -> AnyArray:
    """What is on the host as an array of numbers."""
    return value if isinstance(value, jax.Array) else as_numbers(f"minimum_snap_batch: {name}", value)


def _shape(waypoints: ArrayLike, durations: ArrayLike) -> tuple[int, int]:
    """How many segments and problems, from shapes that fit."""
    have, times = np.shape(waypoints), np.shape(durations)
    if len(have) != 3 or have[1] != 3 or have[0] < 2:
        raise InputError(
            f"minimum_snap_batch: waypoints have shape {have}, want (m+1, 3, b) with the batch last and m at least 1"
        )
    if times != (have[0] - 1, have[2]):
        raise InputError(f"minimum_snap_batch: durations have shape {times}, want {(have[0] - 1, have[2])}")
    return have[0] - 1, have[2]


def _for_each(name: str, value: ArrayLike | None, shape: tuple[int, ...], rows: int, width: int) -> AnyArray | None:
    """``value`` of at least ``rows`` rows as an array of ``shape`` with the batch behind; None stays None."""
    if value is None:
        return None
    value = _numbers(name, value)
    xp, have = namespace(value), np.shape(value)
    if len(have) == len(shape):
        value, have = xp.asarray(value)[..., None], (*have, 1)
    if have[0] not in (rows, shape[0]) or have[1:-1] != shape[1:] or have[-1] not in (1, width):
        raise InputError(f"minimum_snap_batch: {name} has shape {np.shape(value)}, want {(rows, *shape[1:], width)}")
    missing = ((0, shape[0] - have[0]), *((0, 0) for _ in have[1:]))
    return xp.broadcast_to(xp.pad(xp.asarray(value), missing), (*shape, width))
