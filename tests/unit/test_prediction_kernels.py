"""What is compiled for the host of the filters and of the mixture: the same as in JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.prediction.imm import NOISE_LEVELS, NOISE_SHARES, log_foreseen, track
from jaxplan.prediction.imm_flights import RANDOMS, believed_position, filter_flights
from jaxplan.prediction.imm_motions import USUAL_MOTION, MotionConfig
from jaxplan.prediction.kernels.flights import filtered
from jaxplan.prediction.kernels.mixture import conditioned, flights_of, log_densities
from jaxplan.prediction.mixture import MODES, condition, conditional_mixture, covariance_factors
from jaxplan.prediction.particles import even_randoms
from jaxplan.records import replace
from tolerances import assert_close, relative

pytestmark = pytest.mark.usefixtures("x64")
OFFSETS, BLUR = 0.1 * np.arange(1, 21), 0.05
LEVELS = np.array(NOISE_LEVELS), np.log(NOISE_SHARES)


def flight(kind: str, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Gaps [s] and positions [m] of a window of ten places, of which the newest count."""
    gaps = rng.uniform(0.05, 0.2, 10)
    times = np.cumsum(gaps)
    positions = {
        "still": np.tile([1.0, 2.0, 1.5], (10, 1)),
        "straight": times[:, None] * [3.0, -1.0, 0.2],
        "turning": 2.0 * np.stack([np.cos(2.0 * times), np.sin(2.0 * times), 0.1 * times], axis=1),
        "noisy": times[:, None] * [8.0, 1.0, 0.0] + 0.1 * rng.normal(size=(10, 3)),
    }[kind]
    positions[: 10 - count] = positions[10 - count]
    return gaps, positions


@pytest.mark.parametrize("count", [1, 2, 3, 10])
@pytest.mark.parametrize("kind", ["still", "straight", "turning", "noisy"])
def test_the_filters_and_their_flights_are_those_of_jax(kind: str, count: int) -> None:
    gaps, positions = flight(kind, count, np.random.default_rng(1))
    held, randoms = max(0, min(5, count - 2)), even_randoms(RANDOMS)
    beliefs = jax.jit(track, static_argnums=0)(USUAL_MOTION, *LEVELS, gaps, positions, np.array(count))
    now, then = (jax.tree.map(lambda leaf, at=at: leaf[at], beliefs) for at in (-1, 9 - held))
    found = filtered(USUAL_MOTION, LEVELS, (gaps, positions, count), held, BLUR, OFFSETS, randoms)
    assert_close(found.log_levels, now.log_levels, "solve")
    assert_close(found.believed, believed_position(now), "solve")
    flights = np.asarray(filter_flights(USUAL_MOTION, now, OFFSETS, *randoms))
    same = np.abs(found.flights - flights).max(axis=(1, 2)) < 1e-6
    assert same.mean() > 0.98  # a number that chooses a mode may fall to the other side by rounding
    if held:
        since = np.cumsum(gaps[10 - held :])
        wanted = log_foreseen(USUAL_MOTION, then, since, positions[10 - held :], np.hypot(BLUR, LEVELS[0]))
        assert_close(found.foreseen, wanted, "solve")


def test_another_motion_and_a_known_noise() -> None:
    gaps, positions = flight("noisy", 10, np.random.default_rng(4))
    motion, noise = MotionConfig(turn_radius=1.0, fading=(0.2, 0.9), straight=0.3, sojourn=0.2), np.array([0.1])
    belief = jax.tree.map(lambda leaf: leaf[-1], track(motion, noise, np.zeros(1), gaps, positions, np.array(10)))
    randoms, far = even_randoms(RANDOMS), 5.0 * np.arange(1, 21)
    found = filtered(motion, (noise, np.zeros(1)), (gaps, positions, 10), 0, 0.0, far, randoms)
    assert_close(found.flights, filter_flights(motion, belief, far, *randoms), "solve")


@pytest.fixture
def model():  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(2)
    roots = rng.normal(scale=0.3, size=(7, 42, 42))
    factors = covariance_factors(roots @ roots.swapaxes(1, 2))
    weights = rng.uniform(0.5, 1.5, 7)
    return conditional_mixture(weights / weights.sum(), rng.normal(size=(7, 42)), factors, 12)


def test_the_mixture_and_its_flights_are_those_of_jax(model) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(3)
    observed, newest = 0.3 * rng.normal(size=12), rng.normal(size=3)
    uniform, normal = rng.random(50), rng.standard_normal((50, MODES))
    log_weights, means, distance = condition(replace(model, rows=jnp.asarray(model.rows)), observed)
    given = conditioned(model, observed)
    assert_close(given.log_weights, log_weights, "formula")
    assert_close(given.means, np.asarray(means).reshape(-1, 7), "formula")
    assert given.distance == pytest.approx(float(distance))
    shares = np.cumsum(np.exp(log_weights))
    component = (uniform[:, None] * shares[-1] >= shares[:-1]).sum(axis=1)
    apart = np.einsum("nr,nrf->nf", normal, np.asarray(model.modes)[component])
    wanted = np.moveaxis(np.asarray(means), 2, 0)[component] + apart.reshape(50, -1, 3) + newest
    assert_close(flights_of(model, given, newest, uniform, normal), wanted, "formula")


def test_densities_are_those_of_the_marginals(model) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(5)
    newest, tolerance, given = rng.normal(size=3), 0.2, conditioned(model, 0.3 * rng.normal(size=12))
    positions = newest + rng.normal(size=(4, 3))
    found = log_densities(model, given, newest, positions, tolerance)
    factors, weights = np.asarray(model.factors), np.exp(given.log_weights)
    for h in range(4):
        density = 0.0
        for k in range(7):
            covariance = factors[h, :, :, k] @ factors[h, :, :, k].T + tolerance**2 * np.eye(3)
            off = positions[h] - newest - given.means[3 * h : 3 * h + 3, k]
            root = np.sqrt(np.linalg.det(2.0 * np.pi * covariance))
            density += weights[k] * np.exp(-0.5 * off @ np.linalg.solve(covariance, off)) / root
        assert found[h] == pytest.approx(np.log(density), **relative("formula"))
