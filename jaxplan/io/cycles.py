"""What every replan cycle of an episode saw and decided, as plain arrays (``cycles.npz``): enough to watch it again.

Of a cycle's trajectories and of its prediction a file keeps what an eye can tell apart: some curves, some steps, the
heaviest components. What was committed is in ``plans.npz`` whole.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt32

from jaxplan.errors import FileError
from jaxplan.files import LARGEST_ARCHIVE, read_arrays, read_limited
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.protocol import StepPredictor
from jaxplan.status import Note, PlanStatus, Reason

if TYPE_CHECKING:
    from jaxplan.planner import Plans
    from jaxplan.prediction.mixture import Prediction
    from jaxplan.prediction.protocol import Predictor
    from jaxplan.replanner import CommittedPlan, Cycle

VERSION = 1
"""Of the file."""
MOST_CURVES, CURVE_POINTS = 40, 25
"""Trajectories that are kept of a cycle, and points of each, evenly spaced in time (arbitrary)."""
MOST_STEPS, MOST_COMPONENTS = 10, 8
"""Instants and components that are kept of a prediction (arbitrary)."""
REASONS = tuple(reason.name.lower() for reason in Reason if reason.name)
"""In the order of their bits, which never changes."""
_FARTHEST = 1e4
"""m from the origin; trajectories beyond have come out wrong."""
_ROUNDED = 4
"""Digits after the point, 0.1 mm: more would only take room."""


class SavedPrediction(NamedTuple):
    """Where a cycle expected the target: mixtures of c normal distributions at s instants."""

    instants: Float[np.ndarray, "s"]
    """Seconds on the episode's clock."""
    weights: Float[np.ndarray, "c"]
    """Of the components that are kept; they add up to less than 1 where some are left out."""
    means: Float[np.ndarray, "s c 3"]
    """Metres, world."""
    covariances: Float[np.ndarray, "s c 3 3"]
    """m^2; 0 for a position that is certain."""


class SavedCycle(NamedTuple):
    """What one replan cycle saw and decided."""

    time: float
    """Seconds on the episode's clock."""
    status: PlanStatus
    plan: int
    """Which of the episode's plans it committed, from 0; -1: none."""
    latency: float
    """Seconds until its plan takes over."""
    deviation: float
    """Of the vehicle from its reference [m]."""
    sooner: float
    """By how much a refinement made the meeting sooner [s]."""
    note: Note
    stage_ms: dict[str, float]
    generated: int
    """Candidates."""
    rejected: dict[str, int]
    """How many of them carry each reason."""
    goals: Float[np.ndarray, "k 3"]
    """Of the candidates [m, world]; none where they stayed in another process."""
    reasons: UInt32[np.ndarray, "k"]
    chosen: int
    """Which of the candidates was committed; -1: none, or a refined plan that is none of them."""
    curves: Float[np.ndarray, "n p 3"]
    """Some of the candidates' trajectories [m, world]."""
    curve_of: Int[np.ndarray, "n"]
    """Whose they are."""
    prediction: SavedPrediction | None


def saved_cycles(
    cycles: "Sequence[Cycle]",
    observations: Sequence[Observations | None],
    plans: "Sequence[CommittedPlan]",
    predictor: "Predictor | None",
) -> list[SavedCycle]:
    """What is kept of an episode's cycles.

    Args:
        cycles: in their order from the first one on.
        observations: that each decided from, None before the target was seen; empty where nobody knows, then no
            prediction is kept.
        plans: that were committed.
        predictor: of the episode; a prediction is asked of it once more, the same as in flight.
    """
    seen = observations if len(observations) == len(cycles) else [None] * len(cycles)
    return [
        saved_cycle(cycle, each, index, plans, predictor)
        for index, (cycle, each) in enumerate(zip(cycles, seen, strict=True))
    ]


def saved_cycle(
    cycle: "Cycle",
    observations: Observations | None,
    index: int,
    plans: "Sequence[CommittedPlan]",
    predictor: "Predictor | None",
) -> SavedCycle:
    """What is kept of cycle number ``index``; the rest as for ``saved_cycles``."""
    curves, curve_of = np.zeros((0, CURVE_POINTS, 3)), np.zeros(0, dtype=int)
    goals, reasons, prediction = np.zeros((0, 3)), np.zeros(0, dtype=np.uint32), None
    if cycle.plans is not None:
        goals, reasons = np.asarray(cycle.plans.goals), np.asarray(cycle.plans.reasons, dtype=np.uint32)
        curves, curve_of = _some_curves(cycle.plans, cycle.chosen)
    if observations is not None and isinstance(predictor, StepPredictor):
        found = predictor.proposal(observations, index).distribution()
        prediction = _some_of(found, cycle.time - float(observations.age))
    return SavedCycle(
        time=cycle.time,
        status=cycle.status,
        plan=_committed_by(cycle, plans),
        latency=cycle.latency,
        deviation=cycle.deviation,
        sooner=cycle.sooner,
        note=cycle.note,
        stage_ms=dict(cycle.stage_ms),
        generated=cycle.generated,
        rejected=dict(cycle.rejected),
        goals=goals,
        reasons=reasons,
        chosen=cycle.chosen,
        curves=curves,
        curve_of=curve_of,
        prediction=prediction,
    )


