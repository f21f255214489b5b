"""A batch of splines in the solver's own layout (batch axis last), from waypoints and durations to samples."""

from typing import SupportsIndex

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplan.arrays import AnyArray, namespace
from jaxplan.minsnap.quadratic_program import Passage
from jaxplan.minsnap.single import interpolate
from jaxplan.numerics import wrap_angle
from jaxplan.polynomials import derivative_table, horner
from jaxplan.records import record
from jaxplan.spline import FlatState, FlatStateBatch, PiecewisePolynomial

SLOWEST_HEADING = 0.2
"""Horizontal speed [m/s] below which a velocity has no heading to follow, distance [m] below which a point has none
(arbitrary)."""


@record
class SplineBatch:
    """k splines of up to m segments; durations of 0 mark padding, whose position is the goal."""

    durations: Float[AnyArray, "m k"]
    """Seconds per segment."""
    position: Float[AnyArray, "m 10 3 k"]
    """Ascending coefficients in normalised time [m, world]."""
    yaw: Float[AnyArray, "m 6 1 k"]
    """Ascending coefficients in normalised time [rad, unwrapped]."""

    def spline(self, index: SupportsIndex) -> PiecewisePolynomial:
        """One of the splines on its own, in NumPy float64, without its padding (host)."""
        durations = np.asarray(self.durations)[:, index]
        real = durations > 0.0
        return PiecewisePolynomial(
            durations=durations[real],
            position=np.asarray(self.position)[..., index][real],
            yaw=np.asarray(self.yaw)[:, :, 0, index][real],
        )

    def states(self, count: int) -> FlatStateBatch:
        """Flat states at ``count`` instants evenly spaced over each spline's own duration, ends included.

        Batch axes (count, k): shapes (5, 3, count, k) and (3, count, k).
        """
        whole = jnp.sum(self.durations, axis=0)
        segment, s, duration = self._located(jnp.linspace(0.0, 1.0, count, dtype=whole.dtype)[:, None] * whole[None])
        position, yaw = self._coefficients(segment)
        rows = [horner(position, s[None], duration[None], derivative) for derivative in range(5)]
        turns = [horner(yaw, s, duration, derivative) for derivative in range(3)]
        return FlatStateBatch(derivatives=jnp.stack(rows), yaw=jnp.stack(turns))

    def positions(self, times: Float[AnyArray, "u k"], derivative: int = 0) -> Float[AnyArray, "u 3 k"]:
        """Where each spline is [m, world] at its ``times`` [s from the start], at rest where it ends; or a derivative.

        Derivatives where it ends are those that it has there. NumPy gives NumPy.
        """
        segment, s, duration = self._located(times)
        position, _ = self._coefficients(segment)
        return namespace(s).moveaxis(horner(position, s[None], duration[None], derivative), 0, 1)

    def _located(
        self, times: Float[AnyArray, "p k"]
    ) -> tuple[Int[AnyArray, "p k"], Float[AnyArray, "p k"], Float[AnyArray, "p k"]]:
        """In which segment each time [s] falls, the normalised time there, and how long that segment is [s]."""
        xp = namespace(self.durations, times)
        ends = xp.cumsum(self.durations, axis=0)
        last = xp.maximum(xp.sum(self.durations > 0.0, axis=0) - 1, 0)
        segment = xp.minimum(xp.sum(times[:, None] >= ends[None], axis=1), last[None])
        duration = xp.take_along_axis(self.durations, segment, axis=0)
        duration = xp.where(duration > 0.0, duration, 1.0)
        begun = xp.take_along_axis(ends - self.durations, segment, axis=0)
        return segment, xp.clip((times - begun) / duration, 0.0, 1.0), duration

    def _coefficients(
        self, segment: Int[AnyArray, "p k"]
    ) -> tuple[list[Float[AnyArray, "3 p k"]], list[Float[AnyArray, "p k"]]]:
        """Those of p segments of each spline, by power: position and yaw are gathered together, which is faster."""
        xp = namespace(self.position, segment)
        segments, count, axes, width = self.position.shape
        flat = self.position.reshape(segments, count * axes, width)
        both = xp.moveaxis(xp.concatenate([flat, self.yaw[:, :, 0]], axis=1), 0, 1)
        found = xp.take_along_axis(both, segment[None], axis=1)
        position = found[: count * axes].reshape(count, axes, *segment.shape)
        turns = found[count * axes :]
        return [position[power] for power in range(count)], [turns[power] for power in range(len(turns))]

    def derivatives(self, s: Float[np.ndarray, "s"]) -> Float[Array, "m s 5 3 k"]:
        """Position to snap at the normalised times ``s`` of every segment; derivatives are 0 on padding."""
        segments, count, axes, width = self.position.shape
        flat, rate = self.position.reshape(segments, count, axes * width), self.rate()
        values = []
        for derivative in range(5):
            table = jnp.asarray(derivative_table(count, s, derivative), flat.dtype)
            sampled = jnp.matmul(table, flat).reshape(segments, len(s), axes, width)
            values.append(sampled * (rate**derivative)[:, None, None])
        return jnp.stack(values, axis=2)

    def yaw_derivatives(self, s: Float[np.ndarray, "s"]) -> Float[Array, "m s 3 k"]:
        """Yaw, yaw rate and yaw acceleration at the normalised times ``s`` of every segment."""
        yaw, rate = self.yaw[:, :, 0], self.rate()
        values = []
        for derivative in range(3):
            table = jnp.asarray(derivative_table(yaw.shape[1], s, derivative), yaw.dtype)
            values.append(jnp.matmul(table, yaw) * (rate**derivative)[:, None])
        return jnp.stack(values, axis=2)

    def rate(self) -> Float[Array, "m k"]:
        """Growth of the normalised time [1/s] on every segment; 0 on padding."""
        real = self.durations > 0.0
        return jnp.where(real, 1.0 / jnp.where(real, self.durations, 1.0), 0.0)


