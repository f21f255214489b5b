"""Conditioning, draws and densities of mixtures, against SciPy and under abuse."""

import jax
import numpy as np
import pytest

from jaxplan.prediction.mixture import (
    CONDITION_LIMIT,
    condition,
    conditional_mixture,
    covariance_factors,
    draw,
    log_density,
)
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.predictors import build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.target_model import shipped_model
from oracles.mixture_conditional import conditional, mixture_log_density
from tolerances import assert_close, tolerance

REFERENCE = {"rtol": 1e-9, "atol": 1e-9}
"""What the mixture promises against an independent reference."""

pytestmark = pytest.mark.usefixtures("x64")


def random_mixture(seed, components=5, observed=12, steps=4, condition_number=1e4):
    rng = np.random.default_rng(seed)
    size = observed + 3 * steps
    rotations = np.linalg.qr(rng.standard_normal((components, size, size)))[0]
    values = condition_number ** -rng.uniform(0.0, 1.0, (components, 1, size))
    weights = rng.dirichlet(np.ones(components))
    return weights, rng.standard_normal((components, size)), (rotations * values) @ rotations.swapaxes(1, 2)


def blocks(prepared):
    """Covariances (s, k, 3, 3) from a prepared mixture's factors."""
    factors = np.moveaxis(np.asarray(prepared.factors), -1, 1)
    return factors @ factors.swapaxes(-1, -2)


@pytest.mark.parametrize("seed", range(8))
def test_conditional_equals_scipy(seed):
    weights, means, covariances = random_mixture(seed)
    prepared = conditional_mixture(weights, means, covariance_factors(covariances), 12)
    observed = means[seed % 5, :12] + 0.05 * np.random.default_rng(seed).standard_normal(12)
    log_weights, centres, _ = jax.jit(condition)(prepared, observed)
    wanted_weights, wanted_centres, wanted_spreads = conditional(weights, means, covariances, observed)
    np.testing.assert_allclose(np.exp(log_weights), np.exp(wanted_weights), **REFERENCE)
    np.testing.assert_allclose(np.asarray(centres).transpose(2, 0, 1).reshape(5, 12), wanted_centres, **REFERENCE)
    for step in range(4):
        at = slice(3 * step, 3 * step + 3)
        np.testing.assert_allclose(blocks(prepared)[step], wanted_spreads[:, at, at], **REFERENCE)


@pytest.mark.parametrize(("world", "dt"), [("env1", 0.1), ("env2", 0.2), ("env3", 0.2), ("unknown", 0.1)])
def test_shipped_models_condition_like_scipy(world, dt):
    model = shipped_model(world, dt)
    q = model.observed
    covariances = model.factors @ model.factors.swapaxes(1, 2)
    observed = model.means[0, :q] + 0.01 * np.random.default_rng(0).standard_normal(q)
    log_weights, centres, _ = condition(model.conditional(), observed)
    wanted_weights, wanted_centres, _ = conditional(model.weights, model.means, covariances, observed)
    np.testing.assert_allclose(np.exp(log_weights), np.exp(wanted_weights), **REFERENCE)
    flat = np.asarray(centres).transpose(2, 0, 1).reshape(len(wanted_centres), -1)
    likely = wanted_weights > np.log(1e-9)
    np.testing.assert_allclose(flat[likely], wanted_centres[likely], **REFERENCE)


@pytest.mark.parametrize("count", [2, 5, 9])
def test_with_fewer_positions_it_is_conditioned_on_these_alone(count):
    """The newest positions of a window, against the mixture without the others."""
    config, model = PredictionConfig(dt=0.2), shipped_model("env2", 0.2)
    times = 0.2 * np.arange(10 - count, 10)
    circle = np.stack([2.0 * np.cos(times), 2.0 * np.sin(times), 1.0 + 0.1 * times], axis=1)
    observations = Observations(times=times, positions=circle)
    kept = np.r_[0:3, 3 + 3 * (10 - count) : 30, 30 : 30 + 3 * config.steps]
    covariances = model.factors @ model.factors.swapaxes(1, 2)
    relative = observations.positions[:-1] - observations.positions[-1]
    observed = np.append(observations.positions[-1], relative)
    log_weights, centres, _ = conditional(
        model.weights, model.means[:, kept], covariances[:, kept][:, :, kept], observed
    )
    wanted = (np.exp(log_weights) @ centres).reshape(-1, 3) + observations.positions[-1]
    found = build_predictor("gmm", config, model=model).predict(observations).mean
    # condition numbers of 1e9: another factorisation of the same matrix
    assert_close(found, wanted, "solve")


def test_log_density_equals_scipy():
    weights, means, covariances = random_mixture(3)
    prepared = conditional_mixture(weights, means, covariance_factors(covariances), 12)
    observed = means[0, :12]
    log_weights, centres, _ = condition(prepared, observed)
    places = np.random.default_rng(1).standard_normal((4, 7, 3))
    found = log_density(log_weights, centres, prepared.inverses, prepared.log_volumes, places)
    kept, wanted_centres, spreads = conditional(weights, means, covariances, observed)
    for step in range(4):
        at = slice(3 * step, 3 * step + 3)
        wanted = [mixture_log_density(kept, wanted_centres[:, at], spreads[:, at, at], p) for p in places[step]]
        np.testing.assert_allclose(found[step], wanted, **tolerance("formula"))


