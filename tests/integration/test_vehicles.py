"""Vehicles that nothing was learned for: what is planned for them is flown, in closed loop and out of it."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import jaxplan
from jaxplan import interception
from jaxplan.config import InterceptConfig
from jaxplan.errors import InputError
from jaxplan.scenario import build_scenario, planner_config, with_a_planner
from jaxplan.spline import hover
from jaxplan.tracking.result import held_error
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.reach import sideways_acceleration
from jaxplan.world.load import load_world

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


def test_a_policy_of_ones_own_takes_the_place_of_the_shipped_ones() -> None:
    """The shipped files by their paths: the same planner as by name, also where it decides what can be flown."""
    folder = Path(jaxplan.__file__).parent
    own = {
        "policy": str(folder / "policy/weights/mfrl.npz"),
        "classifier": str(folder / "feasibility/weights/mfrl.npz"),
    }
    goals = np.random.default_rng(1).uniform([-4.5, -4.5, 0.6], [4.5, 4.5, 1.4], (40, 3))
    given = jaxplan.candidates_from(goals[0], goals, np.linspace(1.0, 4.0, 40), np.zeros(40))
    found = []
    for options in ({}, own, {"policy": own["policy"]}):
        config = InterceptConfig(**options)
        scenario = build_scenario(config)
        assert with_a_planner(config, load_vehicle()).planner == (None if options else "mfrl")
        plans = scenario.planner.plan_batch(scenario.start, given)
        found.append((plans.reasons, np.asarray(plans.margins.probability)))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    assert np.isfinite(found[1][1]).any()
    assert np.isnan(found[2][1]).all(), "without a classifier the rotor limits decide"


@pytest.mark.slow
@pytest.mark.parametrize("name", FLOWN)
def test_every_preset_meets_a_target(name: str) -> None:
    speed, padding = FLOWN[name]
    config = InterceptConfig(vehicle=name, padding=padding, speed=speed, predictor="ground-truth")
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


SPREAD = {
    "40 g": (0.037, 1.73, 0.043),
    "90 g": (0.087, 6.5, 0.05),
    "0.5 kg": (0.48, 3.8, 0.038),
    "4 kg": (4.0, 4.4, 0.047),
}
"""Mass [kg], thrust-to-weight ratio, lag of the motors [s]."""


@pytest.mark.slow
@pytest.mark.parametrize("name", SPREAD)
def test_what_is_called_usable_is_tracked(name: str, tmp_path: Path) -> None:
    mass, ratio, lag = SPREAD[name]
    arm = 0.113 * (mass / 0.771) ** (1 / 3)
    file = tmp_path / "mine.toml"
    file.write_text(f"mass = {mass}\narm = {arm}\nthrust_to_weight = {ratio}\nmotor_time_constant = {lag}\n")
    vehicle, world, rng = load_vehicle(file), load_world("env1"), np.random.default_rng(5)
    chosen = with_a_planner(InterceptConfig(padding=max(0.5, float(vehicle.radius) + 0.15)), vehicle)
    config = planner_config(chosen, exhaustive=True)
    planner = jaxplan.build_planner(config, world=world, vehicle=vehicle, policy=jaxplan.constant_speed_policy())
    goals, times = rng.uniform(world.bounds[0] + 0.6, world.bounds[1] - 0.6, (200, 3)), rng.uniform(1.0, 6.0, 200)
    plans = planner.plan_batch(hover(world.start), jaxplan.candidates_from(goals[0], goals, times, np.zeros(200)))
    usable = [plans.spline(index) for index in np.flatnonzero(plans.reasons == 0)]
    assert len(usable) > 40
    errors = np.asarray(jaxplan.track(usable, vehicle=vehicle).max_position_error)
    assert (errors < held_error(vehicle)).mean() >= 0.9
