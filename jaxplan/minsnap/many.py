"""``minimum_snap_batch``: many minimum-snap problems of mixed length at once, checked lane by lane."""

import functools
from collections.abc import Callable
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32
from numpy.typing import ArrayLike

from jaxplan.arrays import AnyArray
from jaxplan.batching import batch_last, in_parts
from jaxplan.errors import InputError
from jaxplan.minsnap.quadratic_program import Ends, cost, knot_derivatives, make_problem, segment_coefficients
from jaxplan.minsnap.single import POSITION_ORDER, YAW_ORDER, Terminal, ends_of, interpolate, yaw_ends
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.minsnap.status import RESIDUAL_LIMIT, SolveStatus, finite_problems, flag, problem_status, unsolved
from jaxplan.precision import in_float64_inside, is_numpy
from jaxplan.records import record


@record
class MinimumSnapBatch:
    """The solutions of a batch; the batch is the last axis everywhere."""

    splines: SplineBatch
    """Position and yaw; yaw is 0 where none was asked for."""
    cost: Float[AnyArray, "b"]
    """Integral of the squared snap [m^2/s^7]; infinite where the problem could not be solved."""
    yaw_cost: Float[AnyArray, "b"]
    """Integral of the squared yaw acceleration [rad^2/s^3]."""
    residual: Float[AnyArray, "b"]
    """Largest slope of the cost in a free knot derivative, relative to its bound; 1e-15 to 1e-11 is usual."""
    status: UInt32[AnyArray, "b"]
    """``SolveStatus`` bits; 0 is a solution."""


def minimum_snap_batch(
    waypoints: Annotated[ArrayLike, "m+1 3 b"],
    durations: Annotated[ArrayLike, "m b"],
    *,
    initial: Annotated[ArrayLike, "r 3 b or r 3"] | None = None,
    terminal: Terminal | Annotated[ArrayLike, "r 3 b or r 3"] = "rest",
    fixed_order: int = 4,
    yaw: Annotated[ArrayLike, "m+1 b"] | None = None,
    initial_yaw: Annotated[ArrayLike, "2 b or 2"] | None = None,
) -> MinimumSnapBatch:
    """``minimum_snap`` for b problems at once: the batch is the **last** axis, for speed.

    Problems of fewer segments are padded: durations of 0 behind the last real one, and any waypoints there. The work
    is linear in m. A bad problem gets a status, an infinite cost and an empty spline, and changes nothing in the
    others. May stand inside ``jit``, ``vmap`` and ``grad``, with and without 64-bit types: the solve is in float64
    and the results have the precision of the arguments. NumPy in gives NumPy out, in float64, compiled once per shape,
    large batches in parts on all cores.

    The gradient of ``cost`` follows the envelope theorem, that of the splines a second solve: about the price of the
    first, at any order. (Forward mode needs a process with 64-bit types.)

    Args:
        initial, terminal, fixed_order, yaw, initial_yaw: as in ``minimum_snap``; one for all problems, or with the
            batch as last axis.

    Raises:
        InputError: shapes that do not fit, or an unknown ``terminal`` or ``fixed_order``.
    """
    ends = ends_of("minimum_snap_batch", terminal, fixed_order)
    segments, lanes = _shape(waypoints, durations)
    arrays = (
        waypoints,
        durations,
        _ends_array("initial", initial, (POSITION_ORDER, 3), fixed_order, lanes),
        _ends_array("terminal", terminal if ends.goal_moves else None, (POSITION_ORDER, 3), fixed_order, lanes),
        _ends_array("yaw", yaw, (segments + 1,), segments + 1, lanes),
        _ends_array("initial_yaw", initial_yaw, (YAW_ORDER,), YAW_ORDER, lanes),
    )
    if not is_numpy(arrays):
        wanted = [a for a in arrays if a is not None]
        present = tuple(a is not None for a in arrays)
        return _bordered(ends, present)(*wanted)
    wide = tuple(None if a is None else np.asarray(a, dtype=np.float64) for a in arrays)
    return in_parts(lambda part: _compiled(ends, *part), wide, lanes)


@functools.cache
def _bordered(ends: Ends, present: tuple[bool, ...]) -> Callable[..., MinimumSnapBatch]:
    return in_float64_inside(functools.partial(_unpacked, ends, present))


def _unpacked(ends: Ends, present: tuple[bool, ...], *wanted: Array) -> MinimumSnapBatch:
    values = iter(wanted)
    return solve_batch(ends, *(next(values) if there else None for there in present))


