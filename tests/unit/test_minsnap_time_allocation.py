"""Time allocation against SciPy's optimiser, a published optimum, and what must hold of any optimum."""

import functools
import math

import jax
import numpy as np
import pytest
from scipy.optimize import minimize

import jaxplan
from jaxplan.errors import InputError
from jaxplan.minsnap.status import SolveStatus
from jaxplan.minsnap.time_allocation import TimeAllocationConfig, time_allocation
from jaxplan.vehicle.limits import rotor_limit_margin
from jaxplan.vehicle.load import load_vehicle
from tolerances import relative, tolerance


def random_waypoints(width=4, segments=5, seed=0):
    return np.random.default_rng(seed).uniform(0, 1, (segments + 1, 3, width)) * np.array([10.0, 10, 2])[:, None]


def smoothness(waypoints, durations, **options):
    return jaxplan.minimum_snap_batch(waypoints[..., None], durations[:, None], **options).cost[0]


def test_weighted_time_reaches_scipys_optimum():
    waypoints, initial = random_waypoints(), np.random.default_rng(1).normal(size=(4, 3, 4))
    found = time_allocation(waypoints, time_weight=500.0, initial=initial)
    assert (found.status == 0).all()
    for lane in range(4):

        def cost(logs, lane=lane):
            times = np.exp(logs)
            return np.log(smoothness(waypoints[..., lane], times, initial=initial[..., lane]) + 500.0 * times.sum())

        ours = np.log(found.durations[:, lane])
        assert math.exp(cost(ours)) == pytest.approx(found.cost[lane], **relative("formula"))
        best = minimize(cost, ours + 0.05, method="BFGS", options={"gtol": 1e-5})
        assert found.cost[lane] <= math.exp(best.fun) * (1.0 + 1e-4)


def test_at_rest_the_time_term_is_seven_times_the_smoothness():
    """d/d alpha of rho alpha T + alpha^-7 sigma is 0 at the optimum."""
    waypoints = random_waypoints()
    found = time_allocation(waypoints, time_weight=100.0, config=TimeAllocationConfig(tolerance=1e-10))
    time = 100.0 * found.durations.sum(axis=0)
    np.testing.assert_allclose(time, 7.0 * (found.cost - time), rtol=1e-3)


def test_fixed_total_time_is_kept_and_shared_best():
    waypoints = random_waypoints()
    found = time_allocation(waypoints, total_time=np.array([5.0, 6.0, 7.0, 8.0]))
    np.testing.assert_allclose(found.durations.sum(axis=0), [5, 6, 7, 8], **tolerance("exact"))
    rng = np.random.default_rng(2)
    for lane in range(4):
        for _ in range(20):
            moved = found.durations[:, lane] * np.exp(0.05 * rng.normal(size=5))
            moved *= found.durations[:, lane].sum() / moved.sum()
            assert smoothness(waypoints[..., lane], moved) > found.cost[lane] * (1.0 - 1e-4)


@pytest.mark.slow
def test_as_good_as_a_published_allocation(examples):
    rows = [line.strip() for line in (examples / "minsnap" / "mfrl_example.yaml").read_text().splitlines()]
    points = np.array([[float(v) for v in row[3:-1].split(",")] for row in rows if row.startswith("- [")])[:, :3]
    line = next(row for row in rows if row.startswith("t_set"))
    published = np.array([float(v) for v in line[line.index("[") + 1 : -1].split(",")])
    found = time_allocation(points[..., None], total_time=published.sum(), config=TimeAllocationConfig(tolerance=1e-8))
    assert found.cost[0] <= 1.0001 * smoothness(points, published)


MARGIN = functools.partial(rotor_limit_margin, load_vehicle())
margins = jax.jit(jax.vmap(MARGIN))


@pytest.mark.slow
@pytest.mark.parametrize("moving", [False, True])
def test_minimum_time_is_feasible_and_cannot_be_shortened(moving):
    waypoints = random_waypoints(6, 3)
    initial = np.random.default_rng(4).normal(size=(4, 3, 6)) if moving else np.zeros((4, 3, 6))
    found = time_allocation(waypoints, margin=MARGIN, initial=initial)
    assert (found.status == 0).all()

    def inside(durations, lane):
        spline = jaxplan.minimum_snap(waypoints[..., lane], durations, initial=initial[..., lane])
        states = spline.state(np.linspace(0.0, float(spline.duration), TimeAllocationConfig().instants))
        return bool((margins(states) >= -1.0).all())

    for lane in range(2):
        assert inside(found.durations[:, lane], lane)
        assert not inside(0.97 * found.durations[:, lane], lane)


@pytest.mark.slow
def test_mixed_lengths_and_a_bad_lane_do_not_disturb_the_others():
    waypoints, counts = random_waypoints(4), np.array([5, 3, 1, 5])
    alone = [
        time_allocation(waypoints[: n + 1, :, lane : lane + 1], time_weight=100.0) for lane, n in enumerate(counts[:3])
    ]
    waypoints[4:, :, 1], waypoints[2:, :, 2] = np.nan, np.nan
    waypoints[2, 0, 3] = np.nan
    found = time_allocation(waypoints, time_weight=100.0, segments=counts)
    assert found.status.tolist() == [0, 0, 0, SolveStatus.NONFINITE]
    assert np.isinf(found.cost[3])
    assert not found.durations[:, 3].any()
    for lane, single in enumerate(alone):
        assert found.cost[lane] == pytest.approx(single.cost[0], **relative("solve"))
        assert not found.durations[counts[lane] :, lane].any()


@pytest.mark.slow
def test_yaw_counts_towards_the_smoothness():
    waypoints = random_waypoints(1)
    yaw = np.linspace(0.0, 300.0, 6)[:, None]
    without = time_allocation(waypoints, time_weight=100.0)
    turning = time_allocation(waypoints, time_weight=100.0, yaw=yaw)
    assert turning.cost[0] > without.cost[0]
    assert turning.durations.sum() > without.durations.sum()


@pytest.mark.slow
def test_what_is_not_met_in_time_says_so():
    found = time_allocation(random_waypoints(), time_weight=100.0, config=TimeAllocationConfig(max_evaluations=2))
    assert (found.status == SolveStatus.NOT_CONVERGED).all()
    impossible = time_allocation(random_waypoints(2), margin=lambda state: -1.0 + 0.0 * state.derivatives[0, 0])
    assert (impossible.status & SolveStatus.INFEASIBLE).all()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "exactly one"),
        ({"time_weight": 1.0, "total_time": 2.0}, "exactly one"),
        ({"time_weight": -1.0}, "positive"),
        ({"total_time": np.array([1.0, np.nan, 1, 1])}, "positive"),
        ({"time_weight": 1.0, "segments": np.array([0, 1, 1, 1])}, "numbers from 1 to 5"),
        ({"time_weight": 1.0, "initial": np.zeros((3, 3))}, "initial has shape"),
        ({"time_weight": 1.0, "yaw": np.zeros(6)}, "yaw has shape"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(options, said):
    with pytest.raises(InputError, match=said):
        time_allocation(random_waypoints(), **options)
