"""Looking for a target that nobody sees: what is seen from where, and where to look next."""

import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.prediction.kernels.views import seen_from
from jaxplan.prediction.lookout import Lookout, LookoutConfig, Views, views_of
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.predictors import build_predictor
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.search.kernels.solids import solids_of
from jaxplan.status import Note, Reason
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World, aligned_boxes, make_obstacles

PREDICTION = PredictionConfig()


@pytest.fixture(scope="module")
def room() -> World:
    """Of 12 x 8 x 3 m, with a wall that leaves a way around its southern end."""
    wall = aligned_boxes(np.array([[-0.5, -2.0, 0.0]]), np.array([[0.5, 4.0, 3.0]]))
    bounds = np.array([[-6.0, -4.0, 0.0], [6.0, 4.0, 3.0]])
    return World(
        name="two rooms", bounds=bounds, obstacles=make_obstacles(boxes=wall), keep_in=np.array(0.2), provenance="drawn"
    )


@pytest.fixture(scope="module")
def views(room: World) -> Views:
    return views_of(room)


def lookout(room: World, views: Views, **numbers: float) -> Lookout:
    config = LookoutConfig(**numbers)
    return Lookout(
        build_predictor("constant-velocity", PREDICTION, None, 0, None, room), room, PREDICTION, config, views
    )


def seen_at(position: np.ndarray, age: float = 0.0) -> Observations:
    return Observations(times=0.1 * np.arange(3), positions=np.tile(position, (3, 1)), age=age)


def test_lines_of_sight_are_those_of_dense_samples() -> None:
    world, rng = load_world("env1"), np.random.default_rng(0)
    lower, upper = np.asarray(world.bounds)
    eyes, places = rng.uniform(lower, upper, (40, 3)), rng.uniform(lower, upper, (50, 3))
    lines = eyes[:, None, None] + np.linspace(0.0, 1.0, 400)[:, None] * (places[None] - eyes[:, None])[:, :, None]
    solid = make_world_without_faces(world)
    least = host_free_distance(solid, lines.reshape(-1, 3), 1024).reshape(40, 50, 400).min(axis=-1)
    seen = seen_from(solids_of(world), eyes, places, np.inf)
    assert seen[least > 0.05].all()
    assert not seen[least < 0.0].any()
    assert 0.2 < seen.mean() < 0.9
    apart = np.linalg.norm(eyes[:, None] - places[None], axis=-1)
    np.testing.assert_array_equal(seen_from(solids_of(world), eyes, places, 4.0), seen & (apart <= 4.0))


def make_world_without_faces(world: World) -> World:
    """The same obstacles in a room so large that its faces are far from everything."""
    return World(
        name="",
        bounds=np.asarray(world.bounds) + np.array([[-50.0], [50.0]]),
        obstacles=world.obstacles,
        keep_in=np.array(0.0),
        provenance="",
    )


def test_places_are_free_and_connected(room: World, views: Views) -> None:
    assert 40 < len(views.places) < 400
    assert (host_free_distance(room, views.places, 256) >= 0.6 - 1e-9).all()
    assert (views.seen == views.seen.T).all()
    assert views.seen.diagonal().all()
    assert views_of(load_world("env3")).seen.shape[0] < 700


def test_what_is_in_view_is_looked_at_and_forgotten_again(room: World, views: Views) -> None:
    looking = lookout(room, views, dwell=0.2, forgotten=5.0)
    west = np.array([-4.0, 1.0, 1.5])
    for step in range(20):
        looking.look_from(0.1 * step, west)
    near, far = views.places[:, 0] < -1.0, (views.places[:, 0] > 1.0) & (views.places[:, 1] > 1.0)
    assert looking.unseen[near].max() < 0.1 < 0.99 < looking.unseen[far].min()
    looking.look_from(60.0, np.array([4.0, 1.0, 1.5]))
    assert looking.unseen[near].min() > 0.99


def test_a_camera_that_turns_takes_longer(room: World, views: Views) -> None:
    looking = lookout(room, views, dwell=2.0)
    for step in range(5):
        looking.look_from(0.1 * step, np.array([-4.0, 1.0, 1.5]))
    assert looking.unseen[views.places[:, 0] < -1.0].min() > 0.2


def test_it_looks_behind_the_wall_and_on(room: World, views: Views) -> None:
    """Until all has been seen; each time from a place that sees what was not."""
    looking, place = lookout(room, views, forgotten=1e6), np.array([-5.0, 3.0, 1.5])
    for step in range(200):
        looking.look_from(0.1 * step, place)
        found = looking(None, step)
        assert found.note == int(Note.SEARCHING)
        assert found.futures is not None
        goal = np.asarray(found.goals)[0]
        assert (np.asarray(found.goals) == goal).all()
        assert (np.asarray(found.reasons) == 0).all()
        way = goal - place
        place = place + way * min(1.0, 0.5 / max(float(np.linalg.norm(way)), 1e-9))
        if looking.unseen.max() < 0.5:
            break
    assert looking.unseen.max() < 0.5
    assert step < 60  # 30 m of flying


def test_a_target_that_is_seen_is_the_predictors_and_a_lost_one_is_looked_for_where_it_was(
    room: World, views: Views
) -> None:
    looking, own = lookout(room, views), build_predictor("constant-velocity", PREDICTION, None, 0, None, room)
    looking.look_from(0.0, np.array([-5.0, 3.0, 1.5]))
    corner = np.array([4.5, 3.0, 1.5])
    given, want = looking(seen_at(corner), 0), own(seen_at(corner), 0)
    np.testing.assert_array_equal(given.goals, want.goals)
    assert given.note == want.note
    looking.look_from(1.5, np.array([-5.0, 3.0, 1.5]))
    assert (np.asarray(own(seen_at(corner, 1.5), 1).reasons) == np.uint32(Reason.TARGET_LOST)).all()
    lost = looking(seen_at(corner, 1.5), 1)
    assert lost.note == int(Note.SEARCHING)
    assert seen_from(views.solids, np.asarray(lost.goals)[:1], corner[None], np.inf).all()


def test_who_cannot_get_anywhere_stays(room: World, views: Views) -> None:
    looking = lookout(room, views)
    looking.look_from(0.0, np.array([0.0, 1.0, 1.5]))  # within the wall
    assert (np.asarray(looking(None, 0).reasons) == np.uint32(Reason.NONFINITE)).all()
    assert (
        np.asarray(lookout(room, views)(None, 0).reasons) == np.uint32(Reason.NONFINITE)
    ).all()  # not told where it is


def test_what_means_nothing_is_refused(room: World, views: Views) -> None:
    for numbers in ({"dwell": 0.0}, {"sight_range": 0.0}, {"sight_range": np.nan}, {"pace": -1.0}):
        with pytest.raises(InputError, match=next(iter(numbers))):
            LookoutConfig(**numbers)
    with pytest.raises(InputError, match="position"):
        lookout(room, views).look_from(0.0, np.array([np.nan, 0.0, 1.0]))
