"""Batched BFGS: many small smooth problems minimised side by side, the batch as the last axis.

Every iteration evaluates all lanes once. A lane whose trial decreases enough (Armijo) accepts it and updates its
inverse Hessian (Nocedal & Wright, Numerical Optimization, 2006, eq. 6.17); another shortens its step. The dense
inverse Hessian is n x n for at most about 14 unknowns, so a lane needs fewer evaluations than with limited memory.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

SUFFICIENT_DECREASE = 1e-4
"""Armijo's constant (Nocedal & Wright, sec. 3.1)."""
STEEPEST = 0.05
"""Step along the gradient where the model's direction does not descend (arbitrary; rounding errors only)."""
LONGEST_STEP = 1.0
"""Largest change of an unknown in one step (arbitrary: a factor e in a duration)."""
SHORTEST_STEP = 1e-8
"""A lane whose step shrinks below this fraction has met rounding errors and stops (arbitrary)."""


@runtime_checkable
class Objective(Protocol):
    """What is minimised."""

    def __call__(self, x: Float[Array, "n b"], /) -> tuple[Float[Array, "b"], Float[Array, "n b"]]:
        """Value and gradient of every lane."""
        ...


class Minimum(NamedTuple):
    """Where the search ended."""

    x: Float[Array, "n b"]
    value: Float[Array, "b"]
    decrement: Float[Array, "b"]
    """The further decrease that the quadratic model predicts."""
    evaluations: Int[Array, "b"]


class _Search(NamedTuple):
    x: Float[Array, "n b"]
    value: Float[Array, "b"]
    gradient: Float[Array, "n b"]
    inverse: Float[Array, "n n b"]
    direction: Float[Array, "n b"]
    step: Float[Array, "b"]
    active: Bool[Array, "b"]
    evaluations: Int[Array, "b"]
    rounds: Int[Array, ""]


def minimise(
    objective: Objective,
    start: Float[Array, "n b"],
    inverse: Float[Array, "n n b"],
    tolerance: float,
    max_evaluations: int,
) -> Minimum:
    """Minimise every lane until its predicted decrease falls below ``tolerance``.

    ``inverse`` is the first guess of the inverse Hessian.
    """
    width = start.shape[1]
    value, gradient = objective(start)
    direction = _limited(-_matvec(inverse, gradient))
    search = _Search(
        start,
        value,
        gradient,
        inverse,
        direction,
        jnp.ones(width, start.dtype),
        jnp.isfinite(value) & (-0.5 * _dot(gradient, direction) > tolerance),
        jnp.ones(width, jnp.int32),
        jnp.int32(1),
    )

    def unfinished(search: _Search) -> Bool[Array, ""]:
        return jnp.any(search.active) & (search.rounds < max_evaluations)

    end = jax.lax.while_loop(unfinished, lambda search: _advance(objective, search, tolerance), search)
    return Minimum(end.x, end.value, -0.5 * _dot(end.gradient, end.direction), end.evaluations)


def _advance(objective: Objective, search: _Search, tolerance: float) -> _Search:
    """One evaluation of every lane."""
    move = search.step[None] * search.direction
    value, gradient = objective(search.x + move)
    slope = _dot(search.gradient, search.direction)
    better = search.active & (value <= search.value + SUFFICIENT_DECREASE * search.step * slope)
    inverse = _updated(search.inverse, move, gradient - search.gradient, better)
    direction = -_matvec(inverse, gradient)
    steepest = ~(_dot(direction, gradient) < 0.0)
    direction = _limited(jnp.where(steepest[None], -STEEPEST * gradient, direction))
    excess = value - search.value - search.step * slope
    shorter = search.step * jnp.clip(-0.5 * search.step * slope / jnp.where(excess > 0.0, excess, jnp.inf), 0.1, 0.5)
    shorter = jnp.where(jnp.isfinite(value), shorter, 0.1 * search.step)
    decrement = -0.5 * _dot(direction, gradient)
    keep = search.active & jnp.where(better, decrement > tolerance, shorter > SHORTEST_STEP)
    return _Search(
        jnp.where(better[None], search.x + move, search.x),
        jnp.where(better, value, search.value),
        jnp.where(better[None], gradient, search.gradient),
        inverse,
        jnp.where(better[None], direction, search.direction),
        jnp.where(better, 1.0, shorter),
        keep,
        search.evaluations + search.active.astype(jnp.int32),
        search.rounds + 1,
    )


def _updated(
    inverse: Float[Array, "n n b"],
    move: Float[Array, "n b"],
    change: Float[Array, "n b"],
    better: Bool[Array, "b"],
) -> Float[Array, "n n b"]:
    """The BFGS update, where the step was taken and the curvature along it is positive."""
    curvature = _dot(move, change)
    use = better & (curvature > 1e-12 * jnp.sqrt(_dot(move, move) * _dot(change, change)))
    curvature = jnp.where(use, curvature, 1.0)
    image = _matvec(inverse, change)
    stretch = (1.0 + _dot(change, image) / curvature) / curvature
    cross = (image / curvature[None])[:, None] * move[None]
    grown = inverse + stretch[None, None] * move[:, None] * move[None] - cross - jnp.swapaxes(cross, 0, 1)
    return jnp.where(use[None, None], grown, inverse)


def _limited(direction: Float[Array, "n b"]) -> Float[Array, "n b"]:
    longest = jnp.max(jnp.abs(direction), axis=0)
    return direction * jnp.minimum(1.0, LONGEST_STEP / jnp.where(longest > 0.0, longest, 1.0))[None]


def _matvec(matrix: Float[Array, "n n b"], x: Float[Array, "n b"]) -> Float[Array, "n b"]:
    total = matrix[:, 0] * x[:1]
    for j in range(1, len(x)):
        total = total + matrix[:, j] * x[j : j + 1]
    return total


def _dot(a: Float[Array, "n b"], b: Float[Array, "n b"]) -> Float[Array, "b"]:
    return jnp.sum(a * b, axis=0)