def test_draws_have_the_moments_of_the_mixture():
    weights, means, covariances = random_mixture(5, components=3, condition_number=10.0)
    prepared = conditional_mixture(weights, means, covariance_factors(covariances), 12)
    log_weights, centres, _ = condition(prepared, means.mean(axis=0)[:12])
    rng, count = np.random.default_rng(2), 200_000
    drawn = np.asarray(
        draw(log_weights, centres, prepared.factors, rng.random((4, count)), rng.standard_normal((4, count, 3)))
    )
    shares, middles = np.exp(log_weights), np.asarray(centres)
    mean = middles @ shares
    apart = middles.transpose(0, 2, 1) - mean[:, None]
    spread = np.einsum("k,skij->sij", shares, blocks(prepared)) + np.einsum("k,ski,skj->sij", shares, apart, apart)
    sigma = np.sqrt(np.diagonal(spread, axis1=1, axis2=2) / count)
    assert (np.abs(drawn.mean(axis=1) - mean) < 5.0 * sigma).all()
    scale = np.sqrt(np.einsum("sii,sjj->sij", spread, spread))
    sampled = np.einsum("sbi,sbj->sij", drawn - mean[:, None], drawn - mean[:, None]) / count
    assert (np.abs(sampled - spread) < 5.0 * scale * np.sqrt(3.0 / count)).all()


def test_compiled_and_batched_equal_one_by_one_with_a_bad_lane():
    weights, means, covariances = random_mixture(7)
    prepared = conditional_mixture(weights, means, covariance_factors(covariances), 12)
    observed = np.random.default_rng(0).standard_normal((6, 12)) * [[0.1], [1.0], [10.0], [100.0], [1.0], [1.0]]
    observed[4, 3] = np.nan
    batched = jax.jit(jax.vmap(condition, in_axes=(None, 0)))(prepared, observed)
    for lane in range(6):
        for one, all_ in zip(condition(prepared, observed[lane]), batched, strict=True):
            # another order of summation, and log-weights of -1e7 at 100 m
            np.testing.assert_allclose(all_[lane], one, **tolerance("formula"))
    assert np.isnan(batched[0][4]).all()
    assert np.isfinite(np.delete(batched[0], 4, axis=0)).all()


HOSTILE = ["well-conditioned", "condition 1e18", "rank one", "indefinite", "zero"]


def hostile_covariances(kind, rng, size):
    if kind == "zero":
        return np.zeros((4, size, size))
    rotations = np.linalg.qr(rng.standard_normal((4, size, size)))[0]
    values = {
        "well-conditioned": rng.uniform(0.1, 1.0, (4, 1, size)),
        "condition 1e18": np.logspace(0.0, -18.0, size)[None, None],
        "rank one": np.eye(size)[0][None, None],
        "indefinite": rng.uniform(-0.1, 1.0, (4, 1, size)),
    }[kind]
    return (rotations * values) @ rotations.swapaxes(1, 2)


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_million_hostile_cases_and_no_nan(kind):
    """200,000 observations for each kind of covariance, most of them far from anything that was trained."""
    rng, observed, steps = np.random.default_rng(11), 6, 2
    covariances = hostile_covariances(kind, rng, observed + 3 * steps)
    means = rng.standard_normal((4, observed + 3 * steps))
    weights = np.array([1.0 - 3e-300, 1e-300, 1e-300, 1e-300])
    prepared = conditional_mixture(weights, means, covariance_factors(covariances), observed)

    @jax.jit
    @jax.vmap
    def whole(seen, uniform, normal):
        log_weights, centres, distance = condition(prepared, seen)
        places = draw(log_weights, centres, prepared.factors, uniform, normal)
        density = log_density(log_weights, centres, prepared.inverses, prepared.log_volumes, places)
        return log_weights, centres, places, density, distance

    for _ in range(4):
        size = 50_000
        seen = rng.standard_normal((size, observed)) * 10.0 ** rng.uniform(-3.0, 2.0, (size, 1))
        seen[::7] += 100.0
        found = whole(seen, rng.random((size, steps, 1)), rng.standard_normal((size, steps, 1, 3)))
        for values in found:
            assert np.isfinite(values).all()
        assert_close(np.exp(found[0]).sum(axis=1), 1.0, "exact")


@pytest.mark.parametrize("kind", HOSTILE[1:])
def test_bad_covariances_are_repaired_and_good_ones_left_alone(kind):
    covariances = hostile_covariances(kind, np.random.default_rng(0), 9)
    factors = covariance_factors(covariances)
    repaired = factors @ factors.swapaxes(1, 2)
    values = np.linalg.eigvalsh(repaired)
    assert (values[:, -1] <= 10.0 * CONDITION_LIMIT * np.abs(values[:, 0])).all()
    largest = max(np.abs(np.linalg.eigvalsh(covariances)).max(), 1e-300)
    wanted = np.minimum(np.linalg.eigvalsh(covariances), 0.0).min() * -1.0 + 1e-9 * largest + 1e-18
    assert np.abs(repaired - covariances).max() <= 1.01 * wanted
    good = hostile_covariances("well-conditioned", np.random.default_rng(0), 9)
    np.testing.assert_array_equal(covariance_factors(good), np.linalg.cholesky(0.5 * (good + good.swapaxes(1, 2))))


@pytest.mark.peers
def test_means_and_covariances_equal_gmr():
    gmr = pytest.importorskip("gmr", reason="the peer gmr is not installed")
    weights, means, covariances = random_mixture(9, condition_number=100.0)
    peer = gmr.GMM(n_components=5, priors=weights, means=means, covariances=covariances)
    observed = means[0, :12]
    other = peer.condition(np.arange(12), observed)
    prepared = conditional_mixture(weights, means, covariance_factors(covariances), 12)
    _, centres, _ = condition(prepared, observed)
    np.testing.assert_allclose(np.asarray(centres).transpose(2, 0, 1).reshape(5, 12), other.means, **REFERENCE)
    for step in range(4):
        at = slice(3 * step, 3 * step + 3)
        np.testing.assert_allclose(blocks(prepared)[step], other.covariances[:, at, at], **REFERENCE)
