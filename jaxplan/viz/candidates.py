"""The candidates of one replan cycle as curves to draw."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from jaxplan.errors import InputError
from jaxplan.status import PlanStatus

if TYPE_CHECKING:
    from jaxplan.planner import Plans
    from jaxplan.replanner import Cycle


@dataclass(frozen=True)
class CandidateCurves:
    """Every candidate of one cycle, and the trajectories of those that got one; world frame, metres."""

    time: float
    """When the cycle was [s]."""
    goals: Float[np.ndarray, "k 3"]
    usable: Bool[np.ndarray, "k"]
    curves: Float[np.ndarray, "n s 3"]
    curve_usable: Bool[np.ndarray, "n"]
    chosen: Float[np.ndarray, "s 3"] | None
    """The curve that was committed."""


def illustrative_cycle(cycles: "Sequence[Cycle]") -> "Cycle | None":
    """The cycle that shows most: one that committed an interception, with the most and longest trajectories."""
    best, most = None, (False, 0.0)
    for cycle in cycles:
        if cycle.plans is None:
            continue
        shown = (cycle.status == PlanStatus.INTERCEPT, _total_distance(cycle.plans))
        if shown > most:
            best, most = cycle, shown
    return best


def _total_distance(plans: "Plans") -> float:
    """Straight distances [m] from the start to the goals of all trajectories of a cycle, added up."""
    traced = np.asarray(plans.trajectory) >= 0
    starts = np.asarray(plans.splines.position)[0, 0][:, np.asarray(plans.trajectory)[traced]].T
    return float(np.nansum(np.linalg.norm(np.asarray(plans.goals)[traced] - starts, axis=1)))


def candidate_curves(cycle: "Cycle", samples: int = 12) -> CandidateCurves:
    """Sample all trajectories of a cycle that has its candidates, ``samples`` points per segment."""
    plans = cycle.plans
    if plans is None:
        raise InputError("candidate_curves: the cycle's candidates stayed in another process, want a cycle with them")
    columns = np.asarray(plans.trajectory)
    traced = np.flatnonzero(columns >= 0)
    coefficients = np.asarray(plans.splines.position)[..., columns[traced]]
    powers = np.linspace(0.0, 1.0, samples)[:, None] ** np.arange(coefficients.shape[1])
    points = np.einsum("sn,mnak->kmsa", powers, coefficients)
    curves = points.reshape(len(traced), samples * len(coefficients), 3)
    finite = np.isfinite(curves).all(axis=(1, 2))
    usable = np.asarray(plans.reasons) == 0
    place = np.flatnonzero(traced == cycle.chosen)
    return CandidateCurves(
        time=cycle.time,
        goals=np.asarray(plans.goals),
        usable=usable,
        curves=curves[finite],
        curve_usable=usable[traced][finite],
        chosen=curves[place[0]] if len(place) and finite[place[0]] else None,
    )
