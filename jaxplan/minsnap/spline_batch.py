"""A batch of splines in the solver's own layout (batch axis last), from waypoints and durations to samples."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplan.arrays import AnyArray
from jaxplan.batching import batch_last
from jaxplan.minsnap import hermite
from jaxplan.minsnap.single import POSITION_ORDER, YAW_ORDER, interpolate
from jaxplan.numerics import wrap_angle
from jaxplan.records import record
from jaxplan.spline import FlatState, FlatStateBatch, PiecewisePolynomial

SLOWEST_HEADING = 0.2
"""Horizontal speed [m/s] below which a velocity has no heading to follow (arbitrary)."""


@record
class SplineBatch:
    """k splines of up to m segments; durations of 0 mark padding, whose position is the goal."""

    durations: Float[AnyArray, "m k"]
    """Seconds per segment; 0 marks padding."""
    position: Float[AnyArray, "m 10 3 k"]
    """Ascending coefficients in normalised time, metres."""
    yaw: Float[AnyArray, "m 6 1 k"]
    """Ascending coefficients in normalised time, radians (unwrapped)."""

    def spline(self, index: int) -> PiecewisePolynomial:
        """One of the splines on its own, in NumPy float64, without its padding (host)."""
        durations = np.asarray(self.durations)[:, index]
        real = durations > 0.0
        return PiecewisePolynomial(
            durations=durations[real],
            position=np.asarray(self.position)[real][..., index],
            yaw=np.asarray(self.yaw)[real][:, :, 0, index],
        )

    @batch_last
    def states(self, count: int) -> FlatStateBatch:
        """Flat states at ``count`` instants evenly spaced over each spline's own duration, ends included.

        Batch axes (count, k): shapes (5, 3, count, k) and (3, count, k).
        """
        ends = jnp.cumsum(self.durations, axis=0)
        times = jnp.linspace(0.0, 1.0, count, dtype=ends.dtype)[:, None] * jnp.sum(self.durations, axis=0)
        last = jnp.maximum(jnp.sum(self.durations > 0.0, axis=0) - 1, 0)
        segment = jnp.minimum(jnp.sum(times[:, None] >= ends, axis=1), last)
        duration = jnp.take_along_axis(self.durations, segment, axis=0)
        duration = jnp.where(duration > 0.0, duration, 1.0)
        begun = jnp.take_along_axis(ends - self.durations, segment, axis=0)
        s = jnp.clip((times - begun) / duration, 0.0, 1.0)
        position, yaw = self._coefficients(segment)
        rows = [_horner(position, s, duration, derivative) for derivative in range(5)]
        turns = [_horner(yaw, s, duration, derivative) for derivative in range(3)]
        return FlatStateBatch(derivatives=jnp.stack(rows), yaw=jnp.stack(turns))

    def _coefficients(self, segment: Int[Array, "p k"]) -> tuple[Float[Array, "10 3 p k"], Float[Array, "6 p k"]]:
        """Those of p segments of each spline: position and yaw are gathered together, which is faster."""
        segments, width, axes, lanes = self.position.shape
        flat = self.position.reshape(segments, width * axes, lanes)
        both = jnp.moveaxis(jnp.concatenate([flat, self.yaw[:, :, 0]], axis=1), 0, 1)
        found = jnp.take_along_axis(both, segment[None], axis=1)
        return found[: width * axes].reshape(width, axes, *segment.shape), found[width * axes :]

    @batch_last
    def derivatives(self, s: np.ndarray) -> Float[Array, "m s 5 3 k"]:
        """Position to snap at the normalised times ``s`` of every segment; derivatives are 0 on padding."""
        segments, width, axes, lanes = self.position.shape
        flat = self.position.reshape(segments, width, axes * lanes)
        rate = jnp.where(self.durations > 0.0, 1.0 / jnp.where(self.durations > 0.0, self.durations, 1.0), 0.0)
        values = []
        for derivative in range(5):
            table = jnp.asarray(hermite.derivative_table(POSITION_ORDER, s, derivative), flat.dtype)
            sampled = jnp.matmul(table, flat).reshape(segments, len(s), axes, lanes)
            values.append(sampled * (rate**derivative)[:, None, None])
        return jnp.stack(values, axis=2)

    @batch_last
    def yaw_derivatives(self, s: np.ndarray) -> Float[Array, "m s 3 k"]:
        """Yaw, yaw rate and yaw acceleration at the normalised times ``s`` of every segment."""
        rate = jnp.where(self.durations > 0.0, 1.0 / jnp.where(self.durations > 0.0, self.durations, 1.0), 0.0)
        values = []
        for derivative in range(3):
            table = jnp.asarray(hermite.derivative_table(YAW_ORDER, s, derivative), self.yaw.dtype)
            values.append(jnp.matmul(table, self.yaw[:, :, 0]) * (rate**derivative)[:, None])
        return jnp.stack(values, axis=2)


@batch_last
def fit(
    state: FlatState, waypoints: Float[Array, "knots 3 k"], durations: Float[Array, "m k"], max_yaw_rate: float
) -> SplineBatch:
    """Minimum-snap splines from one flat state through each lane's waypoints to rest at its goal.

    The first waypoint is the state's own position. Yaw follows the path's heading at the waypoints, held
    where the vehicle is slow, and turns by at most ``max_yaw_rate`` [rad/s] on average over a segment.
    """
    return fit_each(state.repeated(waypoints.shape[-1]), waypoints, durations, max_yaw_rate)


@batch_last
def fit_each(
    states: FlatStateBatch, waypoints: Float[Array, "knots 3 k"], durations: Float[Array, "m k"], max_yaw_rate: float
) -> SplineBatch:
    """``fit`` from a state of its own for every lane."""
    points = waypoints.at[0].set(states.pos)
    position, knots = interpolate(durations, points, states.derivatives[1:])
    headings = _headings(states.yaw[0], knots[:, 0, :2], durations, max_yaw_rate)
    yaw, _ = interpolate(durations, headings[:, None], states.yaw[1:, None])
    return SplineBatch(durations=durations, position=position, yaw=yaw)


def _horner(
    coefficients: Float[Array, "n *c p k"], s: Float[Array, "p k"], duration: Float[Array, "p k"], derivative: int
) -> Float[Array, "*c p k"]:
    """Value of the ``derivative``-th time derivative of ascending polynomials in normalised time."""
    value = jnp.zeros_like(coefficients[0])
    for power in range(coefficients.shape[0] - 1, derivative - 1, -1):
        value = value * s + math.perm(power, derivative) * coefficients[power]
    return value / duration**derivative


def _headings(
    start: Float[Array, "k"], velocity: Float[Array, "knots 2 k"], durations: Float[Array, "m k"], max_rate: float
) -> Float[Array, "knots k"]:
    """Unwrapped yaw [rad] at the knots: the direction of the horizontal velocity, rate-limited."""

    def turn(yaw: Float[Array, "k"], knot: tuple) -> tuple[Float[Array, "k"], Float[Array, "k"]]:
        velocity, duration = knot
        moving = velocity[0] ** 2 + velocity[1] ** 2 > SLOWEST_HEADING**2
        x, y = jnp.where(moving, velocity[0], 1.0), jnp.where(moving, velocity[1], 0.0)  # arctan2(0, 0) has no gradient
        wanted = wrap_angle(jnp.where(moving, jnp.arctan2(y, x) - yaw, 0.0))
        following = yaw + jnp.clip(wanted, -max_rate * duration, max_rate * duration)
        return following, following

    _, rest = jax.lax.scan(turn, start, (velocity[1:], durations))
    return jnp.concatenate([start[None], rest])
