"""The arena: what its targets, sensors and contestants do, and what its report says of made-up rows."""

import importlib.util

import numpy as np
import pytest

from experiments.arena import EXPERIMENT, Config, contestant, items
from experiments.arena.evasion import CLEARANCE, WAYS, Agility, Evader
from experiments.arena.families import CLUTTER, FAMILIES, LEVELS, case, clutter, cluttered_room
from experiments.arena.flights import LENGTH, MOST_ACCELERATION, long_flight, open_room
from experiments.arena.sight import Sight, SightConfig, in_sight
from experiments.guidance import FAST, command, law_named
from experiments.guidance import MOST_ACCELERATION as COMMANDED
from experiments.point_mass_mpc import MOST_SPEED, PointMassMpc
from experiments.routing import around_obstacles
from jaxplan.errors import InputError
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.predictors import build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.stream import ObservationStream
from jaxplan.runner.definition import Results
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World, aligned_boxes, make_obstacles
from tolerances import relative, tolerance


@pytest.fixture(scope="module")
def room() -> World:
    return load_world("env2")


@pytest.fixture(scope="module")
def wall() -> World:
    """10 m by 10 m with a wall across the middle that leaves a gap at y > 6 m."""
    box = aligned_boxes(np.array([[4.9, 0.0, 0.0]]), np.array([[5.1, 6.0, 3.0]]))
    bounds = np.array([[0.0, 0.0, 0.0], [10.0, 10.0, 3.0]])
    return World(name="wall", bounds=bounds, obstacles=make_obstacles(boxes=box), keep_in=np.array(0.2), provenance="")


def chased(evader: Evader, seconds: float, speed: float = 6.0) -> np.ndarray:
    """Distances from a pursuer that flies straight at the target from 4 m away."""
    position, apart = evader.motion(np.zeros(1), 0)[0] + np.array([4.0, 0.0, 0.0]), []
    velocity = np.zeros(3)
    for cycle in range(round(seconds / 0.1)):
        now = 0.1 * cycle
        evader.react(now, position, velocity)
        way = evader.motion(np.array([now + 0.1]), 0)[0] - position
        velocity = speed * way / max(np.linalg.norm(way), 1e-9)
        position = position + 0.1 * velocity
        apart.append(np.linalg.norm(way - 0.1 * velocity))
    return np.array(apart)


@pytest.mark.parametrize("way", WAYS)
def test_evasive_targets_keep_to_what_a_point_mass_can_do(room: World, way: str) -> None:
    agility = Agility(5.0, 10.0)
    evader = Evader(room, way, agility, seed=3)
    chased(evader, 4.0)
    times = np.arange(0.0, 4.0, 0.005)
    position, velocity = evader.motion(times, 0), evader.motion(times, 1)
    assert host_free_distance(room, position, 1024).min() > CLEARANCE - 0.05
    assert np.linalg.norm(velocity, axis=1).max() <= agility.speed + 1e-6
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / 0.005
    assert change.max() <= agility.acceleration * 1.001 + 1e-6
    drift = position[1:] - position[:-1] - 0.0025 * (velocity[1:] + velocity[:-1])
    assert np.abs(drift).max() < 1e-4  # positions are the integral of velocities: nothing jumps


def test_who_flees_is_met_later_than_who_flies_on(room: World) -> None:
    """On the average of some targets; a pursuer of twice the speed catches both in the end."""
    apart = {
        way: np.mean([chased(Evader(room, way, Agility(5.0, 15.0), seed), 1.5).mean() for seed in range(6)])
        for way in WAYS
    }
    assert apart["flee"] > apart["dodge"] + 0.2


def test_a_target_is_the_same_again(room: World) -> None:
    first, second = (Evader(room, "hide", Agility(5.0, 10.0), 7) for _ in range(2))
    np.testing.assert_array_equal(chased(first, 1.0), chased(second, 1.0))


def test_a_sensor_is_late_noisy_and_loses_some(room: World) -> None:
    config = SightConfig(noise=0.1, dropouts=0.3, latency=0.2)
    sight, stream = Sight(room, config, np.zeros(3), seed=0), ObservationStream()
    told: list[tuple[float, float, float]] = []
    stream.add = lambda time, position, now: told.append((time, now, float(position[0])))  # type: ignore[method-assign]
    for cycle in range(1000):
        sight.watch(stream, 0.1 * cycle, np.zeros(3))
    seen, known, where = np.array(told).T
    assert 0.65 < len(told) / 998 < 0.75
    assert ((known - seen) > 0.2 - 1e-6).all()
    assert ((known - seen) < 0.3 + 1e-6).all()
    assert 0.09 < where.std() < 0.11


