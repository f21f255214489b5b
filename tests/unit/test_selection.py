"""Checks against brute force on dense samples, and the choice among plans with NaN and with nothing to choose."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.minsnap.spline_batch import fit
from jaxplan.records import replace
from jaxplan.selection import CheckConfig, _running_sums, check, check_clearance, select
from jaxplan.spline import hover
from jaxplan.status import Reason
from jaxplan.vehicle.flatness import differential_flatness
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.clearance import free_distance
from jaxplan.world.obstacles import Cylinders, World, aligned_boxes, make_obstacles
from tolerances import assert_close, tolerance

WIDTH = 24


@pytest.fixture(scope="module")
def room():
    boxes = aligned_boxes(np.array([[-0.5, -0.5, 0.0], [2.0, 1.0, 0.0]]), np.array([[0.5, 0.5, 3.0], [2.1, 1.1, 3.0]]))
    bounds = np.array([[-6.0, -6, -3], [6, 6, 3]])
    return World(name="test", bounds=bounds, obstacles=make_obstacles(boxes=boxes), keep_in=0.2)


@pytest.fixture(scope="module")
def batch(room):
    """Random splines from one hover state, with paths through their waypoints and the checks' result."""
    rng = np.random.default_rng(0)
    waypoints = rng.uniform(-4, 4, (5, 3, WIDTH)) * np.array([1.0, 1.0, 0.4])[:, None]
    waypoints[0] = np.array([-3.0, -3.0, 0.0])[:, None]
    durations = np.linalg.norm(np.diff(waypoints, axis=0), axis=1) / rng.uniform(1.0, 4.0, WIDTH)
    durations[3, ::3] = 0.0
    paths = np.stack(
        [np.linspace(0, 1, 64)[:, None] * (waypoints[4, :, k] - waypoints[0, :, k]) for k in range(WIDTH)], -1
    )
    paths = paths + waypoints[0]
    with jax.enable_x64(True):
        state = hover(waypoints[0, :, 0])
        splines = jax.jit(lambda w, d: fit(state, w, d, 3.0))(waypoints, durations)
        margins = jax.jit(lambda s, p: check(s, p, room, load_vehicle(), CheckConfig()))(splines, paths)
    return splines, paths, margins


def dense(splines, lane, count=4000):
    spline = splines.spline(lane)
    return spline, np.linspace(0.0, float(spline.duration), count)


def test_clearance_is_a_lower_bound_and_a_close_one(room, batch):
    splines, _, margins = batch
    least = jax.jit(lambda points: jnp.min(free_distance(room, points)))
    for lane in range(WIDTH):
        spline, times = dense(splines, lane)
        with jax.enable_x64(True):
            points = spline.evaluate(times)[:, :3]
            true = float(least(points))
        assert float(margins.clearance[lane]) <= true + 1e-9
        speed = np.linalg.norm(spline.evaluate(times, 1)[:, :3], axis=1).max()
        half_piece = 0.5 * speed * float(spline.durations.max()) / CheckConfig().samples_per_segment
        assert float(margins.clearance[lane]) >= true - 1.5 * half_piece


def test_a_needle_between_samples_is_not_missed(room, batch):
    """Each lane passes through a vertical needle of 5 mm; most samples of a lane see nothing within 5 cm of it."""
    splines, _, margins = batch
    rng, config, unseen = np.random.default_rng(1), CheckConfig(), 0
    middles = (np.arange(config.samples_per_segment) + 0.5) / config.samples_per_segment
    clear = jax.jit(lambda m, s, w: check_clearance(m, s, w, load_vehicle(), config).clearance)
    for lane in range(WIDTH):
        spline = splines.spline(lane)
        hit = spline.evaluate(rng.uniform(0.05, 0.95) * float(spline.duration))[None, :3]
        needle = Cylinders(
            center=hit, axis=np.array([[0.0, 0.0, 1.0]]), radius=np.full(1, 0.0025), half_length=np.ones(1)
        )
        world = replace(room, obstacles=make_obstacles(cylinders=needle))
        with jax.enable_x64(True):
            assert float(clear(margins, splines, world)[lane]) <= 0.0
        starts = np.cumsum(spline.durations) - spline.durations
        times = (starts[:, None] + spline.durations[:, None] * middles).ravel()
        unseen += np.linalg.norm((spline.evaluate(times)[:, :3] - hit)[:, :2], axis=1).min() > 0.05
    assert unseen >= 4


def test_rotor_margin_matches_flatness_on_dense_samples(batch):
    splines, _, margins = batch
    vehicle = load_vehicle()
    rotor_speeds = jax.jit(jax.vmap(lambda state: differential_flatness(vehicle, state).rotor_speeds))
    for lane in range(0, WIDTH, 4):
        spline, times = dense(splines, lane, 800)
        with jax.enable_x64(True):
            speeds = np.asarray(rotor_speeds(spline.state(times)))
        true = float(np.minimum(speeds - vehicle.rotor_speed_min, vehicle.rotor_speed_max - speeds).min())
        assert float(margins.rotor_speed[lane]) == pytest.approx(true, abs=0.12 * abs(true) + 30.0)


