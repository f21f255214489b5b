"""Mixtures of normal distributions: conditioning on what is observed, marginals per step, draws and densities.

Joint model of a window y = (o, f), q observed coordinates and s future positions of three coordinates:

    p(y) = sum_k pi_k N(y | mu_k, L_k L_k^T),   L_k = [[A_k, 0], [B_k, C_k]] lower triangular.

The factor is ordered so that nothing has to be solved when an observation comes in: with z_k = A_k^-1 (o - mu_k,o)

    p(f | o) = sum_k w_k N(f | mu_k,f + B_k z_k, C_k C_k^T),   log w_k = log pi_k - log det A_k - |z_k|^2 / 2 + const

(Bishop, Pattern Recognition and Machine Learning, 2006, eq. 2.81 and 2.82, written with Cholesky factors). The
conditional covariance is a product of a factor with its transpose, so it is never indefinite, and it does not depend
on o: the factors of its blocks, one for each step, are computed once. Weights are normalised in logarithms.

``condition``, ``draw`` and ``log_density`` are pure JAX for one observation, in float64 where the caller's JAX has
64-bit types enabled; batch them with ``vmap``. The other functions run on the host in NumPy float64.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.linalg import solve_triangular

from jaxplan.arrays import AnyArray
from jaxplan.records import record, replace

CONDITION_LIMIT = 1e12
"""Largest condition number of a covariance; smaller eigenvalues are raised, so that float64 can factor it."""
MODES = 18
"""Principal axes that are kept for whole futures; what is left of the shipped models is below 4 cm, mostly below 1."""
LEAST_VARIANCE = 1e-18
"""m^2; no eigenvalue stays below: a nanometre, so that the inverses of factors stay far from overflow."""
_LOG_TWO_PI = float(np.log(2.0 * np.pi))


@record
class Prediction:
    """Where a target may be at s future instants: at each a mixture of c normal distributions, components last."""

    offsets: Float[AnyArray, "s"]
    """Seconds from the newest observation."""
    log_weights: Float[AnyArray, "c"]
    """Normalised; the same at every instant."""
    means: Float[AnyArray, "s 3 c"]
    """Metres, world."""
    factors: Float[AnyArray, "s 3 3 c"]
    """Lower triangular factors of the covariances [m]; 0 for a position that is certain."""

    @property
    def mean(self) -> Float[np.ndarray, "s 3"]:
        """The expected positions [m, world] (host)."""
        return np.asarray(self.means) @ np.exp(self.log_weights)


@record
class ConditionalMixture:
    """A joint mixture made ready for conditioning on its first q coordinates; components last, for speed.

    Both z_k and the conditional means are affine in the observation: two matrix-vector products serve all components.
    """

    log_weights: Float[AnyArray, "k"]
    """log pi_k - log det A_k - q/2 log 2 pi: with -|z|^2/2 the joint log-density of component and observation."""
    rows: Float[AnyArray, "n k q"]
    """A_k^-1 above B_k A_k^-1, n = q + 3 s."""
    constants: Float[AnyArray, "n k"]
    """-A_k^-1 mu_k,o above mu_k,f - B_k A_k^-1 mu_k,o."""
    factors: Float[AnyArray, "s 3 3 k"]
    """Lower triangular factors of the 3 x 3 blocks of C_k C_k^T on the diagonal."""
    inverses: Float[AnyArray, "s 3 3 k"]
    """Their inverses."""
    log_volumes: Float[AnyArray, "s k"]
    """Logarithms of their determinants [log m^3]."""
    modes: Float[AnyArray, "k r f"]
    """The r strongest principal axes of C_k C_k^T, in order, each times its deviation [m]; f = 3 s coordinates."""


def covariance_factors(covariances: Float[np.ndarray, "k d d"]) -> Float[np.ndarray, "k d d"]:
    """Lower triangular factors of symmetric matrices; singular or indefinite ones are repaired first.

    Eigenvalues below the largest over ``CONDITION_LIMIT``, or below ``LEAST_VARIANCE``, are raised to it (Higham,
    Computing a nearest symmetric positive semidefinite matrix, 1988).
    Matrices that need no repair are factored as they are.
    """
    symmetric = 0.5 * (covariances + np.swapaxes(covariances, -1, -2))
    values, vectors = np.linalg.eigh(symmetric)
    floor = np.maximum(values[..., -1:] / CONDITION_LIMIT, LEAST_VARIANCE)
    weak = values[..., 0] < floor[..., 0]
    raised = np.maximum(values, floor)
    repaired = (vectors * raised[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return np.linalg.cholesky(np.where(weak[..., None, None], repaired, symmetric))


def conditional_mixture(
    weights: Float[np.ndarray, "k"],
    means: Float[np.ndarray, "k d"],
    factors: Float[np.ndarray, "k d d"],
    observed: int,
    seen: Bool[np.ndarray, "q"] | None = None,
) -> ConditionalMixture:
    """A mixture made ready for conditioning on its first coordinates.

    Args:
        weights: of the components, with the sum 1.
        means: d = observed + 3 s coordinates [m], the observed ones first.
        factors: lower triangular factors of the covariances [m].
        observed: how many coordinates are observed.
        seen: which of these count. The others may have any finite value: they are marginalised.
    """
    components, size = means.shape
    if seen is not None and not seen.all():
        kept: Int[np.ndarray, "n"] = np.append(np.flatnonzero(seen), np.arange(observed, size))
        chosen = factors[:, kept]
        marginal = np.linalg.cholesky(chosen @ np.swapaxes(chosen, -1, -2))
        return _widened(conditional_mixture(weights, means[:, kept], marginal, int(seen.sum())), seen)
    steps = (size - observed) // 3
    head, cross = factors[:, :observed, :observed], factors[:, observed:, :observed]
    tail = factors[:, observed:, observed:]
    identity = np.eye(observed)
    whitening = np.stack([solve_triangular(block, identity, lower=True) for block in head])
    rows = np.concatenate([whitening, cross @ whitening], axis=1)
    constants = -np.einsum("kni,ki->kn", rows, means[:, :observed])
    constants[:, observed:] += means[:, observed:]
    # A step's rows times their transpose are its block; the block's factor is R^T of a QR of the transposed rows.
    steep = np.swapaxes(tail.reshape(components, steps, 3, size - observed), -1, -2)
    upper = np.linalg.qr(steep, mode="r")
    signs = np.where(np.diagonal(upper, axis1=-2, axis2=-1) < 0.0, -1.0, 1.0)
    blocks = _components_last(np.tril(np.swapaxes(upper * signs[..., None], -1, -2)))
    determinant = np.log(np.diagonal(head, axis1=1, axis2=2)).sum(axis=1)
    inverses, log_volumes = density_terms(blocks)
    return ConditionalMixture(
        log_weights=np.log(weights) - determinant - 0.5 * observed * _LOG_TWO_PI,
        rows=np.ascontiguousarray(np.swapaxes(rows, 0, 1)),
        constants=np.ascontiguousarray(constants.T),
        factors=blocks,
        inverses=inverses,
        log_volumes=log_volumes,
        modes=_modes(tail),
    )


def condition(
    model: ConditionalMixture, observed: Float[AnyArray, "q"]
) -> tuple[Float[Array, "k"], Float[Array, "s 3 k"], Float[Array, ""]]:
    """Normalised log-weights and means of the future given what is observed, and how unusual that is.

    The means are in metres. The third value is the least squared Mahalanobis distance over the components: about q for
    a window like those the model was made from. The covariances do not depend on ``observed``: their factors stand in
    the model.
    """
    size = len(observed)
    affine = model.rows.reshape(-1, size) @ observed + model.constants.reshape(-1)
    white, means = jnp.split(affine.reshape(model.constants.shape), [size])
    squared = (white * white).sum(axis=0)
    log_weights = jax.nn.log_softmax(model.log_weights - 0.5 * squared)
    return log_weights, means.reshape(-1, 3, len(log_weights)), squared.min()


def draw(
    log_weights: Float[AnyArray, "c"],
    means: Float[AnyArray, "s 3 c"],
    factors: Float[AnyArray, "s 3 3 c"],
    uniform: Float[AnyArray, "s b"],
    normal: Float[AnyArray, "s b 3"],
) -> Float[Array, "s b 3"]:
    """b positions [m] from the mixture of each of s instants.

    Args:
        log_weights, means, factors: as of ``Prediction``.
        uniform: numbers in [0, 1) that choose the components.
        normal: independent standard normal numbers.
    """
    count = len(log_weights)
    shares = jnp.tril(jnp.ones((count, count))) @ jnp.exp(log_weights)  # cheaper than cumsum, which XLA makes quadratic
    component = (uniform[..., None] * shares[-1] >= shares[None, None, :-1]).sum(axis=-1)
    step = jnp.arange(len(means))[:, None]
    means, factors = jnp.asarray(means), jnp.asarray(factors)
    return means[step, :, component] + (factors[step, :, :, component] * normal[:, :, None, :]).sum(axis=-1)


def log_density(
    log_weights: Float[AnyArray, "c"],
    means: Float[AnyArray, "s 3 c"],
    inverses: Float[AnyArray, "s 3 3 c"],
    log_volumes: Float[AnyArray, "s c"],
    positions: Float[AnyArray, "s b 3"],
) -> Float[Array, "s b"]:
    """Logarithm of the density [1/m^3] of each instant's mixture at b positions [m].

    ``inverses`` and ``log_volumes`` are what ``density_terms`` makes of the factors.
    """
    dx, dy, dz = (positions[:, :, axis, None] - means[:, None, axis] for axis in range(3))
    row = inverses[:, :, :, None]
    x = row[:, 0, 0] * dx
    y = row[:, 1, 0] * dx + row[:, 1, 1] * dy
    z = row[:, 2, 0] * dx + row[:, 2, 1] * dy + row[:, 2, 2] * dz
    exponent = (log_weights[None] - log_volumes)[:, None] - 0.5 * (x * x + y * y + z * z)
    return jax.nn.logsumexp(exponent, axis=-1) - 1.5 * _LOG_TWO_PI


def density_terms(
    factors: Float[np.ndarray, "s 3 3 c"],
) -> tuple[Float[np.ndarray, "s 3 3 c"], Float[np.ndarray, "s c"]]:
    """Inverses [1/m] of regular factors [m], and logarithms of their determinants [log m^3], for ``log_density``."""
    inverses = np.linalg.inv(np.moveaxis(factors, -1, 1))
    diagonal = np.stack([factors[:, axis, axis] for axis in range(3)])
    return np.ascontiguousarray(np.moveaxis(inverses, 1, -1)), np.log(diagonal).sum(axis=0)


def draw_randoms(
    steps: int, batch: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "s b"], Float[np.ndarray, "s b 3"]]:
    """The uniform and the standard normal numbers that ``draw`` wants for ``batch`` positions at each step."""
    normal = rng.standard_normal((steps, batch, 3))
    return rng.random((steps, batch)), normal


def _modes(factors: Float[np.ndarray, "k f f"]) -> Float[np.ndarray, "k r f"]:
    """The strongest principal axes of the covariances with these factors."""
    axes, deviations, _ = np.linalg.svd(factors)
    return np.ascontiguousarray(np.swapaxes(axes * deviations[:, None], -1, -2)[:, :MODES])


def _widened(mixture: ConditionalMixture, seen: Bool[np.ndarray, "q"]) -> ConditionalMixture:
    """The same with observed coordinates in between that have no effect."""
    rows, constants = np.asarray(mixture.rows), np.asarray(mixture.constants)
    at: Bool[np.ndarray, "n"] = np.append(seen, np.ones(len(rows) - int(seen.sum()), bool))
    wide_rows, wide_constants = np.zeros((len(at), rows.shape[1], len(seen))), np.zeros((len(at), rows.shape[1]))
    wide_rows[np.ix_(at, np.arange(rows.shape[1]), seen)], wide_constants[at] = rows, constants
    return replace(mixture, rows=wide_rows, constants=wide_constants)


def _components_last(array: Float[np.ndarray, "k *n"]) -> Float[np.ndarray, "*n k"]:
    return np.ascontiguousarray(np.moveaxis(array, 0, -1))
