"""Piecewise polynomials in time: position (degree 9 by default) and yaw (degree 5).

Each segment i is stored in its own normalised time s = (t - t_i) / T_i in [0, 1]; this keeps the
coefficients of the size of the positions, however long or short the segment.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxplan.numerics import safe_divide
from jaxplan.records import record


@record
class FlatState:
    """A differentially flat state: what a spline gives at one instant and what a plan starts from.

    World frame (z up), SI units. Leading axes are batch axes.
    """

    derivatives: Float[Array, "*batch 5 3"]
    """Position [m] and its first four derivatives: velocity, acceleration, jerk, snap."""
    yaw: Float[Array, "*batch 3"]
    """Yaw [rad, unwrapped], yaw rate [rad/s] and yaw acceleration [rad/s^2]."""

    @property
    def pos(self) -> Float[Array, "*batch 3"]:
        return self.derivatives[..., 0, :]

    @property
    def vel(self) -> Float[Array, "*batch 3"]:
        return self.derivatives[..., 1, :]

    @property
    def acc(self) -> Float[Array, "*batch 3"]:
        return self.derivatives[..., 2, :]

    @property
    def jerk(self) -> Float[Array, "*batch 3"]:
        return self.derivatives[..., 3, :]

    @property
    def snap(self) -> Float[Array, "*batch 3"]:
        return self.derivatives[..., 4, :]


def hover(pos: Float[Array, "3"], yaw: float = 0.0) -> FlatState:
    """The state of rest at ``pos`` [m, world] with heading ``yaw`` [rad]."""
    derivatives = jnp.zeros((5, 3), dtype=float).at[0].set(jnp.asarray(pos, dtype=float))
    return FlatState(derivatives=derivatives, yaw=jnp.array([yaw, 0.0, 0.0], dtype=float))


@record
class PiecewisePolynomial:
    """A trajectory of m segments over [0, duration]; evaluation outside is clamped to its ends.

    Padding: segments of duration 0 behind the last real one are never evaluated.
    """

    durations: Float[Array, "m"]
    """Seconds per segment; 0 marks padding."""
    position: Float[Array, "m n 3"]
    """Ascending coefficients in normalised time, metres."""
    yaw: Float[Array, "m k"]
    """Ascending coefficients in normalised time, radians (unwrapped)."""

    @property
    def duration(self) -> Float[Array, ""]:
        return jnp.sum(self.durations)

    @property
    def knots(self) -> Float[Array, "m+1"]:
        """Times of the knots [s] from the spline's start."""
        return jnp.concatenate([jnp.zeros_like(self.durations[:1]), jnp.cumsum(self.durations)])

    def evaluate(self, t: Float[Array, "*t"], derivative: int = 0) -> Float[Array, "*t 4"]:
        """Position and yaw, or their ``derivative``-th time derivative, at ``t`` [s] from the start.

        Shape (..., 4), yaw last: m and rad per s^derivative.
        """
        segment, s = self._locate(jnp.asarray(t, dtype=self.durations.dtype))
        position = _horner(self.position[segment], s, self.durations[segment], derivative)
        yaw = _horner(self.yaw[segment][..., None], s, self.durations[segment], derivative)
        return jnp.concatenate([position, yaw], axis=-1)

    def state(self, t: Float[Array, "*t"]) -> FlatState:
        """The flat state at ``t`` [s] from the start: position to snap, yaw to yaw acceleration."""
        rows = [self.evaluate(t, derivative) for derivative in range(5)]
        derivatives = jnp.stack([row[..., :3] for row in rows], axis=-2)
        return FlatState(derivatives=derivatives, yaw=jnp.stack([row[..., 3] for row in rows[:3]], axis=-1))

    def dilate(self, alpha: Float[Array, ""]) -> "PiecewisePolynomial":
        """The same path flown ``alpha`` times as slowly (derivative k shrinks by alpha^-k)."""
        return PiecewisePolynomial(durations=self.durations * alpha, position=self.position, yaw=self.yaw)

    def _locate(self, t: Float[Array, "*t"]) -> tuple[Int[Array, "*t"], Float[Array, "*t"]]:
        ends = jnp.cumsum(self.durations)
        last = jnp.maximum(jnp.sum(self.durations > 0.0) - 1, 0)
        segment = jnp.clip(jnp.sum(t[..., None] >= ends, axis=-1), 0, last)
        local = t - jnp.where(segment > 0, ends[segment - 1], 0.0)
        return segment, jnp.clip(safe_divide(local, self.durations[segment]), 0.0, 1.0)


def _horner(
    coefficients: Float[Array, "*t n d"], s: Float[Array, "*t"], duration: Float[Array, "*t"], derivative: int
) -> Float[Array, "*t d"]:
    """Value of the ``derivative``-th time derivative of ascending polynomials in normalised time."""
    n = coefficients.shape[-2]
    if derivative >= n:
        return jnp.zeros(coefficients.shape[:-2] + coefficients.shape[-1:], coefficients.dtype)
    value = jnp.zeros(coefficients.shape[:-2] + coefficients.shape[-1:], coefficients.dtype)
    for power in range(n - 1, derivative - 1, -1):
        factor = float(_falling_factorial(power, derivative))
        value = value * s[..., None] + factor * coefficients[..., power, :]
    return value * safe_divide(jnp.ones_like(duration), duration**derivative)[..., None]


def _falling_factorial(power: int, count: int) -> int:
    product = 1
    for i in range(count):
        product *= power - i
    return product


evaluate_state = jax.jit(PiecewisePolynomial.state)
"""``spline.state(t)`` compiled; a new shape of ``t`` or spline compiles anew."""
