"""A primal interior-point method for few variables and many margins, from starts that need not be feasible.

    min over x, s    f(x) + w s - mu ( sum_i log(c_i(x) + s) + log s )

The slack s is the same for all margins, so f + w s is an exact penalty of the worst violation: with w above the sum of
the multipliers s tends to 0 with mu. Steps are Newton's with the Gauss-Newton Hessian sum_i mu / (c_i + s)^2 J_i J_i^T,
damped in Levenberg's way, the best of a few step lengths is taken, and mu shrinks with every step that is.
Sources: Fiacco & McCormick 1968 (barrier), Fletcher 1987, ch. 14 (exact penalty).
"""

from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxplan.arrays import AnyArray, Scalar
from jaxplan.optimizer.margins import Linearised
from jaxplan.records import record
from jaxplan.validation import require_between, require_positive, require_within

_SHRINKAGES = 0.5 ** np.arange(7)
"""Of the full step (arbitrary)."""


@record
class DescentConfig:
    """How a problem is descended: numbers that are traced, so that other ones compile nothing anew."""

    iterations: int | Int[AnyArray, ""] = 90
    penalty: Scalar = 10.0
    """w: what one unit of violation costs in units of the objective."""
    barrier: Scalar = 3e-3
    """mu at the start."""
    last_barrier: Scalar = 1e-5
    rate: Scalar = 0.88
    """By which mu shrinks with every step."""
    slack: Scalar = 0.1
    """s at the start, beyond the worst violation."""

    def __post_init__(self) -> None:
        require_within("descent", self, 1, 10_000, "iterations")
        require_positive("descent", self, "penalty", "barrier", "last_barrier", "slack")
        require_between("descent", self, 0.0, 1.0, "rate")


@runtime_checkable
class Values(Protocol):
    """What is minimised, and what must not be negative."""

    def __call__(self, x: Float[Array, "k v"], /) -> tuple[Float[Array, "k"], Float[Array, "k c"]]:
        """Objectives and margins of k problems."""


@runtime_checkable
class Linearise(Protocol):
    """The same with its derivatives."""

    def __call__(self, x: Float[Array, "k v"], /) -> Linearised:
        """k problems around k points."""


class Descent(NamedTuple):
    """Where the descents of k problems ended."""

    x: Float[Array, "k v"]
    objective: Float[Array, "k"]
    least: Float[Array, "k"]
    """Of the margins: the worst violation where it is negative."""


class _State(NamedTuple):
    """Of the descents of k problems."""

    found: Descent
    slack: Float[Array, "k"]
    barrier: Float[Array, "k"]
    damping: Float[Array, "k"]


class _Search(NamedTuple):
    """For the length of a step of k problems."""

    turn: Int[Array, ""]
    """Of the length that is tried next."""
    merit: Float[Array, "k"]
    """The best so far."""
    found: Descent
    """With that."""
    best: Int[Array, "k"]
    """Index of its length; -1: that of no step."""


def descend(values: Values, linearise: Linearise, x: Float[Array, "k v"], config: DescentConfig) -> Descent:
    """Local minima near k points; what violates its margins in the end has found no feasible one.

    There is one call of each function in what is compiled: the first slack comes from the first linearisation.
    """
    nothing = jnp.zeros(len(x), x.dtype)
    begin = _State(
        found=Descent(x, nothing, nothing),
        slack=nothing,
        barrier=jnp.full(len(x), config.barrier, x.dtype),
        damping=jnp.full(len(x), 1e-2, x.dtype),
    )

    def step(index: Int[Array, ""], state: _State) -> _State:
        around = linearise(state.found.x)
        first = jnp.asarray(config.slack + jnp.maximum(-jnp.min(around.margins, axis=1), 0.0))
        return _step(values, around, state._replace(slack=jnp.where(index == 0, first, state.slack)), config)

    return jax.lax.fori_loop(0, config.iterations, step, begin).found


