"""The training set: labelled sequences in shards, each made from its own seed, so that a cut-off run goes on.

One shard is four random rooms and some free space: sequences at rest, and sequences from states in flight on the
fastest flights along the former. The latter are labelled from a second, faster or slower initial state as well, so that
a policy can learn what that state changes. ``dataset.json`` holds what made it and the hash of every shard.
"""

import dataclasses
import functools
import hashlib
import json
import math
import os
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxplan.errors import FileError
from jaxplan.files import LARGEST_ARCHIVE, create_folder, read_arrays, read_limited, write_atomically
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.precision import in_float64
from jaxplan.training.labels import (
    Fly,
    LabelConfig,
    Queries,
    rollout_slowdown,
    rotor_limit_labels,
    sped_up,
    trajectories,
)
from jaxplan.training.sequences import (
    Room,
    free_queries,
    join,
    open_room,
    replan_queries,
    rest_queries,
    suffix_queries,
    take,
)
from jaxplan.training.worlds import random_world
from jaxplan.validation import require_at_least
from jaxplan.vehicle.identity import from_header, require_same_vehicle, to_header
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle

WIDTH = 512
"""Sequences that are labelled together."""
ROOMS = 4
REST_IN_ROOM, REPLAN_IN_ROOM = 96, 384
"""Sequences of each room."""
FREE = WIDTH - ROOMS * REST_IN_ROOM
SHARD_SIZE = WIDTH + ROOMS * REPLAN_IN_ROOM + WIDTH
HELD_OUT = 8
"""Every eighth shard, with all its rooms, is held out for tests."""
RESPONSE = 2.0
"""Largest factor by which initial states are sped up, or slowed down, for their second label."""
_FLOATS = ("waypoints", "derivatives", "yaw", "durations", "slowdown", "alpha", "sped_up")


@dataclasses.dataclass(frozen=True)
class DatasetConfig:
    """What is made."""

    shards: int = 48
    """How many shards, of 2,560 sequences each."""
    seed: int = 1
    """Seed of the rooms and sequences."""
    vehicle: str = "mfrl"
    """For whose limits and rollouts: a preset's name or a TOML file."""
    labels: LabelConfig = LabelConfig()
    """How the labels are searched."""

    def __post_init__(self) -> None:
        require_at_least("dataset", self, 1, "shards")
        require_at_least("dataset", self, 0, "seed")


class Shard(NamedTuple):
    """Labelled sequences, batch axis last."""

    queries: Queries
    durations: Float[np.ndarray, "13 b"]
    """Rotor-limit label [s]."""
    feasible: Bool[np.ndarray, "b"]
    """False where no label was found; the durations mean nothing there."""
    slowdown: Float[np.ndarray, "b"]
    """Factor by which a flight must be slower for the rollout to track it; infinite where none tried was slow
    enough, NaN where none was flown."""
    alpha: Float[np.ndarray, "b"]
    """Factor by which the initial state is sped up for the second label."""
    sped_up: Float[np.ndarray, "13 b"]
    """Rotor-limit label [s] from there; zeros where there is none."""


@runtime_checkable
class Labeller(Protocol):
    """The optimiser's durations at the rotors' limits."""

    def __call__(self, queries: Queries, /) -> tuple[Float[np.ndarray, "m b"], Bool[np.ndarray, "b"]]:
        """Durations [s], and whether there are any (host)."""


@runtime_checkable
class Each(Protocol):
    """Whoever makes shards, in this process or in others."""

    def __call__(self, make: Callable[[int], Shard], numbers: list[int], /) -> Iterator[tuple[int, Shard]]:
        """Call ``make`` with each number and give number and shard, in whatever order."""


def build_labels(vehicle: Vehicle, config: LabelConfig) -> Labeller:
    """The rotor-limit labels of a vehicle, compiled once for each size of a batch."""
    compiled = jax.jit(lambda queries: rotor_limit_labels(vehicle, queries, config))
    return in_float64(lambda queries: jax.tree.map(np.asarray, compiled(queries)))