def test_a_wall_hides_what_is_behind_it(wall: World) -> None:
    eye = np.array([2.0, 2.0, 1.0])
    places = np.array([[3.0, 2.0, 1.0], [8.0, 2.0, 1.0], [2.0, 9.0, 1.0], [6.0, 8.0, 1.0]])
    np.testing.assert_array_equal(in_sight(wall, eye, places), [True, False, True, True])
    sight = Sight(wall, SightConfig(occluded=True, sight_range=6.0), eye, seed=0)
    stream = ObservationStream()
    for now, place in enumerate(places):
        sight.watch(stream, float(now), place)
    assert sight.seen == 1  # one is hidden, two are too far away
    sight.look_from(4.0, np.array([8.0, 1.0, 1.0]), np.zeros(3))
    sight.watch(stream, 4.0, places[1])
    assert sight.seen == 2


def test_a_camera_sees_where_it_looks_and_turns_no_faster_than_it_can(wall: World) -> None:
    eye, rate = np.array([2.0, 2.0, 1.0]), 3.0
    ahead, beside = eye + np.array([1.0, 0.0, 0.0]), eye + np.array([0.0, 1.0, 0.3])
    sight = Sight(wall, SightConfig(field_of_view=np.radians(60.0), turn_rate=rate), eye, seed=0)
    stream = ObservationStream()
    sight.watch(stream, 0.0, ahead)
    assert sight.seen == 1
    places = [ahead + share * (beside - ahead) for share in np.linspace(0.0, 1.0, 6)]
    for cycle, place in enumerate(places, start=1):  # slowly: it follows
        before = sight.looks
        sight.watch(stream, 0.1 * cycle, place)
        assert np.arccos(np.clip(before @ sight.looks, -1.0, 1.0)) <= 0.1 * rate + 1e-6
        assert np.linalg.norm(sight.looks) == pytest.approx(1.0, **relative("formula"))
    assert sight.seen == 7
    sight.watch(stream, 0.7, eye - np.array([0.0, 1.0, 0.0]))  # suddenly behind it: not seen
    assert sight.seen == 7
    unseen = 0
    for cycle in range(8, 40):  # it looks round for it, once where it was is of no use any more
        sight.watch(stream, 0.1 * cycle, eye - np.array([0.0, 1.0, 0.0]))
        unseen += sight.seen == 7
    assert 10 < unseen < 10 + 2.0 * np.pi / rate / 0.1
    assert sight.seen > 8


@pytest.mark.parametrize("speed", [4.0, 8.0])
def test_long_flights_are_fast_clear_and_the_same_again(room: World, speed: float) -> None:
    target = long_flight(room, speed, seed=5)
    times = np.linspace(0.0, target.duration, 2000)
    position, velocity = target.position(times), target.velocity(times)
    assert np.linalg.norm(velocity, axis=1).max() == pytest.approx(speed, rel=1e-3)
    assert np.linalg.norm(np.diff(position, axis=0), axis=1).sum() >= 0.99 * LENGTH
    assert host_free_distance(room, position, 4096).min() > CLEARANCE - 0.02
    assert np.linalg.norm(np.gradient(velocity, times, axis=0), axis=1).max() < 1.05 * MOST_ACCELERATION
    again = long_flight(load_world("env2"), speed, seed=5)
    np.testing.assert_array_equal(again.position(times), position)


@pytest.mark.parametrize("level", range(3))
def test_random_rooms_are_as_full_as_they_should_be(level: int) -> None:
    least, most = CLUTTER[level]
    for seed in range(3):
        own = cluttered_room(least, most, seed)
        assert least <= clutter(own) <= most
    # an independent count: points of which a box's rotation-free bounds hold the coordinates
    boxes = own.obstacles.boxes
    points = np.random.default_rng(0).uniform(*np.asarray(own.bounds), (20_000, 3))
    points[:, 2] = np.asarray(own.bounds)[:, 2].mean()
    inside = (np.abs(points[:, None] - np.asarray(boxes.center)) <= np.asarray(boxes.half)).all(axis=-1).any(axis=1)
    assert inside.mean() == pytest.approx(clutter(own), abs=0.03)


@pytest.mark.parametrize("family", [name for name in FAMILIES if name not in {"recorded", "rooms"}])
def test_every_family_has_episodes_that_can_be_flown(family: str) -> None:
    for level in LEVELS:
        one = case(family, level, 1, seed=0)
        there = one.target.position(np.array([one.departure]))[0]
        assert 0.0 <= one.departure < one.target.duration
        assert host_free_distance(one.world, np.stack([one.start, there])).min() > 0.3
        assert np.linalg.norm(there - one.start) > 0.4
        assert one.known == (family != "evasive")


