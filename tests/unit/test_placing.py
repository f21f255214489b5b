"""The placing policy: symmetric by construction, within its bounds, fed with the room as it is, kept as files."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.errors import FileError
from jaxplan.policy.checkpoint import load_policy, resolve_policy
from jaxplan.policy.network import NetworkConfig
from jaxplan.policy.placing import (
    INNER_LEAST,
    INNER_SHARE,
    SEGMENTS,
    SHORTEST,
    STOP_REACH,
    VEHICLE_NUMBERS,
    Courses,
    look_around,
    placing_policy,
    start_placing,
    vehicle_numbers,
)
from jaxplan.policy.placing_checkpoint import load_placing, load_placing_parameters, placing_card, save_placing
from jaxplan.spline import FlatStateBatch
from jaxplan.vehicle.load import load_vehicle
from tolerances import assert_close

SMALL = NetworkConfig(hidden=8, attention=4, latent=4)
WIDTH = 5


@pytest.fixture(scope="module")
def weights():
    """Random ones, large enough that every output matters."""
    return jax.tree.map(lambda leaf: 2.0 * leaf, start_placing(SMALL, jax.random.key(3)))


@pytest.fixture(scope="module")
def place(weights):
    return jax.jit(placing_policy(SMALL, weights))


def courses(seed: int = 0) -> tuple[Courses, FlatStateBatch]:
    """Courses of some metres, flown from states in motion."""
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.uniform(-0.4, 1.2, (SEGMENTS + 1, 3, WIDTH)), axis=0) + 5.0
    room = rng.uniform(0.2, 2.0, (2 * SEGMENTS, 4, WIDTH))
    derivatives = rng.normal(size=(5, 3, WIDTH)) * np.array([0.0, 3.0, 5.0, 20.0, 50.0])[:, None, None]
    derivatives[0] = points[0]
    yaw = np.zeros((3, WIDTH))
    yaw[0] = rng.uniform(-3.0, 3.0, WIDTH)
    numbers = 0.3 * rng.normal(size=(VEHICLE_NUMBERS, WIDTH))
    return Courses(points, room, rng.uniform(0.05, 0.3, WIDTH), numbers), FlatStateBatch(
        derivatives=derivatives, yaw=yaw
    )


def moved(matrix, vectors):
    """Vectors [..., 3, k] of a turned or mirrored world."""
    return np.einsum("ij,...jk->...ik", matrix, np.asarray(vectors))


@pytest.mark.parametrize("angle", [0.7, -2.5])
@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_turned_and_mirrored_courses_get_turned_and_mirrored_plans(place, angle, mirror):
    given, state = courses()
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    matrix = turn @ np.diag([1.0, mirror, 1.0])
    room = np.concatenate([given.room[:, :1], moved(matrix, given.room[:, 1:])], axis=1)
    there = given._replace(points=moved(matrix, given.points), room=room)
    yaw = np.stack([angle + mirror * state.yaw[0], mirror * state.yaw[1], mirror * state.yaw[2]])
    here, beyond = (
        place(given, state),
        place(there, FlatStateBatch(derivatives=moved(matrix, state.derivatives), yaw=yaw)),
    )
    assert_close(beyond.durations, here.durations, "solve", np.float32)
    assert_close(beyond.points, moved(matrix, here.points), "solve", np.float32)


def test_plans_stay_within_what_they_may_move(place):
    given, state = courses(1)
    placed = place(given, state)
    away = np.linalg.norm(np.asarray(placed.points) - given.points, axis=1)
    length = np.linalg.norm(np.diff(given.points, axis=0), axis=1).sum(axis=0)
    assert_close(away[0], np.zeros(WIDTH), "exact", np.float32)
    assert (away[1:-2] <= INNER_SHARE * length / SEGMENTS + INNER_LEAST + 1e-5).all()
    assert (away[-2] <= given.meet_radius + 1e-5).all()
    assert (away[-1] <= STOP_REACH + given.meet_radius + 1e-5).all()
    assert (np.asarray(placed.durations) > SHORTEST).all()
    assert away[1:].max() > 0.05, "weights that move nothing would pass"


def test_a_plan_depends_on_all_that_the_policy_is_told(place):
    given, state = courses(2)
    base = np.asarray(place(given, state).durations)
    others = [
        given._replace(room=given.room + 0.3),
        given._replace(meet_radius=0.5 * given.meet_radius),
        given._replace(vehicle=given.vehicle + 0.5),
    ]
    for other in others:
        assert np.abs(np.asarray(place(other, state).durations) - base).max() > 1e-4
    faster = FlatStateBatch(derivatives=state.derivatives * np.array([1.0, 2, 1, 1, 1])[:, None, None], yaw=state.yaw)
    assert np.abs(np.asarray(place(given, faster).durations) - base).max() > 1e-4


def test_the_room_is_seen_as_it_is():
    """A wall at x = 8: its distance shrinks by a metre for each metre along x, and not along y or z."""
    given, _ = courses(3)
    wall = lambda points: 8.0 - points[..., 0, :]  # noqa: E731
    seen = look_around(wall, np.asarray(given.points))
    middles = 0.5 * (given.points[1:] + given.points[:-1])
    assert_close(seen[:, 0], 8.0 - np.concatenate([given.points[1:], middles])[:, 0], "exact")
    assert_close(seen[:, 1:], np.broadcast_to(np.array([-1.0, 0.0, 0.0])[:, None], seen[:, 1:].shape), "formula")
    traced = jax.jit(lambda points: look_around(wall, points))(jnp.asarray(given.points, jnp.float32))
    assert_close(traced, seen, "solve", np.float32)


def test_vehicle_numbers_say_what_a_vehicle_can():
    own, racer, heavy = (vehicle_numbers(load_vehicle(name)) for name in ("mfrl", "racer5", "x500"))
    assert own.shape == (VEHICLE_NUMBERS,)
    assert np.abs(own).max() < 1.5
    assert racer[0] > own[0] > heavy[0], "thrust to weight"
    assert heavy[-1] > own[-1], "radius"


def test_weights_come_back_from_their_file_and_damaged_ones_do_not(weights, place, tmp_path):
    path = tmp_path / "own.npz"
    save_placing(path, SMALL, weights, {"command": "by hand"})
    given, state = courses(4)
    again = jax.jit(load_placing(path))(given, state)
    np.testing.assert_array_equal(again.points, place(given, state).points)
    assert load_placing_parameters(path).network == SMALL
    assert placing_card(path) == {"command": "by hand"}
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(FileError, match="damaged"):
        load_placing(path)


def test_policies_of_the_other_kind_are_refused_by_name(weights, tmp_path):
    path = tmp_path / "own.npz"
    save_placing(path, SMALL, weights, {})
    with pytest.raises(FileError, match="placing policy"):
        load_policy(path)
    with pytest.raises(FileError, match="want a placing policy"):
        load_placing(resolve_policy("mfrl")[0])


def test_the_shipped_one_comes_by_name_says_how_it_was_made_and_keeps_its_margins_from_hover():
    place, card = load_placing("fleet"), placing_card("fleet")
    assert "jaxplan train placing" in card["command"]
    assert len(card["data"]["sha256"]) == 64
    assert card["held_out"]["kept"][0] > 0.95
    given, state = courses(4)
    placed = place(given, state)
    assert np.isfinite(placed.points).all()
    assert (np.asarray(placed.durations) >= SHORTEST).all()
    with pytest.raises(FileError, match="did you mean 'fleet'"):
        load_placing("flet")
