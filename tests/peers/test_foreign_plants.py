"""Other people's simulators: that they agree with each other, and that they fly what we command."""

import dataclasses
import importlib.util
import os

import numpy as np
import pytest

from jaxplan import minimum_snap
from jaxplan.errors import InputError
from jaxplan.spline import PiecewisePolynomial
from jaxplan.vehicle.load import load_vehicle
from tolerances import tolerance

pytest.importorskip("rotorpy")
if not importlib.util.find_spec("drone_models"):
    pytest.skip("needs drone-models, of the extra peers", allow_module_level=True)

from experiments import foreign_flight, foreign_plants
from experiments.foreign_flight import CONTROLS, PLANTS, fly

pytestmark = pytest.mark.peers


def turn() -> PiecewisePolynomial:
    """Up and round with a heading, at up to 2 g."""
    return minimum_snap([[0.0, 0.0, 1.0], [2.0, 1.0, 1.5], [4.0, 0.0, 1.0]], [1.0, 1.0], yaw=[0.0, 0.3, 0.0])


def test_the_two_simulators_agree_where_both_know_the_physics() -> None:
    """Without rotor inertia, which rotorpy does not know, two codes that share nothing fly alike."""
    bare = dataclasses.replace(load_vehicle(), rotor_inertia=0.0, aero_moment_coefficient=0.0)
    spline = turn()
    first, second = (fly(bare, spline, float(spline.duration), plant).position_error for plant in PLANTS)
    assert np.max(first) > 0.1  # rotors at their limits: an error to agree about
    # rotorpy's integrator is relative to 1e-3 in each step
    np.testing.assert_allclose(first, second, rtol=0.0, atol=tolerance("solve", np.float32)["atol"])


@pytest.mark.parametrize("plant", PLANTS)
def test_the_feed_forward_follows_better_than_the_same_gains_without(plant: str) -> None:
    """More slowly no rotor is at its limit, and drag and rates are what is left."""
    spline = turn().dilate(1.4)
    worst = {
        way: np.max(fly(load_vehicle(), spline, float(spline.duration), plant, way).position_error) for way in CONTROLS
    }
    assert worst["feed-forward"] < 0.25 * worst["our gains"]
    assert worst["our gains"] < 0.4


@pytest.mark.parametrize("tilt", [0.3, 1.2, 2.0])
def test_their_yaw_makes_our_attitude(tilt: float) -> None:
    """Also upside down."""
    from rotorpy.controllers.quadrotor_control import SE3Control
    from scipy.spatial.transform import Rotation

    attitude = Rotation.from_euler("ZYX", [0.7, tilt, 0.2]).as_matrix()
    controller = SE3Control(foreign_flight.parameters(load_vehicle()))
    at = {"x": np.zeros(3), "v": np.zeros(3), "q": np.array([0.0, 0.0, 0.0, 1.0]), "w": np.zeros(3)}
    wanted = {"x": np.zeros(3), "x_dot": np.zeros(3), "x_ddot": 12.0 * attitude[:, 2] - np.array([0.0, 0.0, 9.81])}
    wanted |= {"yaw": foreign_flight.their_yaw(attitude), "yaw_dot": 0.0}
    made = Rotation.from_quat(controller.update(0.0, at, wanted)["cmd_q"]).as_matrix()
    np.testing.assert_allclose(made, attitude, **tolerance("formula"))


def test_the_environment_is_left_as_it_was() -> None:
    before = dict(os.environ)
    fly(load_vehicle(), turn(), 0.05, "drone-models")
    assert dict(os.environ) == before


def test_an_unknown_simulator_is_named() -> None:
    with pytest.raises(InputError, match="--plants: have gazebo"):
        foreign_plants.Config(plants=("gazebo",))
