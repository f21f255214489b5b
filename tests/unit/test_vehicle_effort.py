"""What a motion asks of the body as a whole, against the flatness of the same motion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.spline import FlatState
from jaxplan.vehicle.flatness import against_drag, differential_flatness
from jaxplan.vehicle.limits import effort_of, most_thrust
from jaxplan.vehicle.load import load_vehicle
from tolerances import relative


@pytest.mark.parametrize("seed", range(5))
def test_effort_is_thrust_and_tilting_rate_of_the_flat_outputs_against_drag(seed):
    """Yaw is held, so the body rates across the thrust are all of the turn of the thrust."""
    vehicle, rng = load_vehicle(), np.random.default_rng(seed)
    derivatives = rng.normal(size=(5, 3)) * np.array([1.0, 5.0, 6.0, 20.0, 100.0])[:, None]
    with jax.enable_x64(True):
        state = FlatState(derivatives=jnp.asarray(derivatives), yaw=jnp.zeros(3))
        held = differential_flatness(vehicle, against_drag(vehicle, state))
        effort = effort_of(vehicle, *jnp.asarray(derivatives[1:4]))
        assert float(effort.thrust) == pytest.approx(float(held.specific_thrust), **relative("formula"))
        assert float(effort.tilting) == pytest.approx(float(np.hypot(*held.body_rates[:2])), **relative("formula"))


def test_hovering_asks_for_gravity_and_no_turn():
    with jax.enable_x64(True):
        nothing = jnp.zeros(3)
        effort = effort_of(load_vehicle(), nothing, nothing, nothing)
    assert float(effort.thrust) == pytest.approx(9.81)
    assert float(effort.tilting) == 0.0


def test_the_most_is_four_rotors_at_full_speed():
    vehicle = load_vehicle()
    assert float(most_thrust(vehicle)) == pytest.approx(
        4 * vehicle.thrust_coefficient * vehicle.rotor_speed_max**2 / vehicle.mass
    )
