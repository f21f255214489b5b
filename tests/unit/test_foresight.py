"""Where boxes that are only seen will be: exact where nothing is random, never worse than flying straight on."""

import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.replanner import Foresight
from jaxplan.replanner.foresight import MEMORY, REACTION
from tolerances import assert_close

HALF = np.array([[0.2, 0.3, 0.4]])
LEADS = np.array([0.0, 0.2, 0.4, 0.6])
FLIGHTS = {
    "rest": lambda t: np.stack([0.0 * t, 0.0 * t, 1.0 + 0.0 * t], axis=-1),
    "straight": lambda t: np.stack([2.0 * t, -1.0 * t, 0.5 * t], axis=-1),
    "braking": lambda t: np.stack([3.0 * t - t**2, 0.0 * t, 1.0 + 0.0 * t], axis=-1),
    "circle": lambda t: 1.5 * np.stack([np.cos(2.0 * t), np.sin(2.0 * t), 0.0 * t], axis=-1),
    "swing": lambda t: np.sin(1.8 * t)[..., None] * np.array([1.2, -0.9, 0.1]),
}


def foreseen(flight, now, sightings=7, noise=0.0, rng=None):
    """Centres at the leads, from sightings a tenth of a second apart."""
    foresight = Foresight(HALF, noise=noise or 0.005)
    for time in now - 0.1 * np.arange(sightings)[::-1]:
        foresight.see(time, flight(np.array([time])) + (rng.normal(scale=noise, size=(1, 3)) if noise else 0.0))
    _, lower, upper, _ = foresight.ways(now, LEADS, 0.3)
    return 0.5 * (lower + upper)[0]


def straight_on(flight, now):
    """As ``foreseen``, from the two newest places."""
    before, here = flight(np.array([now - 0.1, now]))
    return here + LEADS[:, None] / 0.1 * (here - before)


@pytest.mark.parametrize("name", FLIGHTS)
def test_smooth_motions_are_foreseen(name):
    """Half as far off as straight on in the mean over all phases, and in the worst, but for what the priors cost."""
    flight, errors, straight = FLIGHTS[name], [], []
    for now in np.linspace(1.0, 4.0, 31):
        truth = flight(now + LEADS)
        errors.append(np.linalg.norm(foreseen(flight, now) - truth, axis=1))
        straight.append(np.linalg.norm(straight_on(flight, now) - truth, axis=1))
    assert np.mean(errors) <= 0.5 * np.mean(straight) + 0.02
    assert np.max(errors) <= np.max(straight) + 0.02


def test_noise_is_smoothed():
    """Seen with the noise that is told, boxes that fly straight on or rest are foreseen better than by two places."""
    rng, errors, straight = np.random.default_rng(0), [], []
    for name in ("rest", "straight"):
        for _ in range(200):
            noisy = rng.normal(scale=0.02, size=(2, 3))
            truth = FLIGHTS[name](2.0 + LEADS)
            found = foreseen(FLIGHTS[name], 2.0, noise=0.02, rng=rng)
            errors.append(np.linalg.norm(found - truth, axis=1))
            straight.append(np.linalg.norm(noisy[1] + LEADS[:, None] / 0.1 * (noisy[1] - noisy[0]), axis=1))
    assert np.mean(errors) < 0.75 * np.mean(straight)


def test_fewer_sightings_are_enough_for_something():
    """One says where it is, two how fast it flies; gaps are no sightings."""
    flight = FLIGHTS["straight"]
    one, two = foreseen(flight, 2.0, 1), foreseen(flight, 2.0, 2)
    assert_close(one, np.broadcast_to(flight(np.array([2.0])), one.shape), "formula")
    assert np.linalg.norm(two - flight(2.0 + LEADS), axis=1).max() < 0.7  # m, of 1.4 m flown: it may swing
    foresight = Foresight(HALF)
    foresight.see(1.8, flight(np.array([1.8])))
    foresight.see(1.9, flight(np.array([1.9])))
    foresight.see(2.0, np.full((1, 3), np.nan))
    _, lower, upper, _ = foresight.ways(2.0, LEADS, 0.3)
    assert np.linalg.norm(0.5 * (lower + upper)[0] - flight(2.0 + LEADS), axis=1).max() < 0.7


def test_boxes_are_larger_by_what_they_may_stray():
    foresight = Foresight(HALF, noise=0.02, straying=10.0)
    foresight.see(0.0, np.ones((1, 3)))
    _, lower, upper, _ = foresight.ways(0.0, np.array([0.0, 0.2, 1.0]), 0.3)
    strayed = 0.06 + 5.0 * np.array([0.0, 0.2, REACTION])[:, None] ** 2
    assert_close(0.5 * (upper - lower)[0], HALF + strayed, "formula")


def test_only_what_has_been_seen_lately_has_ways():
    foresight = Foresight(np.repeat(HALF, 2, axis=0))
    assert np.isnan(foresight.ways(0.0, LEADS, 0.3).lower).all()
    foresight.see(0.0, np.array([[0.0, 0.0, 1.0], [np.nan, np.nan, np.nan]]))
    ways = foresight.ways(0.1, LEADS, 0.3)
    np.testing.assert_array_equal(np.isfinite(ways.lower).all(axis=(1, 2)), [True, False])
    assert ways.keep == 0.3
    assert_close(ways.times, 0.1 + LEADS, "formula")
    assert np.isnan(foresight.ways(2.0 * MEMORY, LEADS, 0.3).upper).all()
    foresight.see(2.0 * MEMORY, np.full((2, 3), np.nan))
    assert np.isnan(foresight.ways(2.0 * MEMORY, LEADS, 0.3).upper).all()


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Foresight(np.zeros((1, 3))),
        lambda: Foresight(np.ones((1, 2))),
        lambda: Foresight(HALF, noise=0.0),
        lambda: Foresight(HALF, straying=-1.0),
        lambda: Foresight(HALF).see(0.0, np.zeros((2, 3))),
        lambda: Foresight(HALF).see(np.nan, np.zeros((1, 3))),
    ],
)
def test_wrong_input_is_named(wrong):
    with pytest.raises(InputError, match="foresight"):
        wrong()


def test_time_does_not_run_backwards():
    foresight = Foresight(HALF)
    foresight.see(1.0, np.zeros((1, 3)))
    with pytest.raises(InputError, match="before"):
        foresight.see(0.5, np.zeros((1, 3)))
