"""The observation stream: whatever happens to samples on their way, the track is the target's."""

import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.io.targets import load_target, stored_targets
from jaxplan.prediction.gating import GateConfig
from jaxplan.prediction.interpolation import interpolate
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.stream import ObservationStream, StreamConfig
from tolerances import tolerance

CONFIG = StreamConfig(observations=10)


def helix(times):
    """2 m/s with 4 m/s^2 across: a brisk target."""
    times = np.asarray(times)
    return np.stack([np.cos(2.0 * times), np.sin(2.0 * times), 0.2 * times], axis=-1)


def feed(times, positions, config=CONFIG, now=None):
    stream = ObservationStream(config)
    for time, position in zip(times, positions, strict=True):
        stream.add(time, position, time if now is None else now)
    return stream


def test_even_samples_pass_unchanged():
    times = 0.1 * np.arange(25)
    seen = feed(times, helix(times)).observe(times[-1])
    np.testing.assert_allclose(seen.times, times[-10:], **tolerance("exact"))
    np.testing.assert_allclose(seen.positions, helix(times[-10:]), **tolerance("exact"))
    assert seen.age == 0.0


@pytest.mark.parametrize(
    ("rate", "dt", "error"), [(10.0, 0.2, 1e-12), (80.0, 0.1, 1e-5), (7.0, 0.1, 6e-3), (33.0, 0.2, 2e-4)]
)
def test_resampled_to_the_interval_of_the_predictions(rate, dt, error):
    times = np.arange(0.0, 4.0, 1.0 / rate)
    seen = feed(times, helix(times), StreamConfig(observations=10, dt=dt)).observe(times[-1])
    assert len(seen.times) == 10
    np.testing.assert_allclose(np.diff(seen.times), dt, **tolerance("exact"))
    np.testing.assert_allclose(seen.positions, helix(seen.times), atol=error)


@pytest.mark.parametrize(("dt", "between"), [(0.1, 1), (0.2, 2), (0.25, 3), (0.05, 1)])
def test_predictors_find_theirs_among_the_positions(dt, between):
    """All that a window spans, a tenth of a second apart or less; every so many are the window itself."""
    prediction = PredictionConfig(dt=dt)
    times = np.arange(0.0, 4.0, 0.02)
    seen = feed(times, helix(times), StreamConfig.for_prediction(prediction)).observe(times[-1])
    assert len(seen.times) == 9 * between + 1
    np.testing.assert_allclose(np.diff(seen.times), dt / between, **tolerance("exact"))
    window = seen.newest(prediction.observations, dt)
    np.testing.assert_array_equal(window.times, seen.times[::between])
    np.testing.assert_array_equal(window.positions, seen.positions[::between])
    np.testing.assert_array_equal(seen.within(9 * dt).times, seen.times)
    assert len(seen.within(4 * dt).times) == 4 * between + 1
    assert len(seen.newest(prediction.observations, 0.77 * dt).times) == 1


def test_shuffled_and_repeated_samples_give_exactly_the_sorted_result():
    """3,000 random streams: random times, outliers, gaps; shuffled within the stream's memory, some sent twice."""
    rng = np.random.default_rng(0)
    for _ in range(3_000):
        count = int(rng.integers(1, 11))
        times = np.sort(rng.choice(60, count, replace=False)) * rng.choice([0.025, 0.01])
        positions = helix(times) + 0.01 * rng.standard_normal((count, 3))
        positions[rng.random(count) < 0.15] += rng.uniform(-4.0, 4.0, 3)
        order = np.concatenate([rng.permutation(count), rng.integers(count, size=rng.integers(0, 4))])
        shuffled = feed(times[order], positions[order], now=times[-1]).observe(times[-1])
        tidy = feed(times, positions, now=times[-1]).observe(times[-1])
        np.testing.assert_array_equal(shuffled.times, tidy.times)
        np.testing.assert_array_equal(shuffled.positions, tidy.positions)


def test_two_positions_for_one_instant_do_not_depend_on_the_order():
    times = [0.0, 0.1, 0.2, 0.2]
    positions = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.2, 0.0, 0.0], [0.21, 0.0, 0.0]])
    seen = [
        feed(np.array(times)[order], positions[order], now=1.0).observe(1.0) for order in ([0, 1, 2, 3], [3, 2, 1, 0])
    ]
    np.testing.assert_array_equal(seen[0].positions, seen[1].positions)


@pytest.mark.parametrize("interval", [0.0125, 0.05, 0.1])
@pytest.mark.parametrize("when", range(3, 20))
def test_a_single_jump_is_never_followed(interval, when):
    stream, times = ObservationStream(), interval * np.arange(40)
    rng = np.random.default_rng(when)
    for index, time in enumerate(times):
        direction = rng.standard_normal(3)
        jump = 1.7 * direction / np.linalg.norm(direction) if index == when else np.zeros(3)
        stream.add(time, helix(time) + jump, time)
        seen = stream.observe(time)
        assert np.abs(seen.positions - helix(seen.times)).max() < 0.01
        assert index != when or stream.outliers == 1


