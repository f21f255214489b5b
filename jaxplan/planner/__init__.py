"""One replan, from candidates to checked trajectories: the stations of the method in order.

candidates -> search -> knots -> policy <-> arrival -> minimum snap -> checks -> selection
"""

from jaxplan.planner.build import build_planner
from jaxplan.planner.records import Approaches, Planner, PlannerConfig, Plans, select, select_approach
from jaxplan.planner.timer import Timer

__all__ = [
    "Approaches",
    "Planner",
    "PlannerConfig",
    "Plans",
    "Timer",
    "build_planner",
    "select",
    "select_approach",
]
