"""Differential flatness against finite differences, closed forms and symmetries; and the rotor limits."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxplan.records import replace
from jaxplan.spline import FlatState, hover
from jaxplan.vehicle.flatness import FlatOutputs, attitude_from, differential_flatness
from jaxplan.vehicle.limits import rotor_limit_margin
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle, hover_speeds
from jaxplan.vehicle.rotations import quat_from_rotation, rotation_from_quat, rotation_vector
from oracles import plant_references
from tolerances import assert_close, tolerance

pytestmark = pytest.mark.usefixtures("x64")


@pytest.fixture
def vehicle() -> Vehicle:
    return load_vehicle()


def states(reference: FlatState) -> FlatState:
    return jax.tree.map(jnp.asarray, reference)


def flat(vehicle: Vehicle, reference: FlatState) -> FlatOutputs:
    return jax.jit(jax.vmap(lambda state: differential_flatness(vehicle, state)))(states(reference))


def random_states(count: int, seed: int = 0) -> FlatState:
    rng = np.random.default_rng(seed)
    scale = np.array([5.0, 3.0, 4.0, 8.0, 20.0])[:, None]
    return FlatState(derivatives=rng.normal(size=(count, 5, 3)) * scale, yaw=rng.normal(size=(count, 3)) * 2.0)


def test_hover(vehicle: Vehicle) -> None:
    out = differential_flatness(vehicle, states(hover(np.zeros(3), yaw=0.7)))
    speed = math.sqrt(vehicle.mass * vehicle.gravity / (4 * vehicle.thrust_coefficient))
    assert_close(out.rotor_speeds, np.full(4, speed), "formula")
    assert_close(out.thrust, vehicle.mass * vehicle.gravity, "formula")
    assert_close(out.quat_wxyz, [math.cos(0.35), 0.0, 0.0, math.sin(0.35)], "formula")
    assert_close(out.moment, np.zeros(3), "formula")


@pytest.mark.parametrize("name", ["helix", "figure_eight"])
def test_rates_are_the_derivatives_of_the_attitude(vehicle: Vehicle, name: str) -> None:
    h = 1e-4
    t = (np.linspace(0.3, 4.0, 40)[:, None] + np.array([-h, 0.0, h])).ravel()
    if name == "helix":
        reference = plant_references.helix(t, 2.0, 1.7, 0.5, 1.3)
    else:
        reference = plant_references.figure_eight(t, 3.0, along_heading=True)
    out = flat(vehicle, reference)
    rotation = Rotation.from_matrix(np.asarray(out.rotation).reshape(40, 3, 3, 3)[:, 0])
    later = Rotation.from_matrix(np.asarray(out.rotation).reshape(40, 3, 3, 3)[:, 2])
    rates = np.asarray(out.body_rates).reshape(40, 3, 3)
    numeric_rates = (rotation.inv() * later).as_rotvec() / (2 * h)
    numeric_acc = (rates[:, 2] - rates[:, 0]) / (2 * h)
    # central differences with h = 1e-4 on quantities with third derivatives up to 1e3: h^2 * 1e3
    np.testing.assert_allclose(rates[:, 1], numeric_rates, **tolerance("exact", np.float32))
    np.testing.assert_allclose(
        np.asarray(out.angular_acceleration).reshape(40, 3, 3)[:, 1], numeric_acc, rtol=1e-4, atol=1e-4
    )


def test_force_heading_and_moment_are_as_demanded(vehicle: Vehicle) -> None:
    reference = random_states(50)
    out = flat(vehicle, reference)
    rotation = np.asarray(out.rotation)
    force = np.asarray(out.specific_thrust)[:, None] * rotation[:, :, 2]
    assert_close(force, reference.acc + np.array([0, 0, vehicle.gravity]), "formula")
    assert_close(np.einsum("nij,nik->njk", rotation, rotation), np.broadcast_to(np.eye(3), (50, 3, 3)), "formula")
    upright = rotation[:, 2, 2] > 0
    heading = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    assert_close(np.cos(heading - reference.yaw[:, 0])[upright], np.ones(upright.sum()), "formula")
    spin, arms = np.asarray(vehicle.rotor_spin), np.asarray(vehicle.rotor_positions)
    squares = np.sign(out.rotor_speeds) * np.asarray(out.rotor_speeds) ** 2
    pull = vehicle.thrust_coefficient * squares
    moment = np.stack([pull @ arms[:, 1], -pull @ arms[:, 0], vehicle.torque_coefficient * squares @ spin], axis=1)
    np.testing.assert_allclose(moment, out.moment, rtol=1e-9, atol=1e-9)  # through numbers of 1e6 (rad/s)^2
    rates, inertia = np.asarray(out.body_rates), np.asarray(vehicle.inertia)
    gyroscopic = np.asarray(out.moment) - inertia * np.asarray(out.angular_acceleration)
    assert_close(np.sum(gyroscopic * rates, axis=1), np.zeros(50), "solve")  # does no work; rates reach 1e2 rad/s


def test_the_rotors_of_a_layout_without_symmetry_make_the_demanded_wrench() -> None:
    arms = np.array([[0.12, 0.06, 0.0], [0.07, -0.1, 0.01], [-0.09, -0.07, 0.0], [-0.06, 0.11, -0.01]])
    vehicle = replace(load_vehicle(), rotor_positions=arms)
    out = flat(vehicle, random_states(50, seed=3))
    squares = np.sign(out.rotor_speeds) * np.asarray(out.rotor_speeds) ** 2
    pull = vehicle.thrust_coefficient * squares
    yaw = vehicle.torque_coefficient * squares @ vehicle.rotor_spin
    moment = np.stack([pull @ arms[:, 1], -pull @ arms[:, 0], yaw], axis=1)
    np.testing.assert_allclose(moment, out.moment, **tolerance("formula"))
    np.testing.assert_allclose(np.sum(pull, axis=1), out.thrust, **tolerance("formula"))
    level = differential_flatness(vehicle, states(hover(np.zeros(3))))
    assert_close(level.rotor_speeds, hover_speeds(vehicle), "solve")


def test_turning_the_world_turns_the_outputs(vehicle: Vehicle) -> None:
    reference = random_states(20, seed=1)
    turn = Rotation.from_euler("z", 1.1).as_matrix()
    turned = FlatState(derivatives=reference.derivatives @ turn.T, yaw=reference.yaw + np.array([1.1, 0.0, 0.0]))
    out, out_turned = flat(vehicle, reference), flat(vehicle, turned)
    assert_close(out_turned.rotation, turn @ np.asarray(out.rotation), "formula")
    assert_close(out_turned.body_rates, out.body_rates, "solve")
    np.testing.assert_allclose(out_turned.rotor_speeds, out.rotor_speeds, **tolerance("solve"))


def test_downward_pull_shows_as_a_negative_speed(vehicle: Vehicle) -> None:
    state = states(jax.tree.map(lambda rows: rows[0], random_states(1)))
    rolling = FlatState(derivatives=jnp.zeros((5, 3)).at[4, 1].set(3000.0), yaw=jnp.zeros(3))
    assert float(jnp.min(differential_flatness(vehicle, rolling).rotor_speeds)) < 0.0
    assert rotor_limit_margin(vehicle, rolling) < 0.0
    assert np.isfinite(rotor_limit_margin(vehicle, state))


def test_free_fall_is_finite_with_finite_gradients(vehicle: Vehicle) -> None:
    falling = FlatState(derivatives=jnp.ones((5, 3)).at[2].set(jnp.array([0.0, 0.0, -9.81])), yaw=jnp.ones(3))
    out = differential_flatness(vehicle, falling)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(out))
    assert out.thrust == 0.0
    gradient = jax.grad(lambda state: jnp.sum(differential_flatness(vehicle, state).rotor_speeds))(falling)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))
    sideways = attitude_from(jnp.array([0.0, 1.0, 0.0]), jnp.array(0.0))
    assert_close(sideways.T @ sideways, np.eye(3), "formula")


def test_margin_of_hover_and_of_states_that_are_not_finite(vehicle: Vehicle) -> None:
    speed = math.sqrt(vehicle.mass * vehicle.gravity / (4 * vehicle.thrust_coefficient))
    state = states(hover(np.zeros(3)))
    margin = jax.jit(lambda state: rotor_limit_margin(vehicle, state))
    assert_close(margin(state), min(speed, vehicle.rotor_speed_max - speed), "formula")
    for row in range(5):
        for bad in (jnp.nan, jnp.inf):
            broken = FlatState(derivatives=state.derivatives.at[row, 1].set(bad), yaw=state.yaw)
            assert margin(broken) == -jnp.inf
    for column in range(3):
        broken = FlatState(derivatives=state.derivatives, yaw=state.yaw.at[column].set(jnp.nan))
        assert margin(broken) == -jnp.inf


def test_margin_crosses_zero_at_the_thrust_limit(vehicle: Vehicle) -> None:
    most = 4 * vehicle.thrust_coefficient * vehicle.rotor_speed_max**2 / vehicle.mass - vehicle.gravity
    climbing = [jnp.zeros((5, 3)).at[2, 2].set(most * factor) for factor in (0.999, 1.001)]
    inside, outside = (rotor_limit_margin(vehicle, FlatState(derivatives=d, yaw=jnp.zeros(3))) for d in climbing)
    assert inside > 0.0 > outside


def test_vmap_and_jit_agree_with_single_calls_beside_a_bad_lane(vehicle: Vehicle) -> None:
    reference = random_states(6, seed=2)
    reference.derivatives[3] = np.nan
    batch = jax.jit(lambda lanes: jax.vmap(lambda state: differential_flatness(vehicle, state))(lanes))
    out = batch(states(reference))
    for lane in range(6):
        single = differential_flatness(vehicle, jax.tree.map(lambda rows, i=lane: rows[i], states(reference)))
        for name in ("quat_wxyz", "body_rates", "angular_acceleration"):
            np.testing.assert_allclose(getattr(out, name)[lane], getattr(single, name), **tolerance("formula"))
    assert np.all(np.isnan(out.rotor_speeds[3]))


def test_float32_stays_float32(vehicle: Vehicle) -> None:
    state = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), hover(np.zeros(3)))
    out = differential_flatness(vehicle, state)
    assert {leaf.dtype for leaf in jax.tree.leaves(out)} == {jnp.dtype(jnp.float32)}


def test_gradient_equals_finite_differences(vehicle: Vehicle) -> None:
    state = states(jax.tree.map(lambda rows: rows[0], random_states(1, seed=5)))

    def total(derivatives: jax.Array) -> jax.Array:
        return jnp.sum(differential_flatness(vehicle, FlatState(derivatives=derivatives, yaw=state.yaw)).moment)

    direction = jnp.asarray(np.random.default_rng(0).normal(size=(5, 3)))
    h = 1e-6
    numeric = (total(state.derivatives + h * direction) - total(state.derivatives - h * direction)) / (2 * h)
    assert_close(jnp.sum(jax.grad(total)(state.derivatives) * direction), numeric, "gradient")


def test_quaternions_against_scipy() -> None:
    rotations = Rotation.random(200, random_state=0)
    half_turns = Rotation.from_rotvec(np.pi * np.eye(3))
    for rotation in (*rotations, *half_turns):
        matrix = jnp.asarray(rotation.as_matrix())
        quat = np.asarray(quat_from_rotation(matrix))
        assert_close(rotation_from_quat(jnp.asarray(quat)), matrix, "formula")
        assert quat[0] >= 0.0
    for rotation in rotations[:50]:
        assert_close(rotation_vector(jnp.asarray(rotation.as_matrix())), rotation.as_rotvec(), "formula")
    assert_close(rotation_vector(jnp.eye(3)), np.zeros(3), "exact")
