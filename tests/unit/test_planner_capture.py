"""How soon plans are expected to capture the target, against closed forms and an evaluation by loops."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplan.errors import InputError
from jaxplan.minsnap.many import minimum_snap_batch
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.planner.capture import (
    MOTIONS,
    RETURN_SPEED,
    STEP,
    CaptureConfig,
    Prospect,
    capture_time,
    capture_times,
    prospect_of,
    straight_capture_times,
)
from jaxplan.planner.kernels.captures import SHARED
from jaxplan.prediction.futures import Futures
from jaxplan.records import replace
from jaxplan.spline import FlatState, PiecewisePolynomial, hover
from tolerances import assert_close, relative

CERTAIN = CaptureConfig(radius=0.3, correction=0.0)


def at_rest(*places: tuple[float, float, float], weights: tuple[float, ...] = ()) -> Futures:
    """Targets that stay where they are."""
    shares = np.array(weights or (1.0,) * len(places))
    return Futures(times=np.zeros(1), positions=np.array(places)[:, None], weights=shares / shares.sum())


def straight(velocity: tuple[float, float, float], duration: float = 4.0) -> PiecewisePolynomial:
    """From the origin, evenly."""
    position = np.zeros((1, 10, 3))
    position[0, 1] = np.array(velocity) * duration
    return PiecewisePolynomial(durations=np.array([duration]), position=position, yaw=np.zeros((1, 6)))


def batch(splines: list[PiecewisePolynomial]) -> SplineBatch:
    return SplineBatch(
        durations=np.stack([spline.durations for spline in splines], axis=-1),
        position=np.stack([spline.position for spline in splines], axis=-1),
        yaw=np.stack([np.asarray(spline.yaw)[:, :, None] for spline in splines], axis=-1),
    )


def wandering(rng: np.random.Generator, count: int) -> Futures:
    """Motions of random steps."""
    steps = rng.normal(scale=0.4, size=(count, 15, 3))
    times = -0.1 + 0.2 * np.arange(16)
    positions = np.pad(np.cumsum(steps, axis=1), ((0, 0), (1, 0), (0, 0))) + np.array([2.0, 0.0, 1.0])
    return Futures(times=times, positions=positions, weights=np.full(count, 1.0 / count))


def by_loops(prospect: Prospect, way: np.ndarray) -> float:
    """The expectation as its definition says, one future after another."""
    total = 0.0
    for motion, weight in zip(np.moveaxis(prospect.motions, 1, 0), prospect.weights, strict=True):
        beyond = np.linalg.norm(way - motion, axis=1) - prospect.reach
        inside = np.flatnonzero(beyond <= 0.0)
        if not len(inside):
            total += weight * (prospect.times[-1] + beyond[-1] / RETURN_SPEED)
        elif inside[0] > 0:
            before, after = beyond[inside[0] - 1], beyond[inside[0]]
            total += weight * (prospect.times[inside[0]] - STEP * (1.0 - before / (before - after)))
    return total


@pytest.mark.parametrize("speed", [1.5, 4.0, 9.0])
def test_a_target_at_rest_is_captured_when_the_way_to_it_but_for_the_radius_is_flown(speed: float) -> None:
    prospect = prospect_of(at_rest((2.9, 0.0, 0.0)), CERTAIN)
    assert capture_time(prospect, straight((speed, 0.0, 0.0))) == pytest.approx(2.6 / speed, **relative("formula"))


@pytest.mark.parametrize(("known", "until"), [(0.7, 2.0), (1.9, 2.0), (3.1, 3.1), (9.0, 4.0)])
def test_it_is_looked_as_far_ahead_as_the_target_is_predicted_within_bounds(known: float, until: float) -> None:
    times = np.array([0.0, known])
    moving = Futures(times=times, positions=times[None, :, None] * [[[0.0, 2.0, 0.0]]], weights=np.ones(1))
    prospect = prospect_of(moving, CERTAIN)
    assert prospect.times[-1] == pytest.approx(until, **relative("formula"))
    assert len(prospect.times) == len(prospect.motions) == len(prospect.reach)
    assert prospect.mean[-1, 1] == pytest.approx(2.0 * min(until, known), **relative("formula"))


def test_what_is_never_reached_counts_as_the_horizon_and_the_way_that_is_left() -> None:
    prospect = prospect_of(at_rest((0.0, 7.3, 0.0)), CERTAIN)
    time = capture_time(prospect, straight((1.0, 0.0, 0.0)))
    assert time == pytest.approx(2.0 + (np.hypot(2.0, 7.3) - 0.3) / RETURN_SPEED, **relative("formula"))


def test_a_correction_reaches_what_is_passed_at_a_distance() -> None:
    """1.3 m beside it at 0.5 s is too far; 0.3 m + 4 m/s^2 (t - 0.25 s)^2 is more than the distance a while later."""
    prospect = prospect_of(at_rest((2.0, 1.3, 0.0)), CaptureConfig(reaction=0.25, correction=8.0))
    times = np.linspace(0.0, 2.0, 200001)
    apart = np.hypot(2.0 - 4.0 * times, 1.3)
    reached = times[np.argmax(apart <= 0.3 + 4.0 * np.maximum(times - 0.25, 0.0) ** 2)]
    assert capture_time(prospect, straight((4.0, 0.0, 0.0))) == pytest.approx(reached, abs=2e-3)  # between instants
    assert capture_time(prospect_of(at_rest((2.0, 1.3, 0.0)), CERTAIN), straight((4.0, 0.0, 0.0))) > 2.0


def test_the_expectation_is_over_all_futures_by_their_weights() -> None:
    one, other = ((3.3, 0.0, 0.0), (0.3, 0.0, 0.0))
    flight = straight((3.0, 0.0, 0.0))
    prospect = prospect_of(at_rest(one, other, weights=(3.0, 1.0)), CERTAIN)
    assert capture_time(prospect, flight) == pytest.approx(0.75, **relative("formula"))


@given(seed=st.integers(0, 2**32 - 1), count=st.sampled_from([1, 3, 40, MOTIONS]))
def test_it_is_what_loops_over_futures_and_instants_give(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    prospect = prospect_of(wandering(rng, count), CaptureConfig(correction=float(rng.uniform(0.0, 6.0))))
    waypoints = np.cumsum(rng.normal(scale=0.8, size=(3, 3, 5)), axis=0)
    splines = minimum_snap_batch(waypoints, rng.uniform(0.2, 1.5, size=(2, 5))).splines
    times = capture_times(prospect, splines)
    for index in range(5):
        spline = splines.spline(index)
        way = spline.evaluate(np.minimum(prospect.times, float(spline.duration)))[:, :3]
        assert times[index] == pytest.approx(by_loops(prospect, way), **relative("formula"))
        assert times[index] == pytest.approx(capture_time(prospect, spline), **relative("formula"))
    some = capture_times(prospect, splines, np.array([3, 1]))
    assert_close(some[[3, 1]], times[[3, 1]], "exact")
    assert np.isnan(some[[0, 2, 4]]).all()


@given(seed=st.integers(0, 2**32 - 1))
def test_more_reach_never_captures_later(seed: int) -> None:
    rng = np.random.default_rng(seed)
    futures, flight = wandering(rng, 20), straight(tuple(rng.normal(size=3).tolist()))
    reaches = [(0.2, 0.0), (0.3, 0.0), (0.3, 2.0), (0.4, 5.0)]
    times = [
        capture_time(prospect_of(futures, CaptureConfig(radius=radius, correction=correction)), flight)
        for radius, correction in reaches
    ]
    assert all(after <= before + 1e-12 for before, after in itertools.pairwise(times))  # round-off


def test_while_what_was_expected_happens_the_time_falls_by_what_passes() -> None:
    """Without corrections, whose growth begins anew with each cycle."""
    target = at_rest((5.0, 0.0, 0.0))
    flight = straight((4.0, 0.0, 0.0))
    whole, rest = (capture_time(prospect_of(target, CERTAIN), flight, since) for since in (0.0, 0.3))
    assert whole - rest == pytest.approx(0.3, **relative("formula"))


def test_more_futures_than_are_looked_at_are_thinned_and_fewer_filled_up_without_weight() -> None:
    many, few = (prospect_of(wandering(np.random.default_rng(1), count), CERTAIN) for count in (500, 5))
    assert many.motions.shape == few.motions.shape == (len(many.times), MOTIONS, 3)
    assert many.weights.sum() == pytest.approx(1.0, **relative("exact"))
    assert (few.weights[5:] == 0.0).all()
    assert few.weights.sum() == pytest.approx(1.0, **relative("exact"))


def test_futures_without_weight_take_no_place() -> None:
    weights = np.zeros(500)
    weights[7] = 1.0
    futures = replace(wandering(np.random.default_rng(1), 500), weights=weights)
    alone = Futures(times=futures.times, positions=futures.positions[7:8], weights=np.ones(1))
    flight = straight((2.0, 0.0, 0.5))
    times = [capture_time(prospect_of(some, CERTAIN), flight) for some in (futures, alone)]
    assert times[0] == pytest.approx(times[1], **relative("exact"))


def test_futures_go_straight_between_their_instants_and_rest_beyond_them() -> None:
    futures = Futures(
        times=np.array([-0.2, 0.2]), positions=np.array([[[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]]]), weights=np.ones(1)
    )
    assert_close(futures.at(np.array([-1.0, 0.0, 0.1, 5.0]))[0, :, 0], [0.0, 2.0, 3.0, 4.0], "exact")


def test_goals_are_ordered_by_the_flights_straight_to_them_before_there_are_trajectories() -> None:
    target, state = (3.0, 0.0, 0.0), hover(np.zeros(3))
    goals = np.array([target, target, (0.0, 3.0, 0.0), (np.nan, 0.0, 0.0)])
    prospect = prospect_of(at_rest(target), CERTAIN)
    times = straight_capture_times(prospect, state, goals, np.array([1.0, 0.6, 0.6, 0.6]))
    assert times[1] < times[0] < times[2]
    assert np.isnan(times[3])
    moving = FlatState(derivatives=np.array([[0.0] * 3, [5.0, 0.0, 0.0], *[[0.0] * 3] * 3]), yaw=np.zeros(3))
    sooner = straight_capture_times(prospect, moving, goals[:1], np.array([0.6]))
    assert sooner[0] == pytest.approx(0.54, **relative("formula"))


def test_a_straight_flight_is_worth_what_its_way_is() -> None:
    rng, prospect = np.random.default_rng(5), prospect_of(wandering(np.random.default_rng(4), 40), CaptureConfig())
    position, velocity = rng.normal(size=(2, 3))
    goals, times = rng.normal(scale=2.0, size=(30, 3)), rng.uniform(-0.1, 2.0, 30)
    state = FlatState(derivatives=np.concatenate([[position, velocity], np.zeros((3, 3))]), yaw=np.zeros(3))
    found = straight_capture_times(prospect, state, goals, times)
    for k in range(30):
        whole = max(times[k], STEP)
        since = np.minimum(prospect.times, whole + 2.0 * STEP)[:, None]
        way = position + since * velocity + (since / whole) ** 2 * (goals[k] - position - velocity * whole)
        assert found[k] == pytest.approx(by_loops(prospect, way), **relative("formula"))


def test_many_straight_flights_are_worth_what_each_is() -> None:
    """Two cores share them."""
    rng, prospect, state = np.random.default_rng(6), prospect_of(at_rest((3.0, 0.0, 0.0)), CERTAIN), hover(np.zeros(3))
    goals, times = rng.normal(scale=2.0, size=(SHARED + 1, 3)), rng.uniform(0.1, 2.0, SHARED + 1)
    found = straight_capture_times(prospect, state, goals, times)
    parts = [straight_capture_times(prospect, state, goals[few], times[few]) for few in (slice(90), slice(90, None))]
    np.testing.assert_array_equal(found, np.concatenate(parts))


@pytest.mark.usefixtures("x64")
def test_positions_of_a_batch_are_those_of_each_spline() -> None:
    rng = np.random.default_rng(3)
    splines = minimum_snap_batch(rng.normal(size=(5, 3, 7)), rng.uniform(0.2, 1.5, size=(4, 7))).splines
    times = np.linspace(0.0, 8.0, 41)
    at = np.tile(times[:, None], (1, 7))
    traced = jax.tree.map(jnp.asarray, splines)
    for derivative in (0, 1):
        found = splines.positions(at, derivative)
        assert isinstance(found, np.ndarray)
        assert_close(traced.positions(jnp.asarray(at), derivative), found, "formula")
        for index in range(7):
            assert_close(found[..., index], splines.spline(index).evaluate(times, derivative)[:, :3], "formula")


@pytest.mark.parametrize(
    ("settings", "field"),
    [
        ({"radius": 0.0}, "radius"),
        ({"horizon": np.nan}, "horizon"),
        ({"horizon": 0.05}, "horizon"),
        ({"correction": -1.0}, "correction"),
        ({"gain": -0.1}, "gain"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, float], field: str) -> None:
    with pytest.raises(InputError, match=field):
        CaptureConfig(**settings)
