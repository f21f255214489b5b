"""The classifier's Gaussian process beside GPJax's (an optional package, for jax before 0.11)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.feasibility.gaussian_process import (
    JITTER,
    divergence,
    expected_log_likelihood,
    new_process,
    posterior,
    predict,
    probability,
    related,
)
from tolerances import relative, tolerance

gpjax = pytest.importorskip("gpjax")
LATENT, LOW, POINTS = 3, 2, 15


@pytest.fixture
def process(x64):
    """Our process with the related kernel and a random variational distribution, in float64."""
    rng = np.random.default_rng(0)
    kernel = jax.tree.map(lambda leaf: jnp.asarray(leaf + 0.3 * rng.normal(size=leaf.shape)), related(LATENT, LOW))
    found = new_process(kernel, jnp.asarray(rng.uniform(-2, 2, (POINTS, LATENT + LOW))))
    root = np.tril(0.2 * rng.normal(size=(POINTS, POINTS)), -1) + np.diag(rng.uniform(-1.5, -0.2, POINTS))
    return found._replace(mean=jnp.asarray(rng.normal(size=POINTS)), root=jnp.asarray(root), offset=jnp.asarray(0.3))


def peer(process):
    """The same in GPJax: own(z) + corr(z) (rbf(f_low) + f_low . f_low' / l)."""
    kernels, shapes = gpjax.kernels, process.kernel
    z, low = list(range(LATENT)), list(range(LATENT, LATENT + LOW))

    def rbf(part, dims):
        return kernels.RBF(
            active_dims=dims,
            lengthscale=jnp.exp(part.log_lengths),
            variance=jnp.exp(2.0 * part.log_scale),
        )

    shared = rbf(shapes.low, low) + kernels.Linear(active_dims=low, variance=1.0 / LOW)
    kernel = rbf(shapes.own, z) + rbf(shapes.correlation, z) * shared
    prior = gpjax.gps.Prior(
        mean_function=gpjax.mean_functions.Constant(process.offset), kernel=kernel, jitter=jitter_of(process)
    )
    root = jnp.tril(process.root, -1) + jnp.diag(jnp.exp(jnp.diag(process.root)))
    return gpjax.variational_families.WhitenedVariationalGaussian(
        model=prior * gpjax.likelihoods.Bernoulli(),
        inducing_inputs=process.inducing,
        variational_mean=process.mean[:, None],
        variational_root_covariance=root,
    )


def jitter_of(process):
    return JITTER * float(jnp.max(jnp.diag(process.kernel(process.inducing, process.inducing))))


def test_posterior_and_divergence_are_those_of_gpjax(process):
    family = peer(process)
    x = jnp.asarray(np.random.default_rng(1).uniform(-2, 2, (40, LATENT + LOW)))
    mean, variance = predict(posterior(process), x)
    theirs = family.predict(x)
    np.testing.assert_allclose(mean, theirs.mean.ravel(), **tolerance("solve"))
    np.testing.assert_allclose(variance, jnp.diag(theirs.covariance_matrix) - jitter_of(process), **tolerance("solve"))
    chance = gpjax.likelihoods.Bernoulli().predict(theirs).mean
    np.testing.assert_allclose(probability(mean, variance), np.ravel(chance), atol=2e-3)
    assert float(divergence(process)) == pytest.approx(float(family.prior_kl()), **relative("formula"))


def test_the_expected_likelihood_is_that_of_gpjax(x64):
    """GPJax keeps probabilities 1e-3 away from 0 and 1: no great surprises here, where that would show."""
    rng = np.random.default_rng(2)
    mean, variance, positive = rng.uniform(-1, 1, 30), rng.uniform(0.05, 0.3, 30), rng.random(30) < 0.5
    found = expected_log_likelihood(jnp.asarray(mean), jnp.asarray(variance), jnp.asarray(positive))
    wanted = gpjax.likelihoods.Bernoulli().expected_log_likelihood(
        jnp.asarray(positive, float)[:, None], jnp.asarray(mean)[:, None], jnp.asarray(variance)[:, None]
    )
    np.testing.assert_allclose(found, np.ravel(wanted), atol=1e-2)
