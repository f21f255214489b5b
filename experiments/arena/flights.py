"""Targets of the arena that follow a fixed motion: long smooth flights in any room, and recorded ones."""

import functools
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import CubicSpline

from jaxplan.errors import InputError
from jaxplan.io.targets import Target, load_target
from jaxplan.minsnap.many import minimum_snap_batch
from jaxplan.prediction.waypoints import ChainConfig, chains
from jaxplan.training.worlds import BOXES, CYLINDERS, FAR, SPHERES
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.obstacles import Cylinders, Spheres, World, aligned_boxes, make_obstacles

from ..named_world import NamedWorld, named

CLEARANCE = 0.5
"""m from everything that targets keep: goals nearer to obstacles are not flown to."""
LENGTH = 20.0
"""m; the shortest flight."""
MOST_ACCELERATION = 15.0
"""m/s^2 at the chosen speed: more than half of what the default vehicle has beside gravity (arbitrary)."""
WAYPOINTS, SAMPLES = 10, 500
TRIES = 8
"""Batches of flights that are drawn before a room is given up."""
AROUND = 3.0
"""m; how much farther than a recorded flight its room reaches."""
WIDTH = 4096
"""Points in one call of the distance."""


class _Piece(NamedTuple):
    """A flight's longest part that keeps its distance."""

    times: Float[np.ndarray, "n"]
    positions: Float[np.ndarray, "n 3"]


def long_flight(world: World, speed: float, seed: int) -> Target:
    """A smooth flight through random free places, of a given maximum speed [m/s]; the same for the same seed.

    Raises ``InputError`` where the room has none.
    """
    return _drawn(named(world), speed, seed)


@functools.lru_cache(maxsize=64)
def _drawn(room: NamedWorld, speed: float, seed: int) -> Target:
    name, world = room.name, room.world
    rng = np.random.default_rng((seed, int(1000 * speed)))
    source = chains(world, ChainConfig(waypoints=WAYPOINTS, margin=CLEARANCE + 0.1, ahead=0.6))
    for _ in range(TRIES):
        waypoints = source(rng)
        durations = np.maximum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1), 1e-3)
        initial = np.zeros((4, 3, waypoints.shape[-1]))
        initial[0] = (waypoints[1] - waypoints[0]) / durations[0]
        splines = minimum_snap_batch(waypoints, durations, initial=initial).splines
        for place in range(waypoints.shape[-1]):
            piece = _longest_clear(world, *splines.spline(place).sample(SAMPLES))
            target = None if piece is None else _scaled(f"{name}-{seed}", piece, speed)
            if target is not None:
                return target
    raise InputError(
        f"arena: no flight of {LENGTH:g} m at {speed:g} m/s fits into world {name!r}; choose a roomier one"
    )


def _longest_clear(world: World, times: Float[np.ndarray, "n"], states: Float[np.ndarray, "n 4"]) -> _Piece | None:
    """What is left of a flight between where it comes too near to something; None for less than ``LENGTH``."""
    positions = np.asarray(states)[:, :3]
    if np.linalg.norm(np.diff(positions, axis=0), axis=1).sum() < LENGTH:
        return None
    begin, end = _longest_run(host_free_distance(world, positions, WIDTH) >= CLEARANCE)
    if np.linalg.norm(np.diff(positions[begin:end], axis=0), axis=1).sum() < LENGTH:
        return None
    return _Piece(np.asarray(times)[begin:end] - times[begin], positions[begin:end])


def _longest_run(good: Bool[np.ndarray, "n"]) -> tuple[int, int]:
    """Where the longest run of true values begins, and where it is over."""
    edges = np.flatnonzero(np.diff(np.r_[False, good, False].astype(int)))
    begins, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - begins)) if len(begins) else 0
    return (int(begins[longest]), int(ends[longest])) if len(begins) else (0, 0)


def _scaled(name: str, piece: _Piece, speed: float) -> Target | None:
    """At the wanted maximum speed [m/s]; None where that takes too large an acceleration."""
    curve = CubicSpline(piece.times, piece.positions, axis=0)
    fine = np.linspace(0.0, piece.times[-1], 4 * SAMPLES)
    rate = speed / float(np.linalg.norm(curve(fine, 1), axis=1).max())
    if float(np.linalg.norm(curve(fine, 2), axis=1).max()) * rate**2 > MOST_ACCELERATION:
        return None
    return Target(name, float(piece.times[-1]) / rate, speed, (), lambda times, order: curve(times, order), rate)


def recorded_flight(path: Path, factor: float) -> tuple[World, Target]:
    """A recorded flight, so many times as fast, and an empty room around it.

    Raises ``FileError`` or ``InputError`` where the file is none.
    """
    recorded = load_target(str(path), world="")
    target = load_target(str(path), world="", speed=factor * recorded.max_speed)
    way = target.position(np.linspace(0.0, target.duration, 1000))
    bounds = np.stack([way.min(axis=0) - AROUND, way.max(axis=0) + AROUND])
    bounds[0, 2] = min(way[:, 2].min() - CLEARANCE - 0.1, 0.0)
    return open_room(path.stem, bounds), target


def open_room(name: str, bounds: Float[np.ndarray, "2 3"]) -> World:
    """A room with nothing in it."""
    nowhere = np.full((BOXES, 3), FAR)
    return room_of_boxes(name, bounds, nowhere, nowhere + 0.1)


def room_of_boxes(
    name: str, bounds: Float[np.ndarray, "2 3"], lower: Float[np.ndarray, "b 3"], upper: Float[np.ndarray, "b 3"]
) -> World:
    """A room whose arrays are those of the training rooms, so that little compiles for it."""
    up = np.tile([0.0, 0.0, 1.0], (CYLINDERS, 1))
    small, nowhere = np.full(CYLINDERS, 0.1), np.full((CYLINDERS, 3), FAR)
    obstacles = make_obstacles(
        boxes=aligned_boxes(lower, upper),
        cylinders=Cylinders(center=nowhere, axis=up, radius=small, half_length=small),
        spheres=Spheres(center=np.full((SPHERES, 3), FAR), radius=np.full(SPHERES, 0.1)),
    )
    return World(name=name, bounds=bounds, obstacles=obstacles, keep_in=np.array(0.2), provenance="drawn")
