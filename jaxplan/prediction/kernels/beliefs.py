"""The filters of ``jaxplan.prediction.imm``, one position after another, compiled (host).

Each level of noise is a filter of its own. A belief is a plain tuple of arrays: ``log_levels`` (l,), ``log_weights``
(l, m), ``means`` (l, m, 3, 3) and ``covariances`` (l, m, 3, 3), as of ``imm.Belief``.
"""

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from jaxplan.prediction.imm_motions import TURN
from jaxplan.prediction.kernels.compiled import inner
from jaxplan.prediction.kernels.motions import expected_acceleration, move_on, turn_rate

LEAST_WEIGHT = 1e-30
LOG_TWO_PI = float(np.log(2.0 * np.pi))


def empty_belief(levels: int) -> tuple[Float[np.ndarray, "..."], ...]:
    """Room for a belief."""
    return np.zeros(levels), np.zeros((levels, 3)), np.zeros((levels, 3, 3, 3)), np.zeros((levels, 3, 3, 3))


@inner
@no_type_check
def copy_belief(to, belief):
    """Copy one belief into another."""
    for level in range(len(to[0])):
        to[0][level] = belief[0][level]
        for m in range(3):
            to[1][level, m] = belief[1][level, m]
            for i in range(3):
                for j in range(3):
                    to[2][level, m, i, j] = belief[2][level, m, i, j]
                    to[3][level, m, i, j] = belief[3][level, m, i, j]


@inner
@no_type_check
def begin_belief(belief, motion, noise, position, speed):
    """What is believed at the first position, of a target of about this speed [m/s]."""
    levels, log_shares = noise
    acceleration = expected_acceleration(motion, speed)
    for level in range(len(levels)):
        belief[0][level] = log_shares[level]
        for m in range(3):
            belief[1][level, m] = -math.log(3.0)
            for i in range(3):
                for j in range(3):
                    belief[2][level, m, i, j] = position[j] if i == 0 else 0.0
                    belief[3][level, m, i, j] = 0.0
            belief[3][level, m, 0, 0] = levels[level] * levels[level]
            belief[3][level, m, 1, 1] = motion[10] * motion[10]
            belief[3][level, m, 2, 2] = acceleration * acceleration


@inner
@no_type_check
def predict_belief(motion, belief, time, there):
    """Write what is believed ``time`` [s] later: modes change hands, and each moves on."""
    left = -math.expm1(-time / motion[8])
    for level in range(len(belief[0])):
        there[0][level] = belief[0][level]
        interact(
            belief[1][level],
            belief[2][level],
            belief[3][level],
            left,
            there[1][level],
            there[2][level],
            there[3][level],
        )
        u, v, w = 0.0, 0.0, 0.0
        for m in range(3):
            share = math.exp(there[1][level, m])
            u += share * there[2][level, m, 1, 0]
            v += share * there[2][level, m, 1, 1]
            w += share * there[2][level, m, 1, 2]
        rate = turn_rate(motion, there[2][level, TURN, 1], there[2][level, TURN, 2])
        move_on(motion, time, math.sqrt(u * u + v * v + w * w), rate, there[2][level], there[3][level])


@inner
@no_type_check
def interact(log_weights, means, covariances, left, mixed_weights, mixed_means, mixed_covariances):
    """Each mode's state as the mixture of those it may have come from (Blom and Bar-Shalom)."""
    for j in range(3):
        weight = 0.0
        for i in range(3):
            weight += max(math.exp(log_weights[i]), LEAST_WEIGHT) * _change(left, i == j)
        mixed_weights[j] = math.log(weight)
        mean, covariance = mixed_means[j], mixed_covariances[j]
        for a in range(3):
            for b in range(3):
                mean[a, b], covariance[a, b] = 0.0, 0.0
        for i in range(3):
            share = max(math.exp(log_weights[i]), LEAST_WEIGHT) * _change(left, i == j) / weight
            for a in range(3):
                for b in range(3):
                    mean[a, b] += share * means[i, a, b]
        for i in range(3):
            share = max(math.exp(log_weights[i]), LEAST_WEIGHT) * _change(left, i == j) / weight
            _spread(share, means[i], covariances[i], mean, covariance)


