"""One replan, from candidates to checked trajectories: the stations of the method in order.

candidates -> search -> knots -> policy <-> arrival -> minimum snap -> checks -> selection
"""

from jaxplan.planner.build import build_planner
from jaxplan.planner.capture import CaptureConfig, Prospect, capture_time, capture_times, expected_goals
from jaxplan.planner.fallbacks import HITS, NEARLY, Approaches, Corrections, Stops, select_approach, select_stop
from jaxplan.planner.records import Planner, PlannerConfig, Plans, prospect_for, select
from jaxplan.planner.refined import Refined, RefinementConfig, Seed
from jaxplan.planner.rollouts import Rollout, RolloutConfig, Rollouts, sampled
from jaxplan.planner.timer import Timer
from jaxplan.planner.validator import Fault, Verdict

__all__ = [
    "HITS",
    "NEARLY",
    "Approaches",
    "CaptureConfig",
    "Corrections",
    "Fault",
    "Planner",
    "PlannerConfig",
    "Plans",
    "Prospect",
    "Refined",
    "RefinementConfig",
    "Rollout",
    "RolloutConfig",
    "Rollouts",
    "Seed",
    "Stops",
    "Timer",
    "Verdict",
    "build_planner",
    "capture_time",
    "capture_times",
    "expected_goals",
    "prospect_for",
    "sampled",
    "select",
    "select_approach",
    "select_stop",
]
