"""Vehicles without symmetry fly: they hover and follow a circle, with hover speeds that differ from rotor to rotor."""

import jax
import numpy as np
import pytest

from jaxplan.records import replace
from jaxplan.spline import FlatState, hover
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.rollout import ControllerName, build_plant
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import hover_speeds
from oracles import plant_references
from oracles.layouts import LAYOUTS

TIMES = np.arange(4 * CONTROL_RATE + 1) / CONTROL_RATE


def references() -> FlatState:
    """Hover, and a circle of 2 m at 2 m/s, as the first axis."""
    circle = plant_references.helix(TIMES, 2.0, 1.0, 0.0, 0.0)
    still = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (len(TIMES), *leaf.shape)), hover(np.zeros(3), yaw=0.5))
    return jax.tree.map(lambda *leaves: np.stack(leaves), still, circle)


@pytest.mark.parametrize(
    ("name", "controller"),
    [
        ("kite", "indi"),
        pytest.param("kite", "se3", marks=pytest.mark.slow),
        pytest.param("triangle and centre", "indi", marks=pytest.mark.slow),
        pytest.param("spins by sides", "indi", marks=pytest.mark.slow),
    ],
)
def test_layouts_without_symmetry_hover_and_follow_a_circle(name: str, controller: ControllerName) -> None:
    positions, spin = (np.array(part) for part in LAYOUTS[name])
    vehicle = replace(load_vehicle(), rotor_positions=positions, rotor_spin=spin)
    plant, flights = build_plant(vehicle, noise=False, controller=controller), references()
    begin = jax.tree.map(lambda leaf: leaf[:, 0], flights)
    states = jax.vmap(plant.reset)(begin, jax.random.split(jax.random.key(0), 2))
    np.testing.assert_allclose(states.rotor_speeds[0], hover_speeds(vehicle), rtol=1e-4)
    log = jax.vmap(plant.fly)(states, flights)[1]
    error, yaw = np.max(log.position_error, axis=1), np.max(log.yaw_error, axis=1)
    print(name, controller, error, yaw)
    assert error[0] < 1e-3
    assert error[1] < (0.02 if controller == "indi" else 0.05)
    assert np.all(yaw < np.radians(1.0))
    assert not np.any(log.saturated)
