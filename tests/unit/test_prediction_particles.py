"""Whole futures of the target: as the mixture has them, none through a wall, and what their goals are worth."""

import numpy as np
import pytest
from scipy.special import ndtri
from scipy.stats import qmc

from experiments.prediction_windows import stored_windows
from jaxplan.prediction.mixture import MODES, conditional_mixture, covariance_factors
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.particles import (
    PARTICLES,
    even_randoms,
    mixture_flights,
)
from jaxplan.prediction.predictors import build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.scores import observe_windows, score
from jaxplan.prediction.survival import CAPTURE_RADIUS, LEAST_CLEARANCE, believable, goals_among, surroundings_of
from jaxplan.prediction.target_model import shipped_model
from jaxplan.status import Note
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.load import load_world
from oracles.mixture_conditional import conditional
from tolerances import assert_close

pytestmark = pytest.mark.usefixtures("x64")


@pytest.fixture(scope="module")
def room():
    return load_world("env2")


@pytest.fixture(scope="module")
def seen(room):
    """60 windows of stored targets, and what happened next."""
    config = PredictionConfig.for_world(room)
    cut = stored_windows("env2", config.dt, 60, np.random.default_rng(1))
    return observe_windows(cut, config.observations, config.dt)


def newest(observations, count):
    return Observations(times=observations.times[-count:], positions=observations.positions[-count:])


