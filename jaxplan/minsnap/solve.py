"""The minimum-snap quadratic programme, solved exactly for a whole batch at once.

For one trajectory through the waypoints p_0 .. p_m with durations T_1 .. T_m:

    minimise  sum_i int_0^{T_i} |d^r f_i / dt^r|^2 dt
    subject to f_i(0) = p_{i-1}, f_i(T_i) = p_i, derivatives 1..r shared at the knots,
               some derivatives given at the ends                       (paper eq. 4; r = 4, yaw r = 2)

The unknowns are the knot derivatives. A segment couples neighbouring knots only, so the normal equations are block
tridiagonal with r x r blocks (``elimination``): the work is linear in m. Unknowns are scaled by their diagonal, which
keeps the condition number near 1e6 even when neighbouring durations differ 40:1.

Derivatives of the solution come from rules of their own, not from differentiating the factorisation: the knots by the
implicit function theorem (a second solve with the same matrix), the optimal cost by the envelope theorem (the partial
derivatives at fixed knots, because at the optimum the cost does not change with the free ones).

Layout: **the batch is the last axis** of every array, so that each scalar of the small-block algebra is one vector
over the batch; ``tests/oracles/minsnap_dense.py`` is the single-problem twin. A duration of 0 marks padding, which
follows the real segments.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplan.minsnap import elimination, hermite


class Problem(NamedTuple):
    """A batch of problems, in the solver's layout."""

    durations: Float[Array, "m b"]
    """Seconds per segment; 0 marks padding."""
    steps: Float[Array, "m d b"]
    """p_i - p_{i-1} [m]; 0 on padding."""
    values: Float[Array, "m+1 r d b"]
    """The prescribed derivatives 1..r [m/s^k] at the knots; 0 where they are free."""


class Ends(NamedTuple):
    """Which derivatives are prescribed at the ends (known when a function is built, not traced)."""

    fixed: int
    """At the start, and at the goal unless it is free: derivatives 1 .. fixed."""
    goal_free: bool = False
    goal_moves: bool = False
    """The derivatives prescribed at the goal may differ from 0."""


REST = Ends(4)
"""Everything is given at the start, and the goal is reached at rest."""


def problem(
    durations: Float[Array, "m b"],
    points: Float[Array, "m+1 d b"],
    initial: Float[Array, "r d b"],
    terminal: Float[Array, "r d b"] | None,
    ends: Ends,
) -> Problem:
    """The problem between waypoints, with derivatives given at the ends as ``ends`` says."""
    steps = jnp.where((durations > 0.0)[:, None], jnp.diff(points, axis=0), 0.0)
    given = (jnp.arange(1, initial.shape[0] + 1) <= ends.fixed)[:, None, None]
    values = jnp.zeros((points.shape[0], *initial.shape), durations.dtype)
    if terminal is not None and ends.goal_moves:
        at_goal = jnp.arange(points.shape[0])[:, None] == _count(durations)
        values = jnp.where(at_goal[:, None, None] & given, terminal, values)
    return Problem(durations, steps, values.at[0].set(jnp.where(given, initial, 0.0)))


def knot_derivatives(problem: Problem, ends: Ends) -> Float[Array, "m+1 r d b"]:
    """Optimal derivatives 1..r at every knot; 0 behind the last real one."""
    rows, scale = _system(problem, ends)
    inner = _unknown_knots(problem, ends)
    force = -_pull(problem, ends)[inner] * scale[inner][:, :, None]
    own = jax.tree.map(lambda x: x[inner], rows)
    solved = jax.lax.custom_linear_solve(
        lambda x: elimination.multiply(own, x), force, lambda _, b: elimination.solve(own, b), symmetric=True
    )
    free = jnp.zeros_like(problem.values).at[inner].set(solved * scale[inner][:, :, None])
    return free + problem.values


def cost(problem: Problem, ends: Ends) -> Float[Array, "b"]:
    """The optimal cost: the integral of the squared r-th derivative, m^2/s^(2r-1)."""
    return _cost_of(ends)(problem)


