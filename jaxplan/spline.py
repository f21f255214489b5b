"""Piecewise polynomials in time: position (degree 9 by default) and yaw (degree 5).

Each segment i is stored in its own normalised time s = (t - t_i) / T_i in [0, 1]; this keeps the
coefficients of the size of the positions, however long or short the segment.

A spline of NumPy arrays evaluates in NumPy: in float64, without compilation, whatever the process's JAX
flags. A spline of JAX arrays evaluates in JAX and may stand inside any transformation.
"""

import math
from types import ModuleType
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

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


def hover(pos: Float[np.ndarray, "3"], yaw: float = 0.0) -> FlatState:
    """The state of rest at ``pos`` [m, world] with heading ``yaw`` [rad], in NumPy float64."""
    derivatives = np.zeros((5, 3))
    derivatives[0] = pos
    return FlatState(derivatives=derivatives, yaw=np.array([yaw, 0.0, 0.0]))


@record
class PiecewisePolynomial:
    """A trajectory of m segments over [0, duration]; evaluation outside is clamped to its ends.

    Padding: segments of duration 0 behind the last real one are never evaluated.
    """

    durations: Float[Array, "m"]
    """Seconds per segment; 0 marks padding."""
    position: Float[Array, "m n 3"]
    """Ascending coefficients in normalised time, metres."""
    yaw: Float[Array, "m k"] | None = None
    """Ascending coefficients in normalised time, radians (unwrapped); None for a path without heading."""

    @property
    def duration(self) -> Float[Array, ""]:
        return self.durations.sum()

    def evaluate(self, t: Float[Array, "*t"], derivative: int = 0) -> Float[Array, "*t c"]:
        """Position and yaw, or their ``derivative``-th time derivative, at ``t`` [s] from the start.

        Shape (..., 4) with yaw last, or (..., 3) where the spline has no yaw: m and rad per s^derivative.
        """
        xp = _namespace(self.durations, t)
        segment, s = self._locate(xp.asarray(t, dtype=self.durations.dtype), xp)
        duration = self.durations[segment]
        position = _horner(self.position[segment], s, duration, derivative, xp)
        if self.yaw is None:
            return position
        yaw = _horner(self.yaw[segment][..., None], s, duration, derivative, xp)
        return xp.concatenate([position, yaw], axis=-1)

    def state(self, t: Float[Array, "*t"]) -> FlatState:
        """The flat state at ``t`` [s] from the start: position to snap, yaw to yaw acceleration (0 without yaw)."""
        xp = _namespace(self.durations, t)
        rows = [self.evaluate(t, derivative) for derivative in range(5)]
        return FlatState(
            derivatives=xp.stack([row[..., :3] for row in rows], axis=-2),
            yaw=xp.zeros_like(rows[0]) if self.yaw is None else xp.stack([row[..., 3] for row in rows[:3]], axis=-1),
        )

    def dilate(self, alpha: Float[Array, ""]) -> "PiecewisePolynomial":
        """The same path flown ``alpha`` times as slowly (derivative k shrinks by alpha^-k)."""
        return PiecewisePolynomial(durations=self.durations * alpha, position=self.position, yaw=self.yaw)

    def _locate(self, t: Float[Array, "*t"], xp: ModuleType) -> tuple[Int[Array, "*t"], Float[Array, "*t"]]:
        ends = xp.cumsum(self.durations)
        last = xp.maximum((self.durations > 0.0).sum() - 1, 0)
        segment = xp.clip((t[..., None] >= ends).sum(axis=-1), 0, last)
        duration = self.durations[segment]
        local = t - (ends[segment] - duration)
        return segment, xp.clip(local / xp.where(duration > 0.0, duration, 1.0), 0.0, 1.0)


def _namespace(*arrays: Any) -> ModuleType:
    """NumPy when every argument is NumPy or plain Python, else JAX."""
    return np if all(isinstance(a, np.ndarray | np.generic | float | int | list) for a in arrays) else jnp


def _horner(
    coefficients: Float[Array, "*t n d"],
    s: Float[Array, "*t"],
    duration: Float[Array, "*t"],
    derivative: int,
    xp: ModuleType,
) -> Float[Array, "*t d"]:
    """Value of the ``derivative``-th time derivative of ascending polynomials in normalised time."""
    value = xp.zeros(coefficients.shape[:-2] + coefficients.shape[-1:], coefficients.dtype)
    for power in range(coefficients.shape[-2] - 1, derivative - 1, -1):
        value = value * s[..., None] + math.perm(power, derivative) * coefficients[..., power, :]
    return value / xp.where(duration > 0.0, duration, 1.0)[..., None] ** derivative