def build_flights(config: LabelConfig) -> Fly:
    """The planner's trajectories, compiled once for each size of a batch."""
    compiled = jax.jit(lambda queries, durations: trajectories(queries, durations, config.max_yaw_rate))
    return in_float64(lambda queries, durations: jax.tree.map(np.asarray, compiled(queries, durations)))


def in_turn(make: Callable[[int], Shard], numbers: list[int]) -> Iterator[tuple[int, Shard]]:
    """One after the other, in this process."""
    for number in numbers:
        yield number, make(number)


def make_dataset(
    folder: Path, config: DatasetConfig, report: Callable[[str], None] = print, each: Each = in_turn
) -> None:
    """Write the shards that are missing in ``folder``; a dataset may grow, since each shard has its own seed.

    Args:
        each: who makes them, in whatever order.
    """
    create_folder(folder)
    record = {"config": dataclasses.asdict(config), "shard_size": SHARD_SIZE, "held_out_every": HELD_OUT}
    record["vehicle"] = to_header(load_vehicle(config.vehicle))
    stated = folder / "dataset.json"
    if os.path.exists(stated):
        held = read_config(folder)
        if dataclasses.replace(held, shards=config.shards) != config:
            raise FileError(f"{folder}: holds a dataset of another configuration; choose another folder")
        if held.shards > config.shards:
            raise FileError(f"{folder}: is of {held.shards} shards, want no fewer than that, have {config.shards}")
        dataset_vehicle(folder)
    write_atomically(stated, json.dumps(record, indent=1) + "\n")
    missing = [index for index in range(config.shards) if not os.path.exists(shard_path(folder, index))]
    for index, shard in each(functools.partial(flown_shard, config), missing):
        write_shard(shard_path(folder, index), shard)
        labelled, tracked = shard.feasible.mean(), np.mean(shard.slowdown[shard.feasible] == 1.0)
        report(
            f"shard {index + 1} of {config.shards}: {labelled:.1%} labelled, {tracked:.1%} of them tracked at the limit"
        )
    hashes = {path.name: digest(path) for path in (shard_path(folder, index) for index in range(config.shards))}
    write_atomically(stated, json.dumps({**record, "sha256": hashes}, indent=1) + "\n")


def read_config(folder: Path) -> DatasetConfig:
    """What the dataset in ``folder`` was made with."""
    return _read_description(folder)[0]


def dataset_vehicle(folder: Path) -> Vehicle:
    """The vehicle that the dataset in ``folder`` was made for, and that all that is trained on it is for.

    Raises:
        FileError: there is no dataset.
        InputError: the vehicle's file has other numbers now than when the dataset was made.
    """
    config, description = _read_description(folder)
    vehicle = load_vehicle(config.vehicle)
    if "vehicle" in description:  # else it is older than the entry
        require_same_vehicle(f"dataset {folder}", from_header(description), vehicle)
    return vehicle


def _read_description(folder: Path) -> tuple[DatasetConfig, dict[str, Any]]:
    """The configuration in ``dataset.json``, and all of that file."""
    stated = folder / "dataset.json"
    try:
        description = json.loads(stated.read_text())
        config = description["config"]
        labels = LabelConfig(**{**config["labels"], "span": tuple(config["labels"]["span"])})
        return DatasetConfig(**{**config, "labels": labels}), description
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise FileError(f"{stated}: is not a dataset's description ({error}); use jaxplan train dataset") from error


def flown_shard(config: DatasetConfig, index: int) -> Shard:
    """Shard ``index`` of a dataset with the labels of the rotor limits and of rollouts."""
    vehicle, label, fly = _tools(config)
    shard = make_shard(config, index, label, fly)
    slowdown = rollout_slowdown(vehicle, shard.queries, shard.durations, shard.feasible, fly)
    return shard._replace(slowdown=slowdown)


@functools.lru_cache(maxsize=1)
def _tools(config: DatasetConfig) -> tuple[Vehicle, Labeller, Fly]:
    """What is compiled once in a process."""
    vehicle = load_vehicle(config.vehicle)
    return vehicle, build_labels(vehicle, config.labels), build_flights(config.labels)


