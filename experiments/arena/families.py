"""The arena's episodes: families of targets, each on three levels of difficulty."""

import contextlib
import dataclasses
import functools
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.interception import React, Watch
from jaxplan.io.targets import Target, load_target, stored_targets
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.prediction.stream import StreamConfig
from jaxplan.training.worlds import BOXES
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.load import ENVIRONMENTS, load_world
from jaxplan.world.obstacles import World
from jaxplan.world.update import with_spare_boxes

from .evasion import WAYS, Agility, Evader
from .flights import long_flight, recorded_flight, room_of_boxes
from .movers import MOST, TURNING, Mover, Traffic, traffic_in
from .sight import Sight, SightConfig

LEVELS = (1, 2, 3)
STORED_SPEEDS = (2.5, 5.0, 10.0)
ENTRY_SPEEDS = (4.0, 6.0, 8.0)
ROOM_SPEED = 3.0
"""m/s; maximum speeds of targets."""
CLUTTER = ((0.05, 0.12), (0.12, 0.2), (0.2, 0.35))
"""Shares of a random room's floor that are taken up."""
SIZES = np.array([[10.0, 8.0, 2.5], [26.0, 16.0, 4.0]])
"""Least and largest sides of a random room [m]."""
LOW, OVERLAP = 0.25, 1.25
"""Share of its boxes that do not reach the ceiling; how much more they take up than is left where they overlap."""
FACTORS = (0.5, 1.0, 2.0)
"""By which recorded flights are flown faster."""
AGILITIES = (Agility(2.5, 5.0), Agility(5.0, 10.0), Agility(8.0, 18.0))
"""Of evasive targets: a quarter, half and nearly all of what the default vehicle reaches in these rooms."""
SIGHTS = (
    SightConfig(noise=0.01, dropouts=0.1, latency=0.05),
    SightConfig(noise=0.10, dropouts=0.2, latency=0.1, sight_range=20.0, occluded=True),
    SightConfig(noise=0.20, dropouts=0.4, latency=0.3, sight_range=12.0, occluded=True),
)
CAMERAS = tuple(
    dataclasses.replace(SIGHTS[1], field_of_view=np.radians(angle), sight_range=far)
    for angle, far in ((120.0, 20.0), (90.0, 15.0), (60.0, 10.0))
)
"""As the second of them, but with a camera that has to look there."""
SEEN_SPEED = 2.5
"""m/s of targets that are half seen, or beside obstacles that move."""
TRAFFIC = ((4, 1.0), (6, 2.0), (MOST, 3.0))
"""How many boxes move, and how fast at most [m/s]."""
BOX_NOISE = 0.02
"""m along each axis, with which boxes are seen that turn around at once."""
DEPARTURE, LATE = 0.5, (0.15, 0.45)
"""s; and shares of a flight between which the defender departs in the middle of it."""
LATER = 0.25
"""Share of a stored flight by which the defender departs later, at most, when it comes again."""
EVADING = 30.5
"""s that an evasive target has to be met in, the half second before the departure included."""
APART, FREE = 3.0, 0.6
"""m from the target's place at the departure, and from everything, at which a defender may hover."""
FAMILIES = {
    "stored": "stored trajectories at 2.5, 5 and 10 m/s",
    "entry": "departures in the middle of long flights at 4, 6 and 8 m/s",
    "rooms": "rooms never stored, of which 10, 20 and 30 % are taken up",
    "evasive": "targets that flee, dodge or hide, at a quarter, half and nearly all of the defender's agility",
    "half-seen": "targets seen with noise of 1, 10 and 20 cm, gaps, latency, limited range, and what hides them",
    "recorded": "recorded flights at 0.5, 1 and 2 times their speed, entered late (--recordings)",
    "camera": "targets half seen by a camera of 120, 90 and 60 degrees that turns to where they were last",
    "moving": "4, 6 and 8 boxes that swing through the stored rooms at 1, 2 and 3 m/s, on ways that are known",
    "moving-seen": "the same boxes, of which only their places are seen",
    "moving-abrupt": "boxes as fast that fly straight on and turn around at once, seen with noise of 2 cm",
}


MOST_SEEDS = 10_000
_ALL, _EACH = 200_000, 10_000
"""Seeds of all families, and of one."""


class Case(NamedTuple):
    """What is flown, whoever flies."""

    world: World
    target: Target
    departure: float
    """[s]"""
    start: Float[np.ndarray, "3"]
    """Where the defender hovers until then [m]."""
    seed: int
    """Of the plant's noise and the predictors' draws."""
    stream: StreamConfig
    watch: Watch | None = None
    react: React | None = None
    known: bool = True
    """Whether the target's motion does not depend on the defender, so that there is a reference."""
    sight: Sight | None = None
    traffic: Traffic | None = None
    """Obstacles that move; the world has ``movers.MOST`` spare boxes then."""


