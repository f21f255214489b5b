"""Fitting: known mixtures are found again, hostile data is refused; windows are what they claim to be."""

import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.prediction.gmm import FitConfig, fit_mixture, log_likelihood
from jaxplan.prediction.waypoints import ChainConfig, WalkConfig, chains, walks
from jaxplan.prediction.windows import WindowConfig, draw_windows
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.load import load_world


def three_clouds(count, seed):
    rng = np.random.default_rng(seed)
    which = rng.choice(3, count, p=[0.5, 0.3, 0.2])
    centres = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 1.0], [0.0, 6.0, -1.0]])
    return centres[which] + rng.standard_normal((count, 3)) * [0.5, 1.0, 0.7]


def test_a_known_mixture_is_found_and_its_size_chosen():
    fit, scores = fit_mixture(
        three_clouds(6000, 0), three_clouds(2000, 1), FitConfig(components=(1, 3), tolerance=1e-4)
    )
    assert len(fit.weights) == 3
    assert scores[3] > scores[1] + 0.1
    assert fit.log_likelihood == scores[3]
    order = np.argsort(-fit.weights)
    np.testing.assert_allclose(fit.weights[order], [0.5, 0.3, 0.2], atol=0.03)
    np.testing.assert_allclose(fit.means[order], [[0, 0, 0], [5, 0, 1], [0, 6, -1]], atol=0.1)
    spread = np.diagonal(fit.factors @ fit.factors.swapaxes(1, 2), axis1=1, axis2=2)
    np.testing.assert_allclose(np.sqrt(spread), np.tile([0.5, 1.0, 0.7], (3, 1)), rtol=0.08)


def test_log_likelihood_integrates_to_one():
    fit, _ = fit_mixture(three_clouds(500, 0), three_clouds(100, 1), FitConfig(components=(2,)))
    points = np.random.default_rng(0).uniform(-9.0, 13.0, (400_000, 3))
    mass = np.exp(log_likelihood(fit.weights, fit.means, fit.factors, points)).mean() * 22.0**3
    assert mass == pytest.approx(1.0, abs=0.05)


def test_the_floor_is_a_floor():
    """Coordinates that depend on each other exactly: what EM finds is singular without the floor."""
    data = three_clouds(800, 0)[:, [0, 1, 2, 0, 1]]
    fit, _ = fit_mixture(data, data[:100], FitConfig(components=(2,), floor=0.02, shrinkage=0.0))
    covariances = fit.factors @ fit.factors.swapaxes(1, 2)
    assert np.linalg.eigvalsh(covariances).min() > 0.99 * 0.02**2


BAD = {
    "too few": (three_clouds(10, 0), three_clouds(5, 1), "10 windows"),
    "none held out": (three_clouds(100, 0), three_clouds(0, 1), "0 held out"),
    "constant": (np.ones((100, 3)), np.ones((5, 3)), "same in all"),
    "one constant coordinate": (three_clouds(100, 0) * [1.0, 0.0, 1.0], three_clouds(5, 1), "coordinate 1"),
    "other sizes": (three_clouds(100, 0), np.ones((5, 4)), "shapes"),
    "no table": (np.ones(100), np.ones((5, 3)), "shapes"),
    "NaN": (np.full((100, 3), np.nan), three_clouds(5, 1), "finite"),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_data_is_refused(kind):
    training, held_out, said = BAD[kind]
    with pytest.raises(InputError, match=said):
        fit_mixture(training, held_out, FitConfig(components=(8,)))


@pytest.mark.parametrize("wrong", [{"components": ()}, {"components": (0,)}, {"floor": 0.0}, {"shrinkage": -1.0}])
def test_bad_settings_are_refused(wrong):
    with pytest.raises(InputError):
        FitConfig(**wrong)


@pytest.fixture(scope="module")
def windows():
    world, config = load_world("env1"), WindowConfig()
    return world, config, draw_windows([chains(world)], world, 2000, np.random.default_rng(0), config)


def test_windows_are_clear_and_within_the_speeds(windows):
    world, config, drawn = windows
    assert drawn.shape == (2000, 30, 3)
    assert host_free_distance(world, drawn).min() >= config.margin
    speeds = np.linalg.norm(np.diff(drawn, axis=1), axis=-1) / config.dt
    assert speeds.max() <= config.speeds[1] * 1.01  # maximum speeds are sampled
    assert speeds.max(axis=1).min() < 0.5
    assert (speeds.max(axis=1) > 2.5).mean() > 0.1
    accelerations = np.linalg.norm(np.diff(drawn, n=2, axis=1), axis=-1) / config.dt**2
    assert accelerations.max() <= config.max_acceleration


def test_windows_are_smooth_minimum_snap_curves(windows):
    """A tenth difference of ten-times differentiable pieces is small against the motion."""
    drawn = windows[2]
    jerk = np.diff(drawn, n=3, axis=1)
    assert np.median(np.abs(jerk)) < 0.05 * np.median(np.abs(np.diff(drawn, axis=1)))


def test_the_same_seed_gives_the_same_windows():
    first, second, other = (
        draw_windows([walks(WalkConfig(waypoints=10))], None, 300, np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, second)
    assert np.abs(first - other).max() > 0.1


def test_a_world_without_room_is_refused():
    world = load_world("env1")
    with pytest.raises(InputError, match="places are clear"):
        draw_windows([chains(world, ChainConfig(margin=1.05))], world, 10, np.random.default_rng(0))
    with pytest.raises(InputError, match="of 10 windows"):
        draw_windows([chains(world)], world, 10, np.random.default_rng(0), WindowConfig(margin=1.05))


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        (WindowConfig, {"dt": 0.0}),
        (WindowConfig, {"cuts": 0}),
        (WindowConfig, {"keep": 0}),
        (WindowConfig, {"speeds": (2.0, 1.0)}),
        (WindowConfig, {"margin": np.nan}),
        (ChainConfig, {"waypoints": 1}),
        (ChainConfig, {"step": (0.0, 1.0)}),
        (ChainConfig, {"ahead": 1.5}),
        (WalkConfig, {"restlessness": -1.0}),
        (WalkConfig, {"step": (1.0, np.inf)}),
    ],
)
def test_bad_settings_of_windows_and_waypoints_are_refused(kind, wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        kind(**wrong)
