"""Predictors behind one protocol: observations in, goal candidates out (paper, Sec. III-C).

Every predictor looks ``steps`` intervals of ``dt`` ahead and proposes ``batch`` goals for each, so the number
of candidates is fixed when it is built. ``seed`` makes the random ones repeatable, draw by draw.
"""

import dataclasses
from collections.abc import Callable
from typing import Protocol

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.prediction.candidates import Candidates, candidates_from
from jaxplan.prediction.observations import Observations

Trajectory = Callable[[Float[np.ndarray, "n"]], Float[np.ndarray, "n 3"]]
"""Target positions [m, world] at given times [s]."""

PREDICTORS = ("none", "ground-truth", "noisy", "constant-velocity")
SAMPLING = ("noisy",)
"""Predictors that propose a batch of goals for every step; the others propose one."""


@dataclasses.dataclass(frozen=True)
class PredictionConfig:
    """How far and how densely the target's future is sampled (paper, Sec. IV)."""

    steps: int = 20
    """N_pred, intervals ahead."""
    dt: float = 0.1
    """Length of an interval [s]; 0.1 for rooms of 10 m, 0.2 for rooms of 30 m."""
    batch: int = 20
    """N_batch, samples for each interval, for predictors that sample."""
    observations: int = 10
    """N_obs, positions that are remembered."""
    sigma: float = 0.05
    """sigma_pred [m]: step i of the noisy prediction has the variance i * sigma^2."""

    def __post_init__(self) -> None:
        for name in ("steps", "batch", "observations"):
            if getattr(self, name) < 1:
                raise InputError(f"prediction: {name} is {getattr(self, name)}, want at least 1")
        for name in ("dt", "sigma"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise InputError(f"prediction: {name} is {getattr(self, name)}, want a positive number")

    @property
    def offsets(self) -> Float[np.ndarray, "steps"]:
        """Times of the predicted positions [s] from now."""
        return self.dt * np.arange(1, self.steps + 1)


def candidate_count(name: str, config: PredictionConfig) -> int:
    """How many candidates the predictor called ``name`` proposes in a cycle."""
    return config.steps * (config.batch if name in SAMPLING else 1)


class Predictor(Protocol):
    """Proposes goal candidates for the target seen so far."""

    def __call__(self, observations: Observations, cycle: int) -> Candidates: ...


def build_predictor(name: str, config: PredictionConfig, truth: Trajectory, seed: int = 0) -> Predictor:
    """The predictor called ``name``; ``truth`` is the target's real motion, which only some may look at.

    Raises:
        InputError: ``name`` is not one of ``PREDICTORS``.
    """
    offsets = config.offsets

    def none(observations: Observations, cycle: int) -> Candidates:
        return _certain(observations, np.repeat(observations.positions[-1:], config.steps, axis=0), offsets)

    def ground_truth(observations: Observations, cycle: int) -> Candidates:
        return _certain(observations, truth(observations.times[-1] + offsets), offsets)

    def noisy(observations: Observations, cycle: int) -> Candidates:
        deviations = config.sigma * np.sqrt(np.arange(1, config.steps + 1))
        rng = np.random.default_rng((seed, cycle))
        return _sampled(observations, truth(observations.times[-1] + offsets), deviations, offsets, config.batch, rng)

    def constant_velocity(observations: Observations, cycle: int) -> Candidates:
        return _certain(observations, observations.positions[-1] + offsets[:, None] * _velocity(observations), offsets)

    known = dict(zip(PREDICTORS, (none, ground_truth, noisy, constant_velocity), strict=True))
    if name not in known:
        raise InputError(f"predictor: unknown name {name!r}, want one of {', '.join(PREDICTORS)}")
    return known[name]


def _certain(
    observations: Observations, positions: Float[np.ndarray, "n 3"], offsets: Float[np.ndarray, "n"]
) -> Candidates:
    return candidates_from(observations.positions[-1], positions, offsets, np.zeros(len(offsets)))


def _sampled(
    observations: Observations,
    means: Float[np.ndarray, "n 3"],
    deviations: Float[np.ndarray, "n"],
    offsets: Float[np.ndarray, "n"],
    batch: int,
    rng: np.random.Generator,
) -> Candidates:
    """``batch`` draws from an isotropic normal distribution at each step, with their densities."""
    standard = rng.standard_normal((len(means), batch, 3))
    goals = means[:, None] + deviations[:, None, None] * standard
    log_density = -0.5 * (standard**2).sum(axis=-1) - 3.0 * np.log(deviations)[:, None]
    return candidates_from(
        observations.positions[-1], goals.reshape(-1, 3), np.repeat(offsets, batch), log_density.reshape(-1)
    )


def _velocity(observations: Observations) -> Float[np.ndarray, "3"]:
    """Least-squares velocity [m/s] of the observations; 0 when there is only one."""
    times = observations.times - observations.times.mean()
    spread = float(times @ times)
    return (
        times @ (observations.positions - observations.positions.mean(axis=0)) / spread if spread > 0.0 else np.zeros(3)
    )
