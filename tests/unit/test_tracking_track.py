"""Batches of flights: labels, lengths, order, seeds, bad neighbours, and what the caller is told."""

import jax
import numpy as np
import pytest
from compilations import CompilationCounter
from hypothesis import given, strategies

import jaxplan
from jaxplan.errors import InputError
from jaxplan.minsnap.single import minimum_snap
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.records import replace
from jaxplan.spline import PiecewisePolynomial, hover
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.references import duration_of_each, padded, references_at
from jaxplan.tracking.result import SUCCESS, TRAINING, Flaw, Thresholds, TrackingResult
from jaxplan.tracking.rollout import build_plant
from jaxplan.tracking.track import FLIGHTS_AT_ONCE, TrackConfig, track
from jaxplan.vehicle.load import load_vehicle
from tolerances import tolerance


def random_spline(rng: np.random.Generator, speed: float) -> PiecewisePolynomial:
    """Rest to rest through 2 or 5 random points at about ``speed`` m/s; each number of points compiles for seconds."""
    waypoints = np.cumsum(rng.uniform(-2.0, 2.0, (rng.choice([2, 5]), 3)), axis=0)
    yaw = np.cumsum(rng.uniform(-0.3, 0.3, len(waypoints)))
    return minimum_snap(waypoints, np.linalg.norm(np.diff(waypoints, axis=0), axis=1) / speed + 0.2, yaw=yaw)


def spoiled(spline: PiecewisePolynomial) -> PiecewisePolynomial:
    return replace(spline, position=np.where(spline.position == spline.position[0, 4, 0], np.nan, spline.position))


@pytest.fixture(scope="module")
def splines() -> list[PiecewisePolynomial]:
    rng = np.random.default_rng(0)
    return [random_spline(rng, speed) for speed in rng.uniform(1.0, 6.0, FLIGHTS_AT_ONCE + 10)]


@pytest.fixture(scope="module")
def result(splines: list[PiecewisePolynomial]) -> TrackingResult:
    return track(splines)


FIELDS = ("max_position_error", "max_yaw_error", "time_of_first_violation", "peak_rotor_speed", "saturation_share")


def test_equals_a_single_flight_through_the_plant(splines: list[PiecewisePolynomial], result: TrackingResult) -> None:
    plant, seconds = build_plant(load_vehicle()), 3
    times = np.arange(seconds * CONTROL_RATE + 1) / CONTROL_RATE
    index = int(np.flatnonzero((result.duration > seconds) & result.feasible)[0])
    references = splines[index].state(times)
    key = jax.random.fold_in(jax.random.key(0), index)
    _, log = plant.fly(plant.reset(jax.tree.map(lambda rows: rows[0], references), key), references)
    position, yaw = np.asarray(log.position_error), np.asarray(log.yaw_error)
    thresholds = Thresholds(position=float(np.max(position)) * 0.7, yaw=float(np.max(yaw)) * 0.7)
    cut = track([splines[index]], config=TrackConfig(thresholds=thresholds), indices=np.array([index]))
    first = (np.argmax(~((position < thresholds.position) & (yaw < thresholds.yaw))) + 1) / CONTROL_RATE
    assert cut.time_of_first_violation[0] == pytest.approx(first, abs=0.011)  # rounding may shift it by two steps
    assert cut.max_position_error[0] >= np.max(position) - 1e-4
    assert not cut.feasible[0]
    assert result.peak_rotor_speed[index] >= np.max(log.rotor_speeds) - 1.0


def test_order_batch_size_and_neighbours_change_nothing(
    splines: list[PiecewisePolynomial], result: TrackingResult, compilations: CompilationCounter
) -> None:
    order = np.random.default_rng(1).permutation(len(splines))[:40]
    shuffled = track([*(splines[i] for i in order), spoiled(splines[0])], indices=np.append(order, 0))
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(shuffled, name)[:40], getattr(result, name)[order], err_msg=name)
    np.testing.assert_array_equal(shuffled.reasons[:40], result.reasons[order])
    assert shuffled.reasons[40] == Flaw.NONFINITE
    assert compilations.count <= 1  # reading the keys back; no new program flies


def test_splines_without_yaw_keep_the_heading_zero(splines: list[PiecewisePolynomial]) -> None:
    bare = replace(splines[0], yaw=None)
    level = replace(splines[0], yaw=np.zeros_like(splines[0].yaw))
    found, expected = track([bare]), track([level])
    np.testing.assert_array_equal(found.max_position_error, expected.max_position_error)


def test_the_seed_matters_and_noise_can_be_left_out(splines: list[PiecewisePolynomial]) -> None:
    some = splines[:3]
    other = track(some, config=TrackConfig(seed=1))
    assert np.all(other.max_position_error != track(some).max_position_error)
    with pytest.raises(InputError, match="seed"):
        TrackConfig(seed=-1)