@batch_last
def solve_batch(
    ends: Ends,
    waypoints: Float[Array, "knots 3 b"],
    durations: Float[Array, "m b"],
    initial: Float[Array, "4 3 b"] | None,
    terminal: Float[Array, "4 3 b"] | None,
    yaw: Float[Array, "knots b"] | None,
    initial_yaw: Float[Array, "2 b"] | None,
) -> MinimumSnapBatch:
    """The traced core of ``minimum_snap_batch``, in the precision of its arguments."""
    lanes, dtype = durations.shape[-1], durations.dtype
    given = [a[: ends.fixed] for a in (initial, terminal) if a is not None]
    given += [a[:, None] for a in (yaw, initial_yaw) if a is not None]
    initial = jnp.zeros((POSITION_ORDER, 3, lanes), dtype) if initial is None else initial
    status = problem_status(waypoints, durations, *given)
    skip = unsolved(status)
    points, times = finite_problems(waypoints, durations, skip)
    start = jnp.where(skip, 0.0, initial)
    goal = None if terminal is None else jnp.where(skip, 0.0, terminal)
    problem = make_problem(times, points, start, goal, ends)
    knots = knot_derivatives(problem, ends)
    position = segment_coefficients(problem, points[:-1], knots)
    value, residual = cost(problem, ends)
    value = jnp.where(skip, jnp.inf, value)
    heading, yaw_value = _solve_yaw(times, yaw, initial_yaw, skip, ends)
    status |= flag(~(residual <= RESIDUAL_LIMIT), SolveStatus.ILL_CONDITIONED)
    splines = SplineBatch(durations=times, position=position, yaw=heading)
    return MinimumSnapBatch(splines=splines, cost=value, yaw_cost=yaw_value, residual=residual, status=status)


def _solve_yaw(
    times: Float[Array, "m b"],
    yaw: Float[Array, "knots b"] | None,
    initial_yaw: Float[Array, "2 b"] | None,
    skip: Array,
    ends: Ends,
) -> tuple[Float[Array, "m 6 1 b"], Float[Array, "b"]]:
    """Yaw splines and their cost: 0 where no yaw was asked for."""
    segments, lanes = times.shape
    if yaw is None and initial_yaw is None:
        return jnp.zeros((segments, 6, 1, lanes), times.dtype), jnp.zeros(lanes, times.dtype)
    headings = jnp.zeros((segments + 1, lanes), times.dtype) if yaw is None else yaw
    turning = jnp.zeros((YAW_ORDER, lanes), times.dtype) if initial_yaw is None else initial_yaw
    turning = jnp.where(skip, 0.0, turning)[:, None]
    headings, _ = finite_problems(headings[:, None], times, skip)
    position, _ = interpolate(times, headings, turning, None, yaw_ends(ends))
    return position, cost(make_problem(times, headings, turning, None, yaw_ends(ends)), yaw_ends(ends))[0]


_compiled = jax.jit(solve_batch, static_argnums=0)


def _shape(waypoints: Any, durations: Any) -> tuple[int, int]:
    """Segments and problems, from shapes that fit."""
    have, times = np.shape(waypoints), np.shape(durations)
    if len(have) != 3 or have[1] != 3 or have[0] < 2:
        raise InputError(
            f"minimum_snap_batch: waypoints have shape {have}, want (m+1, 3, b) with the batch last and m at least 1"
        )
    if times != (have[0] - 1, have[2]):
        raise InputError(f"minimum_snap_batch: durations have shape {times}, want {(have[0] - 1, have[2])}")
    return have[0] - 1, have[2]


def _ends_array(name: str, value: Any, shape: tuple[int, ...], rows: int, lanes: int) -> Any:
    """``value`` with all its rows and the batch as last axis; None stays None."""
    if value is None:
        return None
    xp = np if is_numpy(value) else jnp
    have = np.shape(value)
    if len(have) == len(shape):
        value, have = xp.asarray(value)[..., None], (*have, 1)
    if have[0] not in (rows, shape[0]) or have[1:-1] != shape[1:] or have[-1] not in (1, lanes):
        raise InputError(f"minimum_snap_batch: {name} has shape {np.shape(value)}, want {(rows, *shape[1:], lanes)}")
    missing = ((0, shape[0] - have[0]), *((0, 0) for _ in have[1:]))
    return xp.broadcast_to(xp.pad(xp.asarray(value), missing), (*shape, lanes))
