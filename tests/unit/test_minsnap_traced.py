"""``minimum_snap`` inside transformations, batches that come first, and vehicles that compile nothing anew."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplan
from jaxplan.errors import InputError
from jaxplan.minsnap.minimum_time import margin_of_vehicle
from jaxplan.minsnap.time_allocation import TimeAllocationConfig
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import hover_speeds
from tolerances import relative, tolerance

RNG = np.random.default_rng(5)
POINTS, TIMES = RNG.uniform(-3.0, 3.0, (4, 3)), RNG.uniform(0.5, 1.5, 3)
INITIAL, YAW = RNG.normal(size=(4, 3)), RNG.uniform(-2.0, 2.0, 4)
ENDS = [
    {},
    {"initial": INITIAL, "yaw": YAW},
    {"terminal": "free", "initial_yaw": np.array([0.3, -0.2])},
    {"terminal": INITIAL[:3], "fixed_order": 3},
]


@pytest.mark.parametrize("options", ENDS, ids=lambda options: ",".join(options) or "rest")
def test_jit_gives_what_the_host_gives(x64, options):
    wanted = jaxplan.minimum_snap(POINTS, TIMES, **options)
    found = jax.jit(lambda points, times: jaxplan.minimum_snap(points, times, **options))(POINTS, TIMES)
    np.testing.assert_allclose(found.position, wanted.position, **tolerance("solve"))
    assert (found.yaw is None) == (wanted.yaw is None)
    if wanted.yaw is not None:
        np.testing.assert_allclose(found.yaw, wanted.yaw, **tolerance("solve"))
    np.testing.assert_allclose(found.evaluate(0.7), wanted.evaluate(0.7), **tolerance("solve"))


def test_without_64_bit_types_it_is_solved_in_them_all_the_same():
    wanted = jaxplan.minimum_snap(POINTS, TIMES)
    found = jax.jit(jaxplan.minimum_snap)(jnp.float32(POINTS), jnp.float32(TIMES))
    assert found.position.dtype == jnp.float32
    np.testing.assert_allclose(found.position, wanted.position, rtol=0.0, atol=1e-4)  # of arguments in float32


def test_vmap_is_a_loop_and_a_bad_lane_is_nan(x64):
    points = np.stack([POINTS, 2.0 * POINTS, POINTS[::-1], POINTS])
    times = np.stack([TIMES, TIMES[::-1], 2.0 * TIMES, TIMES])
    times[3, 1] = -1.0
    found = jax.vmap(jaxplan.minimum_snap)(points, times)
    for lane in range(3):
        alone = jaxplan.minimum_snap(points[lane], times[lane])
        np.testing.assert_allclose(found.position[lane], alone.position, **tolerance("solve"))
    assert np.isnan(found.position[3]).all()


@pytest.mark.parametrize("wide", [True, False])
def test_the_gradient_is_that_of_finite_differences(wide):
    def height(points, times):
        return jaxplan.minimum_snap(points, times).evaluate(1.1)[2]

    with jax.enable_x64(wide):
        slopes = jax.grad(height, argnums=(0, 1))(jnp.asarray(POINTS), jnp.asarray(TIMES))
    step = 1e-5
    for slope, at in zip(slopes, (POINTS, TIMES), strict=True):
        for index in [(1, 2), (3, 0)] if at.ndim == 2 else [(0,), (2,)]:
            moved = [at.copy(), at.copy()]
            for sign, array in zip((1.0, -1.0), moved, strict=True):
                array[index] += sign * step
            pairs = [(m, TIMES) if at is POINTS else (POINTS, m) for m in moved]
            wanted = (height(*pairs[0]) - height(*pairs[1])) / (2.0 * step)
            assert float(slope[index]) == pytest.approx(wanted, rel=1e-4, abs=1e-5)  # float32 arguments in one case


@pytest.mark.parametrize(
    ("points", "times", "options", "said"),
    [
        (POINTS[:, :2], TIMES, {}, "waypoints have shape"),
        (POINTS, TIMES[:2], {}, "durations has shape"),
        (POINTS, TIMES, {"initial": INITIAL[:2]}, "initial has shape"),
        (POINTS, TIMES, {"yaw": YAW[:2]}, "yaw has shape"),
        (POINTS, TIMES, {"terminal": "stop"}, "terminal is 'stop'"),
    ],
)
def test_shapes_are_refused_while_tracing(points, times, options, said):
    with pytest.raises(InputError, match=said):
        jax.jit(lambda p, t: jaxplan.minimum_snap(p, t, **options))(points, times)


def test_a_batch_that_comes_first_is_one_that_comes_last():
    rng = np.random.default_rng(2)
    points, times, initial = rng.uniform(-3, 3, (7, 4, 3)), rng.uniform(0.5, 1.5, (7, 3)), rng.normal(size=(7, 4, 3))
    yaw, rates = rng.uniform(-1, 1, (7, 4)), np.array([0.1, 0.2])
    last = jaxplan.minimum_snap_batch(
        *(np.moveaxis(a, 0, -1) for a in (points, times)),
        initial=np.moveaxis(initial, 0, -1),
        terminal=np.moveaxis(initial, 0, -1),
        yaw=yaw.T,
        initial_yaw=rates,
    )
    options = {"initial": initial, "terminal": initial, "yaw": yaw, "initial_yaw": rates, "batch_axis": 0}
    first = jaxplan.minimum_snap_batch(points, times, **options)
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(last), strict=True):
        np.testing.assert_array_equal(one, other)
    alone = jaxplan.minimum_snap(
        points[5], times[5], initial=initial[5], terminal=initial[5], yaw=yaw[5], initial_yaw=rates
    )
    np.testing.assert_allclose(first.splines.spline(5).position, alone.position, **tolerance("solve"))
    slopes = jax.grad(lambda t: jaxplan.minimum_snap_batch(points, t, batch_axis=0).cost.sum())(jnp.asarray(times))
    assert slopes.shape == times.shape
    with pytest.raises(InputError, match="batch_axis is 1"):
        jaxplan.minimum_snap_batch(points, times, batch_axis=1)
    with pytest.raises(InputError, match="waypoints have shape"):
        jaxplan.minimum_snap_batch(points[0], times, batch_axis=0)


QUICK = TimeAllocationConfig(max_evaluations=4, rounds=1, bisections=4, instants=32)


def test_durations_of_a_batch_that_comes_first():
    points, yaw = np.random.default_rng(3).uniform(-3, 3, (5, 3, 3)), np.zeros((5, 3))
    first = jaxplan.time_allocation(points, total_time=np.arange(3.0, 8.0), yaw=yaw, config=QUICK, batch_axis=0)
    last = jaxplan.time_allocation(np.moveaxis(points, 0, -1), total_time=np.arange(3.0, 8.0), yaw=yaw.T, config=QUICK)
    np.testing.assert_array_equal(first.durations, last.durations.T)
    assert first.durations.shape == (5, 2)


def test_an_equal_vehicle_compiles_nothing_anew(compilations):
    points = np.random.default_rng(4).uniform(-2, 2, (3, 3, 2))
    once = jaxplan.time_allocation(points, vehicle=load_vehicle(), config=QUICK)
    compilations.count = 0
    again = jaxplan.time_allocation(points, vehicle=load_vehicle(), config=QUICK)
    np.testing.assert_array_equal(once.durations, again.durations)
    renamed = dataclasses.replace(load_vehicle(), name="mine")
    jaxplan.time_allocation(points, vehicle=renamed, config=QUICK)
    weak = dataclasses.replace(load_vehicle(), rotor_speed_max=1.1 * hover_speeds(load_vehicle()).max())
    slower = jaxplan.time_allocation(points, vehicle=weak, config=QUICK)
    assert compilations.count == 0
    assert (slower.durations.sum(axis=0) > once.durations.sum(axis=0)).all()
    partial = functools.partial(jaxplan.rotor_limit_margin, load_vehicle())
    by_margin = jaxplan.time_allocation(points, margin=partial, config=QUICK)
    np.testing.assert_allclose(by_margin.durations, once.durations, **tolerance("solve"))
    compilations.count = 0
    partial = functools.partial(jaxplan.rotor_limit_margin, load_vehicle())
    jaxplan.time_allocation(points, margin=partial, config=QUICK)
    assert compilations.count == 0
    with pytest.raises(InputError, match="exactly one"):
        jaxplan.time_allocation(points, margin=partial, vehicle=load_vehicle())


def test_the_margin_of_a_vehicle_is_its_rotors():
    state = jaxplan.hover([0.0, 0.0, 1.0])
    vehicle = load_vehicle("cf21")
    with jax.enable_x64(True):
        wanted = float(jaxplan.rotor_limit_margin(vehicle, state))
        assert float(margin_of_vehicle(vehicle)(state)) == pytest.approx(wanted, **relative("formula"))
