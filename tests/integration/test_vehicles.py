"""Vehicles that nothing was learned for: what is planned for them is flown, in closed loop and out of it."""

import dataclasses

import numpy as np
import pytest

import jaxplan
from jaxplan import interception
from jaxplan.config import InterceptConfig
from jaxplan.errors import InputError
from jaxplan.scenario import build_scenario, planner_config, with_a_planner
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.reach import sideways_acceleration

FLOWN = {"cf21": (1.0, 0.3), "racer5": (3.0, 0.5), "x500": (1.0, 0.6)}
"""Speed of the target [m/s] and padding [m]."""


def test_who_allots_the_times_follows_from_the_vehicle() -> None:
    own, other = load_vehicle(), load_vehicle("racer5")
    assert with_a_planner(InterceptConfig(), own).planner == "mfrl"
    chosen = with_a_planner(InterceptConfig(), other)
    assert (chosen.planner, chosen.allocate) == ("no-policy", "profile")
    assert planner_config(chosen).arrival.least_alpha == 1.0
    assert planner_config(with_a_planner(InterceptConfig(), own)).arrival.least_alpha < 1.0
    asked = InterceptConfig(planner="no-policy")
    assert with_a_planner(asked, other) is asked
    assert sideways_acceleration(other) < sideways_acceleration(own), "slower motors"


def test_what_does_not_fit_the_vehicle_is_refused() -> None:
    with pytest.raises(InputError, match="was made for vehicle 'mfrl'"):
        build_scenario(InterceptConfig(vehicle="racer5", planner="mfrl"))
    with pytest.raises(InputError, match=r"at least the radius of vehicle 'x500', 0\.38 m"):
        build_scenario(InterceptConfig(vehicle="x500", padding=0.3))
    with pytest.raises(InputError, match="no vehicle preset 'balloon'"):
        build_scenario(InterceptConfig(vehicle="balloon"))
    for bad in ({"padding": 0.0}, {"padding": np.inf}, {"vehicle": ""}):
        with pytest.raises(InputError):
            InterceptConfig(**bad)


@pytest.mark.slow
@pytest.mark.parametrize("name", FLOWN)
def test_every_preset_meets_a_target(name: str) -> None:
    speed, padding = FLOWN[name]
    config = InterceptConfig(vehicle=name, padding=padding, speed=speed)
    scenario = build_scenario(config)
    interception.warm_up(scenario)
    for target in ("env1-01", "env1-04", "env1-08"):
        chosen = jaxplan.load_target(target, world="env1", speed=speed)
        episode = interception.fly(dataclasses.replace(scenario, target=chosen, predictor=_knowing(config, target)))
        assert episode.success, (target, episode.outcome)
        assert episode.flight.position_error.max() < 0.2
        assert episode.scenario.vehicle.name == name


def _knowing(config: InterceptConfig, target: str) -> object:
    return build_scenario(dataclasses.replace(config, target=target)).predictor
