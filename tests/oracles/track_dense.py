"""Positions of a moving point as one normal distribution: what a Kalman filter must agree with, without recursion.

Velocity starts normal; an acceleration of known autocovariance is integrated twice, numerically. Conditioning is one
dense solve.
"""

import numpy as np
from scipy.stats import multivariate_normal


def fading_covariance(times, speed, acceleration, fading, grid=1500):
    """Covariance of an axis's positions at ``times`` [s], the first being 0, for an Ornstein-Uhlenbeck acceleration.

    By the trapezium rule for position = v t + int (t - s) a(s) ds.
    """
    instants = np.linspace(0.0, times[-1], grid)
    weights = np.full(grid, instants[1])
    weights[[0, -1]] *= 0.5
    lag = np.maximum(np.asarray(times)[:, None] - instants, 0.0) * weights
    kernel = acceleration**2 * np.exp(-np.abs(instants[:, None] - instants) / fading)
    return speed**2 * np.outer(times, times) + lag @ kernel @ lag.T


def white_covariance(times, speed, intensity):
    """The same where the acceleration is white: the covariance of an integrated Wiener process, in closed form."""
    low, high = np.minimum.outer(times, times), np.maximum.outer(times, times)
    return speed**2 * np.outer(times, times) + intensity**2 * low**2 * (3.0 * high - low) / 6.0


def newest_given(covariance, noise, positions):
    """Mean and variance of the newest position of an axis given all, and the density of those after the first."""
    size = len(positions)
    prior = covariance + noise**2 * np.ones((size, size))  # the start is only known as the first position was seen
    seen = prior + np.diag(np.r_[0.0, np.full(size - 1, noise**2)])
    rest, cross = seen[1:, 1:], prior[-1, 1:]
    off = positions[1:] - positions[0]
    mean = positions[0] + cross @ np.linalg.solve(rest, off)
    variance = prior[-1, -1] - cross @ np.linalg.solve(rest, cross)
    return mean, variance, multivariate_normal(np.zeros(size - 1), rest).logpdf(off)
