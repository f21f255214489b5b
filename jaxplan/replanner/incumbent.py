"""What a committed interception is worth among the candidates of a later cycle."""

import numpy as np
from jaxtyping import Bool, Float

from jaxplan.prediction.candidates import Candidates
from jaxplan.replanner.records import CommittedPlan, ReplannerConfig
from jaxplan.status import PlanStatus


def incumbent_score(
    plan: CommittedPlan, candidates: Candidates, takeover: float, likelihood_weight: float, config: ReplannerConfig
) -> float:
    """Score of the committed interception among today's candidates; -inf when it no longer meets the target."""
    remaining = plan.arrival_time - takeover
    if plan.status is not PlanStatus.INTERCEPT or remaining <= 0.0:
        return -np.inf
    apart, simultaneous = _expected_then(candidates, remaining, plan.goal, 0.5 * config.period)
    same = simultaneous & (apart <= config.keep_radius)
    if not same.any():
        return -np.inf
    nearest = int(np.argmin(np.where(same, apart, np.inf)))
    return likelihood_weight * float(candidates.likelihood[nearest]) - remaining


def _expected_then(
    candidates: Candidates, time: float, goal: Float[np.ndarray, "3"], tolerance: float
) -> tuple[Float[np.ndarray, "k"], Bool[np.ndarray, "k"]]:
    """How far [m] the target would be from ``goal`` at ``time`` if each candidate were true, and which are of then.

    Predictions may be farther apart than replans. A candidate of a neighbouring step is moved along the mean of the
    predicted positions, step by step.
    """
    times, goals = np.asarray(candidates.arrival_times), np.asarray(candidates.goals)
    finite = np.isfinite(times) & np.isfinite(goals).all(axis=-1)
    steps, member = np.unique(np.round(times[finite], 6), return_inverse=True)
    if len(steps) == 0:
        return np.full(len(times), np.inf), np.zeros(len(times), bool)
    size = np.bincount(member)
    means = np.stack([np.bincount(member, weights=goals[finite, axis]) / size for axis in range(3)], axis=1)
    spacing = np.diff(steps).min() if len(steps) > 1 else 0.0
    simultaneous = finite & (np.abs(times - time) <= max(tolerance, 0.5 * spacing) + 1e-6)
    moved = [np.interp(time, steps, means[:, axis]) - np.interp(times, steps, means[:, axis]) for axis in range(3)]
    return np.linalg.norm(goals + np.stack(moved, axis=1) - goal, axis=-1), simultaneous