def case(family: str, level: int, number: int, seed: int, recordings: tuple[str, ...] = ()) -> Case:
    """One episode, the same for the same arguments.

    Raises ``InputError`` for an unknown family or level, or where a room has no such flight.
    """
    if family not in FAMILIES or level not in LEVELS:
        raise InputError(f"arena: have {family!r} on level {level}, want one of {', '.join(FAMILIES)} on level 1 to 3")
    unique = _ALL * seed + _EACH * list(FAMILIES).index(family) + 1000 * level + number
    return _MAKERS[family](level - 1, number, unique, recordings)


def _stored(level: int, number: int, seed: int, recordings: tuple[str, ...]) -> Case:
    world = _stored_world(number)
    target = load_target(_name(world, number), world=world.name, speed=STORED_SPEEDS[level])
    departure = _departure(number, target, seed)
    return _plain(world, target, departure, np.asarray(world.start, dtype=float), seed)


def _departure(number: int, target: Target, seed: int) -> float:
    """As in Table I when a stored target comes for the first time, then later in its flight: nothing else differs."""
    if number < len(ENVIRONMENTS) * len(stored_targets(ENVIRONMENTS[0])):
        return DEPARTURE
    return float(np.round(DEPARTURE + np.random.default_rng((seed, 6)).uniform(0.0, LATER) * target.duration, 1))


def _entry(level: int, number: int, seed: int, recordings: tuple[str, ...]) -> Case:
    world = _stored_world(number)
    return _entered(world, long_flight(world, ENTRY_SPEEDS[level], seed), seed)


def _rooms(level: int, number: int, seed: int, recordings: tuple[str, ...]) -> Case:
    for attempt in range(20):
        world = cluttered_room(*CLUTTER[level], seed + 100_000 * attempt)
        with contextlib.suppress(InputError):
            return _entered(world, long_flight(world, ROOM_SPEED, seed), seed)
    raise InputError(f"arena: no flight fits into any of 20 rooms on level {level + 1}; choose another --seed")


def _recorded(level: int, number: int, seed: int, recordings: tuple[str, ...]) -> Case:
    if not recordings:
        raise InputError("--recordings: the family 'recorded' flies files of yours; name some, or leave it out")
    world, target = recorded_flight(Path(recordings[number % len(recordings)]), FACTORS[level])
    return _entered(world, target, seed)


