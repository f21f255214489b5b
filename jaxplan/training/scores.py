"""Scores of predicted probabilities."""

import numpy as np
from jaxtyping import Bool, Float

BINS = 10


def binary_scores(probability: Float[np.ndarray, "n"], positive: Bool[np.ndarray, "n"]) -> dict[str, float]:
    """Area under the ROC curve, Brier score and expected calibration error over ``BINS`` equal bins (host)."""
    return {
        "auc": area_under_curve(probability, positive),
        "brier": float(np.mean((probability - positive) ** 2)),
        "calibration_error": calibration_error(probability, positive),
    }


def area_under_curve(score: Float[np.ndarray, "n"], positive: Bool[np.ndarray, "n"]) -> float:
    """P(a positive scores above a negative), ties counted half (Mann-Whitney); NaN with one class only."""
    ranks = (np.searchsorted(np.sort(score), score, "left") + np.searchsorted(np.sort(score), score, "right") + 1) / 2.0
    ones, zeros = int(positive.sum()), int((~positive).sum())
    if ones == 0 or zeros == 0:
        return float("nan")
    return float((ranks[positive].sum() - ones * (ones + 1) / 2.0) / (ones * zeros))


def calibration_error(probability: Float[np.ndarray, "n"], positive: Bool[np.ndarray, "n"]) -> float:
    """Mean distance of predicted from observed frequency, each bin weighted by its size."""
    bins = np.minimum((probability * BINS).astype(int), BINS - 1)
    sizes = np.bincount(bins, minlength=BINS)
    gap = np.bincount(bins, probability - positive, minlength=BINS)
    return float(np.sum(np.abs(gap)) / max(sizes.sum(), 1))