def _step(values: Values, around: Linearised, state: _State, config: DescentConfig) -> _State:
    """One damped Newton step, of the length from which shorter ones are no better."""
    x, direction = state.found.x, _direction(around, state, config)
    shares = jnp.asarray(_SHRINKAGES, x.dtype)
    here = _merit(around.objective, around.margins, state.slack, state.barrier, config)
    begin = _Search(
        turn=jnp.zeros((), jnp.int32),
        merit=here,
        found=Descent(x, around.objective, jnp.min(around.margins, axis=1)),
        best=jnp.full(len(x), -1, jnp.int32),
    )

    def going(search: _Search) -> Bool[Array, "k"]:
        """Where the last length that was tried is the best so far, or none is any good, shorter ones may be better."""
        return (search.best < 0) | (search.best == search.turn - 1)

    def unfinished(search: _Search) -> Bool[Array, ""]:
        return (search.turn < len(_SHRINKAGES)) & jnp.any(going(search))

    def tried(search: _Search) -> _Search:
        share = shares[search.turn]
        moved, slack = x + share * direction[:, :-1], state.slack + share * direction[:, -1]
        objective, margins = values(moved)
        merit = _merit(objective, margins, slack, state.barrier, config)
        better = going(search) & (merit < search.merit)
        found = _where(better, Descent(moved, objective, jnp.min(margins, axis=1)), search.found)
        return _Search(
            turn=search.turn + 1,
            merit=jnp.where(better, merit, search.merit),
            found=found,
            best=jnp.where(better, search.turn, search.best),
        )

    search = jax.lax.while_loop(unfinished, tried, begin)
    best, moved = search.best, search.best >= 0
    share = jnp.where(moved, shares[best], 0.0)
    damping = jnp.where(
        moved,
        jnp.where(best == 0, state.damping / 4.0, jnp.where(best <= 2, state.damping, state.damping * 3.0)),
        state.damping * 10.0,
    )
    return _State(
        found=search.found,
        slack=state.slack + share * direction[:, -1],
        barrier=jnp.where(moved, jnp.maximum(config.rate * state.barrier, config.last_barrier), state.barrier),
        damping=jnp.clip(damping, 1e-8, 1e4),
    )


def _where(new: Bool[Array, "k"], these: Descent, those: Descent) -> Descent:
    """Of each problem one or the other."""
    return Descent(
        x=jnp.where(new[:, None], these.x, those.x),
        objective=jnp.where(new, these.objective, those.objective),
        least=jnp.where(new, these.least, those.least),
    )


def _merit(
    objective: Float[Array, "k"],
    margins: Float[Array, "k c"],
    slack: Float[Array, "k"],
    barrier: Float[Array, "k"],
    config: DescentConfig,
) -> Float[Array, "k"]:
    """Penalty and barrier together; infinite outside of the barrier."""
    inside = jnp.min(margins, axis=1) + slack
    good = (inside > 0.0) & (slack > 0.0)
    logs = jnp.sum(jnp.log(jnp.where(good[:, None], margins + slack[:, None], 1.0)), axis=1)
    logs += jnp.log(jnp.where(good, slack, 1.0))
    merit = objective + config.penalty * slack - barrier * logs
    return jnp.where(good & jnp.isfinite(merit), merit, jnp.inf)


def _direction(found: Linearised, state: _State, config: DescentConfig) -> Float[Array, "k w"]:
    """Of x and s."""
    distance = found.margins + state.slack[:, None]
    pull, weight = state.barrier[:, None] / distance, state.barrier[:, None] / distance**2
    ones = jnp.ones((*found.margins.shape, 1), found.jacobian.dtype)
    rows = jnp.concatenate([found.jacobian, ones], axis=2)
    hessian = jnp.swapaxes(rows * weight[:, :, None], 1, 2) @ rows
    count = rows.shape[2]
    curvature = jnp.concatenate([found.curvature, (state.barrier / state.slack**2)[:, None]], axis=1)
    hessian += curvature[:, :, None] * jnp.eye(count, dtype=rows.dtype)[None]
    gradient = -jnp.einsum("kcv,kc->kv", rows, pull)
    gradient = gradient.at[:, :-1].add(found.gradient).at[:, -1].add(config.penalty - state.barrier / state.slack)
    scale = jnp.diagonal(hessian, axis1=1, axis2=2)
    hessian += (state.damping[:, None] * scale + 1e-9)[:, :, None] * jnp.eye(count, dtype=rows.dtype)[None]
    return -jnp.linalg.solve(hessian, gradient[:, :, None])[:, :, 0]
