"""``minimum_snap``: one trajectory, position of degree 9 in C4, yaw of degree 5 in C2 (paper eq. 3 and 4)."""

import functools
from collections.abc import Callable
from typing import Annotated, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float
from numpy.typing import ArrayLike

from jaxplan.errors import InputError
from jaxplan.kept import kept
from jaxplan.minsnap.quadratic_program import (
    Ends,
    Passage,
    gradient,
    knot_derivatives,
    make_problem,
    segment_coefficients,
)
from jaxplan.minsnap.status import RESIDUAL_LIMIT
from jaxplan.precision import float64_island, in_float64
from jaxplan.spline import PiecewisePolynomial
from jaxplan.validation import as_numbers

POSITION_ORDER = 4
"""The derivative of position whose square is minimised: snap."""
YAW_ORDER = 2
"""Likewise of yaw: its acceleration."""

Terminal = Literal["rest", "free"]


def interpolate(
    durations: Float[Array, "m b"],
    points: Float[Array, "n d b"],
    initial: Float[Array, "r d b"],
    terminal: Float[Array, "r d b"] | None = None,
    ends: Ends | None = None,
    passage: Passage | None = None,
) -> tuple[Float[Array, "m 2*r+2 d b"], Float[Array, "n r d b"]]:
    """The smoothest spline through n = m + 1 points that starts with ``initial`` derivatives and ends as ``ends`` says.

    The order r is that of ``initial``: 4 minimises snap, 2 acceleration. At rest at the goal when ``ends`` is
    omitted, and with a prescribed velocity at one more waypoint where there is a ``passage``. Durations of 0 mark
    padding.

    Returns:
        Ascending coefficients in normalised time, and the derivatives at every knot.
    """
    ends = ends or Ends(initial.shape[0])
    problem = make_problem(durations, points, initial, terminal, ends)
    knots = knot_derivatives(problem, ends, passage)
    return segment_coefficients(problem, points[:-1], knots), knots


def minimum_snap(
    waypoints: Annotated[ArrayLike, "n 3"],
    durations: Annotated[ArrayLike, "m"],
    *,
    initial: Annotated[ArrayLike, "fixed_order 3"] | None = None,
    terminal: Terminal | Annotated[ArrayLike, "fixed_order 3"] = "rest",
    fixed_order: int = 4,
    yaw: Annotated[ArrayLike, "n"] | None = None,
    initial_yaw: Annotated[ArrayLike, "2"] | None = None,
) -> PiecewisePolynomial:
    """The minimum-snap trajectory through n waypoints [m] that spends m = n - 1 ``durations`` [s] between them.

    Args:
        initial: velocity, acceleration, jerk and snap at the start; at rest when omitted.
        terminal: "rest" (all derivatives 0 at the goal), "free" (none prescribed), or derivatives like ``initial``.
        fixed_order: how many derivatives are prescribed at the ends. 4 fixes velocity to snap; 3 fixes velocity
            to jerk and leaves snap free, which gives the natural optimum of degree 7. Rows beyond are ignored.
        yaw: heading at the waypoints [rad, unwrapped]; the spline has no yaw when omitted.
        initial_yaw: yaw rate [rad/s] and acceleration at the start; 0 when omitted. The end is at rest, or free
            with ``terminal="free"``.

    Returns:
        A spline of NumPy float64 arrays, whatever the process's JAX flags. Inside ``jit``, ``vmap`` and ``grad`` a
        traced one in the precision of the arguments, solved in float64; there a problem whose values cannot be solved
        has NaN coefficients instead of an error. ``minimum_snap_batch`` is faster than ``vmap`` and says what is wrong.

    Raises:
        InputError: fewer than two waypoints, a wrong shape, a value that is not finite, a duration that is
            not positive, waypoints that all coincide, or a problem that double precision cannot solve.
    """
    given = (waypoints, durations, initial, terminal, yaw, initial_yaw)
    if any(isinstance(value, jax.core.Tracer) for value in given):
        return _traced(waypoints, durations, initial, terminal, fixed_order, yaw, initial_yaw)
    return _on_host(waypoints, durations, initial, terminal, fixed_order, yaw, initial_yaw)


