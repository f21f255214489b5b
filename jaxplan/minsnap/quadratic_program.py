"""The minimum-snap quadratic programme, solved exactly for a whole batch at once.

For one trajectory through the waypoints p_0 .. p_m with durations T_1 .. T_m:

    minimise  sum_i int_0^{T_i} |d^r f_i / dt^r|^2 dt
    subject to f_i(0) = p_{i-1}, f_i(T_i) = p_i, derivatives 1..r shared at the knots,
               some derivatives given at the ends                       (paper eq. 4; r = 4, yaw r = 2)

The unknowns are the knot derivatives. A segment couples neighbouring knots only, so the normal equations are block
tridiagonal with r x r blocks (``block_tridiagonal``): the work is linear in m. Unknowns are scaled by their diagonal,
which keeps the condition number near 1e6 even when neighbouring durations differ 40:1.

Derivatives of the solution come from rules of their own, not from differentiating the factorisation: the knots by the
implicit function theorem (a second solve with the same matrix), the optimal cost by the envelope theorem (the partial
derivatives at fixed knots, because at the optimum the cost does not change with the free ones).

Layout: **the batch is the last axis** of every array, so that each scalar of the small-block algebra is one vector
over the batch; ``tests/oracles/minsnap_dense.py`` is the single-problem twin. A duration of 0 marks padding, which
follows the real segments.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxplan.minsnap import block_tridiagonal, hermite


class Problem(NamedTuple):
    """A batch of problems, in the solver's layout."""

    durations: Float[Array, "m b"]
    """Seconds per segment; 0 marks padding."""
    steps: Float[Array, "m d b"]
    """p_i - p_{i-1} [m]; 0 on padding."""
    start: Float[Array, "r d b"]
    """The prescribed derivatives 1..r [m/s^k] at the start; 0 where they are free."""
    goal: Float[Array, "r d b"] | None
    """The same at the goal; None where they are all 0 or free."""


class Ends(NamedTuple):
    """Which derivatives are prescribed at the ends (known when a function is built, not traced)."""

    fixed: int
    """At the start, and at the goal unless it is free: derivatives 1 .. fixed."""
    goal_free: bool = False
    goal_moves: bool = False
    """The derivatives prescribed at the goal may differ from 0."""


REST = Ends(4)
"""Everything is given at the start, and the goal is reached at rest."""


class Passage(NamedTuple):
    """A velocity that is prescribed at one of the knots between the ends."""

    knot: Int[Array, "b"]
    """Its number; 0 where nothing is prescribed."""
    velocity: Float[Array, "d b"]
    """[m/s]"""


def make_problem(
    durations: Float[Array, "m b"],
    points: Float[Array, "n d b"],
    initial: Float[Array, "r d b"],
    terminal: Float[Array, "r d b"] | None,
    ends: Ends,
) -> Problem:
    """The problem through n = m + 1 waypoints, with the derivatives that ``ends`` wants given at the ends."""
    steps = jnp.where((durations > 0.0)[:, None], jnp.diff(points, axis=0), 0.0)
    given = _given(initial.shape[0], ends)[:, None]
    goal = jnp.where(given, terminal, 0.0) if terminal is not None and ends.goal_moves else None
    return Problem(durations, steps, jnp.where(given, initial, 0.0), goal)


def knot_derivatives(problem: Problem, ends: Ends, passage: Passage | None = None) -> Float[Array, "n r d b"]:
    """Optimal derivatives 1..r at each of the n = m + 1 knots; 0 behind the last real one."""
    powers, push = _weights(problem.durations, len(problem.start))
    inner = _unknown_knots(problem, ends)
    before, behind = _around(powers, inner)
    known, given = _known(problem, ends), _with_ends(problem, None)
    if passage is not None:
        there, value = _at_passage(problem, passage)
        known, given = known | there, given + value
    scale = _scale(before, behind, known[inner])
    rows = block_tridiagonal.Rows(scale * before, scale * behind)
    everywhere = problem.goal is not None or passage is not None
    force = -_pull(problem, powers, push, scale, given if everywhere else given[:2], inner)
    solved = jax.lax.custom_linear_solve(
        lambda x: block_tridiagonal.multiply(rows, x),
        force,
        lambda _, b: block_tridiagonal.solve(rows, b),
        symmetric=True,
    )
    found = _with_ends(problem, solved * scale[:, :, None])
    return found if passage is None else found + value