def test_a_recorded_flight_gets_a_room_around_it(tmp_path) -> None:
    path = tmp_path / "flight.csv"
    times = np.linspace(0.0, 20.0, 400)
    rows = np.stack([times, 5.0 * np.cos(times / 2.0), 5.0 * np.sin(times / 2.0), 1.5 + 0.0 * times], axis=1)
    np.savetxt(path, rows, delimiter=",", header="t,x,y,z", comments="")
    slow, fast = (case("recorded", level, 0, 0, (str(path),)) for level in (1, 3))
    assert fast.target.max_speed == pytest.approx(4.0 * slow.target.max_speed, **relative("formula"))
    assert host_free_distance(fast.world, fast.target.position(np.linspace(0.0, fast.target.duration, 200))).min() > 0.5


def test_fast_navigation_is_the_papers() -> None:
    """Eq. 19, worked out by hand for two geometries, and limited as all laws are."""
    head_on = command(FAST, np.array([0.4, 0.0, 0.0]), np.array([-0.1, 0.0, 0.0]), np.array([0.1, 0, 0]), np.zeros(3))
    np.testing.assert_allclose(head_on, [19.7 * 0.051 * 0.4, 0.0, 0.0], **tolerance("formula"))  # on course: the pull
    passing = command(FAST, np.array([0.3, 0.0, 0.0]), np.array([0.0, 0.1, 0.0]), np.zeros(3), np.array([0, 0.1, 0]))
    ahead = 19.7 * (0.949 * np.array([0.3, 0.3, 0.0]) / 9.0 + 0.051 * np.array([0.3, 0.0, 0.0]))  # 3 s to go
    np.testing.assert_allclose(passing, ahead, **tolerance("formula"))
    rng = np.random.default_rng(0)
    for _ in range(20):
        apart, closing, own = rng.normal(scale=5.0, size=(3, 3))
        assert np.linalg.norm(command(FAST, apart, closing, own, own + closing)) <= COMMANDED * (1.0 + 1e-12)
    fast = command(FAST, np.array([50.0, 1.0, 0.0]), np.array([-13.0, 0.0, 0.0]), np.array([13.0, 0, 0]), np.zeros(3))
    np.testing.assert_allclose(fast[0], 0.0, **tolerance("exact"))
    assert fast[1] > 0.5


def still(position: list[float]) -> Observations:
    return Observations(times=0.1 * np.arange(3), positions=np.tile(np.array(position), (3, 1)))


def test_routed_navigation_flies_around_the_wall(wall: World) -> None:
    aim = around_obstacles(wall)
    corner = aim(np.array([2.0, 2.0, 1.0]), np.array([8.0, 2.0, 1.0]))
    assert corner is not None
    assert corner[1] > 6.0
    assert aim(np.array([2.0, 2.0, 1.0]), np.array([3.5, 2.0, 1.0])) is None
    state = np.zeros((5, 3))
    state[0] = [2.0, 2.0, 1.0]
    straight, around = (law_named("navigation", way)(state, still([8.0, 2.0, 1.0])) for way in (None, aim))
    assert straight[1] == pytest.approx(0.0, **relative("formula"))
    assert around[1] > 0.5


@pytest.mark.skipif(importlib.util.find_spec("osqp") is None, reason="needs OSQP, of the extra peers")
def test_the_point_mass_controller_solves_its_programs_and_reaches_a_target() -> None:
    from scipy.optimize import minimize

    bounds = np.array([[-20.0, -20.0, 0.0], [20.0, 20.0, 10.0]])
    predictor = build_predictor("constant-velocity", PredictionConfig())
    law = PointMassMpc(open_room("open", bounds), predictor)
    state = np.zeros((5, 3))
    state[:2] = [[0.0, 0.0, 2.0], [1.0, -2.0, 0.0]]
    goal = np.array([1.5, 0.5, 2.2])
    own = law(state, still(goal.tolist()))
    times, best = 0.1 * np.arange(1, 11), []
    lags = np.arange(1, 11)[:, None] - np.arange(10)[None]
    for axis in range(3):

        def cost(chosen: np.ndarray, axis: int = axis) -> float:
            place = state[0, axis] + state[1, axis] * times + np.where(lags > 0, 0.01 * (lags - 0.5), 0.0) @ chosen
            return float(((place - goal[axis]) ** 2).sum() + 1e-3 * (chosen**2).sum())

        oracle = minimize(cost, np.zeros(10), bounds=[(-COMMANDED, COMMANDED)] * 10, options={"maxiter": 500})
        best.append(oracle.x[0])
    # the length of what is commanded is limited, too
    np.testing.assert_allclose(own, np.array(best) * min(1.0, COMMANDED / np.linalg.norm(best)), atol=0.1, rtol=0.0)
    for _ in range(40):  # a point mass that does as told
        wanted = law(state, still([8.0, 5.0, 3.0]))
        state[0] += 0.1 * state[1] + 0.005 * wanted
        state[1] += 0.1 * wanted
        assert np.abs(state[1]).max() <= MOST_SPEED + 0.1
    np.testing.assert_allclose(state[0], [8.0, 5.0, 3.0], atol=0.1, rtol=0.0)  # in four seconds