def write_cycles(path: Path, cycles: Sequence[SavedCycle]) -> None:
    """Write the cycles, one row each; docs/files.md lists the arrays."""
    stages = list(dict.fromkeys(stage for cycle in cycles for stage in cycle.stage_ms))
    nothing = SavedPrediction(np.zeros(0), np.zeros(0), np.zeros((0, 0, 3)), np.zeros((0, 0, 3, 3)))
    predictions = [cycle.prediction or nothing for cycle in cycles]
    np.savez_compressed(
        path,
        version=np.int32(VERSION),
        numbers=np.array([[c.time, c.latency, c.deviation, c.sooner] for c in cycles], dtype=float).reshape(-1, 4),
        decisions=np.array([_decision(c) for c in cycles], dtype=np.int32).reshape(-1, 6),
        stages=np.array(stages, dtype=np.str_),
        stage_ms=_table([c.stage_ms for c in cycles], stages, np.float32),
        rejected=_table([c.rejected for c in cycles], REASONS, np.int32),
        goals=_padded([c.goals for c in cycles], 2),
        reasons=_padded([c.reasons for c in cycles], 1, kind=np.uint32),
        curves=_padded([c.curves for c in cycles], 3),
        curve_of=_padded([c.curve_of for c in cycles], 1, kind=np.int32),
        instants=_padded([p.instants for p in predictions], 1),
        weights=_padded([p.weights for p in predictions], 1),
        means=_padded([p.means for p in predictions], 3),
        covariances=_padded([p.covariances for p in predictions], 4, digits=8),
        sizes=np.array(
            [(len(c.goals), len(c.curves), *p.means.shape[:2]) for c, p in zip(cycles, predictions, strict=True)],
            dtype=np.int32,
        ).reshape(-1, 4),
    )


def read_cycles(path: Path, plans: int) -> list[SavedCycle]:
    """The cycles in a ``cycles.npz`` of an episode with so many plans.

    Raises:
        FileError: there is no such file, another version wrote it, or it is damaged.
    """
    content = read_limited(path, LARGEST_ARCHIVE, "a cycles.npz that jaxplan intercept wrote")
    try:
        arrays = read_arrays(content)
        version = int(arrays["version"])
    except Exception as error:  # whatever a damaged archive raises
        raise FileError(f"{path}: is no cycles.npz of jaxplan intercept ({error}); fly again") from error
    if version != VERSION:
        raise FileError(f"{path}: has form {version}, want {VERSION}, another version of jaxplan wrote it; fly again")
    try:
        cycles = [_row(arrays, index, plans) for index in range(len(arrays["numbers"]))]
    except Exception as error:
        raise FileError(f"{path}: is no cycles.npz of jaxplan intercept ({error}); fly again") from error
    return cycles


def _row(arrays: dict[str, np.ndarray], index: int, plans: int) -> SavedCycle:
    """One cycle; raises ``ValueError``, ``KeyError`` or ``IndexError`` where the arrays do not fit together."""
    time, latency, deviation, sooner = np.asarray(arrays["numbers"][index], dtype=float).tolist()
    status, plan, chosen, note, generated, predicted = arrays["decisions"][index].tolist()
    candidates, curves, steps, components = arrays["sizes"][index].tolist()
    stages = [str(name) for name in arrays["stages"].tolist()]
    milliseconds, counts = arrays["stage_ms"][index].tolist(), arrays["rejected"][index].tolist()
    prediction = SavedPrediction(
        _first(arrays["instants"][index], steps, ()),
        _first(arrays["weights"][index], components, ()),
        _first(arrays["means"][index], steps, (components, 3)),
        _first(arrays["covariances"][index], steps, (components, 3, 3)),
    )
    found = SavedCycle(
        time=time,
        status=PlanStatus(status),
        plan=plan,
        latency=latency,
        deviation=deviation,
        sooner=sooner,
        note=Note(note),
        stage_ms={name: ms for name, ms in zip(stages, milliseconds, strict=True) if np.isfinite(ms)},
        generated=generated,
        rejected={name: count for name, count in zip(REASONS, counts, strict=False) if count},
        goals=_first(arrays["goals"][index], candidates, (3,)),
        reasons=_first(arrays["reasons"][index], candidates, ()).astype(np.uint32),
        chosen=chosen,
        curves=_first(arrays["curves"][index], curves, (CURVE_POINTS, 3)),
        curve_of=_first(arrays["curve_of"][index], curves, ()).astype(int),
        prediction=prediction if predicted else None,
    )
    in_range = (found.curve_of >= 0) & (found.curve_of < candidates)
    if not (np.isfinite(time) and in_range.all() and -1 <= chosen < max(candidates, 1) and -1 <= plan < plans):
        raise ValueError(f"cycle {index} speaks of candidates or plans that are not there")
    return found


