"""What a planner's process builds from what a user can choose."""

import functools

from jaxplan.config import InterceptConfig
from jaxplan.runtime.records import Build, Built
from jaxplan.scenario import build_planning, build_scenario
from jaxplan.world.update import with_spare_boxes


def from_config(config: InterceptConfig, spare_boxes: int = 0) -> Build:
    """A planner as ``jaxplan intercept`` has it, for ``Runtime``.

    Args:
        config: world, planner, predictor, and what else a planner is made of; the target matters to a predictor that
            knows the truth only.
        spare_boxes: how many boxes may appear in its world.
    """
    return functools.partial(_built, config, spare_boxes)


def _built(config: InterceptConfig, spare_boxes: int) -> Built:
    scenario = build_scenario(config)
    if not spare_boxes:
        return Built(scenario.planner, scenario.predictor, scenario.world, scenario.start)
    world = with_spare_boxes(scenario.world, spare_boxes)
    return Built(scenario.planner.in_world(world), scenario.predictor, world, scenario.start)


def from_observed(config: InterceptConfig) -> Build:
    """The same against a target that only sensors know, which needs no trajectory of it."""
    return functools.partial(_observed, config)


def _observed(config: InterceptConfig) -> Built:
    world, planner, predictor, start = build_planning(config)
    return Built(planner, predictor, world, start)
