"""Closed-loop episodes in environment 1: what every run must have, and how each kind of episode ends."""

import dataclasses

import jax
import numpy as np
import pytest

from jaxplan import interception
from jaxplan.config import InterceptConfig
from jaxplan.errors import InputError
from jaxplan.interception.judging import until_decided
from jaxplan.io.cycles import read_cycles, saved_cycles, write_cycles
from jaxplan.io.targets import Target, load_target, stored_targets
from jaxplan.prediction.kernels.views import seen_from
from jaxplan.prediction.lookout import Lookout, views_of
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.predictors import PREDICTORS, build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.target_model import shipped_model
from jaxplan.replanner import Replanner
from jaxplan.replanner.committed import CommittedPlans, hold
from jaxplan.scenario import build_scenario
from jaxplan.spline import hover
from jaxplan.status import Note, PlanStatus
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.viz.replay import replay_of
from oracles.metrics_schema import valid_metrics
from tolerances import tolerance


@pytest.fixture(scope="module")
def scenario():
    built = build_scenario(InterceptConfig(predictor="noisy"))
    interception.warm_up(built)
    return built


@pytest.fixture(scope="module")
def episode(scenario):
    return interception.fly(again(scenario))


def again(scenario, *, target=None, predictor="ground-truth", start=None, departure=0.5, seed=0):
    """The same compiled functions in another scenario."""
    target, start = target or scenario.target, start or scenario.start
    mixture = shipped_model("env1", 0.1) if PREDICTORS[predictor].learned else None
    model = build_predictor(predictor, PredictionConfig(), target.position, seed, mixture, scenario.world)
    model(Observations(times=0.1 * np.arange(10), positions=np.tile(start.pos, (10, 1))), 0)  # compiles
    return dataclasses.replace(scenario, target=target, predictor=model, start=start, departure=departure, seed=seed)


def still(position, duration=3.0):
    """A target that hovers."""
    return Target(
        "still", duration, 0.0, (), lambda t, d: np.broadcast_to(0.0 if d else position, (*np.shape(t), 3)), 1.0
    )


def test_default_episode_intercepts(episode):
    assert episode.outcome == "intercepted"
    metrics = valid_metrics(episode)
    assert metrics["success"]
    assert metrics["min_distance_m"] < 0.4
    assert metrics["meeting"]["relative_speed_m_s"] > metrics["meeting"]["speed_m_s"] - 1.5 > 0.0
    assert metrics["max_position_error_m"] < 0.4
    assert metrics["max_yaw_error_deg"] < 45.0
    assert metrics["min_clearance_m"] > float(episode.scenario.vehicle.radius)
    assert metrics["compilations_after_warmup"] == 0
    assert metrics["replans"] == len(episode.cycles)
    assert metrics["candidates"]["generated"] == 20 * len(episode.cycles)
    assert set(metrics["replan_ms"]) >= {"total", "predict", "search", "knots", "policy", "minsnap", "select"}


def test_a_target_that_is_not_in_sight_is_looked_for(scenario):
    """One that hovers behind pillars: without a lookout the defender waits for it forever."""
    views = views_of(scenario.world)
    hidden = views.places[~seen_from(views.solids, scenario.start.pos[None], views.places, np.inf)[0]]
    place = hidden[np.argmax(np.linalg.norm(hidden - np.asarray(scenario.start.pos), axis=1))]
    one = again(scenario, target=still(place, 8.0), predictor="constant-velocity")
    defender = [np.asarray(one.start.pos)]

    def watch(stream, now, position):
        if seen_from(views.solids, defender[0][None], position[None], np.inf).all():
            stream.add(now, position, now)

    def moved(now, position, velocity):
        defender[0] = position

    assert interception.fly(one, watch=watch, react=moved).outcome == "no_plan"
    looking = Lookout(one.predictor, one.world, PredictionConfig(), views=views)
    guide = Replanner(one.planner, looking, one.start, one.replanning)
    defender[0] = np.asarray(one.start.pos)
    episode = interception.fly(one, guide=guide, watch=watch, react=moved)
    assert episode.outcome == "intercepted"
    assert episode.cycles[0].note is Note.SEARCHING
    assert episode.observations[0] is None
    assert episode.cycles[-1].note is not Note.SEARCHING
    assert episode.observations[-1] is not None
    with pytest.raises(InputError, match="searches"):
        Replanner(one.planner, one.predictor, one.start).step(0.0, None)


def test_commanded_trajectory_never_jumps(episode):
    jumps = valid_metrics(episode)["switch_jump"]
    assert all(value <= 1e-6 for value in jumps.values()), jumps


