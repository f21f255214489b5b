"""How the placing policy is made: free courses, problems on its own flights, a loss that is the time of a good plan."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.errors import FileError, InputError
from jaxplan.minsnap.spline_batch import fit_each
from jaxplan.policy.network import NetworkConfig, PolicyNetwork
from jaxplan.policy.placing import OUTPUTS, SEGMENTS, place_waypoints, start_placing
from jaxplan.precision import in_float64
from jaxplan.records import replace
from jaxplan.training.placing import courses as made
from jaxplan.training.placing.courses import CourseConfig, CourseSet, courses_in, load_courses, make_courses
from jaxplan.training.placing.loss import PlacingLoss, judge, keep_of
from jaxplan.training.placing.problems import distance_in, from_hover, in_flight, solved
from jaxplan.training.placing.run import PlacingConfig, train_placing
from jaxplan.training.placing.vehicles import fleet, random_vehicle
from jaxplan.training.sequences import PADDING
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.report import MASSES, RATIOS, thrust_to_weight
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import aligned_boxes, make_obstacles
from tolerances import assert_close

SMALL = NetworkConfig(hidden=8, attention=4, latent=4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, monkeypatch_module):
    """A few small shards."""
    monkeypatch_module.setattr(made, "ROOMS", 2)
    monkeypatch_module.setattr(made, "IN_ROOM", 8)
    monkeypatch_module.setattr(made, "HELD_OUT", 2)
    path = tmp_path_factory.mktemp("courses")
    make_courses(path, CourseConfig(shards=2, seed=3), report=lambda line: None)
    return path


@pytest.fixture(scope="module")
def monkeypatch_module():
    with pytest.MonkeyPatch.context() as patch:
        yield patch


@pytest.fixture(scope="module")
def some(folder) -> CourseSet:
    return load_courses(folder, held_out=False)


def lanes(courses: CourseSet):
    """Points of all courses, batch axis last, room by room."""
    points = courses.points.reshape(-1, *courses.points.shape[2:])
    return np.moveaxis(points, 0, -1).astype(np.float32)


def test_courses_are_ways_through_their_rooms(some):
    assert some.points.shape == (2, 8, SEGMENTS + 1, 3)
    for room, points in enumerate(some.points):
        world = jax.tree.map(lambda leaf, room=room: leaf[room], some.worlds)
        ends = points[:, [0, -2]].reshape(-1, 3)
        assert (host_free_distance(world, ends) > PADDING - 0.01).all()
        steps = np.linalg.norm(np.diff(points[:, :-1], axis=1), axis=2)
        assert (steps.max(axis=1) < 2.0 * steps.mean(axis=1)).all(), "cut evenly, but for corners"


def test_courses_that_were_cut_off_are_made_to_the_end_and_alike(folder, tmp_path, monkeypatch):
    lines: list[str] = []
    make_courses(tmp_path / "again", CourseConfig(shards=1, seed=3), report=lines.append)
    monkeypatch.setattr(made, "_room", lambda *_: pytest.fail("the first shard is there"))
    make_courses(tmp_path / "again", CourseConfig(shards=1, seed=3), report=lines.append)
    monkeypatch.undo()
    monkeypatch.setattr(made, "ROOMS", 2)
    monkeypatch.setattr(made, "IN_ROOM", 8)
    first, again = (np.load(path / "courses-0000.npz") for path in (folder, tmp_path / "again"))
    np.testing.assert_array_equal(first["points"], again["points"])
    with pytest.raises(InputError, match="seed"):
        make_courses(tmp_path / "again", CourseConfig(shards=1, seed=4))


def test_what_is_no_folder_of_courses_is_refused(tmp_path):
    with pytest.raises(FileError, match="train courses"):
        load_courses(tmp_path, held_out=False)
    (tmp_path / "config.json").write_text(json.dumps({"shards": 1, "seed": 3}))
    with pytest.raises(FileError, match="make more shards"):
        load_courses(tmp_path, held_out=False)


def test_random_vehicles_are_of_all_sizes():
    rng = np.random.default_rng(1)
    vehicles = [random_vehicle(rng) for _ in range(40)]
    masses, ratios = np.array([(float(one.mass), thrust_to_weight(one)) for one in vehicles]).T
    assert (masses >= MASSES[0]).all()
    assert (masses <= MASSES[1]).all()
    assert masses.max() / masses.min() > 20.0
    assert (ratios >= RATIOS[0] * 0.999).all()
    assert (ratios <= RATIOS[1] * 1.001).all()
    crew = fleet(vehicles).of(np.array([3, 3, 7]))
    np.testing.assert_allclose(crew.vehicles.mass, np.float32([masses[3], masses[3], masses[7]]))


@in_float64
def flown(some: CourseSet, seed: int = 0):
    """Problems from hover, their plans by the courses themselves, and what is left of those."""
    points = jnp.asarray(lanes(some))
    crew = fleet([load_vehicle("mfrl")]).of(np.zeros(points.shape[-1], int))
    distance, keep = distance_in(some.worlds, len(some.points)), keep_of(crew.vehicles)
    first = from_hover(points, crew, keep, distance, jax.random.key(seed))
    durations = jnp.full((SEGMENTS, points.shape[-1]), 0.7, jnp.float32)
    spline = fit_each(
        jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), first.initial),
        jnp.asarray(points, jnp.float64),
        jnp.asarray(durations, jnp.float64),
        0.0,
    )
    spline = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), spline)
    meeting = jnp.sum(durations[:-1], axis=0)
    return first, spline, in_flight(spline, meeting, crew, keep, distance, jax.random.key(seed + 1)), distance


def test_distances_are_those_of_each_lane_s_own_room(some):
    points = lanes(some)
    found = np.asarray(distance_in(some.worlds, 2)(points))
    for room in range(2):
        world = jax.tree.map(lambda leaf, room=room: leaf[room], some.worlds)
        own = points[..., 8 * room : 8 * (room + 1)]
        exact = host_free_distance(world, np.moveaxis(own, 1, -1).reshape(-1, 3)).reshape(own.shape[0], 8)
        np.testing.assert_allclose(found[:, 8 * room : 8 * (room + 1)], exact, atol=1e-4)


@pytest.mark.slow
def test_problems_in_flight_lie_on_the_flights_that_they_are_left_of(some):
    first, spline, left, _ = flown(some)
    assert first.good.all()
    derivatives = np.asarray(left.initial.derivatives)
    for lane in range(derivatives.shape[-1]):
        exact = spline.spline(lane)
        times = np.linspace(0.0, float(exact.duration), 4000)
        states = np.asarray(exact.state(times).derivatives)
        here = states[np.argmin(np.linalg.norm(states[:, 0] - derivatives[0, :, lane], axis=1))]
        ratio = np.linalg.norm(derivatives[1, :, lane]) / max(np.linalg.norm(here[1]), 1e-6)
        assert np.linalg.norm(here[0] - derivatives[0, :, lane]) < 0.02
        assert 0.59 < ratio < 1.02, "as fast as the flight, or slowed down as an arrival is matched"
    np.testing.assert_allclose(np.asarray(left.courses.points)[0], derivatives[0], atol=0.05)
    goals = np.asarray(left.courses.points)[-2] - np.asarray(first.courses.points)[-2]
    assert np.linalg.norm(goals, axis=0).max() > 0.05, "goals move"


@pytest.mark.slow
def test_a_gentle_plan_costs_its_time_and_a_hasty_one_more(some):
    """With weights of 0 the plans go along the courses, in the time that the outputs' bias says."""
    first, _, _, distance = flown(some)
    crew = fleet([load_vehicle("mfrl")]).of(np.zeros(first.good.shape[0], int))
    config, network = PlacingLoss(), PolicyNetwork(SMALL, OUTPUTS)
    zero = jax.tree.map(jnp.zeros_like, start_placing(SMALL, jax.random.key(0)))

    def judged(log_duration: float):
        weights = jax.tree.map(lambda leaf: leaf, zero)
        head = weights["params"]["head_1"]
        head["bias"] = head["bias"].at[0].set(log_duration)
        return in_float64(judge)(network, weights, first, crew, distance, config)

    slow, hasty = judged(2.0), judged(-2.0)
    gentle = np.asarray(slow.least) > 0.05
    assert gentle.mean() > 0.5
    times = np.asarray(slow.meeting) + config.stopping * np.asarray(slow.splines.durations).sum(axis=0)
    assert_close(np.asarray(slow.loss)[gentle], times[gentle], "formula", np.float32)
    assert (np.asarray(hasty.least) < -1.0).all()
    assert (np.asarray(hasty.loss) > np.asarray(hasty.meeting) + 1.0).all()


