"""Fitting a mixture of normal distributions to windows, by scikit-learn's EM.

Two things are added to what EM finds, both in the direction of admitting ignorance:

- a floor: the variance of an observation's noise is added to every coordinate. EM sees noiseless flights, whose last
  ten positions give away five derivatives; no sensor does.
- shrinkage: each covariance is averaged with the pooled one, scaled to its own trace, as if ``shrinkage`` further
  windows had been seen (Friedman, Regularized discriminant analysis, 1989). A component of few windows has directions
  in which these differ by chance less than others will. Above the floor little is left for it to do: with 10,000 to
  30,000 windows more than a trace of it lowers the likelihood of held-out windows.

How many components there are is decided by the likelihood of windows that were held out.
"""

import dataclasses
import warnings
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular
from scipy.special import logsumexp
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from jaxplan.errors import InputError
from jaxplan.prediction.mixture import covariance_factors
from jaxplan.validation import require_at_least, require_positive

_LEAST_DEVIATION = 1e-9
"""Metres; coordinates whose standard deviation is below this are constant."""


@dataclasses.dataclass(frozen=True)
class FitConfig:
    """How a mixture is fitted."""

    components: tuple[int, ...] = (4, 8, 16)
    """Numbers of components to try; the likelihood of held-out windows decides."""
    floor: float = 0.01
    """Standard deviation [m] of the noise added to every coordinate."""
    shrinkage: float = 1.0
    """Windows' worth of the pooled covariance in each component's."""
    iterations: int = 60
    """Most EM iterations."""
    tolerance: float = 1e-2
    """Gain of log-likelihood per window at which EM stops."""
    seed: int = 0
    """Seed of the fit, and of the flights where those are drawn for it."""

    def __post_init__(self) -> None:
        if not self.components or min(self.components) < 1:
            raise InputError(f"fit: components are {self.components}, want counts of at least 1")
        require_positive("fit", self, "floor", "tolerance")
        require_at_least("fit", self, 0.0, "shrinkage")
        require_at_least("fit", self, 1, "iterations")


@dataclasses.dataclass(frozen=True)
class Fit:
    """A mixture in the form that ``jaxplan.prediction.mixture.conditional_mixture`` wants."""

    weights: Float[np.ndarray, "k"]
    """With the sum 1."""
    means: Float[np.ndarray, "k d"]
    factors: Float[np.ndarray, "k d d"]
    """Lower triangular factors of the covariances."""
    log_likelihood: float
    """Mean logarithm of the density of the held-out windows."""
    converged: bool
    """Whether EM stopped before ``FitConfig.iterations``."""


def fit_mixture(
    training: Annotated[ArrayLike, "n d"],
    held_out: Annotated[ArrayLike, "m d"],
    config: FitConfig = FitConfig(),
) -> tuple[Fit, dict[int, float]]:
    """The mixture whose number of components makes the held-out windows likeliest, and the scores of all numbers.

    Args:
        training: windows to fit, d coordinates [m] each.
        held_out: windows that decide between the numbers of components.
        config: how the mixture is fitted.

    Raises:
        InputError: the windows are too few, constant, not finite, or of different sizes.
    """
    seen, unseen = _checked(training, held_out, config.components)
    fits = {count: _fit(seen, unseen, count, config) for count in sorted(set(config.components))}
    best = max(fits, key=lambda count: fits[count].log_likelihood)
    return fits[best], {count: fit.log_likelihood for count, fit in fits.items()}


def log_likelihood(
    weights: Float[np.ndarray, "k"],
    means: Float[np.ndarray, "k d"],
    factors: Float[np.ndarray, "k d d"],
    points: Float[np.ndarray, "n d"],
) -> Float[np.ndarray, "n"]:
    """Logarithm of the joint density of each point under the mixture, whose ``factors`` are lower triangular (host)."""
    parts = []
    for weight, mean, factor in zip(weights, means, factors, strict=True):
        white = solve_triangular(factor, (points - mean).T, lower=True)
        constant = np.log(weight) - np.log(np.diag(factor)).sum() - 0.5 * len(mean) * np.log(2.0 * np.pi)
        parts.append(constant - 0.5 * (white**2).sum(axis=0))
    return logsumexp(parts, axis=0)


def _fit(training: Float[np.ndarray, "n d"], held_out: Float[np.ndarray, "m d"], count: int, config: FitConfig) -> Fit:
    model = GaussianMixture(
        count,
        reg_covar=config.floor**2,
        max_iter=config.iterations,
        tol=config.tolerance,
        random_state=config.seed,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # reported as ``converged``
        model.fit(training)
    factors = covariance_factors(_shrunk(model.weights_, model.covariances_, len(training), config.shrinkage))
    score = float(log_likelihood(model.weights_, model.means_, factors, held_out).mean())
    return Fit(model.weights_, model.means_, factors, score, bool(model.converged_))


def _shrunk(
    weights: Float[np.ndarray, "k"], covariances: Float[np.ndarray, "k d d"], windows: int, strength: float
) -> Float[np.ndarray, "k d d"]:
    """Each covariance drawn to the shape of the pooled one, the more the fewer windows it was made from."""
    traces = np.trace(covariances, axis1=1, axis2=2)
    shapes = covariances / traces[:, None, None]
    pooled = np.einsum("k,kij->ij", weights, shapes)
    share = strength / (strength + weights * windows)
    return ((1.0 - share)[:, None, None] * shapes + share[:, None, None] * pooled) * traces[:, None, None]


def _checked(
    training: Annotated[ArrayLike, "n d"], held_out: Annotated[ArrayLike, "m d"], components: Sequence[int]
) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "m d"]]:
    """Both as tables of float64; InputError for what cannot be fitted."""
    training, held_out = np.asarray(training, dtype=float), np.asarray(held_out, dtype=float)
    if training.ndim != 2 or held_out.ndim != 2 or training.shape[1] != held_out.shape[1]:
        raise InputError(f"fit: windows have the shapes {training.shape} and {held_out.shape}, want (n, d) and (m, d)")
    least = 2 * max(components)
    if len(training) < least or len(held_out) < 1:
        have = f"{len(training)} windows to fit and {len(held_out)} held out"
        raise InputError(f"fit: have {have}, want at least {least} and 1 for {max(components)} components")
    if not (np.isfinite(training).all() and np.isfinite(held_out).all()):
        raise InputError("fit: windows have values that are not finite; remove them")
    constant = np.flatnonzero(training.std(axis=0) < _LEAST_DEVIATION)
    if len(constant):
        raise InputError(f"fit: coordinate {constant[0]} is the same in all windows; want targets that move")
    return training, held_out
