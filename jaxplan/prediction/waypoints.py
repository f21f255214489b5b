"""Where the flights go from which a mixture learns: chains of free places in a world, or random walks in open space."""

import dataclasses
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.validation import require_at_least, require_positive, require_range, require_within
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.obstacles import World

FLIGHTS = 512
"""Flights that are drawn and solved side by side."""
_POOL = 4096
"""Places that are drawn for one batch of chains."""
_SIGHT_STEP = 0.25
"""Interval [m] at which the way between two places is checked; coarse, since only plausibility hangs on it."""
_TRIES = 12
"""Places that are tried as the next one."""


@runtime_checkable
class WaypointSource(Protocol):
    """Draws the waypoints of flights; how many waypoints a flight has is the source's own affair."""

    def __call__(self, rng: np.random.Generator, /) -> Float[np.ndarray, "n 3 b"]:
        """The waypoints [m, world] of b = ``FLIGHTS`` flights."""


@dataclasses.dataclass(frozen=True)
class ChainConfig:
    """Which chains of free places are drawn."""

    waypoints: int = 10
    """Waypoints of a flight."""
    margin: float = 0.5
    """Least clearance of a place [m]; the way to the next one keeps half of it."""
    step: tuple[float, float] = (2.0, 6.0)
    """Least and largest distance [m] between waypoints."""
    ahead: float = 0.5
    """Share of waypoints that must lie ahead rather than anywhere; 0 wanders, 1 roams far (arbitrary)."""

    def __post_init__(self) -> None:
        require_at_least("chains", self, 2, "waypoints")
        require_positive("chains", self, "margin")
        require_range("chains", self, "step")
        require_within("chains", self, 0.0, 1.0, "ahead")


@dataclasses.dataclass(frozen=True)
class WalkConfig:
    """Which random walks are drawn: small and large ones, since they stand in for all that has no model of its own."""

    waypoints: int = 12
    """Waypoints of a flight."""
    step: tuple[float, float] = (0.6, 8.0)
    """Least and largest scale [m] of a flight; its steps are half to one and a half times as long."""
    restlessness: float = 1.2
    """Largest standard deviation [rad] of the turn at a waypoint (arbitrary)."""

    def __post_init__(self) -> None:
        require_at_least("walks", self, 2, "waypoints")
        require_range("walks", self, "step")
        require_positive("walks", self, "restlessness")


def chains(world: World, config: ChainConfig = ChainConfig()) -> WaypointSource:
    """Chains of free places of a world, each a moderate step from the last and in sight of it.

    The source raises InputError where the world has too little free space.
    """
    lower, upper = np.asarray(world.bounds, dtype=float)

    def source(rng: np.random.Generator) -> Float[np.ndarray, "n 3 b"]:
        pool = rng.uniform(lower, upper, (_POOL, 3))
        pool = pool[host_free_distance(world, pool) > config.margin]
        if len(pool) < config.waypoints:
            raise InputError(f"windows: {len(pool)} of {_POOL} random places are clear; want a roomier world")
        chain = [pool[rng.integers(len(pool), size=FLIGHTS)]]
        heading = np.zeros((FLIGHTS, 3))
        for _ in range(config.waypoints - 1):
            chain.append(_next_places(world, pool, chain[-1], heading, rng, config))
            heading = chain[-1] - chain[-2]
        return np.stack(chain).transpose(0, 2, 1)

    return source


def _next_places(
    world: World,
    pool: Float[np.ndarray, "p 3"],
    places: Float[np.ndarray, "b 3"],
    heading: Float[np.ndarray, "b 3"],
    rng: np.random.Generator,
    config: ChainConfig,
) -> Float[np.ndarray, "b 3"]:
    """For each place another: at a moderate distance, in sight, often ahead; the farthest of some where none fits."""
    choice = pool[rng.integers(len(pool), size=(_TRIES, len(places)))]
    step = choice - places
    distance = np.linalg.norm(step, axis=-1)
    fits = (distance >= config.step[0]) & (distance <= config.step[1])
    onward = rng.random(len(places)) < config.ahead
    fits &= ~onward | ((step * heading).sum(axis=-1) >= 0.0)
    shares = np.linspace(0.0, 1.0, 1 + int(config.step[1] / _SIGHT_STEP))[:, None, None, None]
    fits &= (host_free_distance(world, places + shares * step) > 0.5 * config.margin).all(axis=0)
    rank = np.where(fits, 1e3 - np.arange(_TRIES)[:, None], distance)
    return choice[rank.argmax(axis=0), np.arange(len(places))]


def walks(config: WalkConfig = WalkConfig()) -> WaypointSource:
    """Random walks in open space, mostly level.

    Each flight has a scale and a restlessness of its own, so that there are straight flights and tight turns at every
    speed.
    """
    shape = (config.waypoints - 1, FLIGHTS)

    def source(rng: np.random.Generator) -> Float[np.ndarray, "n 3 b"]:
        turns = rng.standard_normal(shape) * rng.uniform(0.0, config.restlessness, FLIGHTS)
        climb = np.clip(0.3 * rng.standard_normal(shape), -1.0, 1.0)
        least, largest = np.log(config.step)
        scale = np.exp(rng.uniform(least, largest, FLIGHTS))
        length = scale * rng.uniform(0.5, 1.5, shape)
        heading, level = rng.uniform(-np.pi, np.pi, FLIGHTS) + np.cumsum(turns, axis=0), length * np.cos(climb)
        steps = np.stack([level * np.cos(heading), level * np.sin(heading), length * np.sin(climb)], axis=1)
        return np.concatenate([np.zeros((1, 3, FLIGHTS)), np.cumsum(steps, axis=0)])

    return source