def cost(problem: Problem, ends: Ends) -> tuple[Float[Array, "b"], Float[Array, "b"]]:
    """The optimal cost, the integral of the squared r-th derivative [m^2/s^(2r-1)], and its ``gradient``'s residual."""
    return _cost_of(ends)(problem)


def gradient(
    problem: Problem, knots: Float[Array, "n r d b"], ends: Ends
) -> tuple[Float[Array, "b"], Problem, Float[Array, "b"]]:
    """The cost at its optimal ``knots``, its gradient, and how far the optimality conditions are from holding.

    Returns:
        The cost E; its partial derivatives by durations, steps and prescribed values; and the residual, the largest
        |dE/dx| / (2 sqrt(E)) over the free knot derivatives x, scaled so that its largest possible value is 1.
    """
    order = len(problem.start)
    powers, push = _weights(problem.durations, order)
    root = hermite.energy_root(order)[:, 1:]
    energies, by_duration, projected = _energies(problem, knots, root)
    total = jnp.sum(energies, axis=0)
    by_step = _combine(root[:, [order]].T, projected)[:, 0] * push[:, None]
    from_right = _combine(root[:, :order].T, projected) * powers[:, :, None]
    from_left = _combine(root[:, order + 1 :].T, projected) * powers[:, :, None]
    by_start, by_goal = _by_ends(problem, from_left, from_right, ends)
    inner = _unknown_knots(problem, ends)
    scale = _scale(*_around(powers, inner), _known(problem, ends)[inner])[:, :, None]
    slopes = jnp.abs(_around(from_left, inner)[0] + _around(from_right, inner)[1]) * scale
    bound = jnp.where(total > 0.0, 2.0 * jnp.sqrt(total), 1.0)
    residual = jnp.max(functools.reduce(jnp.maximum, _rows(slopes)) / bound[None], axis=0, initial=0.0)
    return total, Problem(by_duration, by_step, by_start, by_goal), residual


def _energies(
    problem: Problem, knots: Float[Array, "n r d b"], root: Float[np.ndarray, "i j"]
) -> tuple[Float[Array, "m b"], Float[Array, "m b"], list[Float[Array, "m d b"]]]:
    """The cost of each segment, its derivative by the duration, and twice the Legendre components it is made of.

    The components are the end values u_j in normalised time times root / T^(r-1/2), and u_j grows with T^j.
    """
    order = len(problem.start)
    slowness, parts = _slowness(problem.durations, order), _end_values(problem, knots)
    components = _combine(root, parts)
    exponents = np.concatenate([np.arange(1.0, order + 1), [0.0], np.arange(1.0, order + 1)]) - (order - 0.5)
    growths = _combine(root * exponents, parts)
    energies = _sum([row**2 for row in _rows(components)]) / slowness**2
    changes = _sum([2.0 * row * growth for row, growth in zip(_rows(components), _rows(growths), strict=True)])
    by_duration = changes / (slowness**2 * jnp.where(problem.durations > 0.0, problem.durations, 1.0))
    doubled = 2.0 * components / slowness[:, None, None]
    return energies, by_duration, [doubled[:, row] for row in range(order + 2)]


def segment_coefficients(
    problem: Problem, starts: Float[Array, "m d b"], knots: Float[Array, "n r d b"]
) -> Float[Array, "m 2*r+2 d b"]:
    """Ascending coefficients in normalised time from the segments' first waypoints and the knots' derivatives."""
    order = knots.shape[1]
    columns = np.concatenate([np.eye(2 * order + 2, 1), hermite.coefficients(order)[:, 1:]], axis=1)
    return _combine(columns, [starts, *_end_values(problem, knots)])


def _cost_of(ends: Ends) -> Callable[[Problem], tuple[Array, Array]]:
    """The optimal cost with the envelope theorem as its rule; its derivatives differentiate the knots implicitly."""

    @jax.custom_jvp
    def optimal(problem: Problem) -> tuple[Float[Array, "b"], Float[Array, "b"]]:
        value, _, residual = gradient(problem, knot_derivatives(problem, ends), ends)
        return value, residual

    @optimal.defjvp
    def rule(primals: tuple, tangents: tuple) -> tuple:
        value, partials, residual = gradient(primals[0], knot_derivatives(primals[0], ends), ends)
        products = jax.tree.map(lambda a, b: jnp.sum(a * b, axis=tuple(range(a.ndim - 1))), partials, tangents[0])
        return (value, jax.lax.stop_gradient(residual)), (sum(jax.tree.leaves(products)), jnp.zeros_like(residual))

    return optimal


