"""What a committed interception is worth among the candidates of a later cycle."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxplan.prediction.candidates import Candidates
from jaxplan.replanner.records import CommittedPlan, ReplannerConfig
from jaxplan.status import PlanStatus


class Incumbent(NamedTuple):
    """A committed interception, as it stands now."""

    score: float
    """Among today's candidates; -inf when it no longer meets the target."""
    goal: Float[np.ndarray, "3"]
    """Where the target is expected when the vehicle is there [m, world]."""
    likelihood: float
    """Of that."""


NO_INCUMBENT = Incumbent(-np.inf, np.full(3, np.nan), np.nan)
"""Nothing that a new plan would have to beat."""


def incumbent_among(
    plan: CommittedPlan, candidates: Candidates, takeover: float, likelihood_weight: float, config: ReplannerConfig
) -> Incumbent:
    """The committed interception by the candidate that is nearest to what it was made for.

    Another motion of the target is another one from ``keep_radius`` on, and not met any more where the vehicle passes
    farther than ``reach`` from it.
    """
    remaining = plan.arrival_time - takeover
    if plan.status is not PlanStatus.INTERCEPT or remaining <= 0.0:
        return NO_INCUMBENT
    expected, simultaneous = _expected_then(candidates, remaining, 0.5 * config.period)
    apart = np.linalg.norm(expected - plan.goal, axis=-1)
    missed = np.linalg.norm(expected - plan.spline.evaluate(plan.arrival_time - plan.start_time)[:3], axis=-1)
    same = simultaneous & (apart <= config.keep_radius) & (missed <= max(config.reach, config.keep_radius))
    if not same.any():
        return NO_INCUMBENT
    nearest = int(np.argmin(np.where(same, apart, np.inf)))
    likelihood = float(candidates.likelihood[nearest])
    return Incumbent(likelihood_weight * likelihood - remaining, expected[nearest], likelihood)


def _expected_then(
    candidates: Candidates, time: float, tolerance: float
) -> tuple[Float[np.ndarray, "k 3"], Bool[np.ndarray, "k"]]:
    """Where the target would be [m] at ``time`` if each candidate were true, and which candidates are of then.

    Predictions may be farther apart than replans. A candidate of a neighbouring step is moved along the mean of the
    predicted positions, step by step.
    """
    times, goals = np.asarray(candidates.arrival_times), np.asarray(candidates.goals)
    finite = np.isfinite(times) & np.isfinite(goals).all(axis=-1)
    steps, member = np.unique(np.round(times[finite], 6), return_inverse=True)
    if len(steps) == 0:
        return np.full(goals.shape, np.inf), np.zeros(len(times), bool)
    size = np.bincount(member)
    means = np.stack([np.bincount(member, weights=goals[finite, axis]) / size for axis in range(3)], axis=1)
    spacing = np.diff(steps).min() if len(steps) > 1 else 0.0
    simultaneous = finite & (np.abs(times - time) <= max(tolerance, 0.5 * spacing) + 1e-6)
    moved = [np.interp(time, steps, means[:, axis]) - np.interp(times, steps, means[:, axis]) for axis in range(3)]
    return goals + np.stack(moved, axis=1), simultaneous