def test_a_single_jump_at_the_second_sample_is_not_followed():
    """The track has no velocity yet; at 10 Hz 1.7 m are more than the fastest target flies."""
    times = 0.1 * np.arange(12)
    positions = helix(times)
    positions[1] += [1.7, 0.0, 0.0]
    stream = ObservationStream()
    for time, position in zip(times, positions, strict=True):
        stream.add(time, position, time)
        seen = stream.observe(time)
        assert np.linalg.norm(seen.positions[-1] - helix(seen.times[-1])) < 0.01


@pytest.mark.parametrize("interval", [0.0125, 0.05, 0.1])
def test_a_real_jump_is_followed_within_four_samples(interval):
    times = interval * np.arange(60)
    positions = helix(times) + np.where(times[:, None] < times[30], 0.0, np.array([1.7, 0.0, 0.0]))
    stream = feed(times[:34], positions[:34])
    seen = stream.observe(times[33])
    np.testing.assert_allclose(seen.positions[-1], positions[33], **tolerance("formula"))
    assert seen.times[0] >= times[30] - 1e-9  # nothing from before the jump
    whole = feed(times, positions).observe(times[-1])
    np.testing.assert_allclose(whole.positions[-1], positions[-1], **tolerance("formula"))


def test_gaps_break_the_track_and_short_ones_are_bridged():
    times = 0.1 * np.arange(30)
    short = np.delete(times, [20, 21])
    seen = feed(short, helix(short)).observe(times[-1])
    assert len(seen.times) == 10
    assert np.abs(seen.positions - helix(seen.times)).max() < 0.02
    long = np.delete(times, range(15, 23))
    seen = feed(long, helix(long)).observe(times[-1])
    np.testing.assert_allclose(seen.times, times[-7:], **tolerance("formula"))


def test_silence_has_an_age():
    times = 0.1 * np.arange(20)
    stream = feed(times, helix(times))
    assert stream.observe(times[-1] + 0.7).age == pytest.approx(0.7)
    assert stream.observe(times[-1] - 0.1).age == 0.0
    assert ObservationStream().observe(1.0) is None


def test_what_cannot_be_taken_is_counted():
    stream = ObservationStream()
    stream.add(5.0, [0.0, 0.0, 1.0], 5.0)
    stream.add(5.0, [0.0, 0.0, 1.0], 5.1)
    stream.add(9.0, [0.0, 0.0, 1.0], 5.1)
    stream.add(5.1, [np.nan, 0.0, 1.0], 5.1)
    stream.add(np.inf, [0.0, 0.0, 1.0], 5.1)
    stream.add(1.0, [0.0, 0.0, 1.0], 5.1)
    assert stream.refused == {"not_finite": 2, "future": 1, "late": 1, "repeated": 1}
    assert len(stream.observe(5.1).times) == 1


@pytest.mark.parametrize("position", [[0.0, 1.0], np.zeros((1, 3)), np.zeros(())])
def test_a_position_of_another_shape_is_refused(position):
    with pytest.raises(InputError, match="shape"):
        ObservationStream().add(0.0, position, 0.0)


def test_the_memory_is_bounded():
    stream = feed(0.001 * np.arange(6000), np.zeros((6000, 3)))
    assert len(stream._times) <= 1502
    assert len(stream._steps) == len(stream._times)


@pytest.mark.parametrize("world", ["env1", "env2", "env3"])
def test_stored_targets_are_never_taken_for_outliers(world):
    """At the highest speed of the paper's range, observed at 10 Hz."""
    for name in stored_targets(world):
        target = load_target(name, world=world, speed=5.5)
        times = np.arange(0.0, target.duration, 0.1)
        stream = ObservationStream()
        for index, (time, position) in enumerate(zip(times, target.position(times), strict=True)):
            stream.add(time, position, time)
            if index % 10 == 9:  # an outlier is remembered for longer
                assert stream.outliers == 0, (name, time)


def test_interpolation_is_exact_for_parabolas_and_through_the_samples():
    rng = np.random.default_rng(0)
    times = np.sort(rng.uniform(0.0, 2.0, 9))
    coefficients = rng.standard_normal((3, 2))
    parabola = lambda t: np.stack([np.ones_like(t), t, t * t], axis=-1) @ coefficients  # noqa: E731
    at = rng.uniform(times[0], times[-1], 50)
    np.testing.assert_allclose(interpolate(times, parabola(times), at), parabola(at), **tolerance("exact"))
    values = rng.standard_normal((9, 2))
    np.testing.assert_allclose(interpolate(times, values, times), values, **tolerance("exact"))


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        (StreamConfig, {"dt": 0.0}),
        (StreamConfig, {"observations": 0}),
        (StreamConfig, {"future": -1.0}),
        (GateConfig, {"slack": np.nan}),
        (GateConfig, {"relock": 0}),
    ],
)
def test_bad_settings_are_refused(kind, wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        kind(**wrong)
