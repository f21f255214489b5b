"""Symmetric block-tridiagonal systems of a minimum-snap problem, solved exactly for a whole batch.

    D_i x_i + U_{i-1}^T x_{i-1} + U_i x_{i+1} = f_i,    i = 0 .. n-1, blocks r x r

with U_i = K_se * c_i a_{i+1}^T (elementwise) and D_i = K_ee * a_i a_i^T + K_ss * c_i c_i^T off its diagonal, where a_i
and c_i scale the energy of the segments before and behind knot i. The unknowns are scaled so that the diagonal of D_i
is 1, also where an unknown is prescribed (then a_i = c_i = f_i = 0, so x_i = 0). Block Cholesky: with upper triangular
R_i, R_i^T R_i = D_i - V_{i-1}^T V_{i-1} and V_i = R_i^-T U_i, knot after knot; then back substitution.

Written for XLA on a CPU, and measured (docs/decisions/0006-minimum-snap.md): the batch is the last axis, so that every
scalar of the block algebra is one vector; a row of a block is one array, because stacking its entries would stop
vectorisation; rows are divided by their pivot rather than multiplied by its inverse, because XLA repeats a cheap
producer in each of its consumers and a division in none.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.batching import in_chunks
from jaxplan.minsnap import hermite


class Rows(NamedTuple):
    """The system: one row of blocks per knot."""

    before: Float[Array, "n r b"]
    """a_i: 0 where the unknown is prescribed or the segment before the knot does not exist."""
    behind: Float[Array, "n r b"]
    """c_i, likewise for the segment behind the knot."""


class _Row(NamedTuple):
    """Row k of R_i and what belongs to it."""

    pivot: Float[Array, "b"]
    own: Float[Array, "o b"]
    """The entries right of the pivot: o = r - 1 - k."""
    link: Float[Array, "r b"]
    """Row k of V_i: how the next knot enters."""
    right: Float[Array, "d b"]
    """Row k of R_i^-T times what remains of f_i."""


Values = list[Float[Array, "d b"]]
"""x of one knot, by row."""


def solve(rows: Rows, force: Float[Array, "n r d b"]) -> Float[Array, "n r d b"]:
    """x of the system for the right-hand side ``force``, which must be 0 where x is prescribed."""
    if len(force) == 0:
        return force
    return in_chunks(lambda system: _sweep(*system), (rows, force), force.shape[-1])


def _sweep(rows: Rows, force: Float[Array, "n r d b"]) -> Float[Array, "n r d b"]:
    """Forward elimination and back substitution."""
    _, order, axes, width = force.shape
    before_next = jnp.concatenate([rows.before[1:], jnp.zeros_like(rows.before[:1])])
    blank = jnp.zeros((order + axes, width), force.dtype)
    nothing = [_Row(blank[0], blank[: order - 1 - k], blank[:order], blank[:axes]) for k in range(order)]
    _, factor = jax.lax.scan(_eliminate, nothing, (rows, before_next, force))
    beyond = [jnp.zeros((axes, width), force.dtype)] * order
    _, x = jax.lax.scan(_substitute, beyond, factor, reverse=True)
    return jnp.stack(x, axis=1)


def multiply(rows: Rows, x: Float[Array, "n r d b"]) -> Float[Array, "n r d b"]:
    """The left-hand side of the system."""
    start, end, across = _energy_blocks(x.shape[1])
    before, behind = rows.before[:, :, None], rows.behind[:, :, None]
    into, out_of = before * x, behind * x
    product = x + before * _apply(_off_diagonal(end), into) + behind * _apply(_off_diagonal(start), out_of)
    product = product.at[:-1].add(behind[:-1] * _apply(across, into[1:]))
    return product.at[1:].add(before[1:] * _apply(across.T, out_of[:-1]))


def _eliminate(
    earlier: list[_Row], knot: tuple[Rows, Float[Array, "r b"], Float[Array, "r d b"]]
) -> tuple[list[_Row], list[_Row]]:
    """Subtract what the knot before determines, then factor this knot's block row by row."""
    (before, behind), before_next, force = knot
    start, end, across = (jnp.asarray(block, force.dtype)[..., None] for block in _energy_blocks(len(before)))
    rows: list[_Row] = []
    for k in range(len(before)):
        rest = slice(k + 1, None)
        pivot: Any = 1.0 - _sum([row.link[k] ** 2 for row in earlier])
        own = end[k, rest] * (before[k][None] * before[rest]) + start[k, rest] * (behind[k][None] * behind[rest])
        own -= _sum([row.link[k][None] * row.link[rest] for row in earlier])
        link = across[k] * (behind[k][None] * before_next)
        right = force[k] - _sum([row.link[k][None] * row.right for row in earlier])
        for j, row in enumerate(rows):
            factor = row.own[k - j - 1]
            pivot -= factor**2
            own -= factor[None] * row.own[k - j :]
            link -= factor[None] * row.link
            right -= factor[None] * row.right
        root = jnp.sqrt(pivot)
        rows.append(_Row(root, own / root[None], link / root[None], right / root[None]))
    return rows, rows


def _substitute(later: Values, rows: list[_Row]) -> tuple[Values, Values]:
    """The backward step: from x of the next knot to x of this knot."""
    x: Values = []
    for row in reversed(rows):
        known = _sum([row.link[j][None] * value for j, value in enumerate(later)])
        known += _sum([row.own[j][None] * value for j, value in enumerate(x)])
        x.insert(0, (row.right - known) / row.pivot[None])
    return x, x


def _energy_blocks(
    order: int,
) -> tuple[Float[np.ndarray, "r r"], Float[np.ndarray, "r r"], Float[np.ndarray, "r r"]]:
    """K_ss, K_ee and K_se: the energy of a segment in the derivatives at its start and its end."""
    energy = hermite.energy(order)
    start, end = slice(1, order + 1), slice(order + 2, 2 * order + 2)
    return energy[start, start], energy[end, end], energy[start, end]


def _off_diagonal(matrix: Float[np.ndarray, "r r"]) -> Float[np.ndarray, "r r"]:
    return matrix - np.diag(np.diag(matrix))


def _apply(matrix: Float[np.ndarray, "r r"], x: Float[Array, "n r d b"]) -> Float[Array, "n r d b"]:
    columns = jnp.asarray(matrix, x.dtype)[None, :, :, None, None]
    return _sum([columns[:, :, j] * x[:, j : j + 1] for j in range(x.shape[1])])


def _sum(terms: list[Array]) -> Any:
    return sum(terms[1:], start=terms[0]) if terms else 0.0
