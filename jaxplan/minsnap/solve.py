"""The minimum-snap quadratic programme, solved exactly for a whole batch at once.

For one trajectory through the waypoints p_0 .. p_m with durations T_1 .. T_m:

    minimise  sum_i int_0^{T_i} |d^r f_i / dt^r|^2 dt
    subject to f_i(0) = p_{i-1}, f_i(T_i) = p_i, derivatives 1..r shared at the knots,
               some derivatives given at the ends                       (paper eq. 4; r = 4, yaw r = 2)

The unknowns are the knot derivatives. A segment couples neighbouring knots only, so the normal equations
A y = f are block tridiagonal with r x r blocks: one Cholesky sweep forward, one substitution backward,
linear in m. Unknowns are scaled by their diagonal, which keeps the condition number near 1e6 even when
neighbouring durations differ 40:1.

Layout: **the batch is the last axis** of every array, so that each scalar of the small-block algebra is one
vector over the batch; ``tests/oracles/minsnap_dense.py`` is the single-problem twin.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplan.minsnap import blocks, hermite


class _Knot(NamedTuple):
    """One row of the block-tridiagonal system: the segments on both sides of a knot."""

    duration_left: Float[Array, "b"]
    duration_right: Float[Array, "b"]
    step_left: Float[Array, "d b"]
    step_right: Float[Array, "d b"]
    known: Bool[Array, "r b"]
    value_before: Float[Array, "r d b"]
    value: Float[Array, "r d b"]
    value_after: Float[Array, "r d b"]


class _Row(NamedTuple):
    """One row of the factor: A = L L^T with diagonal blocks ``cholesky`` and L_{i,i-1}^T = ``coupling``."""

    cholesky: Float[Array, "r r b"]
    coupling: Float[Array, "r r b"]
    forward: Float[Array, "r d b"]
    scale: Float[Array, "r b"]


def knot_derivatives(
    durations: Float[Array, "m b"],
    steps: Float[Array, "m d b"],
    known: Bool[Array, "m+1 r b"],
    values: Float[Array, "m+1 r d b"],
) -> Float[Array, "m+1 r d b"]:
    """Optimal derivatives 1..r at every knot.

    Args:
        durations: seconds per segment; 0 marks padding, which must follow the real segments.
        steps: p_i - p_{i-1} [m]; must be 0 on padding.
        known: which knot derivatives are prescribed (all of them behind the last real knot).
        values: the prescribed derivatives [m/s^k]; must be 0 where not known.
    """
    order, lanes = known.shape[1], durations.shape[-1]
    durations, steps = _surround(durations), _surround(steps)
    around = _surround(values)
    knots = _Knot(durations[:-1], durations[1:], steps[:-1], steps[1:], known, around[:-2], values, around[2:])
    nothing = jnp.zeros((order, order, lanes), durations.dtype)
    start = _Row(
        cholesky=nothing + jnp.eye(order, dtype=durations.dtype)[..., None],
        coupling=nothing,
        forward=jnp.zeros((*values.shape[1:],), durations.dtype),
        scale=jnp.zeros((order, lanes), durations.dtype),
    )
    _, rows = jax.lax.scan(_eliminate, start, knots)
    _, unknowns = jax.lax.scan(_substitute, jnp.zeros_like(start.forward), rows, reverse=True)
    return unknowns * rows.scale[:, :, None] + values


def _eliminate(previous: _Row, knot: _Knot) -> tuple[_Row, _Row]:
    """Assemble the row of one knot, subtract what the previous knot determines, factor the rest."""
    order = knot.known.shape[0]
    matrix = hermite.energy(order)
    at_start, at_end, goal = slice(1, order + 1), slice(order + 2, 2 * order + 2), order + 1
    left, right = _powers(knot.duration_left, order), _powers(knot.duration_right, order)
    own = _weigh(matrix[at_end, at_end], left) + _weigh(matrix[at_start, at_start], right)
    to_left = _weigh(matrix[at_end, at_start], left)
    to_right = _weigh(matrix[at_start, at_end], right)
    force = -(
        _pull(matrix[at_end, goal], left) * knot.step_left
        + _pull(matrix[at_start, goal], right) * knot.step_right
        + blocks.multiply(own, knot.value)
        + blocks.multiply(to_left, knot.value_before)
        + blocks.multiply(to_right, knot.value_after)
    )
    diagonal = jnp.stack([own[k, k] for k in range(order)])
    unknown = ~knot.known & (diagonal > 0.0)
    scale = jnp.where(unknown, jax.lax.rsqrt(jnp.where(unknown, diagonal, 1.0)), 0.0)
    own = own * scale[:, None] * scale[None] + jnp.eye(order, dtype=own.dtype)[..., None] * ~unknown
    to_left = to_left * scale[:, None] * previous.scale[None]
    coupling = blocks.solve_lower(previous.cholesky, jnp.swapaxes(to_left, 0, 1))
    cholesky = blocks.cholesky(own - blocks.multiply_transposed(coupling, coupling))
    reduced = force * scale[:, None] - blocks.multiply_transposed(coupling, previous.forward)
    row = _Row(cholesky, coupling, blocks.solve_lower(cholesky, reduced), scale)
    return row, row


def _substitute(from_right: Float[Array, "r d b"], row: _Row) -> tuple[Float[Array, "r d b"], Float[Array, "r d b"]]:
    """Solve one row backwards; carries what this knot contributes to the knot before it."""
    unknown = blocks.solve_lower_transposed(row.cholesky, row.forward - from_right)
    return blocks.multiply(row.coupling, unknown), unknown


def _powers(duration: Float[Array, "b"], order: int) -> tuple[list[Float[Array, "b"]], Float[Array, "b"]]:
    """[T, T^2 .. T^r] and the weight T^-(2r-1) of the segment's energy (0 on padding)."""
    real = duration > 0.0
    safe = jnp.where(real, duration, 1.0)
    powers = [safe]
    for _ in range(order - 1):
        powers.append(powers[-1] * safe)
    return powers, jnp.where(real, safe / (powers[-1] * powers[-1]), 0.0)