def make_shard(config: DatasetConfig, index: int, label: Labeller, fly: Fly) -> Shard:
    """Shard ``index`` of a dataset with the labels of the rotor limits, from its own seed."""
    rng = np.random.default_rng([config.seed, index])
    rooms: list[Room] = []
    rest: list[Queries] = []
    while len(rooms) < ROOMS:
        room = open_room(random_world(rng, index * ROOMS + len(rooms)))
        queries = rest_queries(room, rng, REST_IN_ROOM)
        if queries is not None:
            rooms.append(room)
            rest.append(queries)
    first = join([*rest, free_queries(rng, FREE)])
    durations, feasible = label(first)
    flights = fly(first, durations)
    parts = [(first, durations, feasible, np.ones(WIDTH), np.zeros_like(durations))]
    moving = [_replans(room, rng, place, first, flights, feasible) for place, room in enumerate(rooms)]
    free = np.arange(ROOMS * REST_IN_ROOM, WIDTH)
    chosen = rng.choice(free[feasible[free]], WIDTH)
    moving.append(suffix_queries(rng, take(first, chosen), jax.tree.map(lambda leaf: leaf[..., chosen], flights)))
    whole = join(moving)
    for begin in range(0, whole.count.shape[0], WIDTH):
        chunk = take(whole, np.arange(begin, begin + WIDTH))
        alpha = np.exp(rng.uniform(-math.log(RESPONSE), math.log(RESPONSE), WIDTH))
        again, possible = label(sped_up(chunk, alpha))
        parts.append((chunk, *label(chunk), alpha, np.where(possible, again, 0.0)))
    chunks, labels, found, alphas, second = zip(*parts, strict=True)
    return Shard(
        queries=join(list(chunks)),
        durations=np.concatenate(labels, axis=-1),
        feasible=np.concatenate(found),
        slowdown=np.full(SHARD_SIZE, np.nan),
        alpha=np.concatenate(alphas),
        sped_up=np.concatenate(second, axis=-1),
    )


def _replans(
    room: Room, rng: np.random.Generator, place: int, first: Queries, flights: SplineBatch, feasible: np.ndarray
) -> Queries:
    """Sequences from states in flight; sequences at rest again where the room is too full to find enough."""
    own = np.arange(place * REST_IN_ROOM, (place + 1) * REST_IN_ROOM)
    own = own[feasible[own]]
    found = replan_queries(
        room, rng, take(first, own), jax.tree.map(lambda leaf: leaf[..., own], flights), REPLAN_IN_ROOM
    )
    return found if found is not None else take(first, rng.choice(own, REPLAN_IN_ROOM))


def shard_path(folder: Path, index: int) -> Path:
    """The file of a shard."""
    return folder / f"shard-{index:04d}.npz"


def write_shard(path: Path, shard: Shard) -> None:
    """Whole or not at all."""

    def write(staged: Path) -> None:
        np.savez_compressed(
            staged,
            waypoints=np.asarray(shard.queries.waypoints, np.float32),
            count=np.asarray(shard.queries.count, np.int32),
            derivatives=np.asarray(shard.queries.derivatives, np.float32),
            yaw=np.asarray(shard.queries.yaw, np.float32),
            durations=np.asarray(shard.durations, np.float32),
            feasible=shard.feasible,
            slowdown=np.asarray(shard.slowdown, np.float32),
            alpha=np.asarray(shard.alpha, np.float32),
            sped_up=np.asarray(shard.sped_up, np.float32),
        )

    write_atomically(path, write)


def read_shard(path: Path) -> Shard:
    """A shard of ``make_dataset``."""
    try:
        data = read_arrays(read_limited(path, LARGEST_ARCHIVE, "a shard of jaxplan train dataset"))
        wide = {name: data[name].astype(float) for name in _FLOATS}
        queries = Queries(wide["waypoints"], data["count"], wide["derivatives"], wide["yaw"])
        labels = wide["durations"], data["feasible"], wide["slowdown"]
        return Shard(queries, *labels, wide["alpha"], wide["sped_up"])
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise FileError(f"{path}: cannot be read as a shard of a training set ({error}); make it again") from error


def is_held_out(index: int) -> bool:
    """Whether a shard is kept from training."""
    return index % HELD_OUT == HELD_OUT - 1


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
