"""Plans flown in the model: what is followed, what is not, and that where the vehicle comes from counts."""

import dataclasses

import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.minsnap.single import minimum_snap
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.planner.rollouts import LOOKED_AT, Rollout, RolloutConfig, build_flyer, sampled
from jaxplan.planner.validator import Room
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.tracking.kernels.flight import fly
from jaxplan.tracking.kernels.step import POS, QUAT, VEL
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.result import held_error
from jaxplan.tracking.track import track
from jaxplan.vehicle.load import load_vehicle
from tolerances import assert_close

CONFIG = RolloutConfig()
VEHICLE = load_vehicle()
NOW = np.arange(-CONFIG.steps, 1) / CONTROL_RATE
LATER = np.arange(CONFIG.steps + 1) / CONTROL_RATE


@pytest.fixture(scope="module")
def flyer():
    return build_flyer(CONFIG, VEHICLE)


@pytest.fixture(scope="module")
def room():
    return Beyond((), np.array([[-20.0, -20.0, 0.0], [2.0, 20.0, 8.0]]))


class Beyond(Room):
    """Everything from x = 2 m on is solid."""

    def free_distance(self, points):
        return 2.0 - points[..., 0]


def along_x(coefficients, times):
    """References of a polynomial in time along x, 2 m high, heading ahead."""
    polynomial = np.polynomial.Polynomial(coefficients)
    rows = np.zeros((len(times), 5, 3))
    for order in range(5):
        rows[:, order, 0] = polynomial.deriv(order)(times) if order else polynomial(times)
    rows[:, 0, 2] = 2.0
    return FlatState(derivatives=rows, yaw=np.zeros((len(times), 3)))


def both(*flights):
    rows = {name: np.stack([getattr(flight, name) for flight in flights]) for name in ("derivatives", "yaw")}
    return FlatState(**rows)


def start(flyer, room, flown, aside=0.0):
    position, velocity = flown.pos[-1] + [0.0, aside, 0.0], flown.vel[-1]
    return Rollout(flyer, room, float(VEHICLE.radius), flown, position, velocity)


def test_a_gentle_plan_is_followed_and_keeps_its_distance(flyer, room):
    model = start(flyer, room, along_x([0.0], NOW))
    found = model.along(both(along_x([0.0, 0.0, 0.0, 0.0, 1.0], LATER)))
    assert found.followed[0]
    assert found.clear[0]
    assert found.error[0] < 0.05
    assert found.twist[0] < 0.05
    assert found.clearance[0] == pytest.approx(1.0, abs=0.05), "1 m of 2 are flown, towards the face of the box"


def test_a_plan_through_a_box_is_followed_and_not_clear(flyer, room):
    model = start(flyer, room, along_x([0.0, 2.0], NOW))
    found = model.along(both(along_x([0.0, 2.0, 0.5], LATER)))
    assert found.followed[0]
    assert not found.clear[0]
    assert found.clearance[0] < float(VEHICLE.radius)


def test_more_than_the_rotors_give_is_not_followed(flyer, room):
    model = start(flyer, room, along_x([0.0], NOW))
    found = model.along(both(along_x([0.0, 0.0, -30.0], LATER)))
    assert not found.followed[0]
    assert found.error[0] > 1.0


def test_it_counts_how_the_vehicle_came_there(flyer, room):
    """The same plan, from the same reference: followed after a steady flight, and not out of a turn of the thrust."""
    plan = both(along_x([0.0, -8.0, 7.0], LATER))
    steady = along_x([0.0, -8.0, 7.0], NOW)
    turned = along_x([0.0, -8.0, 7.0], NOW)
    before = NOW < -0.05
    turned.derivatives[before] = along_x([-0.0175, -7.3, 0.0], NOW).derivatives[before]
    turned.derivatives[before, 2:, 1] = 8.0 * np.array([1.0, 0.0, 0.0])
    turned.derivatives[before, 1, 1] = 8.0 * (NOW[before] + 0.05)
    turned.derivatives[before, 0, 1] = 4.0 * (NOW[before] + 0.05) ** 2
    after_steady, after_turn = (start(flyer, room, flown).along(plan) for flown in (steady, turned))
    assert after_steady.followed[0]
    assert after_turn.error[0] > after_steady.error[0] + 0.03


def test_it_begins_where_the_vehicle_is_measured(flyer, room):
    hover, ahead = along_x([0.0], NOW), both(along_x([0.0], LATER))
    found = start(flyer, room, hover, aside=0.4).along(ahead)
    assert found.error[0] == pytest.approx(0.4, abs=0.02)
    assert not found.followed[0], "0.4 m are more than is asked"
    alone = FlatState(derivatives=hover.derivatives[-1:], yaw=hover.yaw[-1:])
    once = start(flyer, room, alone, aside=0.4).along(ahead)
    assert once.error[0] == pytest.approx(found.error[0], abs=1e-3), "without what is remembered it begins at rest"


def test_errors_count_from_the_takeover_on(flyer, room):
    """Until then it is 0.4 m beside what is committed, and from then on where the plan is."""
    model = start(flyer, room, along_x([0.0], NOW), aside=0.4)
    plan = along_x([0.0], LATER)
    plan.derivatives[20:, 0, 1] = 0.4
    late, whole = model.along(both(plan), 20), model.along(both(plan))
    assert whole.error[0] == pytest.approx(0.4, abs=0.02)
    assert late.error[0] < 0.2


