"""The interacting-multiple-model filter against dense normal distributions, simulated motions and symmetries."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from jaxplan.errors import InputError
from jaxplan.prediction.imm import NOISE_LEVELS, NOISE_SHARES, log_foreseen, track
from jaxplan.prediction.imm_flights import _noise_response
from jaxplan.prediction.imm_motions import (
    FADING,
    STRAIGHT,
    TURN,
    USUAL_MOTION,
    MotionConfig,
    fading_motion,
    liveliness,
    transition,
    turn_motion,
)
from oracles.track_dense import fading_covariance, newest_given, white_covariance
from tolerances import assert_close, relative, tolerance

pytestmark = pytest.mark.usefixtures("x64")
LEVELS, SHARES = np.array(NOISE_LEVELS), np.log(NOISE_SHARES)
CALM = dataclasses.replace(
    USUAL_MOTION, turn_radius=1e12, least_acceleration=2.0, fading=(0.8, 0.8000001), sojourn=1e12, persistence=0.1
)
"""Nothing depends on the speed, and nobody changes the mode."""


@functools.partial(jax.jit, static_argnums=0)
def beliefs(config, levels, shares, gaps, positions, count):
    return track(config, levels, shares, gaps, positions, count)


def last(config, times, positions, levels=LEVELS, shares=SHARES):
    """What is believed in the end; every window has ten places, so that all share one program."""
    empty = 10 - len(times)
    gaps, padded = np.append(np.full(empty + 1, 0.1), np.diff(times)), np.concatenate([np.zeros((empty, 3)), positions])
    stacked = beliefs(config, levels, shares, gaps, padded, np.array(len(times)))
    return jax.tree.map(lambda leaf: np.asarray(leaf[-1]), stacked)


def curve(times, radius=3.0, rate=1.0):
    return radius * np.stack([np.cos(rate * times), np.sin(rate * times), 0.1 * rate * times], axis=-1)


@pytest.mark.parametrize("noise", [0.02, 0.2])
def test_each_mode_is_what_one_dense_normal_distribution_says(noise):
    """Uneven times; means, variances and the density of all that was seen."""
    times = np.array([0.0, 0.11, 0.25, 0.3, 0.52, 0.6, 0.7, 0.95, 1.0, 1.2])
    positions = curve(times) + noise * np.random.default_rng(0).standard_normal((10, 3))
    belief = last(CALM, times, positions, np.array([noise]), np.zeros(1))
    white = CALM.straight * 2.0 * np.sqrt(0.8)
    covariances = {
        STRAIGHT: white_covariance(times, CALM.speed, white),
        FADING: fading_covariance(times, CALM.speed, 2.0, 0.8),
    }
    densities = {}
    for mode, covariance in covariances.items():
        axes = [newest_given(covariance, noise, positions[:, axis]) for axis in range(3)]
        # the oracle's integral over 400 intervals is good to some 1e-5
        np.testing.assert_allclose(belief.means[0, mode, 0], [mean for mean, _, _ in axes], atol=1e-4)
        np.testing.assert_allclose(belief.covariances[0, mode, 0, 0], axes[0][1], rtol=1e-3)
        densities[mode] = sum(density for _, _, density in axes)
    found = belief.log_weights[0, FADING] - belief.log_weights[0, STRAIGHT]
    assert float(found) == pytest.approx(densities[FADING] - densities[STRAIGHT], abs=0.02)
    assert float(belief.log_levels[0] + belief.log_weights[0, STRAIGHT]) == pytest.approx(
        densities[STRAIGHT] - np.log(3.0), **relative("solve")
    )


def test_transitions_are_matrix_exponentials():
    time, fading, rate = 0.37, 0.6, 2.1
    singer = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / fading]])
    turning = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -(rate**2), 0.0]])
    assert_close(fading_motion(np.array(time), np.array(fading)), expm(time * singer), "formula")
    assert_close(turn_motion(np.array(time), np.array(rate)), expm(time * turning), "formula")
    assert_close(turn_motion(np.array(time), np.array(0.0)), expm(time * np.diag([1.0, 1.0], 1)), "formula")


def test_process_noise_is_van_loans():
    """Van Loan, IEEE Transactions on Automatic Control 23(3), 1978."""
    motions, happens = transition(CALM, np.array(0.4), np.array([2.0]), np.array([1.5]))
    drift = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / 0.8]])
    drive = np.diag([0.0, 0.0, 2.0 * 2.0**2 / 0.8])
    block = expm(0.4 * np.block([[-drift, drive], [np.zeros((3, 3)), drift.T]]))
    # five nodes of Gauss and Legendre
    np.testing.assert_allclose(happens[0, FADING], block[3:, 3:].T @ block[:3, 3:], **tolerance("solve"))
    assert_close(motions[0, FADING], block[3:, 3:].T, "solve")


@pytest.mark.parametrize("mode", [STRAIGHT, FADING, TURN])
def test_errors_are_as_large_as_the_filter_says(mode):
    """Normalised errors squared (NEES) of simulated motions of each mode: 3 on average for three coordinates."""
    rng, noise, dt, runs = np.random.default_rng(mode), 0.05, 0.1, 300
    rate = np.full(runs, 1.0)
    motion, happens = (np.asarray(part)[:, mode] for part in transition(CALM, np.array(dt), np.full(runs, 3.0), rate))
    roots = np.linalg.cholesky(happens + 1e-12 * np.eye(3))
    state = rng.standard_normal((runs, 3, 3)) * np.array([0.0, CALM.speed, 2.0])[:, None]
    if mode == TURN:
        state[:, 1:] = [[3.0, 0.0, 0.0], [0.0, 3.0, 0.0]]
    truth = [state]
    for _ in range(9):
        truth.append(motion @ truth[-1] + roots @ rng.standard_normal((runs, 3, 3)))
    truth = np.stack(truth, axis=1)
    seen = truth[:, :, 0] + noise * rng.standard_normal((runs, 10, 3))
    run = jax.vmap(
        lambda positions: track(CALM, np.array([noise]), np.zeros(1), np.full(10, dt), positions, np.array(10))
    )
    belief = jax.jit(run)(seen)
    off = np.asarray(belief.means)[:, -1, 0, mode, 0] - truth[:, -1, 0]
    nees = (off**2).sum(axis=1) / np.asarray(belief.covariances)[:, -1, 0, mode, 0, 0]
    assert nees.mean() == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / runs) + (0.8 if mode == TURN else 0.0))


def test_modes_follow_a_switch():
    """Straight at 4 m/s, then a turn of 1.5 m radius: a sudden acceleration when it begins, a turn once it lasts."""
    times, rate = 0.1 * np.arange(16), 4.0 / 1.5
    angle = rate * np.maximum(times - 0.8, 0.0)
    along, aside = np.minimum(4.0 * times, 3.2) + 1.5 * np.sin(angle), 1.5 * (1.0 - np.cos(angle))
    positions = np.stack([along, aside, np.zeros(16)], axis=-1)
    positions = positions + 0.003 * np.random.default_rng(0).standard_normal((16, 3))
    before, changed, lasting = (
        np.exp(last(USUAL_MOTION, times[at - 9 : at], positions[at - 9 : at]).log_weights[1]) for at in (9, 12, 16)
    )
    assert before[FADING] < 0.3 < 0.5 < changed[FADING]
    assert changed[TURN] < 0.4 < 0.7 < lasting[TURN]


def test_white_acceleration_is_the_straight_modes():
    noise = 0.8 * np.random.default_rng(1).standard_normal((9, 3))
    velocity = np.array([4.0, 0.0, 0.0]) + np.cumsum(noise, axis=0)
    positions = np.concatenate([np.zeros((1, 3)), 0.1 * np.cumsum(velocity, axis=0)])
    assert np.exp(last(USUAL_MOTION, 0.1 * np.arange(10), positions).log_weights[1, STRAIGHT]) > 0.9


@pytest.mark.parametrize("noise", [0.003, 0.08, 0.16])
def test_the_noise_is_found(noise):
    times = 0.1 * np.arange(10)
    rng = np.random.default_rng(1)
    found = [
        np.exp(
            jax.nn.log_softmax(
                last(USUAL_MOTION, times, curve(times) + noise * rng.standard_normal((10, 3))).log_levels
            )
        )
        for _ in range(20)
    ]
    mean = np.exp((np.mean(found, axis=0) * np.log(LEVELS)).sum())
    assert noise / 1.6 < mean < noise * 1.6


def test_where_when_and_which_way_do_not_matter():
    times = np.cumsum([0.0, 0.1, 0.2, 0.1, 0.15, 0.1, 0.1, 0.3, 0.1])
    positions = curve(times) + 0.05 * np.random.default_rng(3).standard_normal((9, 3))
    base = last(USUAL_MOTION, times, positions)
    turn, shift = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(), np.array([10.0, -4.0, 2.0])
    other = last(USUAL_MOTION, times + 100.0, positions @ turn.T + shift)
    np.testing.assert_allclose(other.log_weights, base.log_weights, **tolerance("solve"))
    np.testing.assert_allclose(other.log_levels, base.log_levels, **tolerance("solve"))
    np.testing.assert_allclose(other.means[..., 1:, :], base.means[..., 1:, :] @ turn.T, **tolerance("solve"))
    np.testing.assert_allclose(other.means[..., 0, :], base.means[..., 0, :] @ turn.T + shift, **tolerance("solve"))
    np.testing.assert_allclose(other.covariances, base.covariances, **tolerance("solve"))


def test_what_stands_before_the_window_does_not_count():
    times = 0.1 * np.arange(10)
    positions = curve(times)
    spoiled = np.concatenate([np.full((6, 3), 77.0), positions[6:]])
    one = beliefs(USUAL_MOTION, LEVELS, SHARES, np.full(10, 0.1), spoiled, np.array(4))
    other = last(USUAL_MOTION, times[6:], positions[6:])
    assert_close(one.means[-1], other.means, "formula")
    assert_close(one.log_levels[-1], other.log_levels, "formula")


def test_what_is_foreseen_is_what_the_next_update_finds():
    """The density of the next position by itself is that by which the evidence grows."""
    times = 0.1 * np.arange(10)
    positions = curve(times) + 0.02 * np.random.default_rng(4).standard_normal((10, 3))
    stacked = beliefs(USUAL_MOTION, LEVELS, SHARES, np.full(10, 0.1), positions, np.array(10))
    before, after = (jax.tree.map(lambda leaf, at=at: leaf[at], stacked) for at in (-2, -1))
    foreseen = log_foreseen(USUAL_MOTION, before, np.array([0.1]), positions[-1:], LEVELS)
    grown = jax.nn.logsumexp(after.log_levels) - jax.nn.logsumexp(before.log_levels)
    assert float(foreseen[0]) == pytest.approx(float(grown), **relative("formula"))


@pytest.mark.parametrize(
    "times", [[0.0], [0.0, 1e-9], [0.0, 1e4, 1e4 + 1e-6], 0.1 * np.arange(10), np.r_[0.0, 50.0 + 0.1 * np.arange(9)]]
)
@pytest.mark.parametrize("size", [0.0, 1.0, 1e6])
def test_hostile_windows_stay_finite(times, size):
    times = np.asarray(times, dtype=float)
    positions = size * np.random.default_rng(5).standard_normal((len(times), 3))
    belief = last(USUAL_MOTION, times, positions)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(belief))
    diagonal = np.diagonal(np.asarray(belief.covariances), axis1=-2, axis2=-1)
    assert (diagonal > -1e-9).all()


def test_implausible_motions_are_refused():
    for wrong in ({"turn_radius": 0.0}, {"fading": (2.0, 1.0)}, {"sojourn": 0.0}, {"straight": -1.0}):
        with pytest.raises(InputError):
            MotionConfig(**wrong)


def test_the_noise_of_a_flight_is_summed_up_as_written_out():
    """The response of each mode to each cosine, term by term and particle by particle."""
    config, offsets, speeds = MotionConfig(), 0.2 * np.arange(1, 21), np.array([0.1, 1.0, 4.0, 12.0])
    mode, speed = np.repeat(np.arange(3), 4), np.tile(speeds, 3)
    found = _noise_response(config, jnp.asarray(offsets), jnp.asarray(mode), jnp.asarray(speed))
    grid = offsets[-1] * (np.arange(40) + 0.5) / 40
    for place, (which, fast) in enumerate(zip(mode, speed, strict=True)):
        expected = liveliness(config, np.array(fast))
        fading, size = float(expected.fading), float(np.asarray(expected.noises(config)[which]))
        for step, time in enumerate(offsets):
            lag = np.maximum(time - grid, 0.0)
            response = [lag, fading * (lag + fading * np.expm1(-lag / fading)), 0.5 * lag**2][which]
            for cosine in range(3):
                wave = np.cos(np.pi * cosine * grid / offsets[-1]) * (1.0 if cosine == 0 else np.sqrt(2.0))
                written_out = size * (response * wave).sum() * np.sqrt(offsets[-1]) / 40
                assert float(found[place, step, cosine]) == pytest.approx(written_out, **relative("formula"))
