"""What a planner's process may be told to build; at the top of a module, so that it can be sent there."""

import os
import time

import numpy as np

from jaxplan.errors import FileError
from jaxplan.planner import build_planner
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.runtime import Built
from jaxplan.spline import hover
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from jaxplan.world.update import with_spare_boxes
from oracles.planner_cases import CONFIG, START

GOAL = np.array([-4.0, -1.0, 1.0])


def standing(observations, cycle):
    """The target will stand where it was seen last, three seconds from now."""
    where = np.asarray(observations.positions[-1])
    return candidates_from(where, where[None], np.array([3.0]), np.zeros(1))


def planner():
    """A small planner without a policy, in environment 1."""
    world = with_spare_boxes(load_world("env1"), 4)
    made = build_planner(CONFIG, world=world, vehicle=load_vehicle(), policy=constant_speed_policy())
    return Built(made, standing, world, hover(START))


def hanging_predictor(observations, cycle):
    """Hangs in its tenth cycle."""
    if cycle == 10:
        time.sleep(3600.0)
    return standing(observations, cycle)


def hanging():
    """A planner that hangs after a second."""
    return planner()._replace(predictor=hanging_predictor)


def refusing():
    """A map that is not there."""
    raise FileError("world: no such file 'nowhere.stl'")


def dying():
    """A process that ends without a word."""
    os._exit(7)
