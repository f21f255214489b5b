"""The last look at a plan against dense sampling, the rotors of ``jaxplan.vehicle`` and plans spoilt in every way."""

import functools

import jax
import numpy as np
import pytest

import jaxplan
from jaxplan.errors import InputError
from jaxplan.planner.kernels.pieces import body_of
from jaxplan.planner.validator import Fault, Keep, Room, ValidatorConfig, validate
from jaxplan.precision import in_float64
from jaxplan.records import replace
from jaxplan.search.kernels.solids import solids_of
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.vehicle.limits import rotor_limit_margin
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.load import load_world

WAYPOINTS = np.array([[-4.3, -4.3, 1.0], [-4.2, -2.0, 1.1], [-4.0, 0.5, 1.0], [-4.1, 3.0, 1.2]])
VEHICLE = load_vehicle()
BODY = body_of(VEHICLE)
LEAST = Keep(float(VEHICLE.radius) + 0.1)


def plan(stretch: float = 1.0, waypoints: np.ndarray = WAYPOINTS) -> PiecewisePolynomial:
    """Along a wall of environment 1 and to rest, turning a little."""
    durations = stretch * np.array([0.8, 0.6, 0.9])
    found = jaxplan.minimum_snap(waypoints, durations, yaw=np.array([0.0, 0.3, 0.5, 0.5]))
    return PiecewisePolynomial(
        durations=np.asarray(found.durations), position=np.asarray(found.position), yaw=np.asarray(found.yaw)
    )


def room(name: str = "env1") -> Room:
    world = load_world(name)
    return Room(tuple(solids_of(world)), np.asarray(world.bounds, dtype=float))


def look(spline: PiecewisePolynomial, **options: object):  # type: ignore[no-untyped-def]
    return validate(spline, room(), BODY, LEAST, options.pop("config", ValidatorConfig()), **options)  # type: ignore[arg-type]


def test_a_good_plan_passes() -> None:
    spline = plan()
    assert look(spline, start=spline.state(0.0)).faults == Fault(0)


@pytest.mark.parametrize("since", [0.0, 1.0])
def test_the_clearance_is_a_bound_and_a_tight_one(since: float) -> None:
    spline = plan()
    times = np.linspace(since, float(spline.duration), 4000)
    dense = host_free_distance(load_world("env1"), spline.evaluate(times)[:, :3]).min()
    bound = look(spline, since=since).clearance
    assert dense - 0.1 < bound <= dense + 1e-6
    finer = look(spline, since=since, config=ValidatorConfig(pieces=512)).clearance
    assert dense - 0.01 < finer <= dense + 1e-6


def test_more_is_kept_where_it_is_faster() -> None:
    """Refused as soon as more is kept than there is beside the fast part, though what is kept at rest is there."""
    spline = plan()
    times = np.linspace(0.0, float(spline.duration), 4000)
    speed = np.linalg.norm(spline.evaluate(times, 1)[:, :3], axis=1)
    free = host_free_distance(load_world("env1"), spline.evaluate(times)[:, :3])
    for per_speed in (0.01, 0.03, 0.1, 0.3):
        keep = Keep(0.2, slow=1.0, per_speed=per_speed, most=0.6)
        spare = (free - keep.at(speed)).min()
        found = validate(spline, room(), BODY, keep, ValidatorConfig(pieces=256))
        assert abs(spare) > 0.02, "the case is clear"
        assert bool(found.faults & Fault.CLEARANCE) == (spare < 0.0)
        assert keep.wider(0.1).at(speed) == pytest.approx(keep.at(speed) + 0.1)


def test_the_time_out_of_the_rotors_range_is_that_of_their_speeds() -> None:
    """Without drag, which ``rotor_limit_margin`` does not know."""
    still = replace(VEHICLE, drag_coefficient=0.0)
    limited = in_float64(jax.jit(jax.vmap(functools.partial(rotor_limit_margin, still))))
    for stretch in (0.5, 0.6, 0.75, 1.5):
        spline = plan(stretch)
        times = np.linspace(0.0, float(spline.duration), 4001)
        states = spline.state(0.5 * (times[1:] + times[:-1]))
        margins = np.asarray(limited(FlatState(derivatives=states.derivatives, yaw=states.yaw)))
        expected = float((margins < 0.0).mean() * spline.duration)
        found = validate(spline, room(), body_of(still), LEAST, ValidatorConfig(pieces=256)).excess
        assert found == pytest.approx(expected, abs=0.03)


