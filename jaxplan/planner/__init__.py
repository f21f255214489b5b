"""One replan, from candidates to checked trajectories: the stations of the method in order.

candidates -> search -> knots -> policy <-> arrival -> minimum snap -> checks -> selection
"""

from jaxplan.planner.build import build_planner
from jaxplan.planner.records import (
    Approaches,
    Planner,
    PlannerConfig,
    Plans,
    Stops,
    select,
    select_approach,
    select_stop,
)
from jaxplan.planner.timer import Timer

__all__ = [
    "Approaches",
    "Planner",
    "PlannerConfig",
    "Plans",
    "Stops",
    "Timer",
    "build_planner",
    "select",
    "select_approach",
    "select_stop",
]
