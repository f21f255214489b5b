"""The compiled descent against the one for batches: margins, Newton's system, and where descents end."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.native import entry_point
from jaxplan.optimizer.interior_point import DescentConfig, _merit
from jaxplan.optimizer.interior_point import descend as batched_descend
from jaxplan.optimizer.kernels.case import Case, make_tables, mixer_of
from jaxplan.optimizer.kernels.descent import Patience, descend, solve
from jaxplan.optimizer.kernels.margins import look, make_work
from jaxplan.optimizer.kernels.newton import set_up
from jaxplan.optimizer.margins import linearise, values
from jaxplan.optimizer.problem import Limits, TargetTable, Task, Variables, flatten, splines, unflatten
from jaxplan.records import replace
from jaxplan.search.kernels.solids import solids_of
from jaxplan.spline import hover
from jaxplan.tracking.kernels.craft import craft_of
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World, aligned_boxes, make_obstacles
from oracles.planner_cases import START, in_flight
from tolerances import assert_close, tolerance

BODY, PLACES = 5, 9
BARRIER, PENALTY, DAMPING = 2e-3, 10.0, 1e-2


@entry_point
def looked(case, x, slack, work):
    return look(case, x, slack, work)


@entry_point
def stepped(case, x, slack, barrier, penalty, damping, work):
    set_up(case, x, slack, barrier, penalty, damping, work)


@entry_point
def solved(system, right):
    solve(system, right)


def task_of(vehicle, world="env1", start=None, turning=7.0):
    """A target that passes the start at 1 m/s, met from there at a speed that asks for more distance."""
    numbers = {"clearance": 0.3, "slow": 1.0, "per_speed": 0.025, "most": 0.15, "meet_radius": 0.3, "dilation": 1.05}
    line = np.asarray(START) + np.arange(30)[:, None] * np.array([0.1, 0.05, 0.01])
    beside = {"interval": np.asarray(0.1), "offset": np.array([[0.1], [0.0], [0.05]])}
    target = TargetTable(position=line, velocity=np.gradient(line, 0.1, axis=0), **beside)
    room = load_world(world) if isinstance(world, str) else world
    task = Task(
        start=in_flight() if start is None else start,
        target=target,
        world=replace(room, name="", provenance=""),
        vehicle=vehicle.astype(jnp.float64),
        limits=Limits(**{name: np.full(1, number) for name, number in numbers.items()}),
        max_tilt=np.asarray(1.3),
        max_pitch=np.asarray(1.2),
        max_body_rate=np.asarray(turning),
        body_samples=BODY,
        place_samples=PLACES,
    )
    return jax.tree.map(jnp.asarray, task)


def case_of(task, vehicle, world="env1"):
    """The same for the compiled code."""
    room = load_world(world) if isinstance(world, str) else world
    limits, craft = jax.tree.map(lambda leaf: float(leaf[0]), task.limits), craft_of(vehicle)
    return Case(
        craft=craft,
        mixer=mixer_of(craft),
        solids=tuple(solids_of(room)),
        corners=tuple(np.ravel(room.bounds).tolist()),
        start=np.array(task.start.derivatives),
        yaw=float(task.start.yaw[0]),
        interval=float(task.target.interval),
        position=np.asarray(task.target.position) + np.asarray(task.target.offset)[:, 0],
        velocity=np.array(task.target.velocity),
        meet_radius=limits.meet_radius,
        kept=(limits.clearance, limits.slow, limits.per_speed, limits.most),
        dilation=limits.dilation,
        upright=float(np.cos(task.max_tilt)),
        ahead=float(np.cos(task.max_pitch)),
        turning=float(task.max_body_rate),
        tables=make_tables(BODY, PLACES),
    )


def a_point(m, seed=0):
    """Variables of m segments near the target's way."""
    rng = np.random.default_rng(seed)
    shares = np.linspace(0.0, 1.0, m)[1:-1, None]
    inner = np.asarray(START) + shares * np.array([1.4, 0.4, 0.2]) + 0.05 * rng.normal(size=(m - 2, 3))
    parts = np.log(rng.uniform(0.25, 0.45, (m, 1))), inner[:, :, None], np.full((3, 1), 0.2), np.full((3, 1), 0.7)
    return np.asarray(flatten(Variables(*parts)))[:, 0]


def batched_system(task, x, slack):
    """Newton's matrix and minus its gradient by the dense Jacobian of the batched code."""
    around = linearise(task, jnp.asarray(x)[None])
    rows = np.concatenate([around.jacobian[0], np.ones((around.jacobian.shape[1], 1))], axis=1)
    spare = np.asarray(around.margins[0]) + slack
    matrix = (rows * (BARRIER / spare**2)[:, None]).T @ rows
    matrix += np.diag(np.r_[np.asarray(around.curvature[0]), BARRIER / slack**2])
    pull = rows.T @ (BARRIER / spare) - np.r_[np.asarray(around.gradient[0]), PENALTY - BARRIER / slack]
    return matrix + np.diag(DAMPING * np.diag(matrix) + 1e-9), pull


