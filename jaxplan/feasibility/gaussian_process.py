"""Sparse variational Gaussian processes with a Bernoulli likelihood, and a kernel that learns from a low fidelity.

A process f is known through its values at m inducing inputs Z, whitened: f(Z) = L v with L L^T = k(Z, Z), and
q(v) = N(mean, root root^T). Then (Hensman, Matthews & Ghahramani, AISTATS 2015), with a = L^-1 k(Z, x),

    E f(x) = offset + a^T mean,    Var f(x) = k(x, x) - a^T a + |root^T a|^2,

and the evidence lower bound is sum_i E log Phi(y_i f(x_i)) - KL(q(v) || N(0, I)).

The kernel relates the high fidelity to the l values f_low of the low one (Perdikaris et al., Proc. R. Soc. A 473, 2017;
Li et al., MFRL): k_own(z, z') + k_corr(z, z') (k_f(f_low, f_low') + f_low . f_low' / l).
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular
from jax.scipy.special import log_ndtr, ndtr
from jaxtyping import Array, Bool, Float, Int

JITTER = 1e-4
"""Added to the diagonal of k(Z, Z), relative to its largest entry; float32 needs as much."""
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(20)
"""Gauss-Hermite rule for expectations under N(0, 1); the weights add up to sqrt(2 pi)."""


class Rbf(NamedTuple):
    """Squared exponential kernel with a length for every dimension; logarithms are stored."""

    log_lengths: Float[Array, "d"]
    log_scale: Float[Array, ""]
    """Of the standard deviation."""

    def __call__(self, x: Float[Array, "n d"], y: Float[Array, "m d"]) -> Float[Array, "n m"]:
        """Covariances of f at ``x`` and at ``y``."""
        rates = jnp.exp(-self.log_lengths)[None]
        x, y = x * rates, y * rates
        squared = jnp.sum(x * x, axis=1)[:, None] + jnp.sum(y * y, axis=1)[None] - 2.0 * x @ y.T
        return jnp.exp(2.0 * self.log_scale - 0.5 * jnp.maximum(squared, 0.0))


class Related(NamedTuple):
    """The kernel of the high fidelity, on inputs (z, f_low), f_low of l numbers."""

    own: Rbf
    correlation: Rbf
    low: Rbf
    """On f_low alone."""

    def __call__(self, x: Float[Array, "n e"], y: Float[Array, "m e"]) -> Float[Array, "n m"]:
        """Covariances of f at ``x`` and at ``y``; e = d + l."""
        (x, x_low), (y, y_low) = self.split(x), self.split(y)
        shared = self.low(x_low, y_low) + x_low @ y_low.T / x_low.shape[1]
        return self.own(x, y) + self.correlation(x, y) * shared

    def split(self, x: Float[Array, "n e"]) -> tuple[Float[Array, "n d"], Float[Array, "n l"]]:
        """z and f_low; e = d + l."""
        d = len(self.own.log_lengths)
        return x[:, :d], x[:, d:]


class Process(NamedTuple):
    """One sparse process: its kernel and its whitened variational distribution."""

    kernel: Rbf | Related
    inducing: Float[Array, "m d"]
    offset: Float[Array, ""]
    mean: Float[Array, "m"]
    root: Float[Array, "m m"]
    """Below the diagonal as it is, on it as a logarithm."""


class Posterior(NamedTuple):
    """A process made ready for many queries: what does not depend on the query is computed."""

    kernel: Rbf | Related
    inducing: Float[Array, "m d"]
    offset: Float[Array, ""]
    weights: Float[Array, "m"]
    """E f(x) = offset + k(x, Z) weights."""
    shrink: Float[Array, "m m"]
    """Var f(x) = k(x, x) - k(x, Z) shrink k(Z, x)."""


def rbf(dimensions: int, length: float = 1.0, scale: float = 1.0) -> Rbf:
    """A kernel of one length in all dimensions; ``scale`` is the standard deviation of f."""
    return Rbf(jnp.full(dimensions, np.log(length), jnp.float32), jnp.float32(np.log(scale)))


def related(dimensions: int, low: int, length: float = 1.0) -> Related:
    """A priori the low fidelity counts much, and alike nearly everywhere: what departs from that takes labels."""
    return Related(
        own=rbf(dimensions, length),
        correlation=rbf(dimensions, 8.0 * length, 2.0),
        low=rbf(low, 0.5 * float(np.sqrt(low))),
    )


def new_process(kernel: Rbf | Related, inducing: Float[Array, "m d"]) -> Process:
    """The prior, with inducing inputs where they are."""
    count = len(inducing)
    return Process(
        kernel, inducing, jnp.float32(0.0), jnp.zeros(count, inducing.dtype), jnp.zeros((count, count), inducing.dtype)
    )


def marginals(process: Process, x: Float[Array, "n d"]) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
    """Mean and variance of f at ``x``."""
    whitened = solve_triangular(_factor(process), process.kernel(process.inducing, x), lower=True)
    inner = jnp.sum(whitened**2, axis=0) - jnp.sum((_root(process).T @ whitened) ** 2, axis=0)
    return process.offset + whitened.T @ process.mean, jnp.maximum(_diagonal(process.kernel, x) - inner, 1e-6)


def posterior(process: Process) -> Posterior:
    """The same marginals in two matrix products a query."""
    factor, root = _factor(process), _root(process)
    inverse = solve_triangular(factor, jnp.eye(len(factor), dtype=factor.dtype), lower=True)
    shrink = inverse.T @ (jnp.eye(len(factor), dtype=factor.dtype) - root @ root.T) @ inverse
    return Posterior(process.kernel, process.inducing, process.offset, inverse.T @ process.mean, shrink)


def predict(posterior: Posterior, x: Float[Array, "n d"]) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
    """Mean and variance of f at ``x``, as ``marginals`` gives them."""
    cross = posterior.kernel(x, posterior.inducing)
    inner = jnp.sum((cross @ posterior.shrink) * cross, axis=1)
    variance = jnp.maximum(_diagonal(posterior.kernel, x) - inner, 1e-6)
    return posterior.offset + cross @ posterior.weights, variance


def probability(mean: Float[Array, "n"], variance: Float[Array, "n"]) -> Float[Array, "n"]:
    """P(y = 1) = E Phi(f) for f ~ N(mean, variance)."""
    return ndtr(mean / jnp.sqrt(1.0 + variance))


def expected_log_likelihood(
    mean: Float[Array, "n"], variance: Float[Array, "n"], positive: Bool[Array, "n"]
) -> Float[Array, "n"]:
    """E log Phi(y f), y = 1 or -1, by quadrature."""
    sign = jnp.where(positive, 1.0, -1.0).astype(mean.dtype)
    nodes, weights = jnp.asarray(NODES, mean.dtype), jnp.asarray(WEIGHTS / np.sqrt(2.0 * np.pi), mean.dtype)
    samples = (mean[None] + nodes[:, None] * jnp.sqrt(variance)[None]) * sign[None]
    return weights @ log_ndtr(samples)


def divergence(process: Process) -> Float[Array, ""]:
    """KL(q(v) || N(0, I))."""
    root = _root(process)
    trace = jnp.sum(root**2) + jnp.sum(process.mean**2)
    return 0.5 * (trace - len(root)) - jnp.sum(jnp.diag(process.root))


def lower_bound(
    process: Process, x: Float[Array, "n d"], positive: Bool[Array, "n"], size: int | Int[Array, ""]
) -> Float[Array, ""]:
    """Evidence lower bound per datum, from a sample of a data set of ``size``."""
    likelihood = expected_log_likelihood(*marginals(process, x), positive)
    return jnp.mean(likelihood) - divergence(process) / jnp.asarray(size, x.dtype)


def _factor(process: Process) -> Float[Array, "m m"]:
    covariance = process.kernel(process.inducing, process.inducing)
    largest = jnp.max(jnp.diag(covariance))
    return jnp.linalg.cholesky(covariance + JITTER * largest * jnp.eye(len(covariance), dtype=covariance.dtype))


def _root(process: Process) -> Float[Array, "m m"]:
    return jnp.tril(process.root, -1) + jnp.diag(jnp.exp(jnp.diag(process.root)))


def _diagonal(kernel: Rbf | Related, x: Float[Array, "n d"]) -> Float[Array, "n"]:
    """k(x, x)."""
    if isinstance(kernel, Rbf):
        return jnp.full(len(x), jnp.exp(2.0 * kernel.log_scale))
    own, correlation, low = (jnp.exp(2.0 * part.log_scale) for part in kernel)
    return own + correlation * (low + jnp.mean(kernel.split(x)[1] ** 2, axis=1))