def gradient(
    problem: Problem, knots: Float[Array, "m+1 r d b"], ends: Ends
) -> tuple[Float[Array, "b"], Problem, Float[Array, "b"]]:
    """The cost at its optimal ``knots``, its gradient, and how far the optimality conditions are from holding.

    Returns:
        The cost E; its partial derivatives by durations, steps and prescribed values; and the residual, the largest
        |dE/dx| / (2 sqrt(E)) over the free knot derivatives x, scaled so that its largest possible value is 1.
    """
    order = problem.values.shape[1]
    parts, powers, push = _normalised(problem, knots)
    root = hermite.energy_root(order)[:, 1:]
    values = jnp.stack(parts)
    projected = _project(root, values)
    pulls = _project(2.0 * root.T, projected)
    energies = jnp.sum(projected * projected, axis=(0, 2))
    exponents = np.concatenate([np.arange(1.0, order + 1), [0.0], np.arange(1.0, order + 1)]) - (order - 0.5)
    weighted = jnp.asarray(exponents, values.dtype)[:, None, None, None] * pulls * values
    by_duration = jnp.sum(weighted, axis=(0, 2)) * _inverse(problem.durations)
    from_right = jnp.moveaxis(pulls[:order], 0, 1) * powers[:, :, None]
    from_left = jnp.moveaxis(pulls[order + 1 :], 0, 1) * powers[:, :, None]
    by_knot = _at_knots(from_left, from_right)
    known = _known(problem, ends)[:, :, None]
    scale = _scale(powers, _known(problem, ends))[:, :, None]
    total = jnp.sum(energies, axis=0)
    steepest = jnp.max(jnp.abs(by_knot * scale), axis=(0, 1, 2))
    residual = steepest / jnp.where(total > 0.0, 2.0 * jnp.sqrt(total), 1.0)
    by_step = pulls[order] * push[:, None]
    partials = Problem(by_duration, by_step, jnp.where(known, by_knot, 0.0))
    return total, partials, residual


def segment_coefficients(problem: Problem, starts: Float[Array, "m d b"], knots: Float[Array, "m+1 r d b"]) -> Array:
    """Ascending coefficients (m, n, d, b) in normalised time (n = 2r+2) from waypoints and knot derivatives."""
    order = knots.shape[1]
    powers = _powers(problem.durations, order)
    left = [knots[:-1, k] * powers[k][:, None] for k in range(order)]
    right = [knots[1:, k] * powers[k][:, None] for k in range(order)]
    basis = hermite.coefficients(order)
    ends = [starts, *left, problem.steps, *right]
    columns = np.concatenate([np.eye(2 * order + 2, 1), basis[:, 1:]], axis=1)
    return _combine(columns, ends)


def _cost_of(ends: Ends) -> Callable[[Problem], Array]:
    """The optimal cost with the envelope theorem as its rule; its derivatives differentiate the knots implicitly."""

    @jax.custom_jvp
    def optimal(problem: Problem) -> Float[Array, "b"]:
        return _energy(problem, knot_derivatives(problem, ends))

    @optimal.defjvp
    def rule(primals: tuple, tangents: tuple) -> tuple:
        value, partials, _ = gradient(primals[0], knot_derivatives(primals[0], ends), ends)
        products = jax.tree.map(lambda a, b: jnp.sum(a * b, axis=tuple(range(a.ndim - 1))), partials, tangents[0])
        return value, sum(products)

    return optimal


def _energy(problem: Problem, knots: Float[Array, "m+1 r d b"]) -> Float[Array, "b"]:
    parts, _, _ = _normalised(problem, knots)
    projected = _project(hermite.energy_root(problem.values.shape[1])[:, 1:], jnp.stack(parts))
    return jnp.sum(projected * projected, axis=(0, 1, 2))


def _normalised(problem: Problem, knots: Float[Array, "m+1 r d b"]) -> tuple[list[Array], Array, Array]:
    """End values of each segment in normalised time, divided by T^(r-1/2): derivatives, step, derivatives."""
    powers, push = _weights(problem.durations, problem.values.shape[1])
    order = range(powers.shape[1])
    left = [knots[:-1, k] * powers[:, k, None] for k in order]
    right = [knots[1:, k] * powers[:, k, None] for k in order]
    return [*left, problem.steps * push[:, None], *right], powers, push


def _system(problem: Problem, ends: Ends) -> tuple[elimination.Rows, Float[Array, "m+1 r b"]]:
    """The scaled normal equations at every knot, and the scale of each unknown (0 where prescribed)."""
    powers, _ = _weights(problem.durations, problem.values.shape[1])
    known = _known(problem, ends)
    scale = _scale(powers, known)
    blank = jnp.zeros_like(powers[:1])
    before = scale * jnp.concatenate([blank, powers])
    behind = scale * jnp.concatenate([powers, blank])
    return elimination.Rows(before, behind, jnp.where(scale > 0.0, 0.0, 1.0).astype(scale.dtype)), scale


def _scale(powers: Float[Array, "m r b"], known: Bool[Array, "m+1 r b"]) -> Float[Array, "m+1 r b"]:
    """1 / sqrt of the energy's diagonal at the free knot derivatives, 0 elsewhere."""
    order = powers.shape[1]
    weight = jnp.asarray(np.diag(hermite.energy(order))[1 : order + 1], powers.dtype)[:, None]
    squares = powers * powers
    diagonal = weight * jnp.pad(squares, ((1, 0), (0, 0), (0, 0))) + weight * jnp.pad(squares, ((0, 1), (0, 0), (0, 0)))
    free = ~known & (diagonal > 0.0)
    return jnp.where(free, jax.lax.rsqrt(jnp.where(free, diagonal, 1.0)), 0.0)


