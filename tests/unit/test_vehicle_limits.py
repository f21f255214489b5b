"""The three answers of the feasibility check, against dense sampling."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplan
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.vehicle.flatness import differential_flatness
from jaxplan.vehicle.limits import (
    Feasibility,
    feasibility,
    rotor_feasibility,
    rotor_limit_margin,
    squared_speed_bounds,
    thrust_limit_margin,
)
from tolerances import tolerance


def trajectory(seed, pace, yaw_range=1.0):
    rng = np.random.default_rng(seed)
    waypoints = rng.uniform(0, 1, (5, 3)) * [10.0, 10, 2]
    durations = pace * np.linalg.norm(np.diff(waypoints, axis=0), axis=1) / 3.0 + 0.2
    return jaxplan.minimum_snap(waypoints, durations, yaw=yaw_range * rng.normal(size=5))


@jax.jit
def rotor_speeds(vehicle, states):
    return jax.vmap(lambda state: differential_flatness(vehicle, state).rotor_speeds)(states)


def demanded(vehicle, spline, times):
    with jax.enable_x64(True):
        return np.asarray(rotor_speeds(vehicle, spline.state(times)))


@pytest.mark.parametrize("name", ["mfrl", "flightgoggles"])
def test_answers_agree_with_dense_sampling_and_all_occur(name):
    vehicle, answers = jaxplan.load_vehicle(name), set()
    for seed in range(6):
        for pace in (0.5, 0.8, 1.0, 1.3, 2.0, 4.0):
            spline = trajectory(seed, pace)
            speeds = demanded(vehicle, spline, np.linspace(0.0, float(spline.duration), 3000))
            inside = (speeds >= vehicle.rotor_speed_min).all() and (speeds <= vehicle.rotor_speed_max).all()
            answer = rotor_feasibility(vehicle, spline)
            answers.add(answer)
            assert answer != Feasibility.FEASIBLE or inside
            assert answer != Feasibility.INFEASIBLE or not inside
    assert answers == set(Feasibility)


def test_the_bounds_hold_everywhere_on_each_piece(x64):
    vehicle, spline, pieces = jaxplan.load_vehicle(), trajectory(1, 1.5), 16
    low, high = jax.jit(squared_speed_bounds, static_argnums=2)(vehicle, spline, pieces)
    starts = np.cumsum(spline.durations) - spline.durations
    shares = np.linspace(0.0, 1.0, 12)
    for piece in range(pieces):
        times = starts[:, None] + spline.durations[:, None] * (piece + shares) / pieces
        speeds = demanded(vehicle, spline, times.ravel()).reshape(4, 12, 4)
        squares = np.sign(speeds) * speeds**2
        assert (squares >= np.asarray(low)[:, piece, None] - 1e-3).all()
        assert (squares <= np.asarray(high)[:, piece, None] + 1e-3).all()


def test_hovering_slowly_is_feasible_and_nan_is_not():
    vehicle = jaxplan.load_vehicle()
    still = PiecewisePolynomial(durations=np.ones(1), position=np.zeros((1, 10, 3)))
    assert rotor_feasibility(vehicle, still) == Feasibility.FEASIBLE
    broken = PiecewisePolynomial(durations=np.ones(1), position=np.full((1, 10, 3), np.nan))
    assert rotor_feasibility(vehicle, broken) == Feasibility.INFEASIBLE


def test_a_batch_equals_a_loop(x64):
    vehicle = jaxplan.load_vehicle()
    splines = [trajectory(seed, pace) for seed, pace in ((0, 0.5), (1, 1.3), (2, 4.0))]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *splines)
    codes = jax.jit(jax.vmap(lambda spline: feasibility(vehicle, spline, 64)))(stacked)
    assert codes.tolist() == [int(rotor_feasibility(vehicle, spline)) for spline in splines]


def test_the_share_of_thrust_has_the_sign_of_the_rotor_speed_and_a_slope_where_a_rotor_stands_still(x64):
    """The range of a rotor's thrust is that of its squared speed."""
    vehicle = jaxplan.load_vehicle()
    margins_of = jax.jit(jax.vmap(lambda s: (thrust_limit_margin(vehicle, s), rotor_limit_margin(vehicle, s))))
    for pace in (0.5, 1.0, 2.0):
        spline = trajectory(3, pace)
        times = np.linspace(0.0, float(spline.duration), 200)
        speeds = demanded(vehicle, spline, times)
        squares, least, most = np.sign(speeds) * speeds**2, vehicle.rotor_speed_min**2, vehicle.rotor_speed_max**2
        wanted = np.minimum(squares - least, most - squares).min(axis=1) / (most - least)
        found, least_speed = margins_of(spline.state(times))
        np.testing.assert_allclose(found, wanted, **tolerance("formula"))
        np.testing.assert_array_equal(found >= 0.0, least_speed >= 0.0)
    falling = FlatState(derivatives=jnp.zeros((5, 3)).at[2, 2].set(-9.81), yaw=jnp.zeros(3))
    slope = jax.jit(jax.grad(lambda rise: thrust_limit_margin(vehicle, add_thrust(falling, rise))))(0.0)
    assert np.isfinite(slope)


def add_thrust(state, rise):
    return FlatState(derivatives=state.derivatives.at[2, 2].add(rise), yaw=state.yaw)