def assert_same_step(task, case, x):
    """Trajectory, margins and Newton's system around one point."""
    work = make_work(len(x) // 4, case.tables)
    want, margins = values(task, jnp.asarray(x)[None])
    slack = 0.1 + max(-float(np.min(margins)), 0.0)
    time, least, logs = looked(case, x, slack, work)
    position = np.asarray(splines(task, unflatten(jnp.asarray(x)[:, None])).position)[..., 0]
    assert_close(work.spline.coefficients / np.abs(position).max(), position / np.abs(position).max(), "solve")
    assert_close(time, want[0], "exact")
    assert_close(least, np.min(margins), "solve")
    merit = _merit(want, margins, jnp.full(1, slack), jnp.full(1, BARRIER), DescentConfig(penalty=PENALTY))[0]
    assert_close(time + PENALTY * slack - BARRIER * (logs + np.log(slack)), merit, "solve")
    stepped(case, x, slack, BARRIER, PENALTY, DAMPING, work)
    matrix, pull = batched_system(task, x, slack)
    size = np.sqrt(np.diag(matrix))
    assert_close(np.tril(work.system / np.outer(size, size)), np.tril(matrix / np.outer(size, size)), "solve")
    assert_close(work.direction / np.abs(pull).max(), pull / np.abs(pull).max(), "solve")
    direction = np.linalg.solve(matrix, pull)
    solved(work.system, work.direction)
    assert_close(work.direction / np.abs(direction).max(), direction / np.abs(direction).max(), "solve")


@pytest.mark.parametrize("name", ["mfrl", "cf21", "racer5", "x500", "flightgoggles"])
@pytest.mark.parametrize("flying", [False, True])
def test_one_step_is_that_of_the_batched_code(name, flying, x64):
    vehicle = load_vehicle(name)
    task = task_of(vehicle, start=None if flying else hover(START))
    assert_same_step(task, case_of(task, vehicle), a_point(6))


@pytest.mark.slow
@pytest.mark.parametrize("segments", [3, 8])
def test_without_drag_and_without_a_limit_of_the_turn(segments, x64):
    vehicle = replace(load_vehicle(), drag_coefficient=0.0)
    task = task_of(vehicle, turning=np.inf)
    assert_same_step(task, case_of(task, vehicle), a_point(segments, seed=1))


@pytest.mark.slow
def test_one_step_in_other_rooms(x64):
    """Beside boxes, where nothing is near, and among walls and pillars; for other solids see ``test_search_slopes``."""
    lower = np.asarray(START) + np.array([[0.4, 0.8, -0.5], [0.9, -0.9, -0.5], [-0.9, 0.3, -1.0]])
    room = np.stack([np.asarray(START) - 4.0, np.asarray(START) + 4.0])
    for obstacles in (make_obstacles(boxes=aligned_boxes(lower, lower + 0.5)), make_obstacles()):
        world = World(name="made up", bounds=room, obstacles=obstacles, keep_in=0.2)
        task = task_of(load_vehicle(), world)
        assert_same_step(task, case_of(task, load_vehicle(), world), a_point(6))
    for name in ("env2", "env3"):
        task = task_of(load_vehicle(), name)
        assert_same_step(task, case_of(task, load_vehicle(), name), a_point(6))


@pytest.mark.parametrize("name", [pytest.param("mfrl", marks=pytest.mark.slow), "racer5"])
def test_descents_end_where_those_of_the_batched_code_do(name, x64):
    """From the better of two starts; a descent is a chain of decisions, so rounding grows along it."""
    vehicle = load_vehicle(name)
    task, config = task_of(vehicle, start=hover(START)), DescentConfig(iterations=12, rate=0.75)
    case = case_of(task, vehicle)
    starts = np.stack([a_point(6, seed=2), a_point(6, seed=3)])
    times, margins = jax.vmap(lambda x: values(task, x[None]))(jnp.asarray(starts))
    cost = times[:, 0] + config.penalty * np.maximum(-np.min(margins[:, 0], axis=1), 0.0)
    begin = jnp.asarray(starts[np.argmin(cost)])[None]
    want = jax.jit(batched_descend, static_argnums=(0, 1))(
        functools.partial(values, task), functools.partial(linearise, task), begin, config
    )
    found = descend(case, starts, config)
    near = {"rel": 0.0, "abs": 1e-6}  # after twelve steps, each of them a decision
    assert found.objective == pytest.approx(float(want.objective[0]), **near)
    assert found.least == pytest.approx(float(want.least[0]), **near)
    np.testing.assert_allclose(
        found.position, splines(task, unflatten(want.x.T)).position[..., 0], **tolerance("solve")
    )
    again = descend(case, starts[::-1], config)
    assert again.objective == found.objective
    assert np.array_equal(again.x, found.x)


def test_starts_that_are_not_finite_are_not_taken_and_spoil_nothing(x64):
    case = case_of(task_of(load_vehicle()), load_vehicle())
    good, config = a_point(6), DescentConfig(iterations=4)
    bad = good.copy()
    bad[7] = np.nan
    alone = descend(case, good[None], config)
    assert np.array_equal(descend(case, np.stack([bad, good]), config).x, alone.x)
    assert np.array_equal(descend(case, np.stack([good, bad]), config).x, alone.x)
    assert not descend(case, bad[None], config).least >= -1.0


def test_a_descent_that_violates_its_margins_for_too_long_is_given_up(x64):
    case = case_of(task_of(load_vehicle()), load_vehicle())
    starts, config = a_point(6)[None], DescentConfig(iterations=12, rate=0.75)
    through, halfway = descend(case, starts, config), descend(case, starts, replace(config, iterations=4))
    assert halfway.least < 0.0
    given_up = descend(case, starts, config, Patience(steps=4, least=0.0))
    assert np.array_equal(given_up.x, halfway.x)
    assert given_up.least == halfway.least
    assert (given_up.steps, through.steps) == (4, 12)
    for patience in (Patience(4, halfway.least), Patience(0, -np.inf), Patience(13, np.inf)):
        assert np.array_equal(descend(case, starts, config, patience).x, through.x)
    assert not np.array_equal(through.x, halfway.x)
