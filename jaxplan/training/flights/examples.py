"""Flights for the network that foretells them: random ones through random rooms, seen well and badly (host).

Shards of rooms, each made from its own seed, so that a run that was cut off goes on and several processes share the
work. In a shard three quarters of the rooms are random, one is a stored one and one is open space; flights of other
people's vehicles may be mixed in. A window is shown twice, exactly or with noise, whole or its newest part. Some are
shaken a little as a whole, since real vehicles do not follow polynomials.
"""

import concurrent.futures
import dataclasses
import functools
import hashlib
import multiprocessing
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float16, Float32

from jaxplan.errors import FileError, InputError
from jaxplan.files import (
    LARGEST_ARCHIVE,
    create_folder,
    read_arrays,
    read_limited,
    state_configuration,
    write_atomically,
)
from jaxplan.names import ENVIRONMENTS
from jaxplan.prediction.mdn.view import OBSERVATIONS, STEPS, View, frame_of, view_of
from jaxplan.prediction.protocol import SPACING, SPACING_IN_LARGE_ROOMS, PredictionConfig
from jaxplan.prediction.survival import Surroundings, surroundings_of
from jaxplan.prediction.waypoints import ChainConfig, WaypointSource, chains, walks
from jaxplan.prediction.windows import WindowConfig, draw_windows
from jaxplan.training.tours import tours
from jaxplan.training.worlds import random_world
from jaxplan.validation import require_at_least
from jaxplan.world.load import load_world
from jaxplan.world.obstacles import World

INTERVALS = (SPACING, SPACING_IN_LARGE_ROOMS)
"""Seconds between positions."""
LENGTH = OBSERVATIONS + STEPS
ROOMS, STORED, OPEN = 8, 6, 7
"""Of a shard; which of them is a stored one, and which has neither walls nor obstacles."""
HELD_OUT = 16
"""One shard of so many, with all its rooms, is for tests."""
SPEEDS, MARGINS = (0.5, 10.0), (0.3, 0.5)
"""Maximum speeds of flights [m/s], and what they keep from obstacles [m]."""
OPEN_ACCELERATION = 20.0
"""m/s^2 that flights in open space need at most."""
NOISES, EXACT = (0.002, 0.3), 0.5
"""Deviations of positions [m], and how many windows have none."""
WHOLE = 0.6
"""Of windows; of the others as many positions are seen as chance has it, two at least."""
SHAKEN, SHAKES, RHYTHMS = 0.4, (0.002, 0.05), (0.1, 1.5)
"""Share of the windows that are, by how much [m], and how often a second, in three sines for each axis."""
RECORDED = 0.1
"""Share of recorded flights among the examples, where there are any."""


@dataclasses.dataclass(frozen=True)
class ExamplesConfig:
    """What is made."""

    shards: int = 128
    """How many shards, of 8 rooms each."""
    windows: int = 300
    """Windows of a random room; twice and four times as many of a stored one and of open space."""
    seed: int = 21
    """Seed of the rooms and flights."""

    def __post_init__(self) -> None:
        require_at_least("examples", self, 1, "windows")
        require_at_least("examples", self, HELD_OUT, "shards")
        require_at_least("examples", self, 0, "seed")


class Examples(NamedTuple):
    """n windows, as they are seen and what follows."""

    view: View
    future: Float32[np.ndarray, "n s 3"]
    """As the target would see it."""


def make_examples(folder: Path, config: ExamplesConfig, workers: int, report: Callable[[str], None] = print) -> None:
    """Write the shards that are missing in ``folder``, in so many processes; 0: in this one."""
    create_folder(folder)
    state_configuration(folder, dataclasses.asdict(config), may_differ=("shards",))
    missing = [shard for shard in range(config.shards) if not os.path.exists(_path(folder, shard))]
    make = functools.partial(_write_shard, folder, config)
    if not workers or len(missing) < 2:
        for shard in missing:
            report(make(shard))
        return
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(workers, context) as pool:
        for said in pool.map(make, missing):
            report(said)


def load_examples(folder: Path, *, held_out: bool) -> Examples:
    """All examples for training, or those for tests.

    Raises:
        FileError: no shards of that kind, or what is there is none.
    """
    paths = sorted(folder.glob("flights-*.npz"))
    chosen = [path for path in paths if (int(path.stem[-4:]) % HELD_OUT == HELD_OUT - 1) == held_out]
    if not chosen:
        raise FileError(f"{folder}: has no {'held-out' if held_out else 'training'} flights; make more shards")
    shards = [
        read_arrays(read_limited(path, LARGEST_ARCHIVE, "flights, written by jaxplan train mdn")) for path in chosen
    ]
    arrays = {name: np.concatenate([shard[name] for shard in shards]) for name in shards[0]}
    return Examples(View(**{name: arrays[name] for name in View._fields}), arrays["future"])


def examples_digest(folder: Path) -> str:
    """SHA-256 of the shards' hashes, in order."""
    hashes = [hashlib.sha256(path.read_bytes()).digest() for path in sorted(folder.glob("flights-*.npz"))]
    return hashlib.sha256(b"".join(hashes)).hexdigest()


