"""One replan, from candidates to checked trajectories: the stations of the method in order.

candidates -> search -> knots -> policy <-> arrival -> minimum snap -> checks -> selection
"""

from jaxplan.planner.build import build_planner
from jaxplan.planner.records import Planner, PlannerConfig, Plans, Timer, select

__all__ = ["Planner", "PlannerConfig", "Plans", "Timer", "build_planner", "select"]