def fit(
    state: FlatState,
    waypoints: Float[Array, "n 3 k"],
    durations: Float[Array, "m k"],
    max_yaw_rate: float,
    looking: Float[Array, "n 2 k"] | None = None,
    passage: Passage | None = None,
) -> SplineBatch:
    """Minimum-snap splines from one flat state through each lane's n = m + 1 waypoints to rest at its goal.

    The first waypoint is the state's own position. Yaw follows the path's heading at the waypoints, or the horizontal
    directions ``looking`` there, held where those are shorter than ``SLOWEST_HEADING`` (the vehicle is slow, or the
    point that it looks at near), and turns by at most ``max_yaw_rate`` [rad/s] on average over a segment. Where there
    is a ``passage`` a waypoint is passed at its velocity.
    """
    return fit_each(state.repeated(waypoints.shape[-1]), waypoints, durations, max_yaw_rate, looking, passage)


def fit_each(
    states: FlatStateBatch,
    waypoints: Float[Array, "n 3 k"],
    durations: Float[Array, "m k"],
    max_yaw_rate: float,
    looking: Float[Array, "n 2 k"] | None = None,
    passage: Passage | None = None,
) -> SplineBatch:
    """``fit`` from a state of its own for every lane."""
    derivatives, turning = jnp.asarray(states.derivatives), jnp.asarray(states.yaw)
    points = waypoints.at[0].set(derivatives[0])
    position, knots = interpolate(durations, points, derivatives[1:], passage=passage)
    directions = knots[:, 0, :2] if looking is None else looking
    headings = _headings(turning[0], directions, durations, max_yaw_rate)
    yaw, _ = interpolate(durations, headings[:, None], turning[1:, None])
    return SplineBatch(durations=durations, position=position, yaw=yaw)


def _headings(
    start: Float[Array, "k"], directions: Float[Array, "n 2 k"], durations: Float[Array, "m k"], max_rate: float
) -> Float[Array, "n k"]:
    """Unwrapped yaw [rad] at the knots: these horizontal directions where they are not too short, rate-limited."""

    def turn(yaw: Float[Array, "k"], knot: tuple) -> tuple[Float[Array, "k"], Float[Array, "k"]]:
        direction, duration = knot
        clear = direction[0] ** 2 + direction[1] ** 2 > SLOWEST_HEADING**2
        x, y = jnp.where(clear, direction[0], 1.0), jnp.where(clear, direction[1], 0.0)  # arctan2(0, 0): no gradient
        wanted = wrap_angle(jnp.where(clear, jnp.arctan2(y, x) - yaw, 0.0))
        following = yaw + jnp.clip(wanted, -max_rate * duration, max_rate * duration)
        return following, following

    _, rest = jax.lax.scan(turn, start, (directions[1:], durations))
    return jnp.concatenate([start[None], rest])
