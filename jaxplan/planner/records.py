"""What the planner is told, what it returns and how it measures itself."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int, UInt32

from jaxplan.arrival import ArrivalConfig
from jaxplan.errors import InputError
from jaxplan.knots import KnotConfig
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.records import record
from jaxplan.selection import CheckConfig, Margins
from jaxplan.selection import select as select_best
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.world.obstacles import World

APPROACH_GOALS = 4
APPROACH_SHARES = (1.0, 0.6, 0.3)
APPROACH_STRETCHES = (1.0, 1.4, 2.0)
"""An approach tries this many goals, each along these shares of its path, at these multiples of its least time
(arbitrary)."""


@dataclasses.dataclass(frozen=True)
class PlannerConfig:
    """Every setting of the planner, in SI units."""

    padding: float = 0.5
    """Clearance of goals and searched paths from obstacles [m] (paper, Sec. IV)."""
    max_speed: float = 8.0
    """Goals that need more than this average speed [m/s] are dropped at once (arbitrary, above what is ever flown)."""
    max_yaw_rate: float = 1.5
    """Average yaw rate [rad/s] that a segment may ask for (docs/decisions/0010-yaw-rate.md)."""
    likelihood_weight: float = 1.0
    """Seconds that a likelihood of 1 is worth in the selection (paper eq. 9 leaves the unit open)."""
    path_capacity: int = 32
    """Corners of the longest taut path; longer ones are planned as prefixes."""
    lanes: int = 64
    """Candidates that the compiled stations take at a time; on a GPU, as many as there are (decision 0014)."""
    exhaustive: bool = False
    """Match and check every candidate (the paper) instead of the best ones until one passes: the same winner."""
    knots: KnotConfig = KnotConfig()
    arrival: ArrivalConfig = ArrivalConfig()
    checks: CheckConfig = CheckConfig()

    def __post_init__(self) -> None:
        for name in ("max_speed", "max_yaw_rate"):
            if not 0.0 < getattr(self, name) < float("inf"):
                raise InputError(f"planner: {name} is {getattr(self, name)}, want a positive number")
        if not 0.0 <= self.padding < float("inf"):
            raise InputError(f"planner: padding is {self.padding} m, want 0 or more")
        if not 1 <= self.lanes <= 65536:
            raise InputError(f"planner: lanes is {self.lanes}, want 1 to 65536")


@record
class Plans:
    """What became of every candidate, in the order they were given."""

    goals: Float[np.ndarray, "k 3"]
    arrival_times: Float[np.ndarray, "k"]
    """When each target is there [s from the start state]."""
    reasons: UInt32[np.ndarray, "k"]
    """0 means usable."""
    score: Float[np.ndarray, "k"]
    """What the selection maximises [s]."""
    alpha: Float[np.ndarray, "k"]
    """Scale factor of the time allocation; NaN where none was computed."""
    lanes: Int[np.ndarray, "k"]
    """Lane of each candidate in ``splines`` and ``margins``; -1 for those without a trajectory."""
    splines: SplineBatch
    margins: Margins

    def spline(self, index: int) -> PiecewisePolynomial:
        """The trajectory to candidate ``index`` (host, NumPy)."""
        return self.splines.spline(int(self.lanes[index]))


def select(plans: Plans) -> int:
    """Index of the candidate to commit; -1 when nothing is usable, never index 0 by accident."""
    return select_best(plans.score, plans.reasons)


class Planner(NamedTuple):
    """The planner's functions; after ``warmup`` none of them compiles anything."""

    plan_batch: Callable[..., Plans]
    """(state, candidates, timer): trajectories from one state timed to meet each candidate (paper, Sec. III-B)."""
    approach: Callable[..., Plans]
    """(state, candidates, timer): trajectories towards the latest candidates, only late, for when none can be met."""
    warmup: Callable[[FlatState], None]
    """Compile every station."""
    in_world: Callable[[World], "Planner"]
    """The same planner in another world, with all that is compiled without looking at the world."""
    config: PlannerConfig


class Timer:
    """Wall time of the stations [ms]; waits for compiled results, so that each station pays for itself."""

    def __init__(self) -> None:
        self.stages: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str, result: Any = None) -> None:
        jax.block_until_ready(result)
        now = time.perf_counter()
        self.stages[stage] = self.stages.get(stage, 0.0) + 1e3 * (now - self._last)
        self._last = now
