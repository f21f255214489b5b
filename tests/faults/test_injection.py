"""The fault injector does what it says, and episodes with faults hit nothing.

``jaxplan experiment faults`` flies many of them.
"""

import dataclasses

import numpy as np
import pytest

from experiments import closed_loop, faults, injection
from experiments.closed_loop import EpisodeConfig
from experiments.injection import Trouble
from jaxplan import interception
from jaxplan.prediction.stream import ObservationStream
from jaxplan.status import PlanStatus
from jaxplan.tracking.disturbance import Disturbance
from jaxplan.tracking.rates import CONTROL_RATE
from tolerances import tolerance

EPISODE = EpisodeConfig(
    world="env1", planner="no-policy", predictor="constant-velocity", target="env1-01", speed=2.0, departure=0.5, seed=3
)


def seen(fault: str, seed: int = 3) -> tuple[list[float], np.ndarray, np.ndarray]:
    """Ages, newest positions and the true ones, over 4 s."""
    scenario = dataclasses.replace(closed_loop.scenario_of(EPISODE), seed=seed)
    trouble = Trouble(scenario, fault)
    stream, ages, newest, true = ObservationStream(), [], [], []
    for cycle in range(40):
        now = 0.1 * cycle
        where = scenario.target.position(np.array([now]))[0]
        trouble.watch(stream, now, where)
        observed = stream.observe(now)
        if observed is not None:
            ages.append(observed.age)
            newest.append(observed.positions[-1])
            true.append(where)
    return ages, np.array(newest), np.array(true)


def test_a_sensor_without_fault_shows_the_target_where_it_is() -> None:
    ages, newest, true = seen("none")
    assert max(ages) < 1e-9
    np.testing.assert_array_equal(newest, true)


def test_late_observations_are_old() -> None:
    ages, _, _ = seen("late")
    assert min(ages) == pytest.approx(injection.DELAY)


def test_half_of_what_is_lost_is_missing() -> None:
    ages, _, _ = seen("lost")
    assert 0.2 < np.mean(np.array(ages) > 0.05) < 0.8


def test_noise_has_its_size() -> None:
    _, newest, true = seen("noisy")
    assert np.std(newest - true) == pytest.approx(injection.NOISE, rel=0.3)


def test_jumps_are_told_and_not_believed() -> None:
    """Single ones are left out by the stream."""
    _, newest, true = seen("teleporting")
    assert np.linalg.norm(newest - true, axis=1).max() < 1.0


def test_what_is_told_again_changes_nothing() -> None:
    for told, plain in zip(seen("shuffled"), seen("none"), strict=True):
        np.testing.assert_array_equal(told, plain)


def test_the_same_seed_does_the_same_and_another_does_not() -> None:
    assert np.array_equal(seen("noisy")[1], seen("noisy")[1])
    assert not np.array_equal(seen("noisy")[1], seen("noisy", seed=4)[1])


def test_a_stalled_planner_does_nothing_until_it_is_done() -> None:
    """Cycles fall out while it is at an earlier one, whose plan is dropped; the reference never jumps."""
    base = dataclasses.replace(closed_loop.scenario_of(EPISODE), seed=3)
    trouble = Trouble(base, "stalled")
    flown = interception.fly(trouble.disturbed(), guide=trouble, watch=trouble.watch)
    times = np.array([cycle.time for cycle in flown.cycles])
    late = np.array([cycle.status is PlanStatus.LATE for cycle in flown.cycles])
    gaps = np.diff(times)
    assert gaps.max() > 0.35
    assert late.any()
    assert gaps[late[:-1]].min() > base.replanning.latency
    assert gaps.max() <= injection.LONGEST + 0.1 + 1e-9
    assert max(cycle.jump[:4].max() for cycle in flown.cycles if cycle.jump is not None) < tolerance("solve")["atol"]


def test_a_hit_is_avoidable_where_a_stop_flown_in_the_same_air_stays_clear() -> None:
    """In calm air one does; in a storm that blows the vehicle into a wall none does."""
    base = dataclasses.replace(closed_loop.scenario_of(EPISODE), seed=3)
    calm, storm = Trouble(base, "none"), Trouble(base, "none")
    flown = interception.fly(calm.disturbed(), guide=calm, watch=calm.watch)
    interception.fly(storm.disturbed(), guide=storm, watch=storm.watch)
    storm._disturbance = Disturbance(wind=(40.0, 0.0, 0.0))
    event = base.departure + 0.2
    later = np.arange(len(flown.flight.times)) > CONTROL_RATE * (base.departure + 0.6)
    assert faults._is_avoidable(flown, calm, later, event)
    assert not faults._is_avoidable(flown, storm, later, event)
    assert not faults._is_avoidable(flown, calm, ~later, event), "nothing can be done about what happens before"


def test_a_state_between_those_that_were_kept_is_the_one_that_was_flown_through() -> None:
    base = dataclasses.replace(closed_loop.scenario_of(EPISODE), seed=3)
    calm = Trouble(base, "none")
    flown = interception.fly(calm.disturbed(), guide=calm, watch=calm.watch)
    step = round((base.departure + 0.45) * CONTROL_RATE)
    state = calm.state_at(step)
    assert state is not None
    assert step not in calm.states
    np.testing.assert_allclose(state.pos, flown.flight.position[step - 1], atol=1e-5)  # m, a float32
    assert calm.state_at(step + 10_000) is None


def test_what_troubles_the_vehicle_is_felt_where_it_is_off_its_reference_and_the_rest_is_told_at_once() -> None:
    base = dataclasses.replace(closed_loop.scenario_of(EPISODE), seed=3)
    flown = interception.fly(base)
    far = [cycle._replace(deviation=0.0 if n < 4 else 0.3) for n, cycle in enumerate(flown.cycles)]
    event = far[1].time
    assert faults._felt(flown._replace(cycles=tuple(far)), "gust", event) == far[4].time
    assert faults._felt(flown, "box", event) == event
    assert faults._felt(flown._replace(cycles=tuple(far[:4])), "gust", event) == np.inf


@pytest.mark.slow
@pytest.mark.parametrize("fault", injection.FAULTS)
def test_episodes_with_a_fault_hit_nothing_and_never_jump(fault: str) -> None:
    """Late plans are dropped, clocks that go back refused, boxes not flown into."""
    config = faults.Config(faults=(fault,), worlds=("env1",), episodes=3)
    rows = [faults.evaluate(config, item) for item in faults.items(config)]
    assert not any(row["hit"] for row in rows)
    assert sum(row["reference_hits"] for row in rows) == 0
    assert max(row["largest_jump"] for row in rows) <= 1e-6
    assert sum(row["outcome"] == "intercepted" for row in rows) >= 2
    assert fault != "slow" or sum(row["late"] for row in rows) > 0
    assert fault != "push" or max(row["largest_deviation_m"] for row in rows) > 0.25
