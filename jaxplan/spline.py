"""Piecewise polynomials in time: position (degree 9 by default) and yaw (degree 5).

Each segment i is stored in its own normalised time s = (t - t_i) / T_i in [0, 1]; this keeps the
coefficients of the size of the positions, however long or short the segment.

A spline of NumPy arrays evaluates in NumPy: in float64, without compilation, whatever the process's JAX
flags. A spline of JAX arrays evaluates in JAX and may stand inside any transformation.
"""

from collections.abc import Sequence
from types import ModuleType
from typing import Annotated, Any, SupportsIndex, no_type_check

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from jaxplan.arrays import AnyArray, Scalar, namespace
from jaxplan.errors import InputError
from jaxplan.polynomials import control_point_table, horner, part_table
from jaxplan.records import record
from jaxplan.validation import as_finite, as_order

Times = float | ArrayLike
"""Instants [s], one or an array of any shape."""


@record
class FlatState:
    """A differentially flat state: what a spline gives at one instant and what a plan starts from.

    World frame (z up), SI units. Leading axes are batch axes; ``FlatStateBatch`` has them last.
    """

    derivatives: Float[AnyArray, "*batch 5 3"]
    """Position [m] and its first four derivatives: velocity, acceleration, jerk, snap."""
    yaw: Float[AnyArray, "*batch 3"]
    """Yaw [rad, unwrapped], yaw rate [rad/s] and yaw acceleration [rad/s^2]."""

    @property
    def pos(self) -> Float[AnyArray, "*batch 3"]:
        """Position [m]."""
        return self.derivatives[..., 0, :]

    @property
    def vel(self) -> Float[AnyArray, "*batch 3"]:
        """Velocity [m/s]."""
        return self.derivatives[..., 1, :]

    @property
    def acc(self) -> Float[AnyArray, "*batch 3"]:
        """Acceleration [m/s^2]."""
        return self.derivatives[..., 2, :]

    @property
    def jerk(self) -> Float[AnyArray, "*batch 3"]:
        """Jerk [m/s^3]."""
        return self.derivatives[..., 3, :]

    @property
    def snap(self) -> Float[AnyArray, "*batch 3"]:
        """Snap [m/s^4]."""
        return self.derivatives[..., 4, :]

    def repeated(self, width: int) -> "FlatStateBatch":
        """This state, one without batch axes, for each of ``width`` candidates."""
        derivatives, yaw = (
            jnp.broadcast_to(leaf[..., None], (*leaf.shape, width)) for leaf in (self.derivatives, self.yaw)
        )
        return FlatStateBatch(derivatives=derivatives, yaw=yaw)


@record
class FlatStateBatch:
    """Flat states whose batch axes are *last*, as ``SplineBatch`` and the kernels over many candidates have them.

    World frame (z up), SI units. One state without batch axes has the same arrays as a ``FlatState``.
    """

    derivatives: Float[AnyArray, "5 3 *batch"]
    """Position [m] and its first four derivatives: velocity, acceleration, jerk, snap."""
    yaw: Float[AnyArray, "3 *batch"]
    """Yaw [rad, unwrapped], yaw rate [rad/s] and yaw acceleration [rad/s^2]."""

    @property
    def pos(self) -> Float[AnyArray, "3 *batch"]:
        """Position [m]."""
        return self.derivatives[0]

    @property
    def vel(self) -> Float[AnyArray, "3 *batch"]:
        """Velocity [m/s]."""
        return self.derivatives[1]

    @property
    def acc(self) -> Float[AnyArray, "3 *batch"]:
        """Acceleration [m/s^2]."""
        return self.derivatives[2]

    @property
    def jerk(self) -> Float[AnyArray, "3 *batch"]:
        """Jerk [m/s^3]."""
        return self.derivatives[3]

    @property
    def snap(self) -> Float[AnyArray, "3 *batch"]:
        """Snap [m/s^4]."""
        return self.derivatives[4]

    def at(self, *index: SupportsIndex) -> FlatState:
        """One of the states, by its index along each batch axis."""
        place: tuple[Any, ...] = (..., *index)
        return FlatState(derivatives=self.derivatives[place], yaw=self.yaw[place])


@no_type_check
def hover(pos: Annotated[ArrayLike, "3"], yaw: float = 0.0) -> FlatState:
    """The state of rest at ``pos`` [m, world] with heading ``yaw`` [rad], in NumPy float64.

    Raises InputError for what is not finite numbers.
    """
    derivatives = np.zeros((5, 3))
    derivatives[0] = as_finite("hover: position", pos, (3,))
    return FlatState(derivatives=derivatives, yaw=np.array([as_finite("hover: yaw", yaw, ()), 0.0, 0.0]))


