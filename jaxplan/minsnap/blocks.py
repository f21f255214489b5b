"""Algebra of small dense blocks with the batch as the last axis.

Every function is unrolled over the block (2 x 2 or 4 x 4) and vectorised over the batch. LAPACK's batched
routines are slower here by an order of magnitude, and hang in some versions of JAX on two-core machines.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def multiply(a: Float[Array, "n k b"], x: Float[Array, "k *d b"]) -> Float[Array, "n *d b"]:
    """a @ x for every lane."""
    return _stack([_sum([a[i, k] * x[k] for k in range(a.shape[1])]) for i in range(a.shape[0])])


def multiply_transposed(a: Float[Array, "k n b"], x: Float[Array, "k *d b"]) -> Float[Array, "n *d b"]:
    """a.T @ x for every lane."""
    return _stack([_sum([a[k, i] * x[k] for k in range(a.shape[0])]) for i in range(a.shape[1])])


def cholesky(a: Float[Array, "n n b"]) -> Float[Array, "n n b"]:
    """Lower factor of a symmetric positive definite block, with the *inverse* diagonal on its diagonal."""
    n = a.shape[0]
    lower: list[list[Array]] = [[jnp.zeros_like(a[0, 0])] * n for _ in range(n)]
    for j in range(n):
        pivot = a[j, j] - _sum([lower[j][k] * lower[j][k] for k in range(j)])
        lower[j][j] = jax.lax.rsqrt(pivot)
        for i in range(j + 1, n):
            lower[i][j] = (a[i, j] - _sum([lower[i][k] * lower[j][k] for k in range(j)])) * lower[j][j]
    return jnp.stack([jnp.stack(row) for row in lower])


def solve_lower(lower: Float[Array, "n n b"], x: Float[Array, "n *d b"]) -> Float[Array, "n *d b"]:
    """L^-1 x for a factor from ``cholesky``."""
    solved: list[Array] = []
    for i in range(lower.shape[0]):
        solved.append((x[i] - _sum([lower[i, k] * solved[k] for k in range(i)])) * lower[i, i])
    return _stack(solved)


def solve_lower_transposed(lower: Float[Array, "n n b"], x: Float[Array, "n *d b"]) -> Float[Array, "n *d b"]:
    """L^-T x for a factor from ``cholesky``."""
    n = lower.shape[0]
    solved: list[Array] = [x[0]] * n
    for i in reversed(range(n)):
        solved[i] = (x[i] - _sum([lower[k, i] * solved[k] for k in range(i + 1, n)])) * lower[i, i]
    return _stack(solved)


def _sum(terms: list[Array]) -> Array | float:
    return sum(terms[1:], start=terms[0]) if terms else 0.0


def _stack(rows: list[Array]) -> Array:
    return jnp.stack(rows)
