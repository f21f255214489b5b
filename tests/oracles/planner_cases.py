"""States and candidates in environment 1, all over the room, for tests of the planner."""

import numpy as np

from jaxplan.knots import KnotConfig
from jaxplan.planner import PlannerConfig
from jaxplan.prediction.candidates import candidates_from
from jaxplan.spline import FlatState

START = np.array([-4.3, -4.3, 1.0])
GOAL = START + np.array([0.3, 3.3, 0.0])
"""[m]; straight on along y."""
CONFIG = PlannerConfig(width=16, knots=KnotConfig(distance_per_knot=1.0))


def nowhere(observations, cycle):
    """What a predictor says that knows one goal, outside the room."""
    return candidates_from(GOAL, GOAL[None] + 50.0, np.ones(1), np.zeros(1))


def in_flight():
    """A state in full flight."""
    derivatives = np.zeros((5, 3))
    derivatives[0], derivatives[1], derivatives[2] = [-4.0, -2.5, 1.0], [0.3, 1.5, 0.1], [0.5, 0.4, -0.2]
    derivatives[3], derivatives[4] = [1.0, -1.0, 0.3], [4.0, 3.0, -2.0]
    return FlatState(derivatives=derivatives, yaw=np.array([1.2, 0.3, -0.1]))


def candidates(count=20, seed=0):
    """Goals all over the room, some outside it, in obstacles, invalid or too soon."""
    rng = np.random.default_rng(seed)
    goals = rng.uniform([-5.2, -5.2, 0.1], [5.2, 5.2, 1.9], (count, 3))
    times = rng.uniform(0.5, 12.0, count)
    return candidates_from(goals[0], goals, times, -0.1 * rng.random(count))
