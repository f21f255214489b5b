"""The problem that refines plans: its derivatives, and what a refined plan keeps, against other code than its own."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.compilation import compilations
from jaxplan.errors import InputError
from jaxplan.optimizer.kernels import descent
from jaxplan.optimizer.margins import linearise, values
from jaxplan.optimizer.problem import Limits, TargetTable, Task, Variables, flatten, slowed
from jaxplan.planner import Fault, PlannerConfig, RefinementConfig, Seed, build_planner
from jaxplan.policy.constant_speed import constant_speed_policy
from jaxplan.prediction.candidates import candidates_from
from jaxplan.records import replace
from jaxplan.spline import hover
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.load import load_world
from oracles.planner_cases import START, in_flight
from tolerances import tolerance


def expected(count=30):
    """A target that flies evenly past the start, one candidate an instant."""
    times = 0.1 * np.arange(1, count + 1)
    goals = np.asarray(START) + np.array([1.6, 0.3, 0.2]) + times[:, None] * np.array([0.4, 0.1, 0.0])
    return candidates_from(goals[0], goals, times, np.zeros(count))


@pytest.fixture(scope="module")
def planner():
    config = PlannerConfig(refinement=RefinementConfig(soonest=0.5))
    found = build_planner(config, world=load_world("env1"), vehicle=load_vehicle(), policy=constant_speed_policy())
    found.warmup(hover(START))
    return found


@pytest.fixture(scope="module")
def seed(planner):
    candidates = expected()
    plans = planner.plan_batch(hover(START), candidates)
    best = int(np.argmax(np.where(plans.reasons == 0, plans.score, -np.inf)))
    assert plans.reasons[best] == 0
    return Seed(plans.spline(best), 0.0, float(plans.arrival_times[best]), plans.goals[best], 1.0)


@pytest.mark.slow
def test_derivatives_of_all_margins_are_those_of_small_steps(x64):
    """From flight, near a pillar, with a speed that asks for more distance: every row against central differences."""
    numbers = {"clearance": 0.3, "slow": 2.0, "per_speed": 0.025, "most": 0.15, "meet_radius": 0.3, "dilation": 1.05}
    beside = {"interval": np.asarray(0.1), "offset": np.array([[0.1], [0.0], [0.05]])}
    line = np.asarray(START) + np.arange(30)[:, None] * np.array([0.1, 0.05, 0.01])
    target = TargetTable(position=line, velocity=np.gradient(line, 0.1, axis=0), **beside)
    task = Task(
        start=in_flight(),
        target=target,
        world=replace(load_world("env1"), name="", provenance=""),
        vehicle=load_vehicle().astype(jnp.float64),
        limits=Limits(**{name: np.full(1, number) for name, number in numbers.items()}),
        max_tilt=np.asarray(1.3),
        max_pitch=np.asarray(1.2),
        max_body_rate=np.asarray(7.0),
        body_samples=3,
        place_samples=4,
    )
    task = jax.tree.map(jnp.asarray, task)
    inner = np.asarray(START) + np.array([[0.5, 0.2, 0.1], [1.0, 0.3, 0.2], [1.4, 0.4, 0.2]])
    point = flatten(Variables(np.log(np.full((5, 1), 0.35)), inner[:, :, None], np.full((3, 1), 0.1), np.ones((3, 1))))
    x = jnp.asarray(np.asarray(point).T)
    found = linearise(task, x)
    evaluate = jax.jit(functools.partial(values, task))
    step, columns = 1e-6, []
    for column in range(x.shape[1]):
        ahead, behind = (evaluate(x.at[0, column].add(sign * step)) for sign in (1.0, -1.0))
        columns.append((np.asarray(ahead[1] - behind[1])[0], float(ahead[0][0] - behind[0][0])))
    slopes = np.stack([margins for margins, _ in columns], axis=1) / (2.0 * step)
    apart = np.abs(slopes - np.asarray(found.jacobian)[0]) / (1.0 + np.abs(slopes))
    assert np.quantile(apart, 0.99) < 1e-5, "but where the nearest obstacle or face changes"
    np.testing.assert_allclose([t / (2.0 * step) for _, t in columns], found.gradient[0], **tolerance("gradient"))
    np.testing.assert_allclose(evaluate(x)[1], found.margins, **tolerance("solve"))


def test_a_refined_plan_is_sooner_and_keeps_what_every_plan_keeps(planner, seed):
    compiled = compilations()
    refined = planner.refine(hover(START), expected(), seed)
    assert compilations() == compiled
    assert refined.reasons == 0
    assert refined.arrival_time < 0.9 * seed.meeting
    assert refined.score == pytest.approx(1.0 - refined.arrival_time)
    met = refined.spline.state(refined.arrival_time)
    assert np.linalg.norm(met.pos - refined.goal) <= RefinementConfig().meet_radius + 1e-3
    line = expected()
    where = [np.interp(refined.arrival_time, line.arrival_times, line.goals[:, axis]) for axis in range(3)]
    np.testing.assert_allclose(refined.goal, where, atol=2e-3)
    start = refined.spline.state(0.0)
    np.testing.assert_allclose(start.derivatives, hover(START).derivatives, **tolerance("solve"))
    assert not planner.validate(refined.spline).faults & Fault.NOT_AT_REST
    assert not planner.validate(refined.spline, 0.0, hover(START)).faults
    assert refined.clearance > float(load_vehicle().radius)


def test_what_is_left_of_a_plan_is_refined_from_flight(planner, seed):
    first = planner.refine(hover(START), expected(), seed)
    since = 0.05
    state = first.spline.state(since)
    later = expected()
    later = replace(later, arrival_times=later.arrival_times - since)
    left = Seed(first.spline, since, first.arrival_time - since, first.goal, 1.0)
    again = planner.refine(state, later, left)
    np.testing.assert_allclose(again.spline.state(0.0).derivatives, state.derivatives, **tolerance("solve"))
    assert again.arrival_time < left.meeting + 0.1


def test_nothing_is_refined_where_nothing_can_be_gained(planner, seed):
    near = seed._replace(meeting=0.4)
    assert planner.refine(hover(START), expected(), near) is None
    one = candidates_from(np.zeros(3), np.asarray(START)[None] + 1.0, np.ones(1), np.zeros(1))
    assert planner.refine(hover(START), one, seed) is None
    state = hover(START)
    turning = replace(state, yaw=np.array([0.0, 1.0, 0.0]))
    assert planner.refine(turning, expected(), seed) is None


def test_a_planner_in_another_world_refines_without_compiling(planner, seed):
    compiled, counted = compilations(), len(descent._compiled().signatures)
    for name in ("env2", "env3"):
        assert planner.in_world(load_world(name)).refine(hover(START), expected(), seed) is not None
    assert compilations() == compiled
    assert len(descent._compiled().signatures) == counted == 1


@pytest.mark.parametrize(
    "options", [{"iterations": 0}, {"segments": 2}, {"meet_radius": 0.0}, {"dilation": 0.9}, {"spare": -1.0}]
)
def test_wrong_settings_are_refused(options):
    with pytest.raises(InputError, match=next(iter(options))):
        RefinementConfig(**options)


@pytest.mark.parametrize("options", [{"meet": "rest"}, {"heading": "path"}])
def test_only_passing_plans_with_a_held_heading_are_refined(options):
    with pytest.raises(InputError, match="refinement"):
        dataclasses.replace(PlannerConfig(**options), refinement=RefinementConfig())


def test_a_start_is_slowed_by_its_durations_alone():
    one = np.random.default_rng(3).normal(size=24)
    longer = slowed(one, 1.25)
    np.testing.assert_allclose(np.exp(longer[:6]), 1.25 * np.exp(one[:6]), **tolerance("exact"))
    np.testing.assert_array_equal(longer[6:], one[6:])