@record
class PiecewisePolynomial:
    """A trajectory of m segments over [0, duration]; evaluation outside is clamped to its ends.

    Padding: segments of duration 0 behind the last real one are never evaluated.
    """

    durations: Float[AnyArray, "m"]
    """Seconds per segment; 0 marks padding."""
    position: Float[AnyArray, "m n 3"]
    """Ascending coefficients in normalised time, metres."""
    yaw: Float[AnyArray, "m k"] | None = None
    """Ascending coefficients in normalised time, radians (unwrapped); None for a path without heading."""

    @property
    def duration(self) -> Scalar:
        """Seconds from start to end."""
        return self.durations.sum()

    def evaluate(self, t: Times, derivative: int = 0) -> Float[AnyArray, "*t c"]:
        """Position and yaw, or their ``derivative``-th time derivative, at ``t`` [s] from the start.

        Shape (..., 4) with yaw last, or (..., 3) where the spline has no yaw: m and rad per s^derivative. Raises
        ``InputError`` where ``derivative`` is not a whole number from 0 on.
        """
        xp, derivative = namespace(self.durations, t), as_order("spline: derivative", derivative)
        segment, s, duration = self._locate(xp.asarray(t, dtype=self.durations.dtype), xp)
        s, duration = s[..., None], duration[..., None]
        position = horner(_powers(self.position[segment]), s, duration, derivative)
        if self.yaw is None:
            return position
        yaw = horner(_powers(self.yaw[segment][..., None]), s, duration, derivative)
        return xp.concatenate([position, yaw], axis=-1)

    def state(self, t: Times) -> FlatState:
        """The flat state at ``t`` [s] from the start: position to snap, yaw to yaw acceleration (0 without yaw)."""
        xp = namespace(self.durations, t)
        rows = [self.evaluate(t, derivative) for derivative in range(5)]
        return FlatState(
            derivatives=xp.stack([row[..., :3] for row in rows], axis=-2),
            yaw=xp.zeros_like(rows[0]) if self.yaw is None else xp.stack([row[..., 3] for row in rows[:3]], axis=-1),
        )

    def dilate(self, alpha: Scalar) -> "PiecewisePolynomial":
        """The same path flown ``alpha`` times as slowly (derivative k shrinks by alpha^-k)."""
        return PiecewisePolynomial(durations=self.durations * alpha, position=self.position, yaw=self.yaw)

    def sample(self, count: int) -> tuple[Float[AnyArray, "{count}"], Float[AnyArray, "{count} c"]]:
        """``count`` evenly spaced times [s] from start to end, and position (and yaw) there."""
        xp = namespace(self.durations)
        times = xp.linspace(0.0, 1.0, count) * self.duration
        return times, self.evaluate(times)

    def monomials(self) -> Float[AnyArray, "m n 3"]:
        """Ascending position coefficients in the time since each segment's start [m/s^k]; 0 on padding."""
        xp = namespace(self.durations)
        real = (self.durations > 0.0)[:, None]
        safe = xp.where(real, self.durations[:, None], 1.0)
        exponents = np.arange(self.position.shape[1], dtype=self.durations.dtype)[None]
        powers = xp.where(real, 1.0 / safe**exponents, 0.0)
        return self.position * powers[..., None]

    def bound(self, derivative: int, pieces: int = 8) -> Float[AnyArray, "m"]:
        """An upper bound of the norm of the ``derivative``-th derivative of position on each segment [m/s^k].

        Rigorous between samples: on each of ``pieces`` parts the polynomial lies in the hull of its control points
        (``polynomials.control_point_table``). The excess shrinks with pieces^-2. 1 gives speed, 2 acceleration.
        """
        return self.bounds(derivative, pieces).max(axis=1)

    def bounds(self, derivative: int, pieces: int) -> Float[AnyArray, "m {pieces}"]:
        """``bound`` on each of the ``pieces`` parts of each segment."""
        points = _control_points(self.position, self.durations, derivative, pieces)
        return namespace(self.durations).sqrt((points * points).sum(axis=-1).max(axis=-1))

    def yaw_bounds(self, derivative: int, pieces: int) -> Float[AnyArray, "m {pieces}"]:
        """The same for the size of a derivative of yaw [rad/s^k]; 0 without yaw."""
        xp = namespace(self.durations)
        if self.yaw is None:
            return xp.zeros((self.durations.shape[0], pieces), self.durations.dtype)
        return xp.abs(_control_points(self.yaw[..., None], self.durations, derivative, pieces)[..., 0]).max(axis=-1)

    def split(self, t: float) -> tuple["PiecewisePolynomial", "PiecewisePolynomial"]:
        """The parts before and behind ``t`` [s], which must lie strictly inside (host, NumPy).

        Raises InputError for another ``t``.
        """
        durations = np.asarray(self.durations)
        if not 0.0 < t < durations.sum():
            raise InputError(f"spline: cannot split at {t} s, want a time strictly between 0 and {durations.sum()} s")
        ends = np.cumsum(durations)
        segment = int(np.searchsorted(ends, t, side="left"))
        share = (t - (ends[segment] - durations[segment])) / durations[segment]

        def cut(coefficients: Float[np.ndarray, "m n ..."]) -> tuple[np.ndarray, np.ndarray]:
            first, second = np.array(coefficients[: segment + 1]), np.array(coefficients[segment:])
            first[-1] = part_table(coefficients.shape[1], 0.0, share) @ coefficients[segment]
            second[0] = part_table(coefficients.shape[1], share, 1.0) @ coefficients[segment]
            return first, second

        left, right = np.array(durations[: segment + 1]), np.array(durations[segment:])
        left[-1], right[0] = share * durations[segment], (1.0 - share) * durations[segment]
        positions = cut(np.asarray(self.position))
        yaws: tuple = (None, None) if self.yaw is None else cut(np.asarray(self.yaw))
        if share >= 1.0:  # the cut falls on a knot
            right, positions, yaws = (
                right[1:],
                (positions[0], positions[1][1:]),
                (yaws[0], None if yaws[1] is None else yaws[1][1:]),
            )
        return (
            PiecewisePolynomial(durations=left, position=positions[0], yaw=yaws[0]),
            PiecewisePolynomial(durations=right, position=positions[1], yaw=yaws[1]),
        )

    def _locate(
        self, t: Float[AnyArray, "*t"], xp: ModuleType
    ) -> tuple[Int[AnyArray, "*t"] | np.integer, Float[AnyArray, "*t"], Float[AnyArray, "*t"]]:
        """The segments at times ``t`` [s], the normalised times there, the segments' durations [s] (1 if padding)."""
        ends = xp.cumsum(self.durations)
        last = xp.maximum((self.durations > 0.0).sum() - 1, 0)
        segment = xp.clip((t[..., None] >= ends.reshape((1,) * t.ndim + (-1,))).sum(axis=-1), 0, last)
        duration = self.durations[segment]
        local = t - (ends[segment] - duration)
        duration = xp.where(duration > 0.0, duration, 1.0)
        return segment, xp.asarray(xp.clip(local / duration, 0.0, 1.0)), duration