def _decision(cycle: SavedCycle) -> list[int]:
    """Status, plan, chosen candidate, notes, candidates, and whether there is a prediction."""
    numbers = (cycle.status, cycle.plan, cycle.chosen, cycle.note, cycle.generated, cycle.prediction is not None)
    return [int(number) for number in numbers]


def _committed_by(cycle: "Cycle", plans: "Sequence[CommittedPlan]") -> int:
    """The plan that takes over when one of this cycle would; -1 where it committed none, or one that was withdrawn."""
    if cycle.jump is None:
        return -1
    starts = np.array([plan.start_time for plan in plans])
    index = int(np.searchsorted(starts, cycle.time + cycle.latency - 1e-6))
    return index if index < len(starts) and plans[index].status == cycle.status else -1


def _some_curves(plans: "Plans", chosen: int) -> tuple[Float[np.ndarray, "n p 3"], Int[np.ndarray, "n"]]:
    """The chosen trajectory, then usable ones, then others, evenly among them, sampled evenly in time."""
    traced, usable = np.asarray(plans.trajectory) >= 0, np.asarray(plans.reasons) == 0
    good, bad = np.flatnonzero(traced & usable), np.flatnonzero(traced & ~usable)
    room = MOST_CURVES - min(len(bad), MOST_CURVES // 4)
    kept = [_evenly(good, room), _evenly(bad, MOST_CURVES - min(len(good), room))]
    indices = np.unique(np.concatenate([*kept, [chosen] if chosen >= 0 else []]).astype(int))
    curves = np.zeros((len(indices), CURVE_POINTS, 3))
    for row, index in enumerate(indices.tolist()):
        curves[row] = np.asarray(plans.spline(index).sample(CURVE_POINTS)[1])[:, :3]
    finite = (np.abs(curves) < _FARTHEST).all(axis=(1, 2))
    return curves[finite], indices[finite]


def _evenly(values: Int[np.ndarray, "n"], most: int) -> Int[np.ndarray, "m"]:
    """At most so many of the values, evenly among them."""
    return values if len(values) <= most else values[np.linspace(0, len(values) - 1, most).round().astype(int)]


def _some_of(prediction: "Prediction", newest: float) -> SavedPrediction:
    """Some instants and the heaviest components; ``newest`` is when the target was seen last [s]."""
    offsets, weights = np.asarray(prediction.offsets, float), np.exp(np.asarray(prediction.log_weights, float))
    steps = _evenly(np.arange(len(offsets)), MOST_STEPS)
    components = np.argsort(-weights, kind="stable")[:MOST_COMPONENTS]
    means = np.moveaxis(np.asarray(prediction.means, float), 2, 1)[steps][:, components]
    factors = np.moveaxis(np.asarray(prediction.factors, float), 3, 1)[steps][:, components]
    return SavedPrediction(newest + offsets[steps], weights[components], means, factors @ np.swapaxes(factors, -1, -2))


def _first(array: np.ndarray, count: int, shape: tuple[int, ...]) -> np.ndarray:
    """The first ``count`` rows, each of this shape; what is behind them is padding."""
    kept = np.asarray(array)[(slice(0, count), *(slice(0, side) for side in shape))]
    if count < 0 or kept.shape != (count, *shape):
        raise ValueError(f"have an array of {kept.shape}, want {(count, *shape)}")
    return kept.astype(float) if kept.dtype.kind == "f" else kept


def _table(rows: Sequence[dict[str, Any]], names: Sequence[str], kind: Any) -> np.ndarray:
    """One column for each name; what a row does not have is NaN among numbers and 0 among counts."""
    missing = np.nan if np.issubdtype(kind, np.floating) else 0
    return np.array([[row.get(name, missing) for name in names] for row in rows], kind).reshape(len(rows), len(names))


def _padded(arrays: Sequence[np.ndarray], axes: int, digits: int = _ROUNDED, kind: Any = np.float32) -> np.ndarray:
    """Arrays of so many axes side by side, each filled up with zeros to the largest."""
    shape = np.max([array.shape for array in arrays], axis=0) if len(arrays) else np.zeros(axes, dtype=int)
    out = np.zeros((len(arrays), *shape), dtype=kind)
    for row, array in zip(out, arrays, strict=True):
        row[tuple(slice(0, side) for side in array.shape)] = np.round(array, digits)
    return out