def test_names_that_nobody_has_are_refused() -> None:
    for wrong, match in (
        ({"families": ("stored", "sored")}, "--families: have 'sored'.*did you mean 'stored'"),
        ({"levels": (4,)}, "--levels: have 4"),
        ({"contestants": ("mfrl",)}, "--contestants: have 'mfrl'"),
        ({"contestants": ("mfrl/partcles",)}, "--contestants: have 'mfrl/partcles'.*did you mean 'mfrl/particles'"),
        ({"contestants": ("pursuit/gmm",)}, "--contestants: have 'pursuit/gmm'"),
        ({"episodes": 0}, "--episodes"),
        ({"families": ("recorded",)}, "--recordings"),
    ):
        with pytest.raises(InputError, match=match):
            Config(**wrong)
    with pytest.raises(InputError, match="arena: have 'nothing'"):
        case("nothing", 1, 0, 0)
    assert contestant("navigation").planner == "navigation"


def test_stored_targets_that_come_again_are_departed_for_later() -> None:
    """Nothing else would differ: the same flight twice says what once does."""
    first, again = (case("stored", 3, number, 0, ()) for number in (4, 34))
    assert first.target.name == again.target.name
    assert first.departure == 0.5 < again.departure <= 0.5 + 0.25 * again.target.duration + 0.05
    assert again.departure == case("stored", 3, 34, 0, ()).departure


def test_other_seeds_are_other_episodes() -> None:
    flown = {(seed, number): case("entry", 1, number, seed, ()) for seed in (0, 1) for number in (0, 3)}
    assert len({one.seed for one in flown.values()}) == len({tuple(one.start) for one in flown.values()}) == 4


def test_every_contestant_flies_every_episode_once() -> None:
    config = Config(episodes=2, contestants=("reference", "pursuit", "mfrl/gmm"))
    found = items(config)
    assert len({item.name for item in found}) == len(found) == (2 * 9 - 1 + 9) * 3 * 2
    groups = [item.group for item in found]
    assert groups == sorted(groups, key=groups.index)


def test_the_report_ranks_and_compares_with_the_reference() -> None:
    config = Config(episodes=2, families=("entry",), levels=(1,), contestants=("reference", "pursuit", "mfrl/gmm"))
    listed = items(config)
    shared = {"closest_m": 0.5, "relative_speed_m_s": 5.0, "energy_hover_s": 2.0}
    shared |= {"committed": 2, "changes": 1, "cycles": 4, "outside": 3, "candidates": 12}
    times = {"reference": [1.0, 2.0], "pursuit": [None, None], "mfrl/gmm": [2.0, 8.0]}
    rows = [
        {**item.values, **shared, "outcome": "intercepted" if times[item.group][item.values["number"]] else "collision"}
        | {"time_s": times[item.group][item.values["number"]]}
        for item in listed
    ]
    found = EXPERIMENT.report(Results(config, listed, list(rows), [1.0] * 6, [False] * 6, {}, {}))
    lines = [line for line in found.markdown.splitlines() if line.startswith("|")]
    assert [line.split("|")[1].strip() for line in lines[2:5]] == ["reference", "mfrl/gmm", "pursuit"]
    assert "| mfrl/gmm | 2 | 1.000 |" in lines[3]
    assert "| 2.83 | 5.00 |" in lines[3]  # sqrt(2 * 4), and the median of 2 and 8 s
    assert "| 0.50 | 0.25 | 0.250 |" in lines[3]  # committed, changed, outside
    assert found.summary == "6 episodes; our planners hit something in 0 of 2"


def test_the_picture_is_drawn(tmp_path) -> None:
    config = Config(episodes=1, families=("entry", "evasive"), contestants=("reference", "pursuit", "navigation"))
    listed = items(config)
    rows = [{**item.values, "outcome": "intercepted", "time_s": 1.0} for item in listed]
    found = EXPERIMENT.report(Results(config, listed, rows, [1.0] * len(rows), [False] * len(rows), {}, {}))
    met_soon = next(line for line in found.markdown.split("met within")[1].splitlines() if "| pursuit |" in line)
    assert met_soon.startswith("| 1 | pursuit | 1.000 | 1.000 |")
    found.figures["arena.png"](tmp_path / "arena.png")
    assert (tmp_path / "arena.png").stat().st_size > 10_000
