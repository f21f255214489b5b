"""The free body's stages of MJX against the whole of ``mjx.step``, at attitudes, velocities and forces of all kinds."""

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxplan.precision import float32_island
from jaxplan.records import replace
from jaxplan.tracking.model import Body, Motion, complete_body, vehicle_body
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle
from oracles.layouts import LAYOUTS
from tolerances import tolerance

FLIGHTS = 64
Inputs = tuple[Motion, np.ndarray, np.ndarray, np.ndarray]


def lopsided() -> Vehicle:
    """A layout without symmetry, with three different moments of inertia."""
    positions, spin = (np.array(part) for part in LAYOUTS["kite"])
    inertia = np.array([0.003, 0.005, 0.007])
    return replace(load_vehicle(), rotor_positions=positions, rotor_spin=spin, inertia=inertia)


VEHICLES = {"mfrl": load_vehicle(), "flightgoggles": load_vehicle("flightgoggles"), "lopsided": lopsided()}
SLOW = ("flightgoggles", "lopsided")


def inputs() -> Inputs:
    """Far away, upside down, at 10 m/s and 10 rad/s, under newtons of thrust and tenths of a newton metre."""
    rng = np.random.default_rng(0)
    motion = Motion(
        pos=rng.normal(size=(FLIGHTS, 3)) * 5.0,
        quat_wxyz=Rotation.random(FLIGHTS, random_state=1).as_quat()[:, [3, 0, 1, 2]],
        vel=rng.normal(size=(FLIGHTS, 3)) * 10.0,
        body_rates=rng.normal(size=(FLIGHTS, 3)) * 10.0,
    )
    thrusts, force = rng.uniform(0.0, 8.0, (FLIGHTS, 4)), rng.normal(size=(FLIGHTS, 3)) * 3.0
    return motion, thrusts, force, rng.normal(size=(FLIGHTS, 3)) * 0.1


def stepped(body: Body, *given: object) -> Motion:
    return jax.jit(jax.vmap(lambda motion, *forces: body(motion, *forces)))(*given)


@pytest.mark.parametrize("name", ["mfrl", *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_a_step_is_that_of_mjx_in_float64(name: str) -> None:
    with jax.enable_x64(True), jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        ours = stepped(vehicle_body(VEHICLES[name], float64=True), *inputs())
        theirs = stepped(complete_body(VEHICLES[name], float64=True), *inputs())
    for field, one, other in zip(Motion._fields, ours, theirs, strict=True):
        assert one.dtype == np.float64
        np.testing.assert_allclose(one, other, **tolerance("exact"), err_msg=field)
    assert np.ptp(np.asarray(ours.body_rates) - inputs()[0].body_rates) > 0.1  # the step is not idle


def test_a_step_is_that_of_mjx_in_float32_and_a_bad_flight_leaves_its_neighbours_alone() -> None:
    motion, *forces = inputs()
    motion.vel[5, 1] = np.nan
    ours, theirs = (
        float32_island(jax.vmap(body))(motion, *forces)
        for body in (vehicle_body(load_vehicle()), complete_body(load_vehicle()))
    )
    for field, one, other in zip(Motion._fields, ours, theirs, strict=True):
        one, other = (np.delete(np.asarray(part), 5, axis=0) for part in (one, other))
        scale = np.max(np.abs(other))
        np.testing.assert_allclose(one / scale, other / scale, **tolerance("exact", np.float32), err_msg=field)
        assert one.dtype == np.float32
    assert not np.all(np.isfinite(ours.vel[5]))
