"""Which problems of a batch can be solved, and what stands in for those that cannot."""

import enum

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, UInt32

from jaxplan.status import bit

RESIDUAL_LIMIT = 1e-6
"""Largest relative residual of the optimality conditions that counts as solved (arbitrary; usual values are 1e-13)."""


class SolveStatus(enum.IntFlag):
    """What is wrong with one problem of a batch; 0 is a solution."""

    NONFINITE = 1 << 0
    """A waypoint, a duration or a prescribed derivative is not finite, or the solution overflows."""
    DURATIONS = 1 << 1
    """A duration is negative, a 0 stands before a positive one, or none is positive."""
    COINCIDENT = 1 << 2
    """All waypoints are the same point. The problem is solved nonetheless, but it is no path."""
    ILL_CONDITIONED = 1 << 3
    """The optimality conditions do not hold to 1e-6."""
    NOT_CONVERGED = 1 << 4
    """The iterations ran out before the tolerance was met; the best durations found are returned."""
    INFEASIBLE = 1 << 5
    """No durations within the allowed factor satisfy the rotor limits."""


UNSOLVED = SolveStatus.NONFINITE | SolveStatus.DURATIONS
"""The bits of problems that are not attempted: their cost is infinite and their spline empty."""


def problem_status(
    waypoints: Float[Array, "n d b"], durations: Float[Array, "m b"], *given: Float[Array, "_ _ b"]
) -> UInt32[Array, "b"]:
    """NONFINITE, DURATIONS and COINCIDENT of every problem through n = m + 1 waypoints.

    ``given`` are the derivatives prescribed at the ends. Waypoints behind the goal may be anything.
    """
    count = jnp.sum(durations > 0.0, axis=0)
    behind = jnp.arange(len(waypoints))[:, None] > count[None]
    finite = jnp.all(jnp.isfinite(durations), axis=0)
    finite &= jnp.all(jnp.isfinite(waypoints).all(axis=1) | behind, axis=0)
    for values in given:
        finite &= jnp.isfinite(values).all(axis=(0, 1))
    padding = jnp.arange(len(durations))[:, None] >= count[None]
    ordered = jnp.all((durations > 0.0) | ((durations == 0.0) & padding), axis=0) & (count > 0)
    moved = jnp.any((waypoints != waypoints[:1]).any(axis=1) & ~behind, axis=0)
    return (
        bit(~finite, SolveStatus.NONFINITE)
        | bit(~ordered & finite, SolveStatus.DURATIONS)
        | bit(~moved & finite & ordered, SolveStatus.COINCIDENT)
    )


def has_any(status: UInt32[Array, "b"], bits: SolveStatus) -> Bool[Array, "b"]:
    """Where at least one of the ``bits`` is set."""
    return (status & jnp.uint32(int(bits))) != 0


def finite_problems(
    waypoints: Float[Array, "n d b"], durations: Float[Array, "m b"], skip: Bool[Array, "b"]
) -> tuple[Float[Array, "n d b"], Float[Array, "m b"]]:
    """The same batch with every value finite: empty problems where ``skip``, the goal repeated on padding."""
    durations = jnp.where(skip[None], 0.0, durations)
    count = jnp.sum(durations > 0.0, axis=0)
    goal = jnp.take_along_axis(waypoints, count[None, None], axis=0)
    behind = jnp.arange(len(waypoints))[:, None, None] > count[None, None]
    return jnp.where(skip[None, None], 0.0, jnp.where(behind, goal, waypoints)), durations
