"""The speed profile against integrated motion, and against what it promises of speeds at bends."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.arrival import sped_up
from jaxplan.errors import InputError
from jaxplan.policy.speed_profile import LEAST_SPEED, speed_profile_policy
from jaxplan.spline import FlatStateBatch
from tolerances import tolerance

ACCELERATION = 6.0


def at_speed(velocity):
    derivatives = np.zeros((5, 3, 1))
    derivatives[1, :, 0] = velocity
    return FlatStateBatch(derivatives=derivatives, yaw=np.zeros((3, 1)))


def allot(points, velocity, count=None, acceleration=ACCELERATION):
    """Durations for one sequence."""
    policy = speed_profile_policy(acceleration)
    waypoints = np.asarray(points, float)[..., None]
    with jax.enable_x64(True):
        context = policy.encode(waypoints, np.array([count or len(points)]))
        return np.asarray(policy.decode(context, at_speed(velocity)))[:, 0]


def by_steps(points, speed, acceleration=ACCELERATION, steps=20000):
    """The oracle: limits of speed at fine steps of the way, passed forwards and backwards, then integrated."""
    points = np.asarray(points, float)
    edges = np.diff(points, axis=0)
    lengths = np.linalg.norm(edges, axis=1)
    way = np.linspace(0.0, lengths.sum(), steps + 1)
    limit = np.full(steps + 1, np.inf)
    limit[0], limit[-1] = speed, 0.0
    corners = np.cumsum(lengths)
    for before, after, place in zip(edges[:-1], edges[1:], corners[:-1], strict=True):
        angle = np.arccos(np.dot(before, after) / np.linalg.norm(before) / np.linalg.norm(after))
        radius = 0.5 * min(np.linalg.norm(before), np.linalg.norm(after)) / np.tan(0.5 * angle)
        limit[np.argmin(np.abs(way - place))] = np.sqrt(acceleration * radius)
    step = way[1]
    for i in range(1, steps + 1):
        limit[i] = min(limit[i], np.sqrt(limit[i - 1] ** 2 + 2.0 * acceleration * step))
    for i in range(steps - 1, -1, -1):
        limit[i] = min(limit[i], np.sqrt(limit[i + 1] ** 2 + 2.0 * acceleration * step))
    times = np.concatenate([[0.0], np.cumsum(2.0 * step / (limit[:-1] + limit[1:]))])
    return np.diff(np.interp(np.concatenate([[0.0], corners]), way, times))


ZIGZAG = [[0, 0, 0], [4, 0, 0], [7, 2, 0], [7, 5, 1], [12, 5, 1]]


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_times_are_those_of_the_profile_integrated_in_small_steps(speed):
    found = allot(ZIGZAG, [speed, 0.0, 0.0])
    np.testing.assert_allclose(found, by_steps(ZIGZAG, speed), rtol=2e-3)


def test_a_straight_way_from_rest_is_full_acceleration_and_full_braking():
    """d = a t^2 / 4, with as good as no speed at the start."""
    assert allot([[0, 0, 0], [6, 0, 0]], [0, 0, 0]).item() == pytest.approx(
        2.0 * np.sqrt(6.0 / ACCELERATION), abs=LEAST_SPEED / ACCELERATION
    )


def test_padding_takes_no_time_and_changes_nothing():
    padded = ZIGZAG + [ZIGZAG[-1]] * 3
    found = allot(padded, [2, 0, 0], count=len(ZIGZAG))
    np.testing.assert_allclose(found[:4], allot(ZIGZAG, [2, 0, 0]), **tolerance("exact"))
    assert not found[4:].any()


def test_a_first_segment_too_short_to_brake_is_flown_at_the_mean_of_its_speeds():
    """10 m/s, a right angle after 1 m and 1 m behind it: the bend allows sqrt(a / 2) at the end of the first."""
    found = allot([[0, 0, 0], [1, 0, 0], [1, 1, 0]], [10, 0, 0])
    assert found[0] == pytest.approx(2.0 / (10.0 + np.sqrt(0.5 * ACCELERATION)))


def test_scaled_it_is_the_profile_of_a_smaller_acceleration_from_the_same_speed():
    """alpha pi(alpha D) with a is pi(D) with a / alpha^2."""
    alpha = 1.7
    policy = speed_profile_policy(ACCELERATION)
    with jax.enable_x64(True):
        context = policy.encode(np.asarray(ZIGZAG, float)[..., None], np.array([5]))
        scaled = alpha * np.asarray(policy.decode(context, sped_up(at_speed([3, 1, 0]), jnp.array([alpha]))))[:, 0]
    np.testing.assert_allclose(
        scaled, allot(ZIGZAG, [3, 1, 0], acceleration=ACCELERATION / alpha**2), **tolerance("formula")
    )


def test_coincident_and_reversing_waypoints_have_finite_times():
    found = allot([[0, 0, 0], [0, 0, 0], [2, 0, 0], [0, 0, 0]], [-3, 1, 0])
    assert np.isfinite(found).all()
    assert (found > 0.0).all()


@pytest.mark.parametrize("acceleration", [0.0, -1.0, float("nan"), float("inf")])
def test_an_acceleration_that_makes_no_sense_is_refused(acceleration):
    with pytest.raises(InputError, match="acceleration"):
        speed_profile_policy(acceleration)
