"""The training set: labelled sequences in shards, each made from its own seed, so that a cut-off run goes on.

One shard is four random rooms and some free space: sequences at rest, and sequences from states in flight on the
fastest flights along the former. The latter are labelled from a second, faster or slower initial state as well, so that
a policy can learn what that state changes. ``dataset.json`` holds what made it and the hash of every shard.
"""

import dataclasses
import functools
import hashlib
import io
import json
import math
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxplan.errors import FileError, InputError
from jaxplan.files import create_folder, write_atomically
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.precision import in_float64
from jaxplan.training.labels import (
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
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle

LANES = 512
"""Sequences that are labelled together."""
ROOMS = 4
REST_IN_ROOM, REPLAN_IN_ROOM = 96, 384
"""Sequences of each room."""
FREE = LANES - ROOMS * REST_IN_ROOM
SHARD_SIZE = LANES + ROOMS * REPLAN_IN_ROOM + LANES
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
    """A preset's name or a TOML file."""
    labels: LabelConfig = LabelConfig()
    """How the labels are searched."""

    def __post_init__(self) -> None:
        if self.shards < 1 or self.seed < 0:
            raise InputError(f"dataset: have {self.shards} shards and seed {self.seed}, want at least 1 and 0")


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


Labeller = Callable[[Queries], tuple[np.ndarray, np.ndarray]]
Flyer = Callable[[Queries, Float[np.ndarray, "m b"]], SplineBatch]
Each = Callable[[Callable[[int], Shard], list[int]], Iterator[tuple[int, Shard]]]
"""Calls a function with each number and gives what it returns, in whatever order."""


def build_labels(vehicle: Vehicle, config: LabelConfig) -> Labeller:
    compiled = jax.jit(lambda queries: rotor_limit_labels(vehicle, queries, config))
    return in_float64(lambda queries: jax.tree.map(np.asarray, compiled(queries)))


def build_flights(config: LabelConfig) -> Flyer:
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
    stated = folder / "dataset.json"
    if stated.exists():
        held = read_config(folder)
        if dataclasses.replace(held, shards=config.shards) != config:
            raise FileError(f"{folder}: holds a dataset of another configuration; choose another folder")
        if held.shards > config.shards:
            raise FileError(f"{folder}: is of {held.shards} shards, want no fewer than that, have {config.shards}")
    write_atomically(stated, json.dumps(record, indent=1) + "\n")
    missing = [index for index in range(config.shards) if not shard_path(folder, index).exists()]
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
    stated = folder / "dataset.json"
    try:
        config = json.loads(stated.read_text())["config"]
        labels = LabelConfig(**{**config["labels"], "span": tuple(config["labels"]["span"])})
        return DatasetConfig(**{**config, "labels": labels})
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise FileError(f"{stated}: is not a dataset's description ({error}); use jaxplan train dataset") from error


def flown_shard(config: DatasetConfig, index: int) -> Shard:
    """Shard ``index`` of a dataset with the labels of the rotor limits and of rollouts."""
    vehicle, label, fly = _tools(config)
    shard = make_shard(config, index, label, fly)
    slowdown = rollout_slowdown(vehicle, shard.queries, shard.durations, shard.feasible, fly)
    return shard._replace(slowdown=slowdown)


@functools.lru_cache(maxsize=1)
def _tools(config: DatasetConfig) -> tuple[Vehicle, Labeller, Flyer]:
    """What is compiled once in a process."""
    vehicle = load_vehicle(config.vehicle)
    return vehicle, build_labels(vehicle, config.labels), build_flights(config.labels)


def make_shard(config: DatasetConfig, index: int, label: Labeller, fly: Flyer) -> Shard:
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
    parts = [(first, durations, feasible, np.ones(LANES), np.zeros_like(durations))]
    moving = [_replans(room, rng, place, first, flights, feasible) for place, room in enumerate(rooms)]
    free = np.arange(ROOMS * REST_IN_ROOM, LANES)
    lanes = rng.choice(free[feasible[free]], LANES)
    moving.append(suffix_queries(rng, take(first, lanes), jax.tree.map(lambda leaf: leaf[..., lanes], flights)))
    whole = join(moving)
    for begin in range(0, whole.count.shape[0], LANES):
        chunk = take(whole, np.arange(begin, begin + LANES))
        alpha = np.exp(rng.uniform(-math.log(RESPONSE), math.log(RESPONSE), LANES))
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
    lanes = np.arange(place * REST_IN_ROOM, (place + 1) * REST_IN_ROOM)
    lanes = lanes[feasible[lanes]]
    found = replan_queries(
        room, rng, take(first, lanes), jax.tree.map(lambda leaf: leaf[..., lanes], flights), REPLAN_IN_ROOM
    )
    return found if found is not None else take(first, rng.choice(lanes, REPLAN_IN_ROOM))


def shard_path(folder: Path, index: int) -> Path:
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
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as data:
            wide = {name: data[name].astype(float) for name in _FLOATS}
            queries = Queries(wide["waypoints"], data["count"], wide["derivatives"], wide["yaw"])
            labels = wide["durations"], data["feasible"], wide["slowdown"]
            return Shard(queries, *labels, wide["alpha"], wide["sped_up"])
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise FileError(f"{path}: cannot be read as a shard of a training set ({error}); make it again") from error


def is_held_out(index: int) -> bool:
    return index % HELD_OUT == HELD_OUT - 1


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
