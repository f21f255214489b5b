"""One replan, from candidates to checked trajectories: the stations of the method in order.

candidates -> search -> knots -> policy <-> arrival -> minimum snap -> checks -> selection
"""

from jaxplan.planner.build import build_planner
from jaxplan.planner.records import (
    HITS,
    Approaches,
    Planner,
    PlannerConfig,
    Plans,
    Stops,
    select,
    select_approach,
    select_stop,
)
from jaxplan.planner.refined import Refined, RefinementConfig, Seed
from jaxplan.planner.timer import Timer
from jaxplan.planner.validator import Fault, Verdict

__all__ = [
    "HITS",
    "Approaches",
    "Fault",
    "Planner",
    "PlannerConfig",
    "Plans",
    "Refined",
    "RefinementConfig",
    "Seed",
    "Stops",
    "Timer",
    "Verdict",
    "build_planner",
    "select",
    "select_approach",
    "select_stop",
]