def test_labels_follow_from_errors_and_are_monotone(result: TrackingResult) -> None:
    assert 0.1 < np.mean(result.feasible) < 0.9
    np.testing.assert_array_equal(result.labels(TRAINING), result.feasible)
    np.testing.assert_array_equal(np.isfinite(result.time_of_first_violation), ~result.feasible)
    assert np.all(result.labels(SUCCESS) >= result.labels(TRAINING))
    counts = result.count_reasons()
    assert set(counts) <= {"position", "yaw", "diverged"}
    assert counts["position"] == np.count_nonzero(~(result.max_position_error < TRAINING.position))
    assert np.all(result.peak_rotor_speed <= load_vehicle().rotor_speed_max + 0.1)
    assert np.all((result.saturation_share >= 0.0) & (result.saturation_share <= 1.0))


@given(
    strategies.floats(1e-3, 5.0), strategies.floats(1e-3, 5.0), strategies.floats(1e-3, 3.1), strategies.floats(1e-3, 3)
)
def test_labels_are_monotone_in_each_threshold(a: float, b: float, c: float, d: float) -> None:
    rng = np.random.default_rng(0)
    numbers = rng.exponential(1.0, (2, 200))
    numbers[0, :3] = np.inf
    blank = np.zeros(200)
    result = TrackingResult(
        max_position_error=numbers[0],
        max_yaw_error=numbers[1],
        time_of_first_violation=blank,
        peak_rotor_speed=blank,
        saturation_share=blank,
        duration=blank,
        feasible=blank > 0,
        reasons=blank.astype(np.uint32),
    )
    tight, loose = sorted([a, b]), sorted([c, d])
    for yaw in loose:
        narrow, wide = (result.labels(Thresholds(position=position, yaw=yaw)) for position in tight)
        assert np.all(wide >= narrow)
    for position in tight:
        narrow, wide = (result.labels(Thresholds(position=position, yaw=yaw)) for yaw in loose)
        assert np.all(wide >= narrow)


def test_flights_that_cannot_be_flown_get_their_reasons(splines: list[PiecewisePolynomial]) -> None:
    huge = replace(splines[0], position=splines[0].position * 1e30)
    long = splines[0].dilate(101.0 / splines[0].duration)
    negative = replace(splines[0], durations=-splines[0].durations)
    still = replace(splines[0], durations=splines[0].durations * 0.0)
    result = track([splines[1], huge, long, negative, still, spoiled(splines[2])])
    assert result.reasons[1] == Flaw.DIVERGED | Flaw.POSITION | Flaw.YAW
    assert [Flaw(int(bits)) for bits in result.reasons[2:]] == [
        Flaw.DURATION,
        Flaw.NONFINITE,
        Flaw.DURATION,
        Flaw.NONFINITE,
    ]
    assert result.max_position_error[0] == track([splines[1]]).max_position_error[0]
    assert np.all(np.isinf(result.max_position_error[1:]))
    assert not np.any(result.feasible[1:])


def test_the_planners_batch_equals_its_splines_one_by_one(splines: list[PiecewisePolynomial]) -> None:
    chosen = splines[:6]
    rows = padded(chosen, np.arange(6))
    batch = SplineBatch(
        durations=np.moveaxis(rows.durations, 0, -1),
        position=np.moveaxis(rows.position, 0, -1),
        yaw=np.moveaxis(rows.yaw[:, :, :, None], 0, -1),
    )
    np.testing.assert_allclose(duration_of_each(batch), duration_of_each(chosen))
    np.testing.assert_array_equal(track(batch).max_position_error, track(chosen).max_position_error)


def test_references_are_those_of_the_splines(splines: list[PiecewisePolynomial]) -> None:
    times = np.linspace(0.0, 3.0, 50)
    sampled = references_at(padded(splines, np.array([3, 7])), times)
    for row, index in enumerate((3, 7)):
        state = splines[index].state(times)
        np.testing.assert_allclose(sampled.derivatives[row], state.derivatives, **tolerance("exact", np.float32))
        np.testing.assert_allclose(sampled.yaw[row], state.yaw, **tolerance("solve"))


def test_a_start_beside_the_trajectory_is_flown_and_one_far_away_refused(splines: list[PiecewisePolynomial]) -> None:
    slow = splines[0].dilate(3.0)
    begin = slow.evaluate(np.array(0.0))
    beside = track([slow], start=hover(begin[:3] + np.array([0.15, 0.0, 0.0]), yaw=begin[3]))
    assert 0.1 < beside.max_position_error[0] < 0.2
    with pytest.raises(InputError, match=r"trajectory 0 begins 1\.00 m.*0\.20 m"):
        track([slow], start=hover(begin[:3] + np.array([0.0, 0.0, 1.0])))


def test_bad_arguments_are_named(splines: list[PiecewisePolynomial]) -> None:
    with pytest.raises(InputError, match="splines: the spline"):
        track(spoiled(splines[0]))
    with pytest.raises(InputError, match="at least one"):
        track([])
    with pytest.raises(InputError, match="at least one"):
        track([np.zeros(3)])  # type: ignore[list-item]
    with pytest.raises(InputError, match="indices"):
        track(splines[:2], indices=np.array([0, -1]))
    with pytest.raises(InputError, match="position"):
        Thresholds(position=0.0)
    with pytest.raises(InputError, match="yaw"):
        Thresholds(yaw=4.0)
    assert jaxplan.track is track