@in_float64
def _on_host(
    waypoints: ArrayLike,
    durations: ArrayLike,
    initial: ArrayLike | None,
    terminal: Terminal | ArrayLike,
    fixed_order: int,
    yaw: ArrayLike | None,
    initial_yaw: ArrayLike | None,
) -> PiecewisePolynomial:
    """``minimum_snap`` of what is known, checked."""
    points, times = _checked(waypoints, durations)
    start, goal, ends = checked_ends("minimum_snap", initial, terminal, fixed_order)
    solve = _kept_solve()
    position, residual = solve(ends, times[:, None], points[..., None], start[..., None], goal[..., None])
    if not (np.isfinite(position).all() and float(residual[0]) <= RESIDUAL_LIMIT):
        raise InputError(
            f"minimum_snap: the problem is beyond double precision (residual {float(residual[0]):.1e}); durations are "
            f"{times.min():.3g} to {times.max():.3g} s, the largest coordinate {np.abs(points).max():.3g} m"
        )
    heading = None
    if yaw is not None or initial_yaw is not None:
        angles = _array("yaw", np.zeros(len(points)) if yaw is None else yaw, (len(points),))
        rates = _array("initial_yaw", np.zeros(YAW_ORDER) if initial_yaw is None else initial_yaw, (YAW_ORDER,))
        turning = solve(yaw_ends(ends), times[:, None], angles[:, None, None], rates[:, None, None], None)
        heading = np.asarray(turning[0][:, :, 0, 0])
    return PiecewisePolynomial(durations=times, position=np.asarray(position[..., 0]), yaw=heading)


def _traced(
    waypoints: ArrayLike,
    durations: ArrayLike,
    initial: ArrayLike | None,
    terminal: Terminal | ArrayLike,
    fixed_order: int,
    yaw: ArrayLike | None,
    initial_yaw: ArrayLike | None,
) -> PiecewisePolynomial:
    """``minimum_snap`` of what is not known before the program runs: shapes are checked, values become NaN."""
    ends, points = ends_of("minimum_snap", terminal, fixed_order), _floats(waypoints)
    _require_points(points.shape)
    times = _of_shape("durations", _floats(durations), (len(points) - 1,))
    start, goal = (
        _traced_end(what, None if isinstance(value, str) else value, fixed_order, points.dtype)
        for what, value in (("initial", initial), ("terminal", terminal))
    )
    solved = _island(ends)(times[:, None], points[..., None], start[..., None], goal[..., None])
    good = jnp.all(times > 0.0) & (solved[1][0] <= RESIDUAL_LIMIT) & jnp.all(jnp.isfinite(solved[0]))
    heading = None
    if yaw is not None or initial_yaw is not None:
        angles = jnp.zeros_like(points[:, 0]) if yaw is None else _of_shape("yaw", _floats(yaw), points.shape[:1])
        rates = jnp.zeros(YAW_ORDER, points.dtype) if initial_yaw is None else _floats(initial_yaw)
        rates = _of_shape("initial_yaw", rates, (YAW_ORDER,))
        turning, _ = _island(yaw_ends(ends))(times[:, None], angles[:, None, None], rates[:, None, None], None)
        heading = jnp.where(good, turning[:, :, 0, 0], jnp.nan)
    return PiecewisePolynomial(durations=times, position=jnp.where(good, solved[0][..., 0], jnp.nan), yaw=heading)


@functools.cache
def _island(ends: Ends) -> Callable[[Array, Array, Array, Array | None], tuple[Array, Array]]:
    """``_solve`` for the ends inside another program, in float64; the residual has no gradient."""

    def solve(durations: Array, points: Array, initial: Array, terminal: Array | None) -> tuple[Array, Array]:
        coefficients, residual = _solve(ends, durations, points, initial, terminal)
        return coefficients, jax.lax.stop_gradient(residual)

    return float64_island(solve)


def _floats(value: ArrayLike) -> Array:
    array = jnp.asarray(value)
    return array if jnp.issubdtype(array.dtype, jnp.floating) else array.astype(jnp.result_type(float))


def _of_shape(name: str, array: Array, shape: tuple[int, ...]) -> Array:
    if array.shape != shape:
        raise InputError(f"minimum_snap: {name} has shape {array.shape}, want {shape}")
    return array


def _traced_end(what: str, given: ArrayLike | None, fixed_order: int, dtype: DTypeLike) -> Float[Array, "4 3"]:
    """``_end_values`` of what is not known."""
    values = jnp.zeros((POSITION_ORDER, 3), dtype)
    if given is None:
        return values
    array = _floats(given)
    _require_rows("minimum_snap", what, array.shape, fixed_order)
    return values.at[:fixed_order].set(array[:fixed_order].astype(dtype))