def _end_values(problem: Problem, knots: Float[Array, "n r d b"]) -> list[Float[Array, "m d b"]]:
    """End values of each segment in normalised time: derivatives at its start, step, derivatives at its end."""
    powers = _powers(problem.durations, knots.shape[1])
    left = [knots[:-1, k] * power[:, None] for k, power in enumerate(powers)]
    right = [knots[1:, k] * power[:, None] for k, power in enumerate(powers)]
    return [*left, problem.steps, *right]


def _scale(
    before: Float[Array, "k r b"], behind: Float[Array, "k r b"], known: Bool[Array, "k r b"]
) -> Float[Array, "k r b"]:
    """1 / sqrt of the energy's diagonal at the free knot derivatives, 0 elsewhere."""
    order = before.shape[1]
    weight = jnp.asarray(np.diag(hermite.energy(order))[1 : order + 1], before.dtype)[None, :, None]
    diagonal = weight * (before * before + behind * behind)
    free = ~known & (diagonal > 0.0)
    return jnp.where(free, jax.lax.rsqrt(jnp.where(free, diagonal, 1.0)), 0.0)


def _at_passage(problem: Problem, passage: Passage) -> tuple[Bool[Array, "n r b"], Float[Array, "n r d b"]]:
    """Which derivatives are prescribed between the ends, and their values; 0 elsewhere."""
    kind = passage.knot.dtype
    knot = jnp.arange(len(problem.durations) + 1, dtype=kind)[:, None, None]
    first = (jnp.arange(len(problem.start)) == 0)[None, :, None]
    inside = (passage.knot > 0) & (passage.knot < _count(problem.durations).astype(kind))
    there = (knot == passage.knot[None, None]) & first & inside[None, None]
    return there, jnp.where(there[:, :, None], passage.velocity[None, None], 0.0)


def _pull(
    problem: Problem,
    powers: Float[Array, "m r b"],
    push: Float[Array, "m b"],
    scale: Float[Array, "k r b"],
    values: Float[Array, "v r d b"],
    inner: slice,
) -> Float[Array, "k r d b"]:
    """dE/dx / 2 at the unknown knots for free derivatives 0, scaled: how waypoints and prescribed values pull.

    ``values``: derivatives at the first v knots, 0 where they are free; all that is prescribed is among them.
    """
    order = powers.shape[1]
    energy, scale = hermite.energy(order), scale[:, :, None]
    start, end, goal = slice(1, order + 1), slice(order + 2, 2 * order + 2), order + 1
    steps = (problem.steps * push[:, None])[:, None]
    column = jnp.asarray(energy[:, goal], steps.dtype)[None, :, None, None]
    (before, behind), (step_before, step_behind) = _around(powers[:, :, None], inner), _around(steps, inner)
    pull = scale * (column[:, end] * before * step_before + column[:, start] * behind * step_behind)
    count = len(values) - 1
    weights = powers[:count]
    parts = [values[:count, k] * weights[:, k, None] for k in range(order)]
    parts += [values[1 : count + 1, k] * weights[:, k, None] for k in range(order)]
    both = [*range(1, order + 1), *range(order + 2, 2 * order + 2)]
    from_right, from_left = (_combine(energy[side][:, both], parts) * weights[:, :, None] for side in (start, end))
    given = _at_knots(from_left, from_right)[inner]
    return pull.at[: len(given)].add(scale[: len(given)] * given)


def _with_ends(problem: Problem, free: Float[Array, "k r d b"] | None) -> Float[Array, "n r d b"]:
    """Derivatives at every knot: the unknown ones, 0 when omitted, and the prescribed ones."""
    count = len(problem.durations) + 1
    nothing = jnp.zeros_like(problem.start)[None]
    if free is None:
        free = jnp.zeros((count - 2, *problem.start.shape), problem.start.dtype)
    if len(free) == count:
        knots = free.at[0].add(problem.start)
    else:
        knots = jnp.concatenate([problem.start[None], free, nothing])
    if problem.goal is None:
        return knots
    at_goal = jnp.arange(count)[:, None] == _count(problem.durations)[None]
    return jnp.where(at_goal[:, None, None], knots + problem.goal[None], knots)


