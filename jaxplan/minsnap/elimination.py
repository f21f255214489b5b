"""Symmetric block-tridiagonal systems of a minimum-snap problem, solved exactly for a whole batch.

    D_i x_i + U_{i-1}^T x_{i-1} + U_i x_{i+1} = f_i,    i = 0 .. n-1, blocks r x r

with D_i = K_ee * a_i a_i^T + K_ss * c_i c_i^T + diag(fixed_i) and U_i = K_se * c_i a_{i+1}^T (elementwise), where a_i
and c_i scale the energy of the segments before and behind knot i. Block Cholesky, from both ends towards the middle
at the same time: K is symmetric under reversal of time, so the second half, mirrored, is further lanes of the first.

Written for XLA on a CPU, and measured (docs/decisions/0006-minimum-snap.md): the batch is the last axis, so that every
scalar of the block algebra is one vector; a whole row of a block is one array, because stacking its entries would
stop vectorisation; rows are divided by their pivot rather than multiplied by its inverse, because XLA repeats a cheap
producer in each of its consumers and a division in none.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.minsnap import hermite


class Rows(NamedTuple):
    """The system: one row of blocks per knot. Unknowns are scaled so that the diagonal of each D_i is 1."""

    before: Float[Array, "n r b"]
    """a_i: 0 where the unknown is prescribed or the segment before the knot does not exist."""
    behind: Float[Array, "n r b"]
    """c_i, likewise for the segment behind the knot."""
    fixed: Float[Array, "n r b"]
    """1 where the entry is prescribed (its x is 0), else 0."""


class _Factor(NamedTuple):
    """Rows of the Cholesky factor: ``own[k]`` holds [right-hand side, block row k], ``next[k]`` the coupling."""

    own: tuple[Float[Array, "w b"], ...]
    next: tuple[Float[Array, "r b"], ...]


def solve(rows: Rows, force: Float[Array, "n r d b"]) -> Float[Array, "n r d b"]:
    """x of the system for the right-hand side ``force``, which must be 0 where ``fixed``."""
    n, order, axes, lanes = force.shape
    if n == 0:
        return force
    odd = jax.tree.map(lambda x: x if n % 2 else jnp.concatenate([x, jnp.zeros_like(x[:1])]), (rows, force))
    halves, packed = _mirrored(odd[0], odd[1], padding=0 if n % 2 else 1)
    middle = len(packed) - 1
    start = tuple(jnp.zeros((packed.shape[2], 2 * lanes), force.dtype) for _ in range(order))
    carry, factors = jax.lax.scan(
        _eliminate, start, (packed[:middle], halves.behind[:middle], halves.before[1 : middle + 1])
    )
    sign = jnp.asarray(hermite.reversal(order), force.dtype)
    at_middle = _meet(packed[middle], carry, sign)
    last = _solve_row(at_middle, [row[:axes] for row in at_middle])
    mirrored = [jnp.concatenate([x, s * x], axis=-1) for x, s in zip(last, sign, strict=True)]
    _, others = jax.lax.scan(_substitute(axes), tuple(mirrored), factors, reverse=True)
    both = jnp.stack(others, axis=1) if middle else jnp.zeros((0, order, axes, 2 * lanes), force.dtype)
    right = (sign[:, None, None] * both[..., lanes:])[::-1]
    return jnp.concatenate([both[..., :lanes], jnp.stack(last)[None], right])[:n]


def multiply(rows: Rows, x: Float[Array, "n r d b"]) -> Float[Array, "n r d b"]:
    """The left-hand side of the system."""
    start, end, across = _energy_blocks(x.shape[1])
    before, behind = rows.before[:, :, None], rows.behind[:, :, None]
    into, out_of = before * x, behind * x
    product = before * _apply(end, into) + behind * _apply(start, out_of) + rows.fixed[:, :, None] * x
    product = product.at[:-1].add(behind[:-1] * _apply(across, into[1:]))
    return product.at[1:].add(before[1:] * _apply(across.T, out_of[:-1]))


def _mirrored(rows: Rows, force: Float[Array, "n r d b"], padding: int) -> tuple[Rows, Float[Array, "h r w 2b"]]:
    """Both halves of the system, up to and with the middle row, side by side in the lanes.

    Also [right-hand side, D_i] packed as w columns, a multiple of 4 (so that XLA splits the rows evenly).
    """
    order, axes = force.shape[1:3]
    fixed = rows.fixed.at[-1].set(1.0) if padding else rows.fixed
    count = len(force) // 2 + 1
    before = jnp.concatenate([rows.before[:count], rows.behind[::-1][:count]], axis=-1)
    behind = jnp.concatenate([rows.behind[:count], rows.before[::-1][:count]], axis=-1)
    fixed = jnp.concatenate([fixed[:count], fixed[::-1][:count]], axis=-1)
    sign = jnp.asarray(hermite.reversal(order), force.dtype)[:, None, None]
    right = jnp.concatenate([force[:count], sign * force[::-1][:count]], axis=-1)
    start, end, _ = (jnp.asarray(block, force.dtype)[..., None] for block in _energy_blocks(order))
    own = end * (before[:, :, None] * before[:, None]) + start * (behind[:, :, None] * behind[:, None])
    own += jnp.eye(order, dtype=force.dtype)[..., None] * fixed[:, :, None]
    blank = jnp.zeros((count, order, -(axes + order) % 4, own.shape[-1]), force.dtype)
    return Rows(before, behind, fixed), jnp.concatenate([right, blank, own], axis=2)


def _eliminate(
    couplings: tuple[Float[Array, "w b"], ...],
    row: tuple[Float[Array, "r w b"], Float[Array, "r b"], Float[Array, "r b"]],
) -> tuple[tuple[Float[Array, "w b"], ...], _Factor]:
    """Subtract what the knot before determines, then factor this knot's block row by row.

    ``couplings[k]`` is [solved right-hand side, coupling to this knot] of row k of the knot before.
    """
    packed, behind, before_next = row
    order, width = packed.shape[:2]
    across = jnp.asarray(_energy_blocks(order)[2], packed.dtype)[..., None]
    shift = width - order
    own: list[Array] = []
    following: list[Array] = []
    for k in range(order):
        line = packed[k] - _sum([coupling[shift + k] * coupling for coupling in couplings])
        link = across[k] * (behind[k] * before_next)
        for j in range(k):
            line = line - own[j][shift + k] * own[j]
            link = link - own[j][shift + k] * following[j]
        pivot = jnp.sqrt(line[shift + k])
        own.append(line / pivot)
        following.append(link / pivot)
    pairs = zip(own, following, strict=True)
    return tuple(jnp.concatenate([a[:shift], b]) for a, b in pairs), _Factor(tuple(own), tuple(following))


def _meet(
    packed: Float[Array, "r w 2b"], couplings: tuple[Float[Array, "w 2b"], ...], sign: Float[Array, "r"]
) -> list[Float[Array, "w b"]]:
    """Factor the middle block, from which both halves subtract."""
    order, width, lanes = packed.shape[0], packed.shape[1], packed.shape[2] // 2
    shift = width - order
    columns = jnp.concatenate([jnp.ones(shift, packed.dtype), sign])[:, None]
    own: list[Array] = []
    for k in range(order):
        both = _sum([coupling[shift + k] * coupling for coupling in couplings])
        line = packed[k, :, :lanes] - both[:, :lanes] - sign[k] * columns * both[:, lanes:]
        for j in range(k):
            line = line - own[j][shift + k] * own[j]
        own.append(line / jnp.sqrt(line[shift + k]))
    return own


def _substitute(axes: int) -> Callable[[tuple, _Factor], tuple[tuple, tuple]]:
    """The backward step: from x of the knot behind to x of this knot."""

    def step(behind: tuple[Float[Array, "d b"], ...], row: _Factor) -> tuple[tuple, tuple]:
        right = [
            own[:axes] - _sum([link[j] * x for j, x in enumerate(behind)])
            for own, link in zip(row.own, row.next, strict=True)
        ]
        solved = tuple(_solve_row(row.own, right))
        return solved, solved

    return step


def _solve_row(
    own: list[Float[Array, "w b"]] | tuple[Float[Array, "w b"], ...], right: list[Float[Array, "d b"]]
) -> list[Float[Array, "d b"]]:
    """R^-1 right, for the rows of an upper triangular block."""
    order = len(own)
    shift = own[0].shape[0] - order
    solved: list[Array] = [right[0]] * order
    for k in reversed(range(order)):
        rest = right[k] - _sum([own[k][shift + j] * solved[j] for j in range(k + 1, order)])
        solved[k] = rest / own[k][shift + k]
    return solved


def _energy_blocks(order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """K_ss, K_ee and K_se: the energy of a segment in the derivatives at its start and its end."""
    energy = hermite.energy(order)
    start, end = slice(1, order + 1), slice(order + 2, 2 * order + 2)
    return energy[start, start], energy[end, end], energy[start, end]


def _apply(matrix: np.ndarray, x: Float[Array, "n r d b"]) -> Float[Array, "n r d b"]:
    columns = jnp.asarray(matrix, x.dtype)[:, :, None, None]
    return _sum([columns[:, j] * x[:, j : j + 1] for j in range(x.shape[1])])


def _sum(terms: list[Array]) -> Any:
    return sum(terms[1:], start=terms[0]) if terms else 0.0
