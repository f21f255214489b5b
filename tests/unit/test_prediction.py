"""Predictors and candidates: what each may know, likelihoods, early rejection."""

import jax
import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.prediction.candidates import candidates_from, reject_early
from jaxplan.prediction.observations import first_observation
from jaxplan.prediction.predictors import PREDICTORS, PredictionConfig, build_predictor
from jaxplan.records import replace
from jaxplan.status import Reason
from jaxplan.world.scene import load_world

CONFIG = PredictionConfig(steps=6, dt=0.2, batch=500, sigma=0.05)


def truth(times):
    """A helix: curved, so that constant velocity is wrong."""
    return np.stack([np.cos(times), np.sin(times), 0.1 * times], axis=-1)


def watch(duration=1.0, dt=0.1, keep=10):
    observations = first_observation(0.0, truth(np.array([0.0]))[0])
    for time in np.arange(dt, duration + 1e-9, dt):
        observations = observations.add(time, truth(np.array([time]))[0], keep)
    return observations


def predict(name, observations=None, cycle=0):
    return build_predictor(name, CONFIG, truth, seed=3)(observations or watch(), cycle)


def test_none_repeats_what_was_seen_last():
    candidates = predict("none")
    np.testing.assert_allclose(candidates.goals, np.repeat(truth(np.array([1.0])), 6, axis=0))
    np.testing.assert_allclose(candidates.arrival_times, 0.2 * np.arange(1, 7))


def test_ground_truth_is_the_real_future():
    candidates = predict("ground-truth")
    np.testing.assert_allclose(candidates.goals, truth(1.0 + candidates.arrival_times))
    np.testing.assert_array_equal(candidates.likelihood, 1.0)


def test_noisy_truth_spreads_with_the_square_root_of_the_step():
    candidates = predict("noisy")
    offsets = (candidates.goals - truth(1.0 + candidates.arrival_times)).reshape(6, 500, 3)
    expected = 0.05 * np.sqrt(np.arange(1, 7))
    np.testing.assert_allclose(offsets.std(axis=(1, 2)), expected, rtol=5 / np.sqrt(2 * 1500))
    assert candidates.likelihood.max() == 1.0
    assert (candidates.likelihood > 0.0).all()
    nearest = np.linalg.norm(offsets, axis=-1).argmin(axis=1)
    assert (candidates.likelihood.reshape(6, 500).argmax(axis=1) == nearest).all()


def test_noise_is_repeatable_and_differs_between_cycles():
    np.testing.assert_array_equal(predict("noisy", cycle=4).goals, predict("noisy", cycle=4).goals)
    assert not np.array_equal(predict("noisy", cycle=4).goals, predict("noisy", cycle=5).goals)


def test_constant_velocity_is_exact_on_a_line_and_knows_nothing_of_the_future():
    line = first_observation(0.0, np.zeros(3))
    for time in (0.1, 0.2, 0.35):
        line = line.add(time, time * np.array([1.0, -2.0, 0.5]), 10)
    candidates = predict("constant-velocity", line)
    np.testing.assert_allclose(candidates.goals, (0.35 + candidates.arrival_times)[:, None] * [1.0, -2.0, 0.5])
    alone = predict("constant-velocity", first_observation(0.0, np.ones(3)))
    np.testing.assert_allclose(alone.goals, 1.0)


def test_only_the_newest_observations_are_kept():
    assert len(watch(duration=5.0, keep=10).times) == 10
    assert watch(duration=5.0).times[-1] == pytest.approx(5.0)


def test_unknown_predictor_and_bad_settings_are_refused():
    with pytest.raises(InputError, match=", ".join(PREDICTORS)):
        predict("oracle")
    for wrong in ({"dt": 0.0}, {"sigma": np.nan}, {"steps": 0}):
        with pytest.raises(InputError):
            PredictionConfig(**wrong)


def test_likelihoods_survive_equal_and_infinite_logarithms():
    times = np.ones(3)
    goals = np.zeros((3, 3))
    np.testing.assert_array_equal(candidates_from(goals[0], goals, times, np.full(3, -1e9)).likelihood, 1.0)
    mixed = candidates_from(goals[0], goals, times, np.array([-np.inf, 0.0, np.nan])).likelihood
    np.testing.assert_array_equal(mixed, [0.0, 1.0, 0.0])


def test_early_rejection_names_every_reason():
    world = load_world("env1")
    start = np.array([-4.3, -4.3, 1.0])
    goals = np.array(
        [
            [-4.0, -3.5, 1.0],
            [np.nan, 0, 0],
            [9.0, 0, 1],
            [-3.0, -2.95, 1.0],
            [-4.0, -3.5, 1],
            [4.5, 4.5, 1],
            [50, np.inf, 1],
        ]
    )
    times = np.array([1.0, 1.0, 5.0, 5.0, -1.0, 0.5, 1.0])
    candidates = candidates_from(start, goals, times, np.zeros(7))
    with jax.enable_x64(True):
        reasons = np.asarray(jax.jit(reject_early, static_argnums=(3, 4))(candidates, world, start, 0.5, 8.0).reasons)
    wanted = [
        0,
        Reason.NONFINITE,
        Reason.GOAL_OUTSIDE,
        Reason.GOAL_OCCUPIED,
        Reason.T_GOAL_INVALID,
        Reason.OUT_OF_REACH,
    ]
    assert reasons[0] == 0
    for have, want in zip(reasons[1:6], wanted[1:], strict=True):
        assert have & int(want)
    assert reasons[6] & int(Reason.GOAL_OUTSIDE)
    assert replace(candidates, reasons=reasons).reasons is reasons