def _by_ends(
    problem: Problem, from_left: Float[Array, "m r d b"], from_right: Float[Array, "m r d b"], ends: Ends
) -> tuple[Float[Array, "r d b"], Float[Array, "r d b"] | None]:
    """The derivatives of the cost by the prescribed values at the start and at the goal."""
    given = _given(len(problem.start), ends)[:, None]
    by_start = jnp.where(given, from_right[0], 0.0)
    if problem.goal is None:
        return by_start, None
    last = jnp.arange(1, len(from_left) + 1)[:, None] == _count(problem.durations)[None]
    return by_start, jnp.where(given, jnp.sum(jnp.where(last[:, None, None], from_left, 0.0), axis=0), 0.0)


def _around(segments: Float[Array, "m ... b"], knots: slice) -> tuple[Array, Array]:
    """A quantity of the segment before and of the segment behind each of the ``knots``; 0 beyond the ends."""
    if knots.start == 1:
        return segments[:-1], segments[1:]
    nothing = jnp.zeros_like(segments[:1])
    return jnp.concatenate([nothing, segments]), jnp.concatenate([segments, nothing])


def _unknown_knots(problem: Problem, ends: Ends) -> slice:
    """The knots that may have free derivatives."""
    order, last = len(problem.start), len(problem.durations)
    return slice(1, last) if ends.fixed >= order and not ends.goal_free else slice(0, last + 1)


def _known(problem: Problem, ends: Ends) -> Bool[Array, "n r b"]:
    """Which knot derivatives are prescribed: those of the ends, and all behind the goal."""
    index = jnp.arange(len(problem.durations) + 1)[:, None, None]
    last = _count(problem.durations)[None, None]
    at_ends = (index == 0) | ((index == last) & (not ends.goal_free))
    return (at_ends & _given(len(problem.start), ends)[None]) | (index > last)


def _given(order: int, ends: Ends) -> Bool[Array, "r 1"]:
    """Which of the derivatives 1..r are prescribed at an end."""
    return (jnp.arange(1, order + 1) <= ends.fixed)[:, None]


def _count(durations: Float[Array, "m b"]) -> Int[Array, "b"]:
    """How many segments are real."""
    return jnp.sum(durations > 0.0, axis=0)


def _weights(durations: Float[Array, "m b"], order: int) -> tuple[Float[Array, "m r b"], Float[Array, "m b"]]:
    """T^(k - r + 1/2) for the derivatives k = 1..r and for k = 0; 0 on padding."""
    real = durations > 0.0
    push = jnp.where(real, 1.0 / _slowness(durations, order), 0.0)
    return jnp.stack([push * power for power in _powers(durations, order)], axis=1), push


def _slowness(durations: Float[Array, "m b"], order: int) -> Float[Array, "m b"]:
    """T^(r - 1/2), by which the end values in normalised time are divided; 1 on padding."""
    safe = jnp.where(durations > 0.0, durations, 1.0)
    return jnp.sqrt(safe) * safe ** (order - 1)


def _powers(durations: Float[Array, "m b"], order: int) -> list[Float[Array, "m b"]]:
    """T, T^2 .. T^r."""
    powers = [durations]
    for _ in range(order - 1):
        powers.append(powers[-1] * durations)
    return powers


def _at_knots(from_left: Float[Array, "m r d b"], from_right: Float[Array, "m r d b"]) -> Float[Array, "m+1 r d b"]:
    """Sum at every knot of what the segment before it and the segment behind it contribute."""
    width = ((1, 0), (0, 0), (0, 0), (0, 0))
    return jnp.pad(from_left, width) + jnp.pad(from_right, (width[0][::-1], *width[1:]))


def _combine(matrix: Float[np.ndarray, "i j"], parts: list[Float[Array, "m d b"]]) -> Float[Array, "m i d b"]:
    """matrix @ parts for every segment, axis and lane, as one elementwise expression."""
    columns = jnp.asarray(matrix, parts[0].dtype)[None, :, :, None, None]
    return _sum([columns[:, :, j] * part[:, None] for j, part in enumerate(parts)])


def _rows(values: Float[Array, "m i d b"]) -> list[Float[Array, "m b"]]:
    """The rows of the two middle axes. XLA vectorises a sum of these, but not a reduction over their axes."""
    return [values[:, i, j] for i in range(values.shape[1]) for j in range(values.shape[2])]


def _sum(terms: list[Array]) -> Array:
    return sum(terms[1:], start=terms[0])