@functools.cache
def _kept_solve() -> Callable[..., tuple[Array, Array]]:
    """``_solve`` on the host, compiled."""
    return kept(_solve, static=1)


def _solve(
    ends: Ends,
    durations: Float[Array, "m b"],
    points: Float[Array, "n d b"],
    initial: Float[Array, "r d b"],
    terminal: Float[Array, "r d b"] | None,
) -> tuple[Float[Array, "m 2*r+2 d b"], Float[Array, "b"]]:
    """The coefficients of ``interpolate``, and how far they are from being optimal (``quadratic_program.gradient``)."""
    coefficients, knots = interpolate(durations, points, initial, terminal, ends)
    _, _, residual = gradient(make_problem(durations, points, initial, terminal, ends), knots, ends)
    return coefficients, residual


def checked_ends(
    name: str,
    initial: Annotated[ArrayLike, "fixed_order 3"] | None,
    terminal: Terminal | Annotated[ArrayLike, "fixed_order 3"],
    fixed_order: int,
) -> tuple[Float[np.ndarray, "4 3"], Float[np.ndarray, "4 3"], Ends]:
    """The prescribed derivatives at the start and at the goal, and which of them count (host).

    ``name`` is that of the entry point, for its messages.
    """
    ends = ends_of(name, terminal, fixed_order)
    start = _end_values(name, "initial", initial, fixed_order)
    goal = _end_values(name, "terminal", None if isinstance(terminal, str) else terminal, fixed_order)
    return start, goal, ends


def ends_of(name: str, terminal: object, fixed_order: int) -> Ends:
    """Which derivatives are prescribed at the ends; ``name`` is that of the entry point, for its messages."""
    if fixed_order not in (3, POSITION_ORDER):
        raise InputError(f"{name}: fixed_order is {fixed_order}, want 4 (snap prescribed at the ends) or 3 (snap free)")
    if isinstance(terminal, str) and terminal not in ("rest", "free"):
        raise InputError(f"{name}: terminal is {terminal!r}, want 'rest', 'free' or derivatives at the goal")
    moves = not isinstance(terminal, str)
    return Ends(int(fixed_order), goal_free=not moves and terminal == "free", goal_moves=moves)


def yaw_ends(ends: Ends) -> Ends:
    """The same for yaw, which always ends at rest or free."""
    return Ends(YAW_ORDER, goal_free=ends.goal_free)


def _end_values(name: str, what: str, given: ArrayLike | None, fixed_order: int) -> Float[np.ndarray, "4 3"]:
    """Velocity to snap at one end, with the rows that are not prescribed 0."""
    values = np.zeros((POSITION_ORDER, 3))
    if given is None:
        return values
    array = as_numbers(f"{name}: {what}", given)
    _require_rows(name, what, array.shape, fixed_order)
    if not np.isfinite(array[:fixed_order]).all():
        raise InputError(f"{name}: {what} holds a value that is not finite")
    values[:fixed_order] = array[:fixed_order]
    return values


def _require_rows(name: str, what: str, shape: tuple[int, ...], fixed_order: int) -> None:
    if shape not in ((fixed_order, 3), (POSITION_ORDER, 3)):
        raise InputError(f"{name}: {what} has shape {shape}, want ({fixed_order}, 3), one row per derivative")


def _require_points(shape: tuple[int, ...]) -> None:
    if len(shape) != 2 or shape[1] != 3 or shape[0] < 2:
        raise InputError(f"minimum_snap: waypoints have shape {shape}, want (m+1, 3) with at least 2 rows")


def _checked(waypoints: ArrayLike, durations: ArrayLike) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "m"]]:
    """Waypoints [m] and durations [s] that make a problem."""
    points = as_numbers("minimum_snap: waypoints", waypoints)
    _require_points(points.shape)
    points = _array("waypoints", points, points.shape)
    times = _array("durations", durations, (len(points) - 1,))
    if not (times > 0.0).all():
        raise InputError(
            f"minimum_snap: duration {int(np.argmin(times))} is {times.min()} s, want all of them positive"
        )
    if not (points != points[0]).any():
        raise InputError("minimum_snap: all waypoints are the same point; hold the position instead of planning a path")
    return points, times


def _array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    array = as_numbers(f"minimum_snap: {name}", value)
    if array.shape != shape:
        raise InputError(f"minimum_snap: {name} has shape {array.shape}, want {shape}")
    if not np.isfinite(array).all():
        raise InputError(f"minimum_snap: {name} holds a value that is not finite")
    return array
