"""Ways through random rooms: what the placing policy is asked to fly (host).

Shards of rooms, each room made from its own seed, so that a run that was cut off goes on. Only the courses are kept;
rooms are made anew from their seeds.
"""

import dataclasses
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxplan.errors import FileError, InputError
from jaxplan.files import (
    LARGEST_ARCHIVE,
    create_folder,
    read_arrays,
    read_limited,
    state_configuration,
    write_atomically,
)
from jaxplan.knots import resample
from jaxplan.planner.validator import Room as Solid
from jaxplan.policy.placing import SEGMENTS
from jaxplan.precision import in_float64
from jaxplan.search.kernels.solids import solids_of
from jaxplan.search.routes import find_routes
from jaxplan.search.stops import stop_points
from jaxplan.training.sequences import CORNERS, GOALS_PER_SEARCH, PADDING, Room, open_room
from jaxplan.training.worlds import random_world
from jaxplan.validation import require_at_least
from jaxplan.world.obstacles import World

ROOMS = 32
"""Of a shard."""
IN_ROOM, FROM_ONE = 64, 8
"""Courses of a room, and of one start."""
HELD_OUT = 8
"""Every eighth shard, with all its rooms, is for tests."""
FAR = (1.0, 14.0)
"""Least and largest distance of goals [m]."""
_LEVEL = np.array([1.0, 1.0, 0.2])
"""How much goals differ along x, y and z."""
_ATTEMPTS, _TRIES = 32, 8
"""Rooms that are tried for one, and random starts in a room of one's own for each course."""


@dataclasses.dataclass(frozen=True)
class CourseConfig:
    """What is made."""

    shards: int = 24
    """How many shards, of 32 rooms with 64 courses each."""
    seed: int = 11
    """Seed of the rooms and courses."""

    def __post_init__(self) -> None:
        require_at_least("courses", self, 1, "shards")
        require_at_least("courses", self, 0, "seed")


class CourseSet(NamedTuple):
    """Rooms and ways through them."""

    worlds: World
    """r of them, with a leading axis, float32."""
    points: Float[np.ndarray, "r c 7 3"]
    """Start, four points at even distances, goal, and a stop behind it [m, world]."""


def make_courses(folder: Path, config: CourseConfig, report: Callable[[str], None] = print) -> None:
    """Write the shards that are missing in ``folder``."""
    create_folder(folder)
    state_configuration(folder, dataclasses.asdict(config), may_differ=("shards",))
    for shard in range(config.shards):
        path = _path(folder, shard)
        if not os.path.exists(path):
            rooms = [_room(config.seed, shard * ROOMS + number) for number in range(ROOMS)]
            arrays = {
                "attempts": np.array([room[0] for room in rooms]),
                "points": np.stack([room[1] for room in rooms]),
            }
            write_atomically(path, lambda file, arrays=arrays: np.savez_compressed(file, **arrays))
        report(f"shard {shard + 1} of {config.shards}: {ROOMS} rooms, {ROOMS * IN_ROOM} courses")


def load_courses(folder: Path, *, held_out: bool) -> CourseSet:
    """All rooms and courses for training, or those for tests.

    Raises:
        FileError: no shards of that kind, or what is there is none.
    """
    config = read_course_config(folder)
    worlds, points = [], []
    for shard in range(config.shards):
        path = _path(folder, shard)
        if (shard % HELD_OUT == HELD_OUT - 1) != held_out or not os.path.exists(path):
            continue
        arrays = read_arrays(read_limited(path, LARGEST_ARCHIVE, "courses, written by jaxplan train courses"))
        attempts = arrays["attempts"].tolist()
        worlds += [_world(config.seed, shard * ROOMS + number, attempt) for number, attempt in enumerate(attempts)]
        points.append(arrays["points"])
    if not worlds:
        raise FileError(f"{folder}: has no {'held-out' if held_out else 'training'} courses; make more shards")
    nameless = [world.nameless() for world in worlds]
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves).astype(np.float32), *nameless)
    return CourseSet(stacked, np.concatenate(points))


def courses_in(world: World, seed: int, count: int) -> Float[np.ndarray, "c 7 3"]:
    """So many courses through a room of one's own, as ``CourseSet.points`` has them.

    Raises:
        InputError: the room is too full for that many.
    """
    found = _courses(open_room(world), np.random.default_rng([seed, 2]), count, _TRIES * count)
    if found is None:
        raise InputError(f"courses: the room {world.name!r} has fewer than {count}; want one with more space")
    return found


def read_course_config(folder: Path) -> CourseConfig:
    """What the courses in ``folder`` were made with."""
    stated = folder / "config.json"
    try:
        return CourseConfig(**json.loads(stated.read_text()))
    except (OSError, TypeError, ValueError) as error:
        raise FileError(f"{stated}: does not describe courses ({error}); use jaxplan train courses") from error


def _path(folder: Path, shard: int) -> Path:
    return folder / f"courses-{shard:04d}.npz"


def _world(seed: int, index: int, attempt: int) -> World:
    return random_world(np.random.default_rng([seed, index, attempt]), index)


def _room(seed: int, index: int) -> tuple[int, Float[np.ndarray, "c 7 3"]]:
    """The first of a few random rooms that has enough courses, and these."""
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, index, attempt, 1])
        found = _courses(open_room(_world(seed, index, attempt)), rng, IN_ROOM, 4 * IN_ROOM // FROM_ONE)
        if found is not None:
            return attempt, found
    raise InputError(f"courses: no room {index} of seed {seed} has any; take another seed")


def _courses(room: Room, rng: np.random.Generator, count: int, starts: int) -> Float[np.ndarray, "c 7 3"] | None:
    """So many courses, from so many random starts at most; None where the room is too full."""
    parts: list[Any] = []
    solid = Solid(tuple(solids_of(room.world)), np.asarray(room.world.bounds, dtype=np.float64))
    for _ in range(starts):
        lower, upper = solid.bounds
        start = rng.uniform(lower + PADDING, upper - PADDING)
        if solid.free_distance(start[None])[0] < PADDING:
            continue
        away = rng.normal(size=(GOALS_PER_SEARCH, 3)) * _LEVEL
        away *= rng.uniform(*FAR, (GOALS_PER_SEARCH, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
        goals = start + away
        goals = goals[((goals > lower + PADDING) & (goals < upper - PADDING)).all(axis=1)]
        if not len(goals):
            continue
        goals = np.resize(goals, (GOALS_PER_SEARCH, 3))
        paths = find_routes(room.lattices, room.world, start, goals, float(np.mean(FAR)), capacity=CORNERS)
        good = np.flatnonzero(paths.reasons == 0)[:FROM_ONE]
        stops = stop_points(room.lattices, room.world, paths)
        parts.append(np.concatenate([np.asarray(_even(np.asarray(paths.points))), stops[:, None]], axis=1)[good])
        if sum(map(len, parts)) >= count:
            return np.concatenate(parts)[:count].astype(np.float32)
    return None


@in_float64
@jax.jit
def _even(paths: Float[Array, "k l 3"]) -> Float[Array, "k 6 3"]:
    return jax.vmap(lambda path: resample(path, SEGMENTS))(paths)
