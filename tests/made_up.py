"""Made-up cycles and the folder of a made-up run: what the tests of what is kept and drawn look at."""

import socket
from pathlib import Path
from typing import Any

import numpy as np

from jaxplan.io.cycles import SavedCycle, saved_cycles, write_cycles
from jaxplan.io.files import write_json, write_tum
from jaxplan.io.plans import write_plans
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.planner import Plans
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.predictors import build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.replanner import CommittedPlan, Cycle
from jaxplan.selection import Margins
from jaxplan.spline import PiecewisePolynomial
from jaxplan.status import PlanStatus, Reason, count_reasons


def planned(rng: np.random.Generator, count: int = 90) -> Plans:
    """Candidates of which the first two thirds have a curved trajectory of 1 to 2 s, each with a stop in it."""
    traced = 2 * count // 3
    position = 0.3 * rng.normal(size=(2, 10, 3, traced))
    durations = rng.uniform(0.5, 1.0, size=(2, traced))
    reasons = rng.choice([0, Reason.CLEARANCE, Reason.LIMITS | Reason.BODY_RATE], size=count).astype(np.uint32)
    reasons[traced:] = np.uint32(Reason.OUTRANKED)
    unknown = np.full(traced, np.nan)
    return Plans(
        goals=rng.normal(size=(count, 3)),
        arrival_times=rng.uniform(1.0, 2.0, size=count),
        reasons=reasons,
        score=np.zeros(count),
        alpha=np.ones(count),
        trajectory=np.where(np.arange(count) < traced, np.arange(count), -1),
        splines=SplineBatch(durations=durations, position=position, yaw=np.zeros((2, 6, 1, traced))),
        margins=Margins(
            deviation=unknown,
            clearance=unknown,
            rotor_speed=unknown,
            probability=unknown,
            reasons=np.zeros(traced, dtype=np.uint32),
        ),
    )


def cycle(time: float, plans: Plans | None, chosen: int = -1, **changes: Any) -> Cycle:
    usual: dict[str, Any] = {
        "time": time,
        "status": PlanStatus.INTERCEPT if chosen >= 0 else PlanStatus.KEPT_COMMITTED,
        "plans": plans,
        "chosen": chosen,
        "stage_ms": {"predict": 1.5, "search": 2.25},
        "generated": 0 if plans is None else len(plans.reasons),
        "rejected": {} if plans is None else count_reasons(plans.reasons),
        "jump": np.zeros(5) if chosen >= 0 else None,
        "latency": 0.1,
        "deviation": 0.02,
    }
    return Cycle(**usual | changes)


def committed(start: float) -> CommittedPlan:
    spline = planned(np.random.default_rng(9)).spline(0)
    return CommittedPlan(start, spline, np.ones(3), start + 1.0, 1.2, PlanStatus.INTERCEPT)


def straight(start: float, origin: np.ndarray, velocity: np.ndarray, duration: float) -> CommittedPlan:
    """A plan at a steady velocity [m/s], which meets its target half-way."""
    position = np.zeros((1, 10, 3))
    position[0, 0], position[0, 1] = origin, velocity * duration
    spline = PiecewisePolynomial(durations=np.array([duration]), position=position, yaw=np.zeros((1, 6)))
    half = 0.5 * duration
    return CommittedPlan(start, spline, origin + velocity * half, start + half, 1.1, PlanStatus.INTERCEPT, 0.9)


FLOWN = np.array([0.0, 2.0, 0.0])
"""m/s; the defender of a made-up run from (-4, -4, 1) on."""
FLEES = np.array([1.0, 0.0, 0.0])
"""m/s; its target from (-4, 3, 1) on."""


def made_up_run(folder: Path) -> list[SavedCycle]:
    """A flight of 2 s in env1 with three cycles, two of which commit a plan; the last one has less to show."""
    folder.mkdir()
    times = np.arange(1, 401) / 200.0
    flown = np.array([-4.0, -4.0, 1.0]) + times[:, None] * FLOWN
    target = np.array([-4.0, 3.0, 1.0]) + times[:, None] * FLEES
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(times), 1))
    plans = [straight(start, np.array([-4.0, -4.0 + 2.0 * start, 1.0]), FLOWN, 3.0) for start in (0.6, 0.7)]
    rng = np.random.default_rng(3)
    some = [planned(rng), planned(rng), planned(rng, 6)]
    usable = [int(np.flatnonzero(each.reasons == 0)[0]) for each in some[:2]]
    cycles = [
        cycle(0.5, some[0], usable[0]),
        cycle(0.6, some[1], usable[1]),
        cycle(1.0, some[2], stage_ms={"predict": 1.0, "refine": 30.0}),
    ]
    seen = [
        Observations(times=now + 0.1 * np.arange(-4, 1), positions=np.array([-4.0, 3.0, 1.0]) + np.zeros((5, 3)))
        for now in (0.5, 0.6, 1.0)
    ]

    def truth(t: np.ndarray) -> np.ndarray:
        return np.array([-4.0, 3.0, 1.0]) + t[..., None] * FLEES

    predictor = build_predictor("noisy", PredictionConfig(), truth=truth)
    kept = saved_cycles(cycles, seen, plans, predictor)
    write_json(folder / "config.json", {"world": "env1", "predictor": "noisy", "vehicle": "mfrl", "padding": 0.4})
    write_tum(folder / "flown.csv", times, flown, upright)
    write_tum(folder / "target.csv", times, target, upright)
    write_plans(folder / "plans.npz", plans)
    write_cycles(folder / "cycles.npz", kept)
    write_json(folder / "metrics.json", {"outcome": "intercepted", "target": {"name": "a <b>fleeing</b> target"}})
    return kept


def free_port() -> int:
    """A port of this machine that nobody has just now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
