"""How good a predictor is on windows whose future is known."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.precision import in_float64
from jaxplan.prediction.mixture import Prediction, density_terms, draw, log_density
from jaxplan.prediction.observations import Observations

RANK_DRAWS = 200
"""Draws against which the density of what happened is ranked."""


@dataclasses.dataclass(frozen=True)
class Scores:
    """One row per window, one column per step."""

    errors: Float[np.ndarray, "n s"]
    """Distance [m] of the expected from the real position."""
    log_density: Float[np.ndarray, "n s"]
    """Of the real position [log 1/m^3]; NaN for predictors that are certain."""
    rank: Float[np.ndarray, "n s"]
    """Probability of the region of higher density than at the real position; NaN for those that are certain."""

    def summary(self) -> dict[str, float | None]:
        """ADE and FDE [m]; mean negative log-likelihood and coverage of the 50 and 90 % regions over all steps."""
        certain = bool(np.isnan(self.rank).any())
        return {
            "ade_m": float(self.errors.mean()),
            "fde_m": float(self.errors[:, -1].mean()),
            "nll": None if certain else float(-self.log_density.mean()),
            "coverage_50": None if certain else float((self.rank < 0.5).mean()),
            "coverage_90": None if certain else float((self.rank < 0.9).mean()),
            "coverage_90_last": None if certain else float((self.rank[:, -1] < 0.9).mean()),
        }


@in_float64
def score(predictions: Sequence[Prediction], futures: Float[np.ndarray, "n s 3"], seed: int = 0) -> Scores:
    """Compare predictions with what happened.

    The 90 % region is that of highest density: what happened lies in it where fewer than 90 % of the draws are at
    places of higher density (Hyndman, The American Statistician 50(2), 1996).
    """
    rng = np.random.default_rng(seed)
    rows = [_score_one(one, future, rng) for one, future in zip(predictions, futures, strict=True)]
    return Scores(*(np.array(column) for column in zip(*rows, strict=True)))


def observe_windows(
    windows: Float[np.ndarray, "n l 3"], observations: int, dt: float
) -> tuple[list[Observations], Float[np.ndarray, "n s 3"]]:
    """What a predictor sees of each window, and what happens next."""
    times = dt * np.arange(observations)
    return [Observations(times=times, positions=window[:observations]) for window in windows], windows[:, observations:]


def _score_one(
    prediction: Prediction, truth: Float[np.ndarray, "s 3"], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    errors = np.linalg.norm(prediction.mean - truth, axis=1)
    factors = np.asarray(prediction.factors)
    if not factors.any():
        unknown = np.full(len(errors), np.nan)
        return errors, unknown, unknown
    steps = len(errors)
    randoms = rng.random((steps, RANK_DRAWS)), rng.standard_normal((steps, RANK_DRAWS, 3))
    density, rank = _rank(prediction, density_terms(factors), truth, *randoms)
    return errors, np.asarray(density), np.asarray(rank)


@jax.jit
def _rank(
    prediction: Prediction,
    terms: tuple[Float[Array, "s 3 3 c"], Float[Array, "s c"]],
    truth: Float[Array, "s 3"],
    uniform: Float[Array, "s b"],
    normal: Float[Array, "s b 3"],
) -> tuple[Float[Array, "s"], Float[Array, "s"]]:
    drawn = draw(prediction.log_weights, prediction.means, prediction.factors, uniform, normal)
    places = jnp.concatenate([truth[:, None], drawn], axis=1)
    densities = log_density(prediction.log_weights, prediction.means, *terms, places)
    return densities[:, 0], (densities[:, 1:] > densities[:, :1]).mean(axis=1)