@pytest.mark.slow
def test_plans_hold_their_heading_and_end_at_rest(some):
    first, *_ = flown(some)
    network, weights = PolicyNetwork(SMALL, OUTPUTS), start_placing(SMALL, jax.random.key(0))
    placed = in_float64(place_waypoints)(network, weights, first.courses, first.initial)
    splines = in_float64(solved)(first.initial, placed)
    end = np.asarray(splines.derivatives(np.array([1.0])))[-1, 0]
    assert np.abs(end[1:3]).max() < 0.05
    np.testing.assert_allclose(
        np.asarray(splines.yaw)[:, 0, 0], np.broadcast_to(np.asarray(first.initial.yaw)[0], (6, len(first.good)))
    )


@pytest.mark.slow
def test_training_makes_plans_better_and_goes_on_where_it_stopped(folder, tmp_path):
    config = PlacingConfig(
        network=SMALL, steps=60, rooms=2, courses=8, generations=1, evaluate_every=30, learning_rate=1e-2
    )
    lines: list[str] = []
    _, score = train_placing(tmp_path / "run", folder, config, report=lines.append)
    rows = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [30, 60]
    assert len(score.loss) == 2
    assert sum(score.loss) <= sum(rows[0]["loss"]) + 1e-6
    _, same = train_placing(tmp_path / "run", folder, config, report=lines.append)
    assert same == score
    assert len((tmp_path / "run" / "metrics.jsonl").read_text().splitlines()) == 2


def test_courses_lead_through_a_room_of_one_s_own():
    world = load_world("env1")
    points = courses_in(world, 3, 20)
    assert points.shape == (20, 7, 3)
    assert (host_free_distance(world, points[:, [0, -2]].reshape(-1, 3).astype(float), 4096) > PADDING - 0.1).all()
    np.testing.assert_array_equal(points, courses_in(world, 3, 20))
    assert (points != courses_in(world, 4, 20)).any()
    solid = replace(world, obstacles=make_obstacles(boxes=aligned_boxes(*(corner[None] for corner in world.bounds))))
    with pytest.raises(InputError, match="more space"):
        courses_in(solid, 3, 20)