@inner
@no_type_check
def _spread(share, mean, covariance, mixed_mean, mixed):
    """Add the share of a mode to the covariance of a mixture, its distance from the mean on average over the axes."""
    for a in range(3):
        for b in range(3):
            spread = 0.0
            for axis in range(3):
                spread += (mean[a, axis] - mixed_mean[a, axis]) * (mean[b, axis] - mixed_mean[b, axis])
            mixed[a, b] += share * (covariance[a, b] + spread / 3.0)


@inner
@no_type_check
def _change(left, same):
    """Probability that a mode goes over to another one, or stays."""
    return (1.0 - left - 0.5 * left) + 0.5 * left if same else 0.5 * left


@inner
@no_type_check
def update_belief(levels, belief, position, gain):
    """The belief after a position [m, world] was seen (Joseph's form, which keeps covariances definite)."""
    for level in range(len(levels)):
        noise = levels[level] * levels[level]
        for m in range(3):
            mean, covariance = belief[2][level, m], belief[3][level, m]
            variance = covariance[0, 0] + noise
            u, v, w = position[0] - mean[0, 0], position[1] - mean[0, 1], position[2] - mean[0, 2]
            for i in range(3):
                gain[i] = covariance[i, 0] / variance
            for i in range(3):
                mean[i, 0], mean[i, 1], mean[i, 2] = (
                    mean[i, 0] + gain[i] * u,
                    mean[i, 1] + gain[i] * v,
                    mean[i, 2] + gain[i] * w,
                )
            _joseph(covariance, gain, noise)
            belief[1][level, m] += log_density(variance, u * u + v * v + w * w)
        density = log_sum(belief[1][level])
        belief[0][level] += density
        for m in range(3):
            belief[1][level, m] -= density


@inner
@no_type_check
def _joseph(covariance, gain, noise):
    """(I - K H) P (I - K H)^T + K R K^T for the gain K of the first coordinate."""
    for column in range(3):
        first = covariance[0, column]
        for row in range(3):
            covariance[row, column] -= gain[row] * first
    for row in range(3):
        first = covariance[row, 0]
        for column in range(3):
            covariance[row, column] = covariance[row, column] - first * gain[column] + noise * gain[row] * gain[column]


@inner
@no_type_check
def log_foreseen(motion, then, time, position, tolerances, there):
    """Logarithm of the density [1/m^3] that a belief gives to a position ``time`` [s] later."""
    predict_belief(motion, then, time, there)
    whole, most = log_sum(there[0]), -math.inf
    for turn in range(2):  # the largest exponent first
        total = 0.0
        for level in range(len(tolerances)):
            for m in range(3):
                mean = there[2][level, m]
                u, v, w = position[0] - mean[0, 0], position[1] - mean[0, 1], position[2] - mean[0, 2]
                variance = there[3][level, m, 0, 0] + tolerances[level] * tolerances[level]
                density = log_density(variance, u * u + v * v + w * w)
                own = there[0][level] - whole + there[1][level, m] + density
                if turn == 0:
                    most = max(most, own)
                else:
                    total += math.exp(own - most)
    return most + math.log(total)


@inner
@no_type_check
def log_density(variance, squared):
    """Of an isotropic normal distribution in three dimensions."""
    return -1.5 * (LOG_TWO_PI + math.log(variance)) - 0.5 * squared / variance


@inner
@no_type_check
def log_sum(exponents):
    """Logarithm of the sum of exponentials."""
    most, total = -math.inf, 0.0
    for i in range(len(exponents)):
        most = max(most, exponents[i])
    for i in range(len(exponents)):
        total += math.exp(exponents[i] - most)
    return most + math.log(total)