def _evasive(level: int, number: int, seed: int, recordings: tuple[str, ...]) -> Case:
    world, way = _stored_world(number), WAYS[(number // len(ENVIRONMENTS)) % len(WAYS)]
    evader = Evader(world, way, AGILITIES[level], seed)
    target = evader.target(f"{way}-{seed}", EVADING)
    start = _free_place(world, target.position(np.zeros(1))[0], seed)
    return _plain(world, target, DEPARTURE, start, seed)._replace(react=evader.react, known=False)


def _half_seen(level: int, number: int, seed: int, recordings: tuple[str, ...]) -> Case:
    return _seen(SIGHTS[level], number, seed)


def _camera(level: int, number: int, seed: int, recordings: tuple[str, ...]) -> Case:
    return _seen(CAMERAS[level], number, seed)


def _seen(config: SightConfig, number: int, seed: int) -> Case:
    """A stored target, seen by a sensor of this kind."""
    world = _stored_world(number)
    target = load_target(_name(world, number), world=world.name, speed=SEEN_SPEED)
    start = np.asarray(world.start, dtype=float)
    sight = Sight(world, config, start, seed)
    plain = _plain(world, target, 2.0 * DEPARTURE, start, seed)
    return plain._replace(watch=sight.watch, react=sight.look_from, sight=sight)


def _moving(level: int, number: int, seed: int, recordings: tuple[str, ...]) -> Case:
    plain, movers = _among_movers(level, number, seed)
    return plain._replace(traffic=Traffic(movers, True))


def _moving_seen(level: int, number: int, seed: int, recordings: tuple[str, ...]) -> Case:
    plain, movers = _among_movers(level, number, seed - _EACH)  # the same boxes as the family before
    return plain._replace(traffic=Traffic(movers, False))


def _moving_abrupt(level: int, number: int, seed: int, recordings: tuple[str, ...]) -> Case:
    plain, movers = _among_movers(level, number, seed, abrupt=True)
    return plain._replace(traffic=Traffic(movers, False, BOX_NOISE, seed, TURNING))


def _among_movers(level: int, number: int, seed: int, abrupt: bool = False) -> tuple[Case, tuple[Mover, ...]]:
    """A stored target, and the boxes that move around it."""
    world = _roomier(ENVIRONMENTS[number % len(ENVIRONMENTS)])
    target, start = load_target(_name(world, number), world=world.name, speed=SEEN_SPEED), np.asarray(world.start)
    movers = traffic_in(world, target, start, DEPARTURE + 1.0, *TRAFFIC[level], seed, abrupt)
    return _plain(world, target, DEPARTURE, start, seed), movers


@functools.lru_cache(maxsize=8)
def _roomier(name: str) -> World:
    """A stored room with spare boxes for those that move."""
    return with_spare_boxes(_load(name), MOST)


_MAKERS = {
    "stored": _stored,
    "entry": _entry,
    "rooms": _rooms,
    "evasive": _evasive,
    "half-seen": _half_seen,
    "recorded": _recorded,
    "camera": _camera,
    "moving": _moving,
    "moving-seen": _moving_seen,
    "moving-abrupt": _moving_abrupt,
}


def _plain(world: World, target: Target, departure: float, start: Float[np.ndarray, "3"], seed: int) -> Case:
    prediction = PredictionConfig.for_world(world)
    stream = StreamConfig.for_prediction(prediction)
    return Case(world, target, departure, start, seed, stream)


def _entered(world: World, target: Target, seed: int) -> Case:
    """The defender departs in the middle of the flight, from anywhere."""
    departure = float(np.round(np.random.default_rng((seed, 3)).uniform(*LATE) * target.duration, 1))
    return _plain(world, target, departure, _free_place(world, target.position(np.array([departure]))[0], seed), seed)


def _free_place(world: World, target: Float[np.ndarray, "3"], seed: int) -> Float[np.ndarray, "3"]:
    """Somewhere free, not next to the target."""
    lower, upper = np.asarray(world.bounds, dtype=float)
    places = np.random.default_rng((seed, 4)).uniform(lower, upper, (2048, 3))
    good = host_free_distance(world, places, 2048) > FREE
    good &= np.linalg.norm(places - target, axis=1) > APART
    if not good.any():
        raise InputError(f"arena: world {world.name!r} has no free place {APART:g} m from its target")
    return np.asarray(places[int(np.argmax(good))])


def _stored_world(number: int) -> World:
    return _load(ENVIRONMENTS[number % len(ENVIRONMENTS)])


@functools.lru_cache(maxsize=8)
def _load(name: str) -> World:
    return load_world(name)


def _name(world: World, number: int) -> str:
    names = stored_targets(world.name)
    return names[(number // len(ENVIRONMENTS)) % len(names)]


@functools.lru_cache(maxsize=32)
def cluttered_room(least: float, most: float, seed: int) -> World:
    """A random room of which a share of the floor between these is taken up, half way up, by boxes."""
    for attempt in range(100):
        rng = np.random.default_rng((seed, 5, attempt))
        size = rng.uniform(*SIZES)
        area = rng.lognormal(0.0, 0.5, BOXES)
        area *= OVERLAP * rng.uniform(least, most) * size[0] * size[1] / area.sum()
        longer = rng.uniform(1.0, 2.0, BOXES) ** rng.choice([-0.5, 0.5], BOXES)
        sides = np.stack([np.sqrt(area) * longer, np.sqrt(area) / longer, np.full(BOXES, size[2])], axis=1)
        low = rng.random(BOXES) < LOW
        sides[low, 2] *= rng.uniform(0.3, 0.7, int(low.sum()))
        corner = rng.uniform(0.0, 1.0, (BOXES, 3)) * np.maximum(size - sides, 0.0)
        corner[:, 2] = 0.0
        room = room_of_boxes(f"room-{seed}-{attempt}", np.stack([np.zeros(3), size]), corner, corner + sides)
        if least <= clutter(room) <= most:
            return room
    raise InputError(f"arena: no random room has {least:.0%} to {most:.0%} of its floor taken up")


def clutter(world: World) -> float:
    """Share of a room's middle height that obstacles take up."""
    lower, upper = np.asarray(world.bounds, dtype=float)
    x, y = (np.linspace(lower[axis], upper[axis], 62)[1:-1] for axis in (0, 1))
    grid = np.stack([*np.meshgrid(x, y, indexing="ij"), np.full((60, 60), 0.5 * (lower[2] + upper[2]))], axis=-1)
    return float((host_free_distance(world, grid, 4096) <= 0.0).mean())
