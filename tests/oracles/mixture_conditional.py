"""Conditioning a mixture the textbook way: covariances, ``solve`` and SciPy's own densities."""

import numpy as np
from scipy.special import logsumexp
from scipy.stats import multivariate_normal


def conditional(weights, means, covariances, observed):
    """Logarithms of weights, means (k, n) and covariances (k, n, n) of what is left, given the first coordinates."""
    q = len(observed)
    densities = [
        np.log(w) + multivariate_normal.logpdf(observed, m[:q], c[:q, :q])
        for w, m, c in zip(weights, means, covariances, strict=True)
    ]
    gains = [np.linalg.solve(c[:q, :q], c[:q, q:]).T for c in covariances]
    centres = [m[q:] + g @ (observed - m[:q]) for m, g in zip(means, gains, strict=True)]
    spreads = [c[q:, q:] - g @ c[:q, q:] for c, g in zip(covariances, gains, strict=True)]
    return densities - logsumexp(densities), np.array(centres), np.array(spreads)


def mixture_log_density(log_weights, means, covariances, point):
    """Logarithm of the density at one point."""
    parts = [
        w + multivariate_normal.logpdf(point, m, c) for w, m, c in zip(log_weights, means, covariances, strict=True)
    ]
    return logsumexp(parts)