def test_many_are_flown_as_one_is(flyer, room):
    """More than a call takes, too."""
    model = start(flyer, room, along_x([0.0, 1.0], NOW))
    flights = [along_x([0.0, 1.0, share], LATER) for share in np.linspace(-3.0, 3.0, 70)]
    many = model.along(both(*flights))
    assert many.error.shape == (70,)
    for index in (0, 40, 69):
        one = model.along(both(flights[index]))
        for name in ("error", "twist", "clearance"):
            assert getattr(one, name)[0] == pytest.approx(getattr(many, name)[index], abs=1e-3)


def test_references_of_a_batch_are_those_of_its_splines():
    rng = np.random.default_rng(0)
    durations = np.where(np.arange(6)[:, None] < [[2, 3, 1]], rng.uniform(0.2, 0.5, (6, 3)), 0.0)
    position, yaw = rng.normal(size=(6, 10, 3, 3)), rng.normal(size=(6, 6, 1, 3))
    batch = SplineBatch(durations=durations, position=position, yaw=yaw)
    times = LATER - 0.1
    found = sampled(batch, times)
    for index in range(3):
        spline = batch.spline(index)
        assert isinstance(spline, PiecewisePolynomial)
        want = spline.state(np.maximum(times, 0.0))
        assert_close(found.derivatives[index][:, 0], want.pos, "formula", np.float32)
        assert_close(found.yaw[index][:, 0], want.yaw[:, 0], "formula", np.float32)


@pytest.mark.parametrize("name", ["seconds", "most_error", "most_twist"])
def test_limits_are_positive(name):
    with pytest.raises(InputError, match=name):
        RolloutConfig(**{name: 0.0})


def dash(seconds, turn=0.0):
    """Minimum snap to 4 m ahead, from rest to rest; the heading turns by ``turn`` within the first half."""
    way = np.array([[0.0, 0.0, 2.0], [2.0, 0.3, 2.0], [4.0, 0.0, 2.0]])
    found = minimum_snap(way, [seconds / 2, seconds / 2])
    yaw = np.zeros((2, 6))
    yaw[0, 1] = yaw[1, 0] = turn
    return PiecewisePolynomial(durations=found.durations, position=found.position, yaw=yaw)


@pytest.mark.parametrize("name", ["mfrl", *(pytest.param(name, marks=pytest.mark.slow) for name in ("racer5", "x500"))])
def test_a_whole_plan_is_followed_as_the_plant_follows_it(name):
    """Slow flights are, fast ones are not, and in between the plant with its noise agrees."""
    vehicle = load_vehicle(name)
    flyer = build_flyer(CONFIG, vehicle)
    flights = [dash(seconds) for seconds in (12.0, 6.0, 3.0, 2.0, 1.5, 1.2, 0.8)]
    errors = np.asarray(track(flights, vehicle=vehicle).max_position_error) / held_error(vehicle)
    followed = np.array([flyer.follows(flight) for flight in flights])
    assert followed[0]
    assert not followed[-1]
    assert (np.diff(followed.astype(int)) <= 0).all()
    assert (errors[followed] < 1.0).all()
    assert not followed[errors > 1.3].any()


def test_a_plan_whose_turn_about_body_z_is_lost_is_not_followed():
    strict, patient = (
        build_flyer(dataclasses.replace(CONFIG, whole_share=50.0, whole_twist=most), VEHICLE) for most in (0.4, 3.2)
    )
    assert strict.follows(dash(4.0, turn=0.1))
    assert not strict.follows(dash(4.0, turn=30.0))
    assert patient.follows(dash(4.0, turn=30.0))


def test_where_the_attitude_is_measured_the_model_is_turned_so(flyer, room):
    """About body z, too, which no acceleration tells: at rest, turned by 0.5 rad, the plan asks for it to turn back."""
    hover, ahead = along_x([0.0], NOW), both(along_x([0.0], LATER))
    turned = np.array([np.cos(0.25), 0.0, 0.0, np.sin(0.25)])
    place = hover.pos[-1], hover.vel[-1], np.zeros(3)
    blind, told = (Rollout(flyer, room, float(VEHICLE.radius), hover, *place, attitude=q) for q in (None, turned))
    assert blind.along(ahead).twist[0] == pytest.approx(0.0, abs=1e-3)
    assert told.along(ahead).twist[0] == pytest.approx(0.5, abs=0.02)


def test_it_goes_on_from_the_model_before(flyer, room):
    """Pushed by 0.2 m a tenth of a second ago and measured since: its filters and rates are those of who was pushed.

    Without the model before, it is taken to have come along the reference, at rest, and starts to turn late.
    """
    hover, ahead = along_x([0.0], NOW), along_x([0.0], LATER)
    pushed = start(flyer, room, hover, aside=0.2)
    steps = 20
    since = FlatState(derivatives=ahead.derivatives[: steps + 1], yaw=ahead.yaw[: steps + 1])
    rest = FlatState(derivatives=ahead.derivatives[steps:], yaw=ahead.yaw[steps:])
    flown = fly(flyer.craft, pushed._state, since.derivatives[None], since.yaw[None]).state[0]
    measured = flown[POS : POS + 3], flown[VEL : VEL + 3], None, flown[QUAT : QUAT + 4]
    going_on = Rollout(flyer, room, float(VEHICLE.radius), since, *measured, before=pushed)
    anew = Rollout(flyer, room, float(VEHICLE.radius), hover, *measured)
    whole = pushed.along(both(ahead)).positions[0, steps // LOOKED_AT :]
    found, other = (model.along(both(rest)).positions[0, : len(whole)] for model in (going_on, anew))
    assert_close(found, whole[: len(found)], "formula")
    assert np.abs(other - whole[: len(other)]).max() > 0.01