def test_deviation_is_the_largest_distance_at_equal_shares_of_length(batch):
    splines, paths, margins = batch
    for lane in range(0, WIDTH, 5):
        spline, times = dense(splines, lane)
        points = spline.evaluate(times)[:, :3]
        share = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        share /= share[-1]
        on_path = np.stack([np.interp(share, np.linspace(0, 1, 64), paths[:, axis, lane]) for axis in range(3)], axis=1)
        true = np.linalg.norm(points - on_path, axis=1).max()
        assert float(margins.deviation[lane]) == pytest.approx(true, rel=0.05, abs=0.05)


def test_nan_is_a_reason_and_stays_in_its_lane(room):
    waypoints = np.repeat(np.linspace([-3.0, -3, 0], [-3, 3, 0], 4)[..., None], 3, axis=-1)
    durations = np.ones((3, 3))
    waypoints[2, 0, 1] = np.nan
    durations[1, 2] = np.nan

    def trace(waypoints, durations):
        splines = fit(hover(np.array([-3.0, -3, 0])), waypoints, durations, 3.0)
        return check(splines, waypoints, room, load_vehicle(), CheckConfig())

    with jax.enable_x64(True):
        margins = jax.jit(trace)(waypoints, durations)
    reasons = np.asarray(margins.reasons)
    assert reasons[0] == 0
    assert reasons[1] & int(Reason.NONFINITE)
    assert reasons[1] & int(Reason.CLEARANCE)
    assert reasons[1] & int(Reason.DEVIATION)
    assert reasons[2] != 0


def test_a_probability_decides_instead_of_the_rotor_limits(room):
    """A quick flight and one at ease, each believed in and doubted; NaN is doubted."""
    waypoints = np.repeat(np.linspace([-3.0, -3, 0], [-3, 3, 0], 4)[..., None], 5, axis=-1)
    durations = np.array([0.6, 0.6, 3.0, 3.0, 3.0]) * np.ones((3, 1))
    chances = jnp.array([0.9, 0.1, 0.9, 0.1, jnp.nan])

    def trace(waypoints, durations, chances):
        splines = fit(hover(np.array([-3.0, -3, 0])), waypoints, durations, 3.0)
        return check(splines, waypoints, room, load_vehicle(), CheckConfig(least_probability=0.5), chances)

    with jax.enable_x64(True):
        margins = jax.jit(trace)(waypoints, durations, chances)
    doubted = (np.asarray(margins.reasons) & int(Reason.UNTRACKABLE)) != 0
    assert doubted.tolist() == [False, True, False, True, True]
    assert not (np.asarray(margins.reasons) & int(Reason.LIMITS)).any()
    assert np.isnan(np.asarray(margins.rotor_speed)).all()
    np.testing.assert_allclose(margins.probability, chances, **tolerance("solve"))


def test_nobody_believes_in_more_than_all_rotors_give_or_in_a_flick_of_the_body(room):
    """Whatever the probability: 2 m in 0.1 s, and a reversal within 0.2 s that all rotors have the thrust for."""
    waypoints = np.zeros((4, 3, 3))
    waypoints[:, :, 0] = waypoints[:, :, 1] = np.linspace([-3.0, -3, 0], [-3, 3, 0], 4)
    waypoints[:, :, 2] = [[-3.0, -3, 0], [-3, -2.85, 0], [-3, -3, 0], [-3, -2.85, 0]]
    durations = np.array([0.1, 3.0, 0.2]) * np.ones((3, 1))

    def trace(waypoints, durations):
        splines = fit(hover(np.array([-3.0, -3, 0])), waypoints, durations, 3.0)
        return check(splines, waypoints, room, load_vehicle(), CheckConfig(), jnp.ones(3))

    with jax.enable_x64(True):
        reasons = np.asarray(jax.jit(trace)(waypoints, durations).reasons)
    assert ((reasons & int(Reason.LIMITS)) != 0).tolist() == [True, False, False]
    assert ((reasons & int(Reason.BODY_RATE)) != 0).tolist() == [True, False, True]


def test_selection_takes_the_best_usable_and_never_a_default():
    assert select(np.array([1.0, 3.0, 2.0]), np.zeros(3, np.uint32)) == 1
    assert select(np.array([1.0, 3.0, 2.0]), np.array([0, 4, 0], np.uint32)) == 2
    assert select(np.array([np.nan, 1.0, np.inf]), np.zeros(3, np.uint32)) == 1
    assert select(np.array([5.0, 5.0]), np.array([1, 2], np.uint32)) == -1
    assert select(np.zeros(0), np.zeros(0, np.uint32)) == -1


def test_configuration_is_checked():
    for wrong in (
        {"max_deviation": 0.0},
        {"tracking_margin": -1.0},
        {"margin_per_speed": -1.0},
        {"most_margin": 0.05},
        {"samples_per_segment": 1},
        {"instants": 1},
        {"least_probability": 1.5},
        {"max_body_rate": 0.0},
    ):
        with pytest.raises(InputError, match=f"^checks: {next(iter(wrong))} is "):
            CheckConfig(**wrong)


@pytest.mark.usefixtures("x64")
def test_running_sums_are_those_of_numpy() -> None:
    steps = np.random.default_rng(0).random((5, 16, 7))
    found = _running_sums(jnp.asarray(steps)).reshape(-1, 7)
    assert_close(found, np.cumsum(steps.reshape(-1, 7), axis=0), "exact")
