"""Early reasons against goals: those of ``prediction.candidates.reject_early``, in every kind of room."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.planner.kernels.goals import reasons_against
from jaxplan.prediction.candidates import candidates_from, reject_early
from jaxplan.search.kernels.solids import REACH, solids_of
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.reach import reach
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World
from oracles.solid_rooms import room_of_all_kinds, room_of_grids

VEHICLE = load_vehicle()


def rooms() -> dict[str, World]:
    return {
        "kinds": room_of_all_kinds(),
        "grids": room_of_grids(),
        **{name: load_world(name) for name in ("env1", "env2", "env3")},
    }


@pytest.mark.parametrize("padding", [0.3, REACH + 0.4])
@pytest.mark.parametrize("name", rooms())
def test_reasons_are_those_of_the_other_code(name: str, padding: float) -> None:
    world, rng = rooms()[name], np.random.default_rng(1)
    bounds = np.asarray(world.bounds, float)
    start, goals = rng.uniform(*bounds), rng.uniform(bounds[0] - 0.6, bounds[1] + 0.6, size=(400, 3))
    times = rng.uniform(-0.1, 2.0, 400)
    goals[::37], goals[::41, 1], times[::53], times[::59] = np.nan, np.inf, np.nan, np.inf
    with jax.enable_x64(True):
        far = np.asarray(reach(VEHICLE, jnp.float64(3.0), jnp.asarray(times)))
        candidates = candidates_from(start, goals, times, np.zeros(400))
        plain = candidates.__class__(**{**vars(candidates), "reasons": np.zeros(400, np.uint32)})
        wanted = np.asarray(jax.jit(reject_early, static_argnums=3)(plain, world, start, padding, far).reasons)
    distances = (float(world.keep_in), padding)
    found = reasons_against(tuple(solids_of(world)), bounds, distances, start, goals, times, reach(VEHICLE, 3.0, times))
    np.testing.assert_array_equal(found, wanted)
    assert len(np.unique(found)) > 5


def test_the_host_knows_how_far_a_vehicle_gets() -> None:
    times = np.array([-1.0, 0.0, 0.1, 1.0, 3.0])
    with jax.enable_x64(True):
        wanted = np.asarray(jax.jit(reach)(VEHICLE, jnp.float64(6.0), jnp.asarray(times)))
    np.testing.assert_allclose(reach(VEHICLE, 6.0, times), wanted, rtol=1e-6)  # its numbers have single precision
    assert not reach(VEHICLE, 6.0, np.array([np.nan]))[0] >= 0.0
