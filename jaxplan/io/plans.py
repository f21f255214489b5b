"""The committed plans of one episode as plain arrays (``plans.npz``)."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from jaxplan.arrays import AnyArray

if TYPE_CHECKING:
    from jaxplan.replanner import CommittedPlan


def write_plans(path: Path, plans: "Sequence[CommittedPlan]") -> None:
    """Write every committed plan, one row each, padded to the longest with segments of duration 0.

    Arrays: ``start_time`` [s], ``durations`` [s] (P, m), ``position`` [m] (P, m, n, 3) and ``yaw`` [rad]
    (P, m, k) as ascending coefficients in each segment's own time from 0 to 1, ``goal`` [m, world] (P, 3),
    ``arrival_time`` [s], ``alpha``, ``probability`` of being tracked and ``status`` (``jaxplan.status.PlanStatus``).
    """
    segments = max((len(plan.spline.durations) for plan in plans), default=0)
    np.savez_compressed(
        path,
        start_time=np.array([plan.start_time for plan in plans], dtype=float),
        durations=_stack([np.asarray(plan.spline.durations) for plan in plans], segments, ()),
        position=_stack([np.asarray(plan.spline.position) for plan in plans], segments, (10, 3)),
        yaw=_stack([np.asarray(plan.spline.yaw) for plan in plans], segments, (6,)),
        goal=np.array([plan.goal for plan in plans], dtype=float).reshape(-1, 3),
        arrival_time=np.array([plan.arrival_time for plan in plans], dtype=float),
        alpha=np.array([plan.alpha for plan in plans], dtype=float),
        probability=np.array([plan.probability for plan in plans], dtype=float),
        status=np.array([int(plan.status) for plan in plans], dtype=np.int32),
    )


def _stack(
    arrays: Sequence[Float[AnyArray, "_ *k"]], segments: int, shape_if_none: tuple[int, ...]
) -> Float[np.ndarray, "plans segments *k"]:
    """What the plans have for each segment, with zeros behind each plan's own segments.

    Args:
        segments: of the longest plan.
        shape_if_none: of one segment's values, where there is no plan.
    """
    if not arrays:
        return np.zeros((0, 0, *shape_if_none))
    padded = []
    for array in arrays:
        values = np.asarray(array, dtype=float)
        padded.append(np.pad(values, [(0, segments - len(values))] + [(0, 0)] * (values.ndim - 1)))
    return np.stack(padded)
