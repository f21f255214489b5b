"""Who flies in the arena: our planners with a predictor each, laws that plan nothing, and the offline reference.

A contestant is a name and a function that builds what stands where a ``Replanner`` stands in an episode; docs/arena.md
adds one.
"""

import dataclasses
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from jaxplan.config import WITH_MODEL
from jaxplan.errors import InputError
from jaxplan.interception import Guide
from jaxplan.names import meant
from jaxplan.prediction.lookout import Lookout, LookoutConfig, Views, views_of
from jaxplan.prediction.predictors import PREDICTORS, build_predictor
from jaxplan.prediction.protocol import PredictionConfig, Predictor
from jaxplan.prediction.target_model import TargetModel, shipped_model
from jaxplan.replanner import Replanner
from jaxplan.scenario import Scenario
from jaxplan.world.load import ENVIRONMENTS
from jaxplan.world.obstacles import World

from ..closed_loop import available_planners
from ..guidance import FAST, LAWS, Guidance, law_named
from ..point_mass_mpc import PointMassMpc, has_solver
from ..routing import around_obstacles
from .families import Case
from .movers import Warned
from .sight import SightConfig

NO_PLANNER = "navigation"
"""Whose scenario has a planner that is never asked."""
REFERENCE = "reference"
"""The offline optimum that knows the target's motion (``jaxplan.reference``)."""


@runtime_checkable
class BuildGuide(Protocol):
    """Builds what commands the defender."""

    def __call__(self, scenario: Scenario, case: Case, /) -> Guide:
        """For one episode."""


class Contestant(NamedTuple):
    """Somebody who flies."""

    build: BuildGuide
    planner: str
    """Whose planner the scenario has; for laws one that is hardly anything."""


def _law(name: str) -> Contestant:
    return Contestant(lambda scenario, case: Guidance(law_named(name), scenario.start), NO_PLANNER)


def _routed(scenario: Scenario, case: Case) -> Guide:
    return Guidance(law_named("navigation", around_obstacles(case.world)), scenario.start)


def _mpc(scenario: Scenario, case: Case) -> Guide:
    return Guidance(PointMassMpc(case.world, predictor_named("constant-velocity", case)), scenario.start)


CONTESTANTS: dict[str, Contestant] = {
    **{name: _law(name) for name in (*LAWS, FAST)},
    "routed-navigation": Contestant(_routed, NO_PLANNER),
    "mpc": Contestant(_mpc, NO_PLANNER),
}
"""Those that are not a planner with a predictor, by name."""


def contestant(name: str) -> Contestant:
    """Who has this name: one of ``CONTESTANTS``, or PLANNER/PREDICTOR.

    Raises ``InputError`` for unknown names, and where a solver is missing.
    """
    if name == "mpc" and not has_solver():
        raise InputError("--contestants: mpc needs OSQP; pip install 'jaxplan[peers]'")
    if name in CONTESTANTS:
        return CONTESTANTS[name]
    planner, _, predictor = name.partition("/")
    if planner in LAWS or planner not in available_planners() or predictor not in PREDICTORS:
        planners = [own for own in available_planners() if own not in LAWS]
        known = [REFERENCE, *CONTESTANTS]
        ours = [f"{one}/{other}" for one in planners for other in PREDICTORS]
        raise InputError(
            f"--contestants: have {name!r}, want one of {', '.join(known)}, or PLANNER/PREDICTOR of "
            f"{', '.join(planners)} and {', '.join(PREDICTORS)}{meant(name, [*known, *ours])}"
        )

    def build(scenario: Scenario, case: Case) -> Guide:
        own = predictor_named(predictor, case)
        if case.sight is not None and predictor != "ground-truth":
            own = looking(own, case.world, case.sight.config)
        replanner = Replanner(scenario.planner, own, scenario.start, scenario.replanning)
        if case.traffic is None:
            return replanner
        return Warned(replanner, case.traffic, case.world, float(scenario.vehicle.radius))

    return Contestant(build, planner)


def predictor_named(name: str, case: Case) -> Predictor:
    """A predictor for one episode; a room that has no mixture of its own gets the generic one."""
    config, model = PredictionConfig.for_world(case.world), None
    if name in WITH_MODEL:
        model = mixture_for(case.world, config)
    truth = case.target.position if case.known else None
    return build_predictor(name, config, truth, case.seed, model, case.world)


def looking(predictor: Predictor, world: World, sight: SightConfig) -> Predictor:
    """The same, and where nobody sees the target, where to look for it with this sensor."""
    config = LookoutConfig(sight_range=sight.sight_range)
    if sight.field_of_view < 2.0 * np.pi:
        config = dataclasses.replace(config, dwell=2.0 * np.pi / sight.turn_rate)
    key = (world.name, config)
    if key not in _VIEWS:
        _VIEWS[key] = views_of(world, config)
    return Lookout(predictor, world, PredictionConfig.for_world(world), config, _VIEWS[key])


_VIEWS: dict[tuple[str, LookoutConfig], Views] = {}
"""Of the stored rooms, by sensor: eighteen at most."""


def mixture_for(world: World, config: PredictionConfig) -> TargetModel:
    """The mixture that is shipped for a room."""
    return shipped_model(world.name if world.name in ENVIRONMENTS else "", config.dt)
