"""Windows on which predictors are compared: stored, fast and recorded flights, new rooms; as a camera would see."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.io.target_log import read_target_log, resample
from jaxplan.io.targets import load_target, stored_targets
from jaxplan.prediction.interpolation import interpolate
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.waypoints import ChainConfig, chains
from jaxplan.prediction.windows import WindowConfig, draw_windows
from jaxplan.training.tours import tours
from jaxplan.training.worlds import random_world
from jaxplan.world.obstacles import World

SPEEDS = np.linspace(0.5, 5.5, 10)
FLIGHT_INTERVAL = 0.1
_FAST = 0.7
"""Share of its maximum speed that a fast target has."""
_DRAWN, _LEAST_DRAWN = 60, 1200
"""Windows drawn for each that is wanted, since most of a flight is slower, and at least."""
_MARGIN = 0.5
_NEW = 90_000
"""From this number on rooms are new."""
_FAST_ACCELERATION = 15.0
"""m/s^2 that a fast flight may need: with gravity that is a thrust-to-weight ratio of 1.8."""


def stored_windows(
    world: str, dt: float, count: int, rng: np.random.Generator, length: int = 30
) -> Float[np.ndarray, "k length 3"]:
    """``count`` windows of the stored targets, the same number at every speed."""
    windows = []
    for speed in SPEEDS:
        cuts = []
        for name in stored_targets(world):
            target = load_target(name, world=world, speed=float(speed))
            starts = np.arange(0.0, target.duration - (length - 1) * dt, 0.1)
            times = starts[:, None] + dt * np.arange(length)
            cuts.append(target.position(times.reshape(-1)).reshape(-1, length, 3))
        joined = np.concatenate(cuts)
        windows.append(joined[rng.permutation(len(joined))[: count // len(SPEEDS)]])
    return np.concatenate(windows)


def fast_windows(
    world: World, dt: float, speed: float, count: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "k length 3"], int]:
    """``count`` windows, or fewer, of new flights through a room, and how many of their positions were seen: a second.

    Two seconds follow. At the newest position seen a target is nearly as fast as ``speed`` [m/s], its maximum.
    Waypoints are chains of free places, not the tours of the stored targets. Raises InputError where the room is too
    small.
    """
    observed, steps = min(10, round(1.0 / dt) + 1), round(2.0 / dt)
    config = WindowConfig(
        observations=observed,
        steps=steps,
        dt=dt,
        speeds=(speed - 0.01, speed),
        margin=_MARGIN,
        max_acceleration=_FAST_ACCELERATION,
        cuts=48,
        keep=48,
    )
    source = chains(world, ChainConfig(waypoints=10, margin=_MARGIN + 0.1, ahead=0.6))
    windows = draw_windows([source], world, max(_DRAWN * count, _LEAST_DRAWN), rng, config)
    now = np.linalg.norm(windows[:, observed - 1] - windows[:, observed - 2], axis=-1) / dt
    fast = windows[now >= _FAST * speed][:count]
    if not len(fast):
        raise InputError(f"fast targets: none of {len(windows)} flights in this room is as fast as {speed:g} m/s")
    return fast, observed


def new_room(number: int) -> World:
    """A random room that nobody trained in, with a number of its own."""
    return random_world(np.random.default_rng([_NEW, number]), _NEW + number)


def room_windows(world: World, dt: float, number: int, count: int) -> Float[np.ndarray, "k length 3"]:
    """``count`` windows of new flights through a room at maximum speeds up to 8 m/s: tours, or every other time chains.

    Raises InputError where the room is too small.
    """
    margin = _MARGIN - 0.1
    source = chains(world, ChainConfig(margin=margin)) if number % 2 else tours(world, margin)
    config = WindowConfig(dt=dt, margin=margin, speeds=(0.5, 8.0))
    return draw_windows([source], world, count, np.random.default_rng([_NEW, number, 1]), config)


def recorded_windows(
    path: Path, count: int, rng: np.random.Generator, length: int = 30
) -> Float[np.ndarray, "k length 3"]:
    """``count`` windows of a recorded flight, or all there are."""
    even = resample(read_target_log(path), FLIGHT_INTERVAL).positions
    starts = rng.permutation(max(0, len(even) - length + 1))[:count]
    return even[starts[:, None] + np.arange(length)]


def as_seen(
    observations: Sequence[Observations], noise: float, dropouts: float, rng: np.random.Generator
) -> list[Observations]:
    """The observations with noise [m], and with a share of positions missing.

    What is missing is interpolated between the others, as a stream does; the newest position is always there.
    """
    return [_seen(one, noise, dropouts, rng) for one in observations]


def _seen(one: Observations, noise: float, dropouts: float, rng: np.random.Generator) -> Observations:
    positions = one.positions + noise * rng.standard_normal(one.positions.shape)
    kept = np.append(rng.random(len(positions) - 1) >= dropouts, True)
    first = int(np.argmax(kept))
    times = one.times[first:]
    return Observations(times=times, positions=interpolate(one.times[kept], positions[kept], times))
