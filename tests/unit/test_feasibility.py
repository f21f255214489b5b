"""The feasibility classifier: its Gaussian process against exact ones, its features' symmetries, its file."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from jaxplan.errors import FileError, InputError
from jaxplan.feasibility.checkpoint import classifier_card, load_classifier, save_classifier
from jaxplan.feasibility.classifier import Classifier, make_classifier, new_model
from jaxplan.feasibility.features import (
    DURATION,
    INSTANTS,
    LOW_FIDELITIES,
    MARGIN,
    MOTION_FEATURES,
    SCARCE,
    SHORT,
    YAWING,
    low_fidelity,
    motion_features,
    summarise,
)
from jaxplan.feasibility.gaussian_process import (
    Rbf,
    divergence,
    expected_log_likelihood,
    lower_bound,
    marginals,
    new_process,
    posterior,
    predict,
    probability,
    rbf,
    related,
)
from jaxplan.minsnap.spline_batch import fit_each
from jaxplan.spline import FlatStateBatch
from jaxplan.training.active import latents
from jaxplan.training.classifier import ClassifierConfig, Labelled, calibrate, train_classifier
from jaxplan.training.scores import area_under_curve, binary_scores
from jaxplan.vehicle.limits import least_rotor_margin, thrust_limit_margin
from jaxplan.vehicle.load import load_vehicle
from tolerances import relative, tolerance

summary_of = jax.jit(summarise)
predict_motion = jax.jit(Classifier.predict_motion)
covariance_of = jax.jit(lambda kernel, one, other: kernel(one, other))


def random_process(kernel, dimensions, count=20, seed=0):
    rng = np.random.default_rng(seed)
    process = new_process(kernel, jnp.asarray(rng.uniform(-2, 2, (count, dimensions)), jnp.float32))
    root = np.tril(0.2 * rng.normal(size=(count, count)), -1) + np.diag(rng.uniform(-1.5, -0.2, count))
    return process._replace(mean=jnp.asarray(rng.normal(size=count), jnp.float32), root=jnp.asarray(root, jnp.float32))


@pytest.mark.parametrize("kernel", [rbf(4, 1.5, 1.2), related(3, 1), related(2, 2)], ids=["no low", "one", "two"])
def test_marginals_follow_their_definition(kernel):
    """The distribution of f(x) under q, written out with inverses in float64."""
    process = random_process(kernel, 4)
    x = np.random.default_rng(1).uniform(-2, 2, (7, 4))
    exact = jax.tree.map(lambda leaf: np.asarray(leaf, float), process)
    with jax.enable_x64(True):
        inner = np.asarray(covariance_of(exact.kernel, jnp.asarray(exact.inducing), jnp.asarray(exact.inducing)))
        cross = np.asarray(covariance_of(exact.kernel, jnp.asarray(exact.inducing), jnp.asarray(x)))
        prior = np.diag(np.asarray(covariance_of(exact.kernel, jnp.asarray(x), jnp.asarray(x))))
    factor = np.linalg.cholesky(inner + 1e-4 * inner.diagonal().max() * np.eye(len(inner)))
    root = np.tril(exact.root, -1) + np.diag(np.exp(np.diag(exact.root)))
    weights = np.linalg.solve(factor, cross)
    mean = exact.offset + weights.T @ exact.mean
    variance = prior - (weights**2).sum(axis=0) + ((root.T @ weights) ** 2).sum(axis=0)
    for found in (
        jax.jit(marginals)(process, x.astype(np.float32)),
        jax.jit(lambda process, x: predict(posterior(process), x))(process, x.astype(np.float32)),
    ):
        np.testing.assert_allclose(found[0], mean, atol=5e-3)
        np.testing.assert_allclose(found[1], variance, atol=2e-2)


def test_kernels_are_positive_definite_and_the_second_depends_on_the_first():
    x = jnp.asarray(np.random.default_rng(0).normal(size=(30, 4)), jnp.float32)
    for kernel in (rbf(4), related(3, 1), related(2, 2)):
        assert np.linalg.eigvalsh(np.asarray(covariance_of(kernel, x, x), float)).min() > -1e-4
    same = jnp.concatenate([jnp.zeros((2, 3)), jnp.array([[1.0], [-1.0]])], axis=1)
    covariance = np.asarray(covariance_of(related(3, 1), same, same))
    assert covariance[0, 1] < covariance[0, 0]


def test_probability_and_expectation_against_quadrature():
    mean, variance = jnp.array([-2.0, 0.3, 4.0]), jnp.array([0.5, 2.0, 1.0])
    chances, grid = np.asarray(jax.jit(probability)(mean, variance)), np.linspace(-30, 30, 200_001)
    for index in range(3):
        density = norm.pdf(grid, float(mean[index]), float(np.sqrt(variance[index])))
        step = grid[1] - grid[0]
        wanted = (density * norm.cdf(grid)).sum() * step
        assert chances[index] == pytest.approx(wanted, **relative("exact", np.float32))
        for positive, sign in ((True, 1.0), (False, -1.0)):
            wanted = (density * norm.logcdf(sign * grid)).sum() * step
            found = jax.jit(expected_log_likelihood)(mean, variance, np.full(3, positive))[index]
            assert float(found) == pytest.approx(wanted, rel=2e-3, abs=1e-4)


def test_divergence_is_that_of_normal_distributions():
    process = random_process(rbf(2), 2, count=5)
    root = np.tril(np.asarray(process.root, float), -1) + np.diag(np.exp(np.diag(process.root)))
    covariance, mean = root @ root.T, np.asarray(process.mean, float)
    wanted = 0.5 * (np.trace(covariance) + mean @ mean - 5 - np.linalg.slogdet(covariance)[1])
    assert float(jax.jit(divergence)(process)) == pytest.approx(wanted, rel=1e-4)
    assert float(jax.jit(divergence)(new_process(rbf(2), jnp.zeros((4, 2))))) == pytest.approx(0.0, **relative("solve"))


def test_with_every_datum_inducing_the_bound_approaches_the_exact_evidence():
    """An exact GP classifier on small data: the evidence by Monte Carlo over the prior, no sparseness."""
    rng = np.random.default_rng(0)
    x = jnp.asarray(rng.uniform(-2, 2, (12, 1)), jnp.float32)
    positive = jnp.asarray(np.asarray(x[:, 0]) > 0.2)
    kernel = Rbf(jnp.log(jnp.array([0.8])), jnp.log(jnp.float32(1.5)))
    covariance = np.asarray(covariance_of(kernel, x, x), float) + 1e-4 * 2.25 * np.eye(12)
    draws = rng.multivariate_normal(np.zeros(12), covariance, 400_000)
    likelihood = norm.cdf(np.where(np.asarray(positive), 1, -1) * draws).prod(axis=1)
    evidence = np.log(likelihood.mean())
    process = new_process(kernel, x)

    @jax.jit
    def climb(values):
        def bound(values):
            return 12 * lower_bound(process._replace(mean=values[0], root=values[1]), x, positive, 12)

        found, slope = jax.value_and_grad(bound)(values)
        return found, jax.tree.map(lambda value, change: value + 0.05 * change, values, slope)

    values = (process.mean, process.root)
    for _ in range(1500):
        found, values = climb(values)
    assert evidence - 0.1 < float(found) <= evidence + 0.01
    fitted = process._replace(mean=values[0], root=values[1])
    chances = jax.jit(lambda process: probability(*marginals(process, x)))(fitted)
    exact = (norm.cdf(draws) * likelihood[:, None]).mean(axis=0) / likelihood.mean()
    np.testing.assert_allclose(chances, exact, atol=0.03)


def random_flights(seed=0, lanes=6):
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.normal(size=(4, 3, lanes)), axis=0)
    derivatives = rng.normal(size=(5, 3, lanes))
    derivatives[0] = points[0]
    return points, derivatives, rng.normal(size=(3, lanes)) * 0.3, rng.uniform(0.4, 1.5, (3, lanes))


def flights_of(points, derivatives, yaw, durations):
    return fit_each(FlatStateBatch(derivatives=derivatives, yaw=yaw), points, durations, 1.5)


@jax.jit
def motion_of(*flight):
    return motion_features(flights_of(*flight), load_vehicle())


@jax.jit
def margins_of(*flight):
    states = flights_of(*flight).states(INSTANTS)
    return thrust_limit_margin(load_vehicle(), states), least_rotor_margin(load_vehicle(), states)


def features_of(*flight):
    with jax.enable_x64(True):
        return np.asarray(motion_of(*flight))


def test_features_do_not_change_when_a_flight_is_moved_or_turned():
    points, derivatives, yaw, durations = random_flights(lanes=40)
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    moved = np.einsum("ij,njk->nik", turn, points) + np.array([5.0, -3.0, 2.0])[:, None]
    turned = yaw + np.array([angle, 0.0, 0.0])[:, None]
    here = features_of(points, derivatives, yaw, durations)
    rotated = np.einsum("ij,njk->nik", turn, derivatives)
    rotated[0] = moved[0]
    there = features_of(moved, rotated, turned, durations)
    assert here.shape == (MOTION_FEATURES, INSTANTS, 40)
    np.testing.assert_allclose(here, there, atol=2e-3)
    assert np.abs(here - features_of(points, derivatives, yaw, 0.8 * durations)).max() > 0.1


def test_the_low_fidelity_is_made_of_the_margin_and_the_summary_is_not():
    flight = random_flights(lanes=40)
    motion = features_of(*flight)
    with jax.enable_x64(True):
        shares, speeds = (np.asarray(margin) for margin in margins_of(*flight))
    low = np.asarray(jax.jit(low_fidelity)(motion))
    compressed = 5.0 * shares / (1.0 + np.abs(5.0 * shares)) ** 0.75
    np.testing.assert_allclose(low[0], compressed.min(axis=0), rtol=1e-3, atol=1e-3)
    impulse = flight[-1].sum(axis=0) * np.maximum(SCARCE - compressed, 0.0).mean(axis=0)
    np.testing.assert_allclose(low[1], np.log(impulse + SHORT), atol=2e-3)
    assert len(low) == LOW_FIDELITIES
    assert 0 < (speeds >= 0.0).sum() < 40
    np.testing.assert_array_equal(low[0] >= 0.0, speeds >= 0.0)
    other = motion.copy()
    other[MARGIN] = 7.0
    np.testing.assert_array_equal(summary_of(motion), summary_of(other))


def test_a_summary_is_extremes_and_means_and_turning_left_counts_as_turning_right():
    motion = random_motion(5, 0)
    found, seen = np.asarray(summary_of(motion)), motion[:DURATION].copy()
    seen[YAWING] = np.abs(seen[YAWING])
    wanted = np.concatenate([seen.max(axis=1), seen.min(axis=1), seen.mean(axis=1), motion[DURATION, :1]])
    np.testing.assert_allclose(found, wanted, **tolerance("solve"))
    mirrored = motion.copy()
    mirrored[YAWING] *= -1.0
    np.testing.assert_array_equal(found, summary_of(mirrored))


def random_motion(count, seed):
    return np.random.default_rng(seed).normal(size=(MOTION_FEATURES, INSTANTS, count)).astype(np.float32)


def learnable(count, seed):
    """Motions whose label is the least margin with noise, which the other features do not tell."""
    rng, motion = np.random.default_rng([seed, 1]), random_motion(count, seed)
    motion[MARGIN] += 1.5 * rng.normal(size=count).astype(np.float32)
    least = motion[MARGIN].min(axis=0)
    return Labelled(motion, least + 0.2 * rng.normal(size=count) > np.median(least))


@pytest.mark.slow
def test_a_classifier_learns_from_the_low_fidelity_and_is_the_same_from_its_file(tmp_path):
    seen, unseen = learnable(2000, 0), learnable(1000, 1)
    config = ClassifierConfig(inducing=16, steps=400, batch=128, learning_rate=1e-2)
    model, loss = train_classifier(config, seen)
    assert np.isfinite(loss)
    found = predict_motion(make_classifier(model), unseen.motion)
    scores = binary_scores(np.asarray(found.probability, float), unseen.feasible)
    assert scores["auc"] > 0.9
    assert scores["brier"] < 0.15
    assert (np.asarray(found.deviation) > 0.0).all()
    blind, _ = train_classifier(dataclasses.replace(config, related_to_low=False), seen)
    guessed = predict_motion(make_classifier(blind), unseen.motion).probability
    assert area_under_curve(np.asarray(guessed, float), unseen.feasible) < 0.6
    path = tmp_path / "mine.npz"
    save_classifier(path, model, {"command": "none"}, vehicle=load_vehicle())
    again = predict_motion(load_classifier(path), unseen.motion)
    np.testing.assert_array_equal(found.probability, again.probability)
    assert classifier_card(path)["command"] == "none"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(bytes(content))
    with pytest.raises(FileError, match=r"mine\.npz"):
        load_classifier(path)


@pytest.mark.slow
def test_another_training_takes_the_same_program(compilations):
    config, labelled = ClassifierConfig(inducing=8, steps=3, batch=16), learnable(40, 0)
    start, _ = train_classifier(config, labelled)
    compilations.count = 0
    more = Labelled(labelled.motion[..., 1:], labelled.feasible[1:])
    train_classifier(dataclasses.replace(config, seed=1), more, start)
    assert compilations.count == 0


def test_calibration_undoes_a_wrong_scale_and_offset():
    """An overconfident, optimistic model, set right on labels drawn from the honest probabilities."""
    rng = np.random.default_rng(0)
    honest = rng.normal(size=4000)
    feasible = rng.random(4000) < norm.cdf(honest)
    model = random_model()
    found = calibrate(model, 3.0 * honest + 1.0, np.zeros(4000), feasible)
    assert float(found.process.kernel.own.log_scale) == pytest.approx(-np.log(3.0), abs=0.1)
    assert float(found.process.offset) == pytest.approx(-1.0 / 3.0, abs=0.1)
    motion = learnable(50, 1).motion
    for before, after in zip(latents(model, motion), latents(found, motion), strict=True):
        assert np.corrcoef(before, after)[0, 1] > 0.99


@pytest.mark.slow
def test_gradients_reach_the_durations():
    points, derivatives, yaw, durations = random_flights()
    classifier = make_classifier(random_model())

    def total(durations):
        state = FlatStateBatch(derivatives=jnp.asarray(derivatives), yaw=jnp.asarray(yaw))
        flights = fit_each(state, jnp.asarray(points), durations, 1.5)
        return jnp.sum(classifier.predict(flights, load_vehicle()).probability)

    with jax.enable_x64(True):
        slope = np.asarray(jax.jit(jax.grad(total))(jnp.asarray(durations)))
    assert np.isfinite(slope).all()
    assert np.abs(slope).max() > 0.0


def random_model():
    model = new_model(8, 0, random_motion(40, 0))
    weights = jnp.asarray(np.random.default_rng(0).normal(size=8), jnp.float32)
    return model._replace(process=model.process._replace(mean=weights))


def test_wrong_settings_are_refused():
    with pytest.raises(InputError, match="batch"):
        ClassifierConfig(batch=0)
    nothing = Labelled(np.zeros((MOTION_FEATURES, INSTANTS, 0), np.float32), np.zeros(0, bool))
    with pytest.raises(InputError, match="want labels"):
        train_classifier(ClassifierConfig(steps=1), nothing)


def test_scores_against_their_definitions():
    rng = np.random.default_rng(0)
    chance, positive = np.round(rng.random(300), 2), rng.random(300) < 0.4
    pairs = chance[positive][:, None] - chance[~positive][None]
    assert area_under_curve(chance, positive) == pytest.approx(np.mean((pairs > 0) + 0.5 * (pairs == 0)))
    assert np.isnan(area_under_curve(chance, np.ones(300, bool)))
    honest = rng.random(200_000)
    assert binary_scores(honest, rng.random(200_000) < honest)["calibration_error"] < 0.01
    assert binary_scores(np.full(100, 0.9), np.zeros(100, bool))["calibration_error"] == pytest.approx(0.9)
