"""Predictors and candidates: what each may know, likelihoods, early rejection."""

import jax
import numpy as np
import pytest

from jaxplan import config
from jaxplan.errors import InputError
from jaxplan.prediction.candidates import candidates_from, reject_early, target_velocities
from jaxplan.prediction.observations import Observations, first_observation
from jaxplan.prediction.predictors import PREDICTORS, build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.target_model import shipped_model
from jaxplan.records import replace
from jaxplan.status import Note, Reason
from jaxplan.world.load import load_world
from tolerances import tolerance

UNLEARNED = [name for name, kind in PREDICTORS.items() if not (kind.learned or kind.network)]
CONFIG = PredictionConfig(steps=6, dt=0.2, batch=500, sigma=0.05)


def truth(times):
    """A helix: curved, so that constant velocity is wrong."""
    return np.stack([np.cos(times), np.sin(times), 0.1 * times], axis=-1)


def watch(duration=1.0, dt=0.1, keep=10, age=0.0):
    times = duration - dt * np.arange(keep - 1, -1, -1)
    return Observations(times=times, positions=truth(times), age=age)


def predict(name, observations=None, cycle=0):
    return build_predictor(name, CONFIG, truth, seed=3)(observations or watch(), cycle)


@pytest.fixture(scope="module")
def mixture():
    """The Gaussian mixture in open space, on ten positions 0.1 s apart."""
    return build_predictor("gmm", PredictionConfig(), truth, seed=3, model=shipped_model("generic", 0.1))


def test_spacing_follows_the_size_of_the_room():
    """0.1 s in the room of 10 m, 0.2 s in those of 30 m, and from a diagonal of exactly 20 m on (paper, Sec. IV)."""
    assert [PredictionConfig.for_world(load_world(name)).dt for name in ("env1", "env2", "env3")] == [0.1, 0.2, 0.2]
    room = replace(load_world("env1"), bounds=np.array([[0.0, 0.0, 0.0], [12.0, 14.142, 2.0]]))
    edge = replace(room, bounds=np.array([[0.0, 0.0, 0.0], [12.0, 16.0, 1e-9]]), keep_in=0.0)
    assert edge.diagonal == 20.0
    assert [PredictionConfig.for_world(one).dt for one in (room, edge)] == [0.1, 0.2]


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
    times = np.array([0.0, 0.1, 0.2, 0.35])
    line = Observations(times=times, positions=times[:, None] * [1.0, -2.0, 0.5])
    candidates = predict("constant-velocity", line)
    np.testing.assert_allclose(candidates.goals, (0.35 + candidates.arrival_times)[:, None] * [1.0, -2.0, 0.5])
    alone = predict("constant-velocity", first_observation(0.0, np.ones(3)))
    np.testing.assert_allclose(alone.goals, 1.0)


def test_constant_acceleration_is_exact_on_a_parabola():
    times = np.array([0.0, 0.1, 0.25, 0.3, 0.4])
    curve = lambda t: np.stack([t, 1.0 - t + 2.0 * t**2, -0.5 * t**2], axis=-1)  # noqa: E731
    candidates = predict("constant-acceleration", Observations(times=times, positions=curve(times)))
    np.testing.assert_allclose(candidates.goals, curve(0.4 + candidates.arrival_times), **tolerance("formula"))
    for count in (1, 2):
        few = Observations(times=times[:count], positions=curve(times[:count]))
        straight = predict("constant-velocity", few)
        np.testing.assert_allclose(predict("constant-acceleration", few).goals, straight.goals, **tolerance("exact"))


def test_every_predictor_gives_a_distribution():
    for name in UNLEARNED:
        prediction = build_predictor(name, CONFIG, truth).predict(watch())
        assert prediction.mean.shape == (6, 3)
        assert np.exp(prediction.log_weights).sum() == pytest.approx(1.0)
        spread = np.linalg.norm(np.asarray(prediction.factors), axis=(1, 2))[:, 0]
        assert (np.diff(spread) >= 0.0).all()


def test_mixture_proposes_a_batch_for_every_step(mixture):
    candidates = mixture(watch(), 0)
    assert candidates.goals.shape == (400, 3)
    np.testing.assert_allclose(
        candidates.arrival_times.reshape(20, 20), np.repeat(0.1 * np.arange(1, 21), 20).reshape(20, 20)
    )
    assert candidates.likelihood.max() == 1.0
    assert candidates.note == 0
    np.testing.assert_array_equal(mixture(watch(), 5).goals, mixture(watch(), 5).goals)
    assert not np.array_equal(mixture(watch(), 5).goals, mixture(watch(), 6).goals)


def test_mixture_is_closer_to_a_turning_target_than_a_straight_line(mixture):
    future = truth(1.0 + 0.1 * np.arange(1, 21))
    straight = build_predictor("constant-velocity", PredictionConfig(), truth)
    errors = [np.linalg.norm(p.predict(watch()).mean - future, axis=1)[-1] for p in (mixture, straight)]
    assert errors[0] < 0.7 * errors[1]


def test_mixture_moves_with_the_target_in_open_space(mixture):
    shift = np.array([30.0, -4.0, 2.0])
    moved = Observations(times=watch().times, positions=watch().positions + shift)
    np.testing.assert_allclose(mixture(moved, 0).goals, mixture(watch(), 0).goals + shift, **tolerance("formula"))