def concatenate(splines: Sequence[PiecewisePolynomial]) -> PiecewisePolynomial:
    """One after the other, without padding; whether they join smoothly is the caller's affair (host, NumPy).

    Raises InputError where there is none, or where some have yaw and some have not.
    """
    if not splines or len({spline.yaw is None for spline in splines}) != 1:
        raise InputError("spline: concatenate wants at least one spline, and all of them with yaw or all without")
    real = [np.asarray(spline.durations) > 0.0 for spline in splines]
    pairs = list(zip(splines, real, strict=True))
    yaws = [np.asarray(spline.yaw)[keep] for spline, keep in pairs if spline.yaw is not None]
    return PiecewisePolynomial(
        durations=np.concatenate([np.asarray(spline.durations)[keep] for spline, keep in pairs]),
        position=np.concatenate([np.asarray(spline.position)[keep] for spline, keep in pairs]),
        yaw=np.concatenate(yaws) if yaws else None,
    )


def _powers(coefficients: Float[AnyArray, "*t n d"]) -> list[Float[AnyArray, "*t d"]]:
    """The coefficients of each power."""
    return [coefficients[..., power, :] for power in range(coefficients.shape[-2])]


def _control_points(
    coefficients: Float[AnyArray, "m n d"], durations: Float[AnyArray, "m"], derivative: int, pieces: int
) -> Float[AnyArray, "m {pieces} c d"]:
    """Control points of a time derivative on equal parts of every segment; 0 on padding."""
    xp = namespace(coefficients)
    table = xp.asarray(control_point_table(coefficients.shape[1], derivative, pieces), dtype=coefficients.dtype)
    real = (durations > 0.0)[:, None, None]
    rate = xp.where(real, 1.0 / xp.where(real, durations[:, None, None], 1.0) ** derivative, 0.0)
    points = xp.einsum("cn,mnd->mcd", table, coefficients) * rate
    return points.reshape(len(durations), pieces, -1, coefficients.shape[-1])
