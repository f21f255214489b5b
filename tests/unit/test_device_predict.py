"""Predictors on a device: what those on the host say, or a distribution that the host knows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.device.predict import PREDICTORS, Seen, build_predict, goals_of, mixtures_for
from jaxplan.device.stations import Goals
from jaxplan.errors import InputError
from jaxplan.io.targets import Target, load_target
from jaxplan.precision import in_float64
from jaxplan.prediction.mixture import density_terms, log_density
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.predictors import build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.target_model import shipped_model
from tolerances import assert_close

CONFIG = PredictionConfig()
MODEL = shipped_model("env1", CONFIG.dt)


@pytest.fixture(scope="module")
def target() -> Target:
    return load_target(None, world="env1", speed=2.5)


def observed(target: Target, now: float, count: int) -> Observations:
    times = now - CONFIG.dt * np.arange(count - 1, -1, -1)
    return Observations(times=times, positions=target.position(times), age=0.0)


@in_float64
def asked(name: str, target: Target, now: float, known: int, seed: int = 0, config: PredictionConfig = CONFIG) -> Goals:
    window = target.position(now - CONFIG.dt * np.arange(CONFIG.observations - 1, -1, -1))
    window[: CONFIG.observations - known] = 1e3  # must not matter
    seen = Seen(jnp.asarray(window), jnp.int32(known), jnp.asarray(CONFIG.dt))
    predict = jax.jit(build_predict(name, config))
    found = predict(seen, jnp.asarray(target.position(now + config.offsets)), mixtures_for(config, MODEL), key_of(seed))
    return Goals(*(np.asarray(part) for part in found))


def key_of(seed: int) -> jax.Array:
    return jax.random.key(seed)


@pytest.mark.parametrize("known", [1, 2, 3, 10])
@pytest.mark.parametrize("name", ["none", "ground-truth", "constant-velocity"])
def test_what_is_certain_is_what_the_host_says(name: str, known: int, target: Target) -> None:
    host = build_predictor(name, CONFIG, target.position)(observed(target, 2.0, known), 0)
    found = asked(name, target, 2.0, known)
    assert_close(found.positions, host.goals, "formula")
    assert_close(found.times, host.arrival_times, "formula")
    assert (found.likelihood == 1.0).all()


def test_noise_has_the_variance_that_grows_by_step(target: Target) -> None:
    config = PredictionConfig(batch=400, sigma=0.1)
    found = asked("noisy", target, 1.0, 10, config=config)
    off = found.positions.reshape(20, 400, 3) - target.position(1.0 + config.offsets)[:, None]
    deviations = off.std(axis=(1, 2)) / (0.1 * np.sqrt(np.arange(1, 21)))
    assert np.abs(deviations - 1.0).max() < 0.1  # four deviations of a sample of 1200
    nearest = np.linalg.norm(off[0], axis=1).argmin()
    assert found.likelihood[:400].argmax() == nearest
    assert found.likelihood.max() == 1.0


@pytest.mark.parametrize("known", [2, 4, 10])
def test_draws_of_the_mixture_have_the_densities_that_the_host_gives_them(known: int, target: Target) -> None:
    host = build_predictor("gmm", CONFIG, model=MODEL).predict(observed(target, 2.0, known))
    found = asked("gmm", target, 2.0, known)
    inverses, volumes = density_terms(np.asarray(host.factors))
    drawn = found.positions.reshape(CONFIG.steps, CONFIG.batch, 3)
    with jax.enable_x64(True):
        log = log_density(host.log_weights, np.asarray(host.means), inverses, volumes, jnp.asarray(drawn))
    expected = np.exp(np.asarray(log) - np.asarray(log).max()).reshape(-1)
    assert_close(found.likelihood, expected, "solve")
    assert len(np.unique(drawn[0], axis=0)) == CONFIG.batch
    assert not np.array_equal(drawn, asked("gmm", target, 2.0, known, seed=1).positions.reshape(drawn.shape))


def test_a_target_seen_once_is_no_question_for_the_mixture(target: Target) -> None:
    found = asked("gmm", target, 2.0, 1)
    assert_close(found.positions, np.broadcast_to(target.position(np.array([2.0])), (400, 3)), "formula")
    assert (found.likelihood == 1.0).all()


def test_as_many_goals_as_promised(target: Target) -> None:
    for name in PREDICTORS:
        assert len(asked(name, target, 2.0, 10).times) == goals_of(name, CONFIG)


def test_unknown_names_and_other_windows_are_refused() -> None:
    with pytest.raises(InputError, match="did you mean 'noisy'"):
        build_predict("noisi", CONFIG)
    with pytest.raises(InputError, match="steps = 20, want 10"):
        mixtures_for(PredictionConfig(steps=10), MODEL)