def test_a_single_observation_falls_back_to_constant_velocity_with_a_note(mixture):
    few = watch(keep=1)
    candidates = mixture(few, 0)
    assert Note(candidates.note) & Note.PREDICTOR_FALLBACK
    straight = build_predictor("constant-velocity", PredictionConfig(), truth)(few, 0)
    np.testing.assert_array_equal(candidates.goals, straight.goals)


def test_observations_like_none_in_training_fall_back_too(mixture):
    for positions in (100.0 * np.random.default_rng(0).standard_normal((10, 3)), np.eye(10)[:, :3] * 1e6):
        candidates = mixture(Observations(times=watch().times, positions=positions), 0)
        assert Note(candidates.note) & Note.PREDICTOR_FALLBACK
        assert np.isfinite(candidates.goals).all()
    uneven = Observations(times=np.cumsum(0.05 + 0.01 * np.arange(10)), positions=watch().positions)
    assert Note(mixture(uneven, 0).note) & Note.PREDICTOR_FALLBACK


def test_a_silent_target_is_less_certain_and_then_lost(mixture):
    fresh, silent = mixture(watch(), 0), mixture(watch(age=0.55), 0)
    np.testing.assert_allclose(silent.arrival_times, fresh.arrival_times - 0.55)
    ahead = lambda c: c.goals[np.abs(c.arrival_times - 0.55) < 0.051].std(axis=0).max()  # noqa: E731
    assert ahead(silent) > 1.5 * ahead(fresh)
    for name in UNLEARNED:
        lost = predict(name, watch(age=1.01))
        assert (lost.reasons == int(Reason.TARGET_LOST)).all()
        assert np.isnan(lost.goals).all()
    assert (mixture(watch(age=np.nan), 0).reasons == int(Reason.TARGET_LOST)).all()


def test_nothing_compiles_after_the_first_call(mixture, compilations):
    mixture(watch(), 0)
    predict("noisy")
    compilations.count = 0
    for cycle in range(5):
        mixture(watch(duration=1.0 + 0.1 * cycle), cycle)
        mixture(watch(keep=3), cycle)
        predict("noisy", cycle=cycle)
    assert compilations.count == 0


def test_the_names_that_a_user_can_give_are_those_of_the_table():
    assert tuple(PREDICTORS) == config.PREDICTORS
    assert tuple(name for name, kind in PREDICTORS.items() if kind.network) == config.WITH_NETWORK


@pytest.mark.parametrize("name", PREDICTORS)
def test_what_a_predictor_needs_to_know_must_be_given(name):
    """And nothing else: with it alone it proposes as many goals as its kind says."""
    kind = PREDICTORS[name]
    if name in ("ground-truth", "noisy"):
        with pytest.raises(InputError, match="real motion"):
            build_predictor(name, PredictionConfig())
    if kind.learned:
        with pytest.raises(InputError, match="train gmm"):
            build_predictor(name, PredictionConfig(dt=0.123))
    if kind.network:
        with pytest.raises(InputError, match=r"dt = 0.123, want 0.1 or 0.2"):
            build_predictor(name, PredictionConfig(dt=0.123))
    known = {} if kind.learned else {"truth": truth}
    assert len(build_predictor(name, PredictionConfig(), **known)(watch(), 0).goals) == (400 if kind.sampling else 20)


def test_unknown_predictor_and_bad_settings_are_refused():
    with pytest.raises(InputError, match=", ".join(PREDICTORS)):
        predict("oracle")
    for wrong in ({"dt": 0.0}, {"sigma": np.nan}, {"steps": 0}, {"lost_after": 0.0}):
        with pytest.raises(InputError):
            PredictionConfig(**wrong)


def test_likelihoods_survive_equal_and_infinite_logarithms():
    times = np.ones(3)
    goals = np.zeros((3, 3))
    np.testing.assert_array_equal(candidates_from(goals[0], goals, times, np.full(3, -1e9)).likelihood, 1.0)
    mixed = candidates_from(goals[0], goals, times, np.array([-np.inf, 0.0, np.nan])).likelihood
    np.testing.assert_array_equal(mixed, [0.0, 1.0, 0.0])


def test_the_targets_velocity_is_the_way_of_the_goals_mean():
    """Exact on a parabola but at its ends, however the goals are ordered; nothing is known from one instant."""
    times, rng = np.repeat(np.arange(1.0, 6.0), 8), np.random.default_rng(2)
    order = rng.permutation(len(times))
    spread = np.tile(rng.normal(size=(4, 3)), (10, 1)) * np.repeat([1.0, -1.0], 4).reshape(1, 8).repeat(5, 0).reshape(
        -1, 1
    )
    goals = np.stack([0.5 * times**2, -times, 0.0 * times], axis=1) + spread
    found = target_velocities(candidates_from(goals[0], goals[order], times[order], np.zeros(40)))
    inner = (times[order] > 1.0) & (times[order] < 5.0)
    wanted = np.stack([times, -np.ones(40), np.zeros(40)], axis=1)[order]
    np.testing.assert_allclose(found[inner], wanted[inner], **tolerance("formula"))
    np.testing.assert_allclose(found[~inner], wanted[~inner], atol=0.5 + 1e-9, rtol=0.0)
    once = candidates_from(goals[0], goals, np.ones(40), np.zeros(40))
    assert (target_velocities(once) == 0.0).all()


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
        rejected = jax.jit(reject_early, static_argnums=3)(candidates, world, start, 0.5, 8.0 * times)
        reasons = np.asarray(rejected.reasons)
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
