"""Flights of the filter and their mixture with the learned ones: where they are and whom they follow."""

import numpy as np
import pytest

from experiments.prediction_windows import as_seen, stored_windows
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.predictors import build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.scores import observe_windows, score
from jaxplan.prediction.target_model import TargetModel, shipped_model, window_coordinates
from jaxplan.status import Note
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.load import load_world
from tolerances import assert_close

pytestmark = pytest.mark.usefixtures("x64")
NAMES = ("imm", "fused")


@pytest.fixture(scope="module")
def room():
    return load_world("env2")


@pytest.fixture(scope="module")
def predictors(room):
    config = PredictionConfig.for_world(room)
    return {name: build_predictor(name, config, world=room) for name in (*NAMES, "particles", "constant-velocity")}


@pytest.fixture(scope="module")
def seen(room):
    """Windows of stored targets at all speeds, and what happened next."""
    windows = stored_windows("env2", PredictionConfig.for_world(room).dt, 40, np.random.default_rng(1))
    return observe_windows(windows, 10, PredictionConfig.for_world(room).dt)


def newest(observations, count):
    return Observations(times=observations.times[-count:], positions=observations.positions[-count:])


def errors(predictor, observations, futures):
    return score([predictor.predict(one) for one in observations], futures).errors


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("count", [1, 2, 10])
def test_no_goal_is_outside_the_room_or_in_an_obstacle(predictors, room, seen, name, count):
    """Also where noise puts what was seen outside."""
    noisy = as_seen(seen[0], 0.4, 0.0, np.random.default_rng(0))
    for observations in [*seen[0][::4], *noisy[::4]]:
        candidates = predictors[name](newest(observations, count), cycle=0)
        assert host_free_distance(room, candidates.goals).min() > 0.0
        assert 0.0 < candidates.likelihood.min() <= candidates.likelihood.max() == 1.0


def test_a_target_seen_inside_a_wall_is_put_before_it(predictors, room):
    wall = np.asarray(room.bounds)[1]
    times = 0.2 * np.arange(5)
    outside = np.array([wall[0] + 0.2, wall[1] / 2.0, 1.5]) + np.zeros((5, 3))
    for name in NAMES:
        goals = predictors[name](Observations(times=times, positions=outside), 0).goals
        assert host_free_distance(room, goals).min() > 0.0


def test_noise_hurts_them_less_than_what_they_are_made_of(predictors, seen):
    """At 10 cm; and where there is no noise, the mixture of both is not worse than the learned one."""
    noisy = as_seen(seen[0], 0.1, 0.0, np.random.default_rng(0))
    found = {name: errors(one, noisy, seen[1])[:, :10].mean() for name, one in predictors.items()}
    assert found["fused"] < found["imm"] < 0.8 * found["constant-velocity"]
    assert found["fused"] < 0.8 * found["particles"]
    exact = {name: errors(predictors[name], *seen)[:, :10].mean() for name in ("fused", "particles")}
    assert exact["fused"] < 1.15 * exact["particles"]


def test_flights_unlike_those_learned_are_the_filters(predictors):
    """At 40 m/s nobody flew in training: then the two are one, and say so."""
    times = 0.2 * np.arange(10)
    config = PredictionConfig(dt=0.2)
    fast = Observations(times=times, positions=times[:, None] * [40.0, 0.0, 0.0])
    one, other = (build_predictor(name, config, model=shipped_model("env2", 0.2)) for name in NAMES)
    assert Note(other(fast, 0).note) == Note.PREDICTOR_FALLBACK
    np.testing.assert_allclose(other.predict(fast).mean, one.predict(fast).mean, atol=0.5)
    np.testing.assert_allclose(one.predict(fast).mean[0], [40.0 * 2.0, 0.0, 0.0], atol=0.5)


def test_uneven_positions_are_the_filters(predictors, seen):
    times = np.cumsum([0.0, 0.2, 0.3, 0.15, 0.25])
    uneven = Observations(times=times, positions=np.array([5.0, 5.0, 1.0]) + times[:, None] * [1.0, 0.0, 0.0])
    candidates = predictors["fused"](uneven, 0)
    assert Note(candidates.note) == Note.PREDICTOR_FALLBACK
    assert_close(candidates.goals, predictors["imm"](uneven, 0).goals, "formula")