def recorded_examples(recordings: Sequence[Float[np.ndarray, "_ 3"]], count: int, seed: int) -> Examples:
    """Windows of recorded flights, positions [m] ``SPACING`` [s] apart, so often that they are ``RECORDED`` of all.

    Args:
        recordings: flights.
        count: how many other examples there are.
        seed: of the noise and of the choice.

    Raises:
        InputError: none is long enough.
    """
    rng, parts = np.random.default_rng([seed, 3]), []
    for stride, interval in enumerate(INTERVALS, start=1):
        for flight in recordings:
            starts = np.arange(max(0, len(flight) - stride * (LENGTH - 1)))
            cut = flight[starts[:, None] + stride * np.arange(LENGTH)]
            parts.append((cut, np.full(len(cut), interval)))
    windows, intervals = (np.concatenate(column) for column in zip(*parts, strict=True))
    if not len(windows):
        raise InputError(f"recorded flights: none is as long as {(LENGTH - 1) * SPACING:g} s; give longer ones")
    chosen = rng.integers(len(windows), size=round(RECORDED / (1.0 - RECORDED) * count))
    found = [_seen(windows[chosen][mine], at, None, rng) for at in INTERVALS if (mine := intervals[chosen] == at).any()]
    return joined(found)


def joined(parts: Sequence[Examples]) -> Examples:
    """One after the other."""
    view = View(*(np.concatenate(column) for column in zip(*(part.view for part in parts), strict=True)))
    return Examples(view, np.concatenate([part.future for part in parts]))


def _path(folder: Path, shard: int) -> Path:
    return folder / f"flights-{shard:04d}.npz"


def _write_shard(folder: Path, config: ExamplesConfig, shard: int) -> str:
    made = joined([_room(config, shard * ROOMS + number) for number in range(ROOMS)])
    arrays = made.view._asdict() | {"future": made.future}
    write_atomically(_path(folder, shard), lambda file: np.savez(file, **arrays))
    return f"shard {shard + 1} of {config.shards}: {len(made.future)} flights"


def _room(config: ExamplesConfig, index: int) -> Examples:
    """Windows of flights through room number ``index``, or through another one where that is too full."""
    for attempt in range(32):
        rng = np.random.default_rng([config.seed, index, attempt])
        world, number = _world(rng, index, config.windows)
        interval = float(rng.choice(INTERVALS)) if world is None else PredictionConfig.for_world(world).dt
        margin = float(rng.uniform(*MARGINS))
        cuts = WindowConfig(dt=interval, margin=margin, speeds=SPEEDS)
        if world is None:
            cuts = dataclasses.replace(cuts, max_acceleration=OPEN_ACCELERATION)
        try:
            windows = draw_windows([_source(world, margin, rng)], world, number, rng, cuts)
        except InputError:
            continue
        room = None if world is None else surroundings_of(world)
        shaken = _shaken(windows, interval, rng)
        return joined([_seen(shaken, interval, room, rng) for _ in range(2)])
    raise InputError(f"flights: no room {index} of seed {config.seed} has any; take another seed")


def _world(rng: np.random.Generator, index: int, windows: int) -> tuple[World | None, int]:
    """A room, and how many windows are wanted of it."""
    if index % ROOMS == OPEN:
        return None, 4 * windows
    if index % ROOMS == STORED:
        return load_world(ENVIRONMENTS[index // ROOMS % len(ENVIRONMENTS)]), 2 * windows
    return random_world(rng, index), windows


def _source(world: World | None, margin: float, rng: np.random.Generator) -> WaypointSource:
    if world is None:
        return walks()
    return chains(world, ChainConfig(margin=margin)) if rng.random() < 0.5 else tours(world, margin)


def _shaken(
    windows: Float[np.ndarray, "n l 3"], interval: float, rng: np.random.Generator
) -> Float[np.ndarray, "n l 3"]:
    """The same, some with a few slow sines added."""
    n = len(windows)
    size = np.where(rng.random(n) < SHAKEN, _spread(SHAKES, n, rng), 0.0)
    rhythm, phase = rng.uniform(*RHYTHMS, (3, n, 1, 3)), rng.uniform(0.0, 2.0 * np.pi, (3, n, 1, 3))
    times = interval * np.arange(windows.shape[1])[None, None, :, None]
    return np.asarray(windows + size[:, None, None] * np.sin(2.0 * np.pi * rhythm * times + phase).sum(axis=0))


def _seen(
    windows: Float[np.ndarray, "n l 3"], interval: float, room: Surroundings | None, rng: np.random.Generator
) -> Examples:
    """As a sensor might see them."""
    n = len(windows)
    noise = np.where(rng.random(n) < EXACT, 0.0, _spread(NOISES, n, rng))
    count = np.where(rng.random(n) < WHOLE, OBSERVATIONS, rng.integers(2, OBSERVATIONS, n))
    positions = windows[:, :OBSERVATIONS]
    positions = positions + noise[:, None, None] * rng.standard_normal(positions.shape)
    frame = frame_of(positions, count)
    view = view_of(frame, positions, count, interval, room)
    small: Float16[np.ndarray, "n p"] = np.asarray(view.room).astype(np.float16)
    return Examples(view._replace(room=small), frame.to_own(windows[:, OBSERVATIONS:]).astype(np.float32))


def _spread(limits: tuple[float, float], n: int, rng: np.random.Generator) -> Float[np.ndarray, "n"]:
    """Numbers whose logarithms are even between those of the limits."""
    least, most = np.log(limits)
    return np.asarray(np.exp(rng.uniform(least, most, n)))