def moved(spline: PiecewisePolynomial, segment: int, power: int, by: float) -> PiecewisePolynomial:
    position = np.array(spline.position)
    position[segment, power, 0] += by
    return replace(spline, position=position)


def cut(spline: PiecewisePolynomial) -> PiecewisePolynomial:
    """All but the last segment."""
    return replace(spline, durations=spline.durations[:2], position=spline.position[:2], yaw=spline.yaw[:2])


SPOILT = {
    "a coefficient": (lambda s: moved(s, 1, 4, np.nan), Fault.NONFINITE),
    "no duration": (lambda s: replace(s, durations=0.0 * s.durations), Fault.NONFINITE),
    "a knot": (lambda s: moved(s, 1, 0, 1e-4), Fault.NOT_SMOOTH),
    "a velocity": (lambda s: moved(s, 2, 1, 1e-4), Fault.NOT_SMOOTH),
    "the end": (
        cut,
        Fault.NOT_AT_REST,
    ),
    "into a wall": (lambda s: moved(s, 0, 0, -1.5), Fault.CLEARANCE),
    "thrust": (lambda s: s.dilate(0.4), Fault.THRUST),
}


@pytest.mark.parametrize("what", SPOILT)
def test_a_spoilt_plan_is_refused(what: str) -> None:
    spoil, fault = SPOILT[what]
    assert fault in look(spoil(plan())).faults


def test_a_plan_that_begins_elsewhere_is_refused() -> None:
    spline = plan()
    state = spline.state(0.0)
    for order in range(4):
        derivatives = np.array(state.derivatives)
        derivatives[order, 1] += 1e-4
        found = look(spline, start=FlatState(derivatives=derivatives, yaw=state.yaw))
        assert found.faults == Fault.STARTS_ELSEWHERE


def test_limits_of_speed_and_of_rotors_are_those_of_the_configuration() -> None:
    fast = plan(0.75)
    assert Fault.SPEED in look(fast, config=ValidatorConfig(max_speed=3.0)).faults
    assert Fault.ROTORS in look(fast, config=ValidatorConfig(most_excess=0.05)).faults
    assert look(fast, config=ValidatorConfig(most_excess=2.0)).faults == Fault(0)


@pytest.mark.parametrize("climbs", [False, True])
def test_a_plan_that_nearly_falls_is_refused(climbs: bool) -> None:
    """Down and to rest, or up and to rest, ever faster, until less than a quarter of gravity is left."""
    heights = np.array([1.0, 2.5, 4.0]) if climbs else np.array([4.0, 2.5, 1.0])
    waypoints = np.column_stack([np.full((3, 2), -4.0), heights])
    times = np.linspace(0.0, 1.0, 4000)

    def least(stretch: float) -> tuple[PiecewisePolynomial, float]:
        spline = jax.tree.map(np.asarray, jaxplan.minimum_snap(waypoints, stretch * np.array([0.5, 0.5])))
        velocity, pull = (spline.evaluate(times * float(spline.duration), order)[:, :3] for order in (1, 2))
        drag = float(VEHICLE.drag_coefficient) / float(VEHICLE.mass)
        force = pull + drag * np.linalg.norm(velocity, axis=1, keepdims=True) * velocity + [0.0, 0.0, 9.81]
        return spline, float(np.linalg.norm(force, axis=1).min()) / 9.81

    config = ValidatorConfig(most_excess=10.0)
    for stretch in np.arange(3.0, 0.8, -0.05):
        spline, share = least(stretch)
        assert (Fault.FALLING in look(spline, config=config).faults) == (share < 0.33), share
        if share < 0.25:
            return
    pytest.fail("none of them falls")


def test_what_is_flown_already_does_not_count() -> None:
    """The first metre is inside a wall; from the second segment on the plan is clear."""
    waypoints = WAYPOINTS.copy()
    waypoints[0, 0] -= 1.5
    spline = plan(waypoints=waypoints)
    assert Fault.CLEARANCE in look(spline).faults
    assert Fault.CLEARANCE not in look(spline, since=float(spline.durations[0])).faults
    assert look(spline, since=np.inf).faults == look(spline, since=float(spline.duration)).faults == Fault(0)


@pytest.mark.parametrize("options", [{"pieces": 4}, {"max_speed": 0.0}, {"most_excess": -1.0}, {"least_thrust": -0.1}])
def test_wrong_settings_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(options))):
        ValidatorConfig(**options)  # type: ignore[arg-type]
