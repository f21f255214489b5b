"""What short pieces of trajectories may do and ask, against dense sampling and NumPy's rotations."""

import itertools

import numpy as np
import pytest

import jaxplan
from jaxplan.planner.kernels.pieces import body_of, cut
from jaxplan.spline import PiecewisePolynomial
from jaxplan.vehicle.load import load_vehicle
from tests.tolerances import assert_close

COUNT = 16
VEHICLE = load_vehicle()
BODY = body_of(VEHICLE)


def flight(seed: int, turning: bool = True) -> PiecewisePolynomial:
    rng = np.random.default_rng(seed)
    waypoints, durations = np.cumsum(rng.normal(size=(5, 3)), axis=0), rng.uniform(0.3, 1.2, 4)
    found = jaxplan.minimum_snap(waypoints, durations, yaw=np.cumsum(rng.normal(scale=0.3, size=5)))
    yaw = np.asarray(found.yaw) if turning else None
    return PiecewisePolynomial(durations=durations, position=np.asarray(found.position), yaw=yaw)


def middles(spline: PiecewisePolynomial) -> np.ndarray:
    ends = np.concatenate([[0.0], np.cumsum(spline.durations)])
    return np.concatenate([a + (np.arange(COUNT) + 0.5) / COUNT * (b - a) for a, b in itertools.pairwise(ends)])


@pytest.mark.parametrize("seed", range(5))
def test_no_point_of_a_piece_is_farther_from_its_middle_or_slower_than_it_says(seed: int) -> None:
    spline, ahead = flight(seed), np.linspace(-0.5, 0.5, 101)
    pieces, _ = cut(spline, COUNT)
    lengths = np.repeat(np.asarray(spline.durations) / COUNT, COUNT)
    times = np.clip(middles(spline)[:, None] + lengths[:, None] * ahead, 0.0, float(spline.duration))
    points = spline.evaluate(times.ravel())[:, :3].reshape(*times.shape, 3)
    speeds = np.linalg.norm(spline.evaluate(times.ravel(), 1)[:, :3], axis=1).reshape(times.shape)
    assert_close(pieces.middle, points[:, 50], "formula")
    assert_close(pieces.speed, speeds[:, 50], "formula")
    away = np.linalg.norm(points - pieces.middle[:, None], axis=2).max(axis=1)
    assert (away <= pieces.moved + 1e-9).all()
    assert (pieces.moved <= 3.0 * away + 0.05).all()
    assert (speeds.min(axis=1) >= pieces.slowest - 1e-9).all()
    assert (pieces.slowest <= pieces.speed).all()


@pytest.mark.parametrize("seed", range(3))
def test_what_is_flown_is_left_out_but_never_the_last_piece(seed: int) -> None:
    spline = flight(seed)
    whole, _ = cut(spline, COUNT)
    since = 0.6 * float(spline.duration)
    half, _ = cut(spline, COUNT, since)
    assert_close(half.middle, whole.middle[-len(half.middle) :], "exact")
    assert np.searchsorted(middles(spline), since) - 1 <= len(whole.middle) - len(half.middle)
    for late in (float(spline.duration), np.inf):
        assert_close(cut(spline, COUNT, late)[0].middle, whole.middle[-1:], "exact")


@pytest.mark.parametrize("turning", [True, False])
def test_the_effort_is_that_of_attitudes_that_are_turned(turning: bool) -> None:
    """Attitudes along the trajectory, from its own derivatives, and their turn by central differences."""
    spline = flight(7, turning)
    step, times = 1e-4, middles(spline)
    attitudes, thrusts = zip(*(_attitude(spline, times + d * step) for d in (-1, 0, 1)), strict=True)
    rates = [_vee(np.swapaxes(a, 1, 2) @ b) / step for a, b in itertools.pairwise(attitudes)]
    rate, turning_rate = 0.5 * (rates[0] + rates[1]), (rates[1] - rates[0]) / step
    inertia, mass = np.asarray(VEHICLE.inertia, float), float(VEHICLE.mass)
    moment = inertia * turning_rate + np.cross(rate, inertia * rate)
    squared = np.concatenate([moment, mass * thrusts[1][:, None]], axis=1) @ BODY.shares.T
    least, most = BODY.squared
    outside = np.any((squared < least) | (squared > most), axis=1)
    lengths = np.repeat(np.asarray(spline.durations) / COUNT, COUNT)
    effort = cut(spline, COUNT, body=BODY)[1]
    whole = 4.0 * float(VEHICLE.thrust_coefficient) * most / mass
    assert 0.05 < float((outside * lengths).sum()) < 0.95 * float(spline.duration), "some are outside"
    assert effort.excess == pytest.approx(float((outside * lengths).sum()), abs=lengths.max())
    assert_close(effort.thrust, thrusts[1].max() / whole, "formula")
    assert_close(effort.least, thrusts[1].min() / float(VEHICLE.gravity), "formula")


def test_without_a_body_nothing_is_asked_of_it() -> None:
    assert tuple(cut(flight(0), COUNT)[1]) == (0.0, 1.0, 0.0)


def _attitude(spline: PiecewisePolynomial, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    velocity, acceleration = (spline.evaluate(times, order)[:, :3] for order in (1, 2))
    drag = float(VEHICLE.drag_coefficient) / float(VEHICLE.mass)
    force = acceleration + drag * np.linalg.norm(velocity, axis=1, keepdims=True) * velocity
    force += [0.0, 0.0, float(VEHICLE.gravity)]
    thrust = np.linalg.norm(force, axis=1)
    up = force / thrust[:, None]
    yaw = np.zeros(len(times)) if spline.yaw is None else spline.evaluate(times)[:, 3]
    forward = np.cross(np.stack([-np.sin(yaw), np.cos(yaw), 0.0 * yaw], axis=1), up)
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    return np.stack([forward, np.cross(up, forward), up], axis=2), thrust


def _vee(turn: np.ndarray) -> np.ndarray:
    skew = 0.5 * (turn - np.swapaxes(turn, 1, 2))
    return np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