def test_particles_have_the_joint_moments_of_the_mixture():
    """Also from one instant to another: they are flights, not clouds."""
    rng, observed, size = np.random.default_rng(0), 6, 6 + MODES
    root = rng.standard_normal((2, size, size)) / 4.0
    means, weights = rng.standard_normal((2, size)), np.array([0.3, 0.7])
    covariances = root @ root.swapaxes(1, 2) + 0.05 * np.eye(size)
    model = conditional_mixture(weights, means, covariance_factors(covariances), observed)
    seen, count = means[0, :observed] + 0.1, 20_000
    place = np.array([1.0, 2.0, 3.0])
    flights, _ = mixture_flights(model, np.append(place, seen), rng.random(count), rng.standard_normal((count, MODES)))
    drawn = np.asarray(flights).reshape(count, -1) - np.tile(place, MODES // 3)
    log_weights, centres, spreads = conditional(weights, means, covariances, seen)
    shares = np.exp(log_weights)
    mean = shares @ centres
    spread = np.einsum("k,kij->ij", shares, spreads + np.einsum("ki,kj->kij", centres - mean, centres - mean))
    sigma = np.sqrt(np.diag(spread))
    assert (np.abs(drawn.mean(axis=0) - mean) < 5.0 * sigma / np.sqrt(count)).all()
    assert (np.abs(np.cov(drawn.T) - spread) < 5.0 * np.sqrt(3.0 / count) * np.outer(sigma, sigma)).all()


def test_short_windows_say_more_than_a_straight_line(seen, room):
    """What the vehicle has when it departs: three positions."""
    config, model = PredictionConfig.for_world(room), shipped_model("env2", 0.2)
    short = [newest(one, 3) for one in seen[0]]
    errors = {}
    for name in ("constant-velocity", "gmm", "particles"):
        predictor = build_predictor(name, config, model=model, world=room)
        errors[name] = score([predictor.predict(one) for one in short], seen[1]).summary()["ade_m"]
    assert errors["gmm"] < 0.75 * errors["constant-velocity"]
    assert errors["particles"] < errors["gmm"]


@pytest.mark.parametrize("world", ["env1", "env2", "env3"])
@pytest.mark.parametrize("count", [1, 3, 10])
def test_no_goal_is_outside_the_room_or_in_an_obstacle(world, count):
    room = load_world(world)
    config = PredictionConfig.for_world(room)
    windows = stored_windows(world, config.dt, 40, np.random.default_rng(2))
    predictor = build_predictor("particles", config, model=shipped_model(world, config.dt), world=room)
    for observations in observe_windows(windows, config.observations, config.dt)[0]:
        candidates = predictor(newest(observations, count), cycle=0)
        assert host_free_distance(room, candidates.goals).min() > 0.0
        assert 0.0 < candidates.likelihood.min() <= candidates.likelihood.max() == 1.0


def test_what_would_hit_a_wall_stops_before_it_and_counts_no_more(room):
    wall = float(np.asarray(room.bounds)[1, 0])
    start = np.array([wall - 1.0, *np.asarray(room.bounds).mean(axis=0)[1:]])
    ways = np.array([[0.4, 0.0, 0.0], [-0.1, 0.0, 0.0]])
    flights = start + np.arange(1, 6)[:, None] * ways[:, None]
    assert host_free_distance(room, flights[1]).min() > LEAST_CLEARANCE
    around = surroundings_of(room)
    stopped, counts = believable(around, start, flights)
    np.testing.assert_array_equal(counts, [[1, 1, 0, 0, 0], [1, 1, 1, 1, 1]])
    np.testing.assert_array_equal(stopped[0, 1:], np.repeat(flights[:1, 1], 4, axis=0))
    np.testing.assert_array_equal(stopped[1], flights[1])

    stopped, counts = believable(around, start, flights[:1])
    np.testing.assert_array_equal(counts, 1.0)  # nobody else is left: it waits
    assert host_free_distance(room, np.asarray(stopped)).min() >= LEAST_CLEARANCE


def test_nobody_jumps_over_what_is_between_two_steps(room):
    """A flight whose steps are clear, and whose way is not."""
    rng = np.random.default_rng(0)
    low, high = np.asarray(room.bounds)
    first, way = rng.uniform(low, high, (4000, 3)), 0.6 * rng.standard_normal((4000, 3))
    at = host_free_distance(room, first + np.array([0.0, 0.5, 1.0])[:, None, None] * way)
    jumps = np.flatnonzero((at[0] > 0.11) & (at[2] > 0.11) & (at[1] < 0.09))
    assert len(jumps) > 3
    for index in jumps[:10]:
        flights = (first + way)[[index]][:, None]
        ways = np.concatenate([flights, first[[index]][:, None]])
        _, counts = believable(surroundings_of(room), first[index], ways)
        assert counts.tolist() == [[False], [True]]


@pytest.mark.parametrize("speed", [0.1, 0.6, 3.0])
def test_what_is_not_looked_at_is_clear(room, speed):
    """Every step and every middle, by the other code that knows distances; many that leave the room among them."""
    rng, (low, high) = np.random.default_rng(3), np.asarray(room.bounds)
    starts = rng.uniform(low, high, (200, 3))
    for start in starts[host_free_distance(room, starts) > LEAST_CLEARANCE][:10]:
        flights = start + np.cumsum(rng.normal(scale=speed, size=(128, 20, 3)), axis=1)
        before = np.concatenate([np.broadcast_to(start, (128, 1, 3)), flights[:, :-1]], axis=1)
        clear = [host_free_distance(room, points) >= LEAST_CLEARANCE for points in (flights, 0.5 * (before + flights))]
        expected = np.cumprod(np.logical_and(*clear), axis=1).sum(axis=1)
        stopped, counts = believable(surroundings_of(room), start, flights)
        survived = np.arange(1, 21) <= expected[:, None]
        np.testing.assert_array_equal(counts, np.arange(1, 21).clip(max=expected.max()) <= expected[:, None])
        np.testing.assert_array_equal(stopped[survived], flights[survived])
        last = np.concatenate([np.broadcast_to(start, (128, 1, 3)), flights], axis=1)[np.arange(128), expected]
        np.testing.assert_array_equal(stopped[:, -1], last)


def test_what_is_not_finite_survives_nothing(room):
    start = np.asarray(room.start)
    flights = np.tile(start, (4, 3, 1))
    flights[1, 1, 0], flights[2, 0, 1], flights[3, 2, 2] = np.nan, np.inf, -np.inf
    stopped, counts = believable(surroundings_of(room), start, flights)
    np.testing.assert_array_equal(counts.sum(axis=1), [3, 1, 0, 2])
    np.testing.assert_array_equal(stopped, np.tile(start, (4, 3, 1)))


def test_who_is_too_fast_takes_shorter_steps_in_the_same_directions():
    rng, longest = np.random.default_rng(4), 0.5
    steps = rng.normal(scale=0.3, size=(50, 20, 3))
    lengths = np.linalg.norm(steps, axis=2, keepdims=True)
    assert 0.2 < (lengths > longest).mean() < 0.8
    stopped, counts = believable(surroundings_of(None), np.ones(3), 1.0 + np.cumsum(steps, axis=1), longest)
    expected = 1.0 + np.cumsum(steps * np.minimum(1.0, longest / lengths), axis=1)
    assert counts.all()
    assert_close(stopped, expected, "formula")


def test_a_goal_is_worth_the_share_of_particles_that_are_near():
    line = CAPTURE_RADIUS * np.array([0.0, 0.6, 1.2, 10.0])
    flights = np.stack([line, np.zeros(4), np.zeros(4)], axis=1)[:, None]
    goals, worth = goals_among(surroundings_of(None), flights, np.array([True, True, True, False])[:, None], 4)
    np.testing.assert_allclose(np.asarray(goals)[0, :, 0], CAPTURE_RADIUS * np.array([0.6, 0.6, 1.2, 0.0]))
    assert_close(worth[0], np.array([3, 3, 2, 2]) / 3.0, "exact")  # the mean stands in the place of the first


def test_goals_move_as_the_target_does_and_not_as_the_dice_fall(seen, room):
    config, model = PredictionConfig.for_world(room), shipped_model("env2", 0.2)
    one, other = (build_predictor("particles", config, seed=seed, model=model, world=room) for seed in (0, 1))
    np.testing.assert_array_equal(one(seen[0][0], 0).goals, other(seen[0][0], 7).goals)
    uniform, normal = even_randoms()
    assert len(uniform) == PARTICLES
    assert np.abs(normal.mean(axis=0)).max() < 0.05
    assert np.abs(normal.std(axis=0) - 1.0).max() < 0.05
    shares = np.bincount((8 * uniform[:24]).astype(int), minlength=8)
    assert shares.max() - shares.min() <= 2  # the first ones are spread evenly, too


@pytest.mark.parametrize("normals", [18, 19])
def test_even_numbers_are_scrambled_sobol_points(normals):
    uniform, normal = even_randoms(normals)
    points = qmc.Sobol(1 + normals, rng=0).random(PARTICLES)
    np.testing.assert_array_equal(uniform, points[:, 0])
    np.testing.assert_array_equal(normal, ndtri(points[:, 1:]))


def test_with_one_position_or_an_unusual_flight_they_spread_around_a_straight_line(room):
    config, model = PredictionConfig.for_world(room), shipped_model("env2", 0.2)
    predictor = build_predictor("particles", config, model=model, world=None)
    times = 0.2 * np.arange(10)
    fast = Observations(times=times, positions=times[:, None] * [40.0, 0.0, 0.0])
    candidates = predictor(fast, 0)
    assert Note(candidates.note) == Note.PREDICTOR_FALLBACK
    first = candidates.goals.reshape(20, 20, 3)[0]
    np.testing.assert_allclose(first[0], [40.0 * 2.0, 0.0, 0.0], atol=4.0)  # none of them is faster than 50 m/s
    assert first.std(axis=0).max() > 0.1
    assert Note(predictor(newest(fast, 1), 0).note) == Note.PREDICTOR_FALLBACK


def test_nothing_compiles_after_the_first_call_whatever_was_seen(seen, room, compilations):
    config, model = PredictionConfig.for_world(room), shipped_model("env2", 0.2)
    predictor = build_predictor("particles", config, model=model, world=room)
    predictor(seen[0][0], 0)
    compilations.count = 0
    for count in (1, 2, 5, 10):
        predictor(newest(seen[0][1], count), 1)
    assert compilations.count == 0
