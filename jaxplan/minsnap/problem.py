"""Minimum-snap trajectories: position of degree 9 in C4, yaw of degree 5 in C2 (paper eq. 3 and 4)."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.errors import InputError
from jaxplan.minsnap.solve import knot_derivatives, segment_coefficients
from jaxplan.numerics import in_float64
from jaxplan.spline import PiecewisePolynomial

POSITION_ORDER = 4
YAW_ORDER = 2


def interpolate(
    durations: Float[Array, "m b"], points: Float[Array, "m+1 d b"], initial: Float[Array, "r d b"]
) -> tuple[Float[Array, "m n d b"], Float[Array, "m+1 r d b"]]:
    """The smoothest spline through ``points`` that starts with ``initial`` derivatives and ends at rest.

    The order r is that of ``initial``: 4 minimises snap, 2 acceleration. Durations of 0 mark padding.

    Returns:
        Ascending coefficients in normalised time (n = 2r+2), and the derivatives at every knot.
    """
    order = initial.shape[0]
    last = jnp.sum(durations > 0.0, axis=0)
    index = jnp.arange(points.shape[0])[:, None]
    known = jnp.broadcast_to(((index == 0) | (index >= last))[:, None], (points.shape[0], order, points.shape[-1]))
    values = jnp.zeros((points.shape[0], *initial.shape), durations.dtype).at[0].set(initial)
    steps = jnp.where((durations > 0.0)[:, None], jnp.diff(points, axis=0), 0.0)
    knots = knot_derivatives(durations, steps, known, values)
    return segment_coefficients(durations, points[:-1], steps, knots), knots


@in_float64
def minimum_snap(
    waypoints: Float[np.ndarray, "m+1 3"],
    durations: Float[np.ndarray, "m"],
    *,
    initial: Float[np.ndarray, "4 3"] | None = None,
    yaw: Float[np.ndarray, "m+1"] | None = None,
    initial_yaw: Float[np.ndarray, "2"] | None = None,
) -> PiecewisePolynomial:
    """The minimum-snap trajectory through ``waypoints`` [m] that spends ``durations`` [s] between them.

    Args:
        initial: velocity, acceleration, jerk and snap at the start; at rest when omitted. The end is at rest.
        yaw: heading at the waypoints [rad, unwrapped]; 0 when omitted.
        initial_yaw: yaw rate [rad/s] and acceleration at the start; 0 when omitted.

    Returns:
        A spline of NumPy float64 arrays, whatever the process's JAX flags.

    Raises:
        InputError: fewer than two waypoints, a wrong shape, a value that is not finite, a duration that is
            not positive, or waypoints that all coincide.
    """
    points, times = _checked(waypoints, durations)
    start = _array("initial", np.zeros((4, 3)) if initial is None else initial, (4, 3))
    headings = _array("yaw", np.zeros(len(points)) if yaw is None else yaw, (len(points),))
    turning = _array("initial_yaw", np.zeros(2) if initial_yaw is None else initial_yaw, (2,))
    position, _ = _interpolate(times[:, None], points[..., None], start[..., None])
    heading, _ = _interpolate(times[:, None], headings[:, None, None], turning[:, None, None])
    return PiecewisePolynomial(
        durations=times, position=np.asarray(position[..., 0]), yaw=np.asarray(heading[:, :, 0, 0])
    )


_interpolate = jax.jit(interpolate)


def _checked(waypoints: np.ndarray, durations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    points = np.asarray(waypoints, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2:
        raise InputError(f"minimum_snap: waypoints have shape {points.shape}, want (m+1, 3) with at least 2 rows")
    points = _array("waypoints", points, points.shape)
    times = _array("durations", durations, (len(points) - 1,))
    if not (times > 0.0).all():
        raise InputError(
            f"minimum_snap: duration {int(np.argmin(times))} is {times.min()} s, want all of them positive"
        )
    if not (np.ptp(points, axis=0) > 0.0).any():
        raise InputError("minimum_snap: all waypoints are the same point; hold the position instead of planning a path")
    return points, times


def _array(name: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != shape:
        raise InputError(f"minimum_snap: {name} has shape {array.shape}, want {shape}")
    if not np.isfinite(array).all():
        raise InputError(f"minimum_snap: {name} holds a value that is not finite")
    return array
