"""The vehicle compiled for the host flies as the one that MJX steps, and samples splines as they are."""

import jax
import numpy as np
import pytest

from jaxplan.records import replace
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.tracking.kernels.craft import craft_of
from jaxplan.tracking.kernels.flight import fly, on_reference, reference_of
from jaxplan.tracking.kernels.sampling import references
from jaxplan.tracking.kernels.step import QUAT
from jaxplan.tracking.plant import PlantState
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.rollout import build_plant
from jaxplan.vehicle.heading import body_axes
from jaxplan.vehicle.load import load_vehicle
from oracles.layouts import LAYOUTS
from tolerances import assert_close

TIMES = np.arange(CONTROL_RATE + 1) / CONTROL_RATE


def reference(seed: int, size: float) -> FlatState:
    """A second of polynomials of degree 5 with derivatives of about ``size``, turning at 0.5 rad/s."""
    scales = size / np.array([1.0, 1.0, 2.0, 6.0, 24.0, 60.0])
    rows = np.zeros((len(TIMES), 5, 3))
    for axis in range(3):
        polynomial = np.polynomial.Polynomial(np.random.default_rng([seed, axis]).normal(size=6) * scales)
        for order in range(5):
            rows[:, order, axis] = (polynomial.deriv(order) if order else polynomial)(TIMES)
    yaw = np.stack([0.5 * TIMES, np.full(len(TIMES), 0.5), np.zeros(len(TIMES))], axis=1)
    return FlatState(derivatives=rows, yaw=yaw)


def row(state: PlantState) -> np.ndarray:
    """The plant's state as the compiled vehicle has it."""
    parts = (state.pos, state.vel, state.quat_wxyz, state.body_rates, state.rotor_speeds)
    return np.concatenate([np.ravel(leaf) for leaf in (*parts, state.signals.value, state.signals.rate)])


def vehicle_called(name: str):
    if name not in LAYOUTS:
        return load_vehicle(name)
    positions, spin = (np.array(part) for part in LAYOUTS[name])
    return replace(load_vehicle(), rotor_positions=positions, rotor_spin=spin)


@pytest.mark.parametrize("name", ["mfrl", "cf21", "racer5", "kite", "spins by sides"])
def test_it_flies_as_the_plant_does(name):
    """At the rotors' limits, too: the last flights ask for far more than there is."""
    vehicle = vehicle_called(name)
    plant, craft = build_plant(vehicle, noise=False), craft_of(vehicle)
    for seed, size in ((0, 0.5), (1, 4.0), (2, 9.0)):
        flight = reference(seed, size)
        start = plant.reset(jax.tree.map(lambda rows: rows[0], flight), jax.random.key(0))
        state = on_reference(craft, flight.derivatives[0], flight.yaw[0])
        scale = np.abs(row(start)).max()
        assert_close(state / scale, row(start) / scale, "formula", np.float32)
        _, log = plant.fly(start, flight)
        found = fly(craft, state, flight.derivatives[None], flight.yaw[None])
        off = np.abs(found.position[0] - np.asarray(log.pos)).max()
        assert off < 1e-5 * (1.0 + size**2), "float32 against float64, more where it is on its limits"
        assert found.error[0] == pytest.approx(float(np.max(log.position_error)), abs=1e-4 * (1.0 + size**2))
        assert found.twist[0] == pytest.approx(float(np.max(log.twist_error)), abs=1e-4 * (1.0 + size**2))


@pytest.mark.parametrize("name", ["mfrl", "x500", "kite"])
def test_a_vehicle_on_a_reference_is_on_that_reference(name):
    """But for how its thrust grows, and for snap and turning, which are taken to be 0."""
    craft, flight = craft_of(vehicle_called(name)), reference(3, 2.0)
    for instant in (0, 70, 200):
        wanted, yaw = flight.derivatives[instant], flight.yaw[instant]
        state = on_reference(craft, wanted, yaw)
        found, heading = reference_of(craft, state, float(yaw[0]) + 2.0 * np.pi)
        scale = np.abs(wanted).max()
        assert_close(found[:3] / scale, wanted[:3] / scale, "formula")
        assert_close(heading, [yaw[0] + 2.0 * np.pi, 0.0, 0.0], "formula")
        up = body_axes(state[QUAT : QUAT + 4])[2]
        assert_close(np.cross(up, found[3] - wanted[3]) / scale, np.zeros(3), "formula")
        assert (found[4] == 0.0).all()


def test_a_flight_in_two_parts_is_one_flight():
    craft, flight = craft_of(load_vehicle()), reference(1, 4.0)
    state = on_reference(craft, flight.derivatives[0], flight.yaw[0])
    whole = fly(craft, state, flight.derivatives[None], flight.yaw[None])
    first = fly(craft, state, flight.derivatives[None, :101], flight.yaw[None, :101])
    second = fly(craft, first.state[0], flight.derivatives[None, 100:], flight.yaw[None, 100:])
    assert_close(second.state, whole.state, "exact")
    assert_close(np.concatenate([first.position, second.position], axis=1), whole.position, "exact")
    assert whole.error[0] == max(first.error[0], second.error[0])


def test_errors_before_since_do_not_count():
    craft, flight = craft_of(load_vehicle()), reference(0, 0.5)
    state = on_reference(craft, flight.derivatives[0], flight.yaw[0])
    state[:3] += [0.5, 0.0, 0.0]
    rows, yaw = flight.derivatives[None], flight.yaw[None]
    assert fly(craft, state, rows, yaw).error[0] > 0.45
    assert fly(craft, state, rows, yaw, since=150).error[0] < 0.2
    assert np.isfinite(fly(craft, state, rows, yaw, since=10_000).error[0]), "at least the last instant counts"


def test_a_flight_that_is_not_finite_is_infinitely_far_and_spoils_no_other():
    craft, flight = craft_of(load_vehicle()), reference(0, 0.5)
    state = on_reference(craft, flight.derivatives[0], flight.yaw[0])
    rows, yaw = (np.stack([leaf, leaf, leaf]) for leaf in (flight.derivatives, flight.yaw))
    rows[1, 100, 2] = np.nan
    found = fly(craft, state, rows, yaw)
    assert np.isinf(found.error[1])
    assert np.isinf(found.twist[1])
    assert np.isfinite(found.position[1, :99]).all()
    assert not np.isfinite(found.position[1, -1]).any()
    assert found.error[0] == found.error[2] < 0.01


def test_splines_are_sampled_as_they_are():
    """Before their beginning, behind their end, on knots, and with padding, too."""
    rng = np.random.default_rng(3)
    durations = np.where(np.arange(6) < [[2], [6], [1]], rng.uniform(0.2, 0.5, (3, 6)), 0.0)
    position, yaw = rng.normal(size=(3, 6, 10, 3)), rng.normal(size=(3, 6, 6))
    times = np.concatenate([np.linspace(-0.2, 3.5, 60), np.cumsum(durations[1])])
    found = references(durations, position, yaw, times)
    for index in range(3):
        spline = PiecewisePolynomial(durations=durations[index], position=position[index], yaw=yaw[index])
        want = spline.state(times)
        scale = 1.0 + np.abs(want.derivatives).max(axis=0)
        assert_close(found.derivatives[index] / scale, np.asarray(want.derivatives) / scale, "exact")
        assert_close(found.yaw[index] / 1e3, np.asarray(want.yaw) / 1e3, "exact")
