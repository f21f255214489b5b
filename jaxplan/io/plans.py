"""The committed plans of one episode as plain arrays (``plans.npz``), and as the one trajectory that was commanded."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.arrays import AnyArray
from jaxplan.errors import FileError
from jaxplan.files import LARGEST_ARCHIVE, read_arrays, read_limited
from jaxplan.spline import PiecewisePolynomial, concatenate

if TYPE_CHECKING:
    from jaxplan.replanner import CommittedPlan

_SHORTEST = 1e-9
"""s; what is shorter is rounding."""


class SavedPlan(NamedTuple):
    """A committed plan as it stands in a file, or what several of them come to."""

    start_time: float
    """When it takes over [s on the episode's clock]."""
    spline: PiecewisePolynomial
    """Position [m, world] and yaw [rad], without padding."""


class Commitment(NamedTuple):
    """A plan in a file, and what was known when it was committed; fields as in ``jaxplan.replanner.CommittedPlan``."""

    plan: SavedPlan
    goal: Float[np.ndarray, "3"]
    arrival_time: float
    alpha: float
    probability: float
    status: int


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


def read_plans(path: Path) -> list[SavedPlan]:
    """The plans in a ``plans.npz``, or in the folder of results that holds one, in the order of their commitment.

    Raises:
        FileError: there is no such file, or it holds something else.
    """
    path = path / "plans.npz" if path.is_dir() else path
    content = read_limited(path, LARGEST_ARCHIVE, "a plans.npz that jaxplan intercept wrote")
    try:
        arrays = read_arrays(content)
        starts, *rows = (np.asarray(arrays[name], float) for name in ("start_time", "durations", "position", "yaw"))
        plans = [_saved(start, *row) for start, *row in zip(starts.tolist(), *rows, strict=True)]
    except Exception as error:  # whatever a damaged archive raises
        raise FileError(f"{path}: is no plans.npz of jaxplan intercept ({error}); give another file") from error
    if not all(np.isfinite(part).all() for _, spline in plans for part in (spline.position, spline.durations)):
        raise FileError(f"{path}: has a plan with NaN or infinite numbers; give another file")
    return plans


def read_commitments(path: Path) -> list[Commitment]:
    """The same with what was known of each. Raises the same."""
    plans = read_plans(path)
    path = path / "plans.npz" if path.is_dir() else path
    try:
        arrays = read_arrays(read_limited(path, LARGEST_ARCHIVE, "a plans.npz that jaxplan intercept wrote"))
        goals = np.asarray(arrays["goal"], float).reshape(-1, 3)
        numbers = [np.asarray(arrays[name], float).tolist() for name in ("arrival_time", "alpha", "probability")]
        status = np.asarray(arrays["status"], int).tolist()
        return [Commitment(*row) for row in zip(plans, goals, *numbers, status, strict=True)]
    except Exception as error:  # whatever a damaged archive raises
        raise FileError(f"{path}: is no plans.npz of jaxplan intercept ({error}); give another file") from error


def _saved(
    start: float,
    durations: Float[np.ndarray, "m"],
    position: Float[np.ndarray, "m n 3"],
    yaw: Float[np.ndarray, "m k"],
) -> SavedPlan:
    real = durations > 0.0
    if not real.any():
        raise ValueError("a plan without duration")
    return SavedPlan(start, PiecewisePolynomial(durations=durations[real], position=position[real], yaw=yaw[real]))


def commanded(plans: Sequence[SavedPlan]) -> SavedPlan:
    """The plans one after the other, each until the next one takes over; where one ends before, it is held at rest.

    There is at least one plan.
    """
    parts = []
    for plan, following in zip(plans, [*plans[1:], None], strict=True):
        length = float(plan.spline.duration)
        until = length if following is None else following.start_time - plan.start_time
        if until > _SHORTEST:
            parts.append(plan.spline if until >= length - _SHORTEST else plan.spline.split(until)[0])
            if until > length + _SHORTEST:
                parts.append(_held(plan.spline, until - length))
    return SavedPlan(plans[0].start_time, concatenate(parts))


def _held(spline: PiecewisePolynomial, duration: float) -> PiecewisePolynomial:
    """Rest for so long [s] where a spline ends."""
    position, yaw = np.zeros_like(np.asarray(spline.position)[:1]), np.zeros_like(np.asarray(spline.yaw)[:1])
    end = np.asarray(spline.evaluate(float(spline.duration)))
    position[0, 0], yaw[0, 0] = end[:3], end[3]
    return PiecewisePolynomial(durations=np.array([duration]), position=position, yaw=yaw)


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