def _weigh(block: np.ndarray, scales: tuple) -> Float[Array, "r r b"]:
    """The energy block of one segment in terms of time derivatives."""
    powers, weight = scales
    scaled = [power * weight for power in powers]
    order = range(len(powers))
    return jnp.stack([jnp.stack([float(block[k, j]) * scaled[k] * powers[j] for j in order]) for k in order])


def _pull(column: np.ndarray, scales: tuple) -> Float[Array, "r 1 b"]:
    """How a step of one metre over a segment acts on the derivatives at one of its ends."""
    powers, weight = scales
    return jnp.stack([float(column[k]) * power * weight for k, power in enumerate(powers)])[:, None]


def _surround(values: Float[Array, "n ..."]) -> Float[Array, "n+2 ..."]:
    blank = jnp.zeros_like(values[:1])
    return jnp.concatenate([blank, values, blank])


def segment_coefficients(
    durations: Float[Array, "m b"],
    starts: Float[Array, "m d b"],
    steps: Float[Array, "m d b"],
    knots: Float[Array, "m+1 r d b"],
) -> Float[Array, "m n d b"]:
    """Ascending coefficients in normalised time (n = 2r+2) from waypoints and knot derivatives."""
    order = knots.shape[1]
    powers = jnp.cumprod(jnp.broadcast_to(durations[:, None], (len(durations), order, durations.shape[-1])), axis=1)
    left, right = knots[:-1] * powers[:, :, None], knots[1:] * powers[:, :, None]
    ends = jnp.concatenate([jnp.zeros_like(steps)[:, None], left, steps[:, None], right], axis=1)
    basis = jnp.asarray(hermite.coefficients(order), durations.dtype)
    coefficients = jnp.einsum("ij,mjdb->midb", basis, ends)
    return coefficients.at[:, 0].add(starts)