def _pull(problem: Problem, ends: Ends) -> Float[Array, "m+1 r d b"]:
    """dE/dx / 2 at every knot for free derivatives 0: how the waypoints and the prescribed values pull."""
    order = problem.values.shape[1]
    powers, push = _weights(problem.durations, order)
    energy = hermite.energy(order)
    start, end, goal = slice(1, order + 1), slice(order + 2, 2 * order + 2), order + 1
    steps = (problem.steps * push[:, None])[:, None]
    column = jnp.asarray(energy[:, goal], steps.dtype)[:, None, None]
    from_right = column[start] * powers[:, :, None] * steps
    from_left = column[end] * powers[:, :, None] * steps
    pull = _at_knots(from_left, from_right)
    count = len(powers) if ends.goal_moves else 1
    weights, values = powers[:count], problem.values[: count + 1]
    parts = [values[:-1, k] * weights[:, k, None] for k in range(order)]
    parts += [values[1:, k] * weights[:, k, None] for k in range(order)]
    both = [*range(1, order + 1), *range(order + 2, 2 * order + 2)]
    pull = pull.at[:count].add(_combine(energy[start][:, both], parts) * weights[:, :, None])
    return pull.at[1 : count + 1].add(_combine(energy[end][:, both], parts) * weights[:, :, None])


def _unknown_knots(problem: Problem, ends: Ends) -> slice:
    """The knots that may have free derivatives."""
    order, last = problem.values.shape[1], len(problem.durations)
    return slice(1, last) if ends.fixed >= order and not ends.goal_free else slice(0, last + 1)


def _known(problem: Problem, ends: Ends) -> Bool[Array, "m+1 r b"]:
    """Which knot derivatives are prescribed: those of the ends, and all behind the goal."""
    order = problem.values.shape[1]
    index = jnp.arange(problem.values.shape[0])[:, None, None]
    last = _count(problem.durations)[None, None]
    given = (jnp.arange(1, order + 1) <= ends.fixed)[None, :, None]
    at_ends = (index == 0) | ((index == last) & (not ends.goal_free))
    return (at_ends & given) | (index > last)


def _count(durations: Float[Array, "m b"]) -> Float[Array, "b"]:
    return jnp.sum(durations > 0.0, axis=0)


def _weights(durations: Float[Array, "m b"], order: int) -> tuple[Float[Array, "m r b"], Float[Array, "m b"]]:
    """T^(k - r + 1/2) for the derivatives k = 1..r and for k = 0; 0 on padding."""
    real = durations > 0.0
    safe = jnp.where(real, durations, 1.0)
    push = jnp.where(real, jax.lax.rsqrt(safe) / safe ** (order - 1), 0.0)
    return jnp.stack([push * power for power in _powers(safe, order)], axis=1), push


def _powers(durations: Float[Array, "m b"], order: int) -> list[Float[Array, "m b"]]:
    """T, T^2 .. T^r."""
    powers = [durations]
    for _ in range(order - 1):
        powers.append(powers[-1] * durations)
    return powers


def _inverse(durations: Float[Array, "m b"]) -> Float[Array, "m b"]:
    real = durations > 0.0
    return jnp.where(real, 1.0 / jnp.where(real, durations, 1.0), 0.0)


def _at_knots(from_left: Float[Array, "m r d b"], from_right: Float[Array, "m r d b"]) -> Float[Array, "m+1 r d b"]:
    """Sum at every knot of what the segment before it and the segment behind it contribute."""
    width = ((1, 0), (0, 0), (0, 0), (0, 0))
    return jnp.pad(from_left, width) + jnp.pad(from_right, (width[0][::-1], *width[1:]))


def _project(matrix: np.ndarray, values: Float[Array, "j m d b"]) -> Float[Array, "i m d b"]:
    """matrix @ values as one product: XLA repeats an elementwise one in each of its consumers."""
    flat = jnp.asarray(matrix, values.dtype) @ values.reshape(len(values), -1)
    return flat.reshape(len(matrix), *values.shape[1:])


def _combine(matrix: np.ndarray, parts: list[Float[Array, "m d b"]]) -> Float[Array, "m i d b"]:
    """matrix @ parts for every segment, axis and lane, as one elementwise expression."""
    columns = jnp.asarray(matrix, parts[0].dtype)[:, :, None, None]
    return sum(columns[:, j] * part[:, None] for j, part in enumerate(parts))  # type: ignore[return-value]
