"""How far a vehicle can get, against the equation of motion integrated."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxplan.records import replace
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.reach import reach

TIMES = np.array([0.0, 0.1, 0.5, 1.0, 3.0])


@pytest.mark.parametrize("drag", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("speed", [0.0, 6.0, 60.0])
def test_equals_the_integrated_equation_of_motion(drag: float, speed: float) -> None:
    vehicle = replace(load_vehicle(), drag_coefficient=drag)
    push = 4.0 * float(vehicle.thrust_coefficient) * float(vehicle.rotor_speed_max) ** 2 / float(vehicle.mass) + 9.81

    def motion(_: float, state: np.ndarray) -> list[float]:
        return [state[1], push - drag / float(vehicle.mass) * state[1] ** 2]

    wanted = solve_ivp(motion, (0.0, 3.0), [0.0, speed], t_eval=TIMES, rtol=1e-9, atol=1e-9).y[0]  # the oracle's own
    with jax.enable_x64(True):
        found = jax.jit(reach)(vehicle, jnp.float64(speed), jnp.asarray(TIMES))
    np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-4)


def test_times_that_are_past_reach_nothing() -> None:
    with jax.enable_x64(True):
        found = np.asarray(jax.jit(reach)(load_vehicle(), jnp.float64(3.0), jnp.array([-1.0, np.nan])))
    assert found[0] == 0.0
    assert not found[1] >= 0.0