def test_flight_log_is_consistent(episode):
    flight = episode.flight
    np.testing.assert_allclose(np.diff(flight.times), 1.0 / CONTROL_RATE, **tolerance("formula"))
    moved = np.linalg.norm(np.diff(flight.position, axis=0), axis=1)
    speed = np.linalg.norm(flight.velocity, axis=1)
    np.testing.assert_allclose(moved * CONTROL_RATE, 0.5 * (speed[1:] + speed[:-1]), atol=0.1)
    np.testing.assert_allclose(
        np.linalg.norm(flight.position - flight.reference, axis=1), flight.position_error, atol=1e-4
    )
    np.testing.assert_allclose(episode.scenario.target.position(flight.times), flight.target)
    before = flight.times < episode.scenario.departure
    assert np.linalg.norm(flight.position[before] - episode.scenario.start.pos, axis=1).max() < 0.02


def test_who_follows_is_shown_all_of_it(scenario, episode):
    shown = []
    again_flown = interception.fly(again(scenario), follow=shown.append)
    assert [so_far.outcome for so_far in shown[:-1]] == [interception.FLYING] * (len(shown) - 1)
    assert [so_far.flight.times[-1] for so_far in shown[:-1]] == pytest.approx(0.1 * np.arange(1, len(shown)))
    assert shown[-1].outcome == again_flown.outcome == "intercepted"
    np.testing.assert_array_equal(shown[-1].flight.position, episode.flight.position)
    grown = None
    for so_far in shown:
        grown = replay_of(so_far, grown)
    assert len(grown.cycles) == len(episode.cycles)
    assert len(grown.plans) == len(episode.plans)
    assert grown.times[-1] == episode.flight.times[-1]


def test_what_is_kept_of_an_episode_is_what_happened(episode, tmp_path):
    """Each commitment belongs to one cycle, and what the file says of the prediction is what the flight asked for."""
    kept = saved_cycles(episode.cycles, episode.observations, episode.plans, episode.scenario.predictor)
    write_cycles(tmp_path / "cycles.npz", kept)
    assert (tmp_path / "cycles.npz").stat().st_size < 2_000_000
    read = read_cycles(tmp_path / "cycles.npz", len(episode.plans))
    assert [cycle.plan for cycle in read if cycle.plan >= 0] == list(range(len(episode.plans)))
    for row, cycle in zip(read, episode.cycles, strict=True):
        assert row.status == cycle.status
        assert row.rejected == cycle.rejected
        truth = episode.scenario.target.position(row.prediction.instants)
        np.testing.assert_allclose(row.prediction.means[:, 0], truth, atol=1e-3)  # m, of a predictor that knows it


def test_same_seed_same_flight(scenario, episode):
    repeated = interception.fly(again(scenario))
    np.testing.assert_array_equal(repeated.flight.position, episode.flight.position)


@pytest.mark.parametrize("predictor", PREDICTORS)
def test_every_predictor_flies_without_compiling(scenario, predictor):
    target = load_target("env1-02", world="env1", speed=1.0)
    result = interception.fly(again(scenario, target=target, predictor=predictor))
    assert result.compilations_after_warmup == 0
    assert result.outcome in ("intercepted", "target_ended", "no_plan")
    assert max(cycle.generated for cycle in result.cycles) == (400 if PREDICTORS[predictor].sampling else 20)
    if predictor not in ("none", "constant-acceleration"):
        assert result.success
    assert valid_metrics(result)["predictor_fallbacks"] == 0  # two observations are enough for a mixture


def test_target_behind_everything_ends_without_success(scenario):
    far = still(np.array([4.3, 4.3, 1.0]), duration=1.2)
    result = interception.fly(again(scenario, target=far))
    assert result.outcome == "target_ended"
    assert not result.success
    assert valid_metrics(result)["time_to_intercept_s"] is None


def test_late_departure_means_no_plan(scenario):
    result = interception.fly(again(scenario, target=still(np.array([4.0, 4.0, 1.0]), 1.0), departure=5.0))
    assert result.outcome == "no_plan"
    assert len(result.cycles) == 0
    assert result.flight.times[-1] == pytest.approx(1.0)
    assert valid_metrics(result)["replan_ms"] == {}


def test_a_silent_target_is_lost_and_no_stale_goal_is_chased(scenario):
    """Predictions first reach less far ahead, then there are none; what is committed is flown to its end."""
    replanner = Replanner(scenario.planner, again(scenario, predictor="constant-velocity").predictor, scenario.start)
    times = 0.1 * np.arange(10)
    positions = scenario.target.position(times)
    statuses = [
        replanner.step(0.9 + age, Observations(times=times, positions=positions, age=age)).status
        for age in (0.0, 0.5, 1.0, 1.1, 1.2)
    ]
    assert PlanStatus.TARGET_LOST not in statuses[:3]
    assert statuses[3:] == [PlanStatus.TARGET_LOST] * 2
    plans = len(replanner.plans)
    cycle = replanner.step(5.0, Observations(times=times, positions=positions, age=4.1))
    assert (cycle.status, cycle.chosen, len(replanner.plans)) == (PlanStatus.TARGET_LOST, -1, plans)
    assert cycle.rejected == {"target_lost": 20}, "and nothing is said of places that it does not have"
    state = replanner.reference(np.array([60.0]))
    np.testing.assert_allclose(state.vel, 0.0, **tolerance("solve"))