@pytest.mark.parametrize(("name", "share"), [("imm", 0.9), ("fused", 1.0)])
def test_positions_between_those_of_the_mixture_tell_the_filter_more(predictors, name, share):
    """Seen every 0.1 s where predictions are 0.2 s apart: the filter's first is a tenth nearer."""
    windows = stored_windows("env2", 0.1, 120, np.random.default_rng(2))
    off = {}
    for apart in (1, 2):
        seen = [Observations(times=0.1 * np.arange(19)[::apart], positions=window[:19:apart]) for window in windows]
        expected = np.stack([predictors[name].predict(one).mean[0] for one in seen])
        off[apart] = np.linalg.norm(expected - windows[:, 20], axis=-1).mean()
    assert off[1] < share * off[2]


def test_the_mixture_sees_none_of_them(predictors, seen):
    fine = seen[0][0]
    between = 0.5 * (fine.positions[1:] + fine.positions[:-1]) + 0.3
    times, positions = np.zeros(19), np.zeros((19, 3))
    times[::2], times[1::2] = fine.times, 0.5 * (fine.times[1:] + fine.times[:-1])
    positions[::2], positions[1::2] = fine.positions, between
    finer = Observations(times=times, positions=positions)
    assert_close(predictors["particles"](finer, 0).goals, predictors["particles"](fine, 0).goals, "formula")


@pytest.mark.parametrize("name", NAMES)
def test_hostile_windows_give_finite_predictions(predictors, name):
    still = np.array([5.0, 5.0, 1.5])
    for times, positions in (
        (np.array([3.0]), still[None]),
        (0.2 * np.arange(10), np.tile(still, (10, 1))),
        (0.2 * np.arange(10), still + 100.0 * np.random.default_rng(0).standard_normal((10, 3))),
        (np.array([0.0, 1e-7, 5.0]), still + np.arange(3)[:, None]),
    ):
        observations = Observations(times=times, positions=positions)
        prediction = predictors[name].predict(observations)
        assert all(np.isfinite(np.asarray(part)).all() for part in (prediction.means, prediction.factors))
        assert np.isfinite(predictors[name](observations, 0).goals).all()


def test_goals_do_not_depend_on_the_dice_and_nothing_compiles_twice(predictors, seen, compilations):
    for name in NAMES:
        first = predictors[name](seen[0][0], 0)
        compilations.count = 0
        for count in (1, 2, 5, 10):
            for noise in (0.0, 0.2):
                predictors[name](newest(as_seen(seen[0][:1], noise, 0.0, np.random.default_rng(0))[0], count), 1)
        assert compilations.count == 0
        np.testing.assert_array_equal(first.goals, predictors[name](seen[0][0], 5).goals)


@pytest.mark.parametrize("anchored", [False, True])
def test_a_mixture_for_noisy_positions_is_that_of_noisy_windows(anchored):
    """Against moments of windows drawn and disturbed: what is seen is noisy, what happens next is not."""
    rng, count, noise = np.random.default_rng(0), 200_000, 0.3
    size = 3 * (2 + 2 + anchored)
    root = rng.standard_normal((size, size)) / 3.0
    factor = np.linalg.cholesky(root @ root.T + 0.1 * np.eye(size))
    bounds = np.array([[0.0] * 3, [9.0] * 3]) if anchored else None
    model = TargetModel("m", 3, 2, 0.1, bounds, np.ones(1), np.zeros((1, size)), factor[None])
    coordinates = rng.standard_normal((count, size)) @ factor.T
    anchor = coordinates[:, :3] if anchored else np.zeros((count, 3))
    relative = coordinates[:, 3 * anchored :].reshape(count, 4, 3)
    windows = np.concatenate([relative[:, :2], np.zeros((count, 1, 3)), relative[:, 2:]], axis=1) + anchor[:, None]
    windows[:, :3] += noise * rng.standard_normal((count, 3, 3))
    disturbed = window_coordinates(windows, 3, anchored)
    covariance = np.cov(disturbed.T)
    observed = model.observed
    slope = np.linalg.solve(covariance[:observed, :observed], covariance[:observed, observed:]).T
    ready = model.conditional(noise=noise)
    np.testing.assert_allclose(np.asarray(ready.rows)[observed:, 0], slope, atol=0.02)
    assert_close(model.conditional(noise=0.0).rows, model.conditional().rows, "exact")
