"""Closed-loop flights: how well references are followed, determinism, bad references, batches, precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compilations import CompilationCounter
from scipy.spatial.transform import Rotation

from jaxplan.spline import FlatState, hover
from jaxplan.tracking.plant import PlantState
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.rollout import FlightLog, Plant, build_plant
from jaxplan.vehicle.flatness import against_drag, differential_flatness
from jaxplan.vehicle.load import load_vehicle
from oracles import plant_references
from tolerances import tolerance

SECONDS = 10
TIMES = np.arange(SECONDS * CONTROL_RATE + 1) / CONTROL_RATE
"""One length for the tracking tests, so that the flight compiles once."""


@pytest.fixture(scope="module")
def plant() -> Plant:
    return build_plant(load_vehicle())


@pytest.fixture(scope="module")
def quiet() -> Plant:
    return build_plant(load_vehicle(), noise=False)


def row(references: FlatState, index: int) -> FlatState:
    return jax.tree.map(lambda rows: rows[index], references)


def rows(references: FlatState, begin: int, end: int) -> FlatState:
    return jax.tree.map(lambda rows: rows[begin:end], references)


def fly(plant: Plant, references: FlatState, seed: int = 0) -> tuple[PlantState, FlightLog]:
    return plant.fly(plant.reset(row(references, 0), jax.random.key(seed)), references)


def hovering(steps: int) -> FlatState:
    state = hover(np.array([1.0, -2.0, 1.5]), yaw=2.0)
    return jax.tree.map(lambda leaf: np.tile(leaf, (steps + 1,) + (1,) * leaf.ndim), state)


def test_hover_holds_within_two_centimetres_in_noise(plant: Plant) -> None:
    _, log = fly(plant, hovering(len(TIMES) - 1))
    assert np.max(log.position_error) < 0.02
    assert np.max(log.yaw_error) < np.radians(2.0)
    assert not np.any(log.saturated)


@pytest.mark.parametrize("along_heading", [False, True])
def test_figure_eight_at_two_metres_per_second_is_followed_within_ten_centimetres(
    plant: Plant, along_heading: bool
) -> None:
    references = plant_references.figure_eight(TIMES, 2.0, along_heading=along_heading)
    assert np.max(np.linalg.norm(references.vel, axis=-1)) == pytest.approx(2.0, rel=1e-3)
    _, log = fly(plant, references)
    assert np.max(log.position_error) < 0.10
    assert np.max(log.yaw_error) < np.radians(5.0)


def test_five_metres_in_two_seconds_is_followed_within_ten_centimetres(plant: Plant) -> None:
    _, log = fly(plant, plant_references.hop(TIMES, 5.0, 2.0))
    assert np.max(log.position_error) < 0.10
    assert np.max(log.position_error[-CONTROL_RATE:]) < 0.02  # and stops


def test_slower_is_never_followed_worse_and_noise_never_helps(plant: Plant, quiet: Plant) -> None:
    durations = (4.0, 2.0, 1.5)
    errors = [np.max(fly(quiet, plant_references.hop(TIMES, 5.0, T))[1].position_error) for T in durations]
    assert errors == sorted(errors)
    hold = hovering(len(TIMES) - 1)
    assert np.max(fly(quiet, hold)[1].position_error) < 1e-4 < np.max(fly(plant, hold)[1].position_error)


def test_the_infeasible_shows_as_saturation_and_error(quiet: Plant) -> None:
    _, log = fly(quiet, plant_references.hop(TIMES, 15.0, 1.0))
    assert np.any(log.saturated)
    assert np.any(~(np.asarray(log.position_error) < 0.4))


def test_errors_are_those_of_the_logged_state(plant: Plant) -> None:
    references = plant_references.figure_eight(TIMES, 2.0, along_heading=True)
    final, log = fly(plant, references)
    distance = np.linalg.norm(np.asarray(log.pos, dtype=np.float64) - references.pos[1:], axis=1)
    np.testing.assert_allclose(log.position_error, distance, **tolerance("exact", np.float32))
    w, x, y, z = np.asarray(log.quat_wxyz, dtype=np.float64).T
    heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    turn = np.abs(np.angle(np.exp(1j * (heading - references.yaw[1:, 0]))))
    np.testing.assert_allclose(log.yaw_error, turn, **tolerance("exact", np.float32))
    demanded = jax.jit(
        jax.vmap(lambda state: differential_flatness(load_vehicle(), against_drag(load_vehicle(), state)).quat_wxyz)
    )(references)
    between = Rotation.from_quat(demanded[1:], scalar_first=True).inv() * Rotation.from_quat(
        log.quat_wxyz, scalar_first=True
    )
    x, y, z, w = between.as_quat().T
    twist = np.abs(np.angle(np.exp(2j * np.arctan2(z, w))))  # swing and twist
    np.testing.assert_allclose(log.twist_error, twist, atol=1e-4)
    np.testing.assert_array_equal(final.pos, log.pos[-1])
    assert int(final.step) == len(TIMES) - 1


def test_flying_backwards_is_a_yaw_error_of_half_a_turn(quiet: Plant) -> None:
    state = quiet.reset(hover(np.zeros(3), yaw=np.pi), jax.random.key(0))
    _, log = quiet.fly(state, jax.tree.map(lambda leaf: np.zeros((21, *leaf.shape)), hover(np.zeros(3))))
    assert log.yaw_error[0] > np.radians(175.0)
    assert log.twist_error[0] > np.radians(175.0)


def test_the_same_seed_repeats_and_cutting_a_flight_in_two_changes_nothing(plant: Plant) -> None:
    references = rows(plant_references.figure_eight(TIMES, 2.0), 0, 41)
    state = plant.reset(row(references, 0), jax.random.key(3))
    whole, log = plant.fly(state, references)
    again, _ = plant.fly(state, references)
    other, _ = plant.fly(plant.reset(row(references, 0), jax.random.key(4)), references)
    np.testing.assert_array_equal(whole.pos, again.pos)
    assert np.any(np.asarray(whole.pos) != np.asarray(other.pos))
    half, first = plant.fly(state, rows(references, 0, 21))
    end, second = plant.fly(half, rows(references, 20, 41))
    np.testing.assert_allclose(end.pos, whole.pos, **tolerance("solve"))
    np.testing.assert_allclose(
        np.concatenate([first.position_error, second.position_error]), log.position_error, **tolerance("solve")
    )
    assert int(end.step) == 40


@pytest.mark.parametrize("leaf", ["derivatives", "yaw"])
def test_nan_in_a_reference_gives_errors_that_are_not_finite(plant: Plant, leaf: str) -> None:
    references = rows(plant_references.figure_eight(TIMES, 2.0), 0, 21)
    getattr(references, leaf)[10] = np.nan
    _, log = fly(plant, references)
    assert np.all(np.isfinite(log.position_error[:9]))
    assert np.all(~(np.asarray(log.position_error[10:]) < 0.4))
    assert np.all(~(np.asarray(log.yaw_error[10:]) < np.pi))
    assert np.all(log.saturated[10:])


def test_vmap_equals_a_loop_over_dissimilar_flights_beside_a_bad_one(plant: Plant) -> None:
    flights = [
        rows(plant_references.figure_eight(TIMES, 2.0), 0, 21),
        rows(plant_references.hop(TIMES, 5.0, 1.0), 0, 21),
        rows(plant_references.helix(TIMES, 2.0, 2.0, 0.5, 1.0), 0, 21),
        hovering(20),
    ]
    flights[3].derivatives[5] = np.nan
    keys = jax.random.split(jax.random.key(0), 4)
    batch = jax.tree.map(lambda *leaves: np.stack(leaves), *flights)
    states = jax.vmap(plant.reset)(jax.tree.map(lambda leaf: leaf[:, 0], batch), keys)
    _, logs = jax.vmap(plant.fly)(states, batch)
    for lane, references in enumerate(flights):
        _, log = plant.fly(plant.reset(row(references, 0), keys[lane]), references)
        np.testing.assert_allclose(logs.pos[lane], log.pos, **tolerance("exact", np.float32))
        np.testing.assert_allclose(logs.rotor_speeds[lane], log.rotor_speeds, atol=0.5)  # of 1e3 rad/s
    assert np.all(np.isfinite(logs.position_error[:3]))
    assert np.all(~np.isfinite(logs.position_error[3, 5:]))


def test_float32_inside_a_float64_scope_and_one_compilation_for_all_callers(
    plant: Plant, compilations: CompilationCounter
) -> None:
    references = rows(plant_references.figure_eight(TIMES, 2.0), 0, 21)
    state, log = fly(plant, references)
    jax.block_until_ready(log)
    compilations.count = 0
    state_again, log_again = plant.fly(plant.reset(row(references, 0), jax.random.key(0)), references)
    plant.fly(state_again, references)
    assert compilations.count == 0
    with jax.enable_x64(True):
        wide = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), references)
        start = plant.reset(row(wide, 0), jax.random.key(0))
        jax.block_until_ready(plant.fly(start, wide))
        compilations.count = 0
        start = plant.reset(row(wide, 0), jax.random.key(0))
        state_wide, log_wide = plant.fly(start, wide)
        plant.fly(state_wide, wide)
        nested = jax.jit(lambda s, r: plant.fly(s, r)[1].position_error.astype(jnp.float64))(start, wide)
    for leaf in jax.tree.leaves((state_wide, log_wide)):
        assert leaf.dtype not in (jnp.float64, jnp.int64)
    np.testing.assert_array_equal(log_wide.pos, log_again.pos)
    np.testing.assert_allclose(nested, log.position_error, **tolerance("solve"))
    assert compilations.count <= 2  # the casts of new slices and the nested program itself
    assert state.pos.dtype == jnp.float32


def test_works_under_strict_promotion(plant: Plant) -> None:
    references = hovering(20)
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        _, log = fly(plant, references)
    assert np.all(np.isfinite(log.position_error))