def test_lost_tracking_and_collision_are_told_apart(scenario):
    flight = interception.fly(again(scenario, target=still(np.array([4.0, 4.0, 1.0]), 1.0))).flight
    rows = len(flight.times)
    lost = flight._replace(position_error=np.where(np.arange(rows) < 50, 0.0, np.nan))
    decided, outcome = until_decided(lost, scenario)
    assert (outcome, len(decided.times)) == ("tracking_lost", 51)
    hit = flight._replace(clearance=np.where(np.arange(rows) < 30, 1.0, 0.1))
    decided, outcome = until_decided(hit, scenario)
    assert (outcome, len(decided.times)) == ("collision", 31)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"start": (9.0, 0.0, 1.0)}, "start"),
        ({"start": (1.0, -0.05, 1.0)}, "start"),
        ({"target": "env9-01"}, "env1-01"),
        ({"world": "moon"}, "env1"),
    ],
)
def test_scenarios_that_do_not_fit_are_refused(options, said):
    with pytest.raises(InputError, match=said):
        build_scenario(InterceptConfig(**options))


def test_target_outside_the_room_is_refused(tmp_path):
    path = tmp_path / "away.csv"
    path.write_text("t,x,y,z\n0,0,1,1\n1,2,1,1\n2,30,1,1\n")
    with pytest.raises(InputError, match=r"outside world 'env1', which is from \(-5.00, -5.00, 0.00\) to ") as refusal:
        build_scenario(InterceptConfig(target=str(path)))
    assert "millimetres" not in str(refusal.value)  # a few metres are no millimetres


def test_stored_targets_are_free_and_have_the_wanted_speed(scenario):
    names = stored_targets("env1")
    assert len(names) == 10
    for name in names:
        target = load_target(name, world="env1", speed=2.0)
        times = np.linspace(0.0, target.duration, 700)
        assert scenario.clearance(target.position(times)).min() >= 0.499
        speeds = np.linalg.norm(target.velocity(times), axis=1)
        assert speeds.max() == pytest.approx(2.0, rel=1e-2)
        moved = np.linalg.norm(np.diff(target.position(times), axis=0), axis=1).sum()
        assert moved == pytest.approx(speeds.mean() * target.duration, rel=1e-2)


@pytest.mark.slow
def test_recorded_flight_in_a_mesh_is_intercepted(examples):
    config = InterceptConfig(
        world=str(examples / "maps" / "kr_skir.stl"),
        target=str(examples / "scenarios" / "oda_010__in__kr_skir_0.csv"),
    )
    result = interception.run(config)
    assert result.outcome == "intercepted"
    assert result.compilations_after_warmup == 0


def test_hover_state_survives_float32_scope():
    """The library computes in float64 whatever the process's own setting is."""
    assert not jax.config.jax_enable_x64
    assert hover(np.array([1.0, 2.0, 3.0])).derivatives.dtype == np.float64


@pytest.mark.slow
def test_an_episode_in_real_time_is_met_as_soon_and_no_setpoint_waits(tmp_path):
    """The planner in a process of its own, against the clock."""
    config = InterceptConfig(predictor="ground-truth", out=str(tmp_path))
    episode = interception.run_in_real_time(config)
    kept = episode.real_time
    assert episode.success
    assert episode.compilations_after_warmup == 0
    assert kept.status.restarts == 0
    assert np.median(kept.setpoint_us) < 1000.0, "no waiting for a planner that takes 10 ms and more"
    assert episode.wall_s == pytest.approx(episode.flight.times[-1], abs=0.5)
    assert abs(float(episode.flight.times[-1]) - float(interception.run(config).flight.times[-1])) < 0.5
    metrics = valid_metrics(episode)
    assert metrics["real_time"]["late_plans"] == kept.status.late
    assert sum(metrics["replan_status"].values()) == pytest.approx(metrics["replans"], abs=1)


def test_the_model_in_a_cycle_is_where_the_vehicle_will_be(scenario):
    """After 0.4 s, along what was flown, to millimetres: each cycle's model goes on from the last one's."""
    models = []

    def noted(*measured):
        models.append((round(scenario.departure + 0.1 * len(models), 3), scenario.planner.roll_out(*measured)))
        return models[-1][1]

    flown = interception.fly(dataclasses.replace(again(scenario), planner=scenario.planner._replace(roll_out=noted)))
    committed = CommittedPlans(hold(flown.scenario.start))
    for plan in flown.plans:
        committed.add(plan)
    off = []
    for now, model in models:
        times = now + np.arange(81) / CONTROL_RATE
        if times[-1] <= flown.flight.times[-1]:
            last = np.searchsorted(flown.flight.times, times[-1] - 1e-6)
            off.append(np.linalg.norm(model.after(committed.reference(times)).pos - flown.flight.position[last]))
    assert len(off) >= 5
    assert np.median(off) < 0.01
    assert max(off) < 0.02
