"""Windows of random minimum-snap flights, from which a mixture learns how targets move (paper, Sec. III-C).

A window is what a predictor sees and what it has to say: N_obs observed and N_pred future positions, dt apart. In a
world, waypoints are chains of free places, each in sight of the last; in open space (no world) they are a random walk.
Durations are proportional to distances, as of the stored targets, and each flight is time-scaled to a random maximum
speed. A window is kept when every one of its points is clear; the rest of its flight does not matter.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxplan.errors import InputError
from jaxplan.minsnap.many import minimum_snap_batch
from jaxplan.precision import in_float64
from jaxplan.world import clearance
from jaxplan.world.obstacles import World

FLIGHTS = 512
"""Flights that are solved side by side."""
_POOL = 4096
"""Places that are drawn for one batch of chains."""
_SIGHT_STEP = 0.25
"""Interval [m] at which the way between two places is checked; coarse, since only plausibility hangs on it."""
_SPEEDS = 10
"""Classes of maximum speed that are equally frequent."""
_PATIENCE = 20
"""Batches without a single window after which the speeds that are missing are given up."""
_SPEED_SAMPLES = 24
"""Samples a segment from which a flight's maximum speed is taken."""


@dataclasses.dataclass(frozen=True)
class WindowConfig:
    """Which flights are drawn and how they are cut."""

    observations: int = 10
    """N_obs, positions observed (paper, Sec. IV)."""
    steps: int = 20
    """N_pred, positions to predict (paper, Sec. IV)."""
    dt: float = 0.1
    """Seconds between two positions of a window."""
    speeds: tuple[float, float] = (0.5, 5.5)
    """Least and largest maximum speed of a flight [m/s] (paper, Sec. IV)."""
    margin: float = 0.5
    """Least clearance [m] of a window's points; goals closer to an obstacle would be rejected anyway."""
    step: tuple[float, float] = (2.0, 6.0)
    """Least and largest distance [m] between waypoints."""
    ahead: float = 0.5
    """Share of waypoints that must lie ahead rather than anywhere; 0 wanders, 1 roams far (arbitrary)."""
    restlessness: float = 1.2
    """Largest standard deviation [rad] of the turn at a waypoint of a walk (arbitrary)."""
    max_acceleration: float = 30.0
    """Windows that accelerate more [m/s^2] are left out: no quadrotor flies them (a thrust-to-weight ratio of 3)."""
    waypoints: int = 10
    """Waypoints of a flight."""
    cuts: int = 24
    """Windows tried in each flight."""
    keep: int = 5
    """Most windows kept of a flight."""

    def __post_init__(self) -> None:
        for name in ("observations", "steps", "waypoints", "cuts"):
            if getattr(self, name) < 2:
                raise InputError(f"windows: {name} is {getattr(self, name)}, want at least 2")
        for name in ("dt", "margin", "max_acceleration", "restlessness"):
            if not 0.0 < getattr(self, name) < float("inf"):
                raise InputError(f"windows: {name} is {getattr(self, name)}, want a positive number")
        for name in ("speeds", "step"):
            low, high = getattr(self, name)
            if not 0.0 < low <= high < float("inf"):
                raise InputError(f"windows: {name} is {(low, high)}, want two positive numbers, the lesser first")

    @property
    def length(self) -> int:
        """Positions of a window."""
        return self.observations + self.steps


OPEN_SPACE: dict[str, Any] = {"speeds": (0.3, 8.0), "step": (0.6, 8.0), "max_acceleration": 20.0, "waypoints": 12}
"""What differs for the generic model: small and fast flights too, since it stands in for all that has no model."""

WaypointSource = Callable[[np.random.Generator], Float[np.ndarray, "m+1 3 b"]]
"""Draws the waypoints [m, world] of ``FLIGHTS`` flights; how many waypoints a flight has is the source's own affair."""


def draw_windows(
    sources: Sequence[WaypointSource],
    world: World | None,
    count: int,
    rng: np.random.Generator,
    config: WindowConfig = WindowConfig(),
) -> Float[np.ndarray, "n l 3"]:
    """``count`` windows [m, world] of flights drawn from each source in turn, shuffled; clear in ``world`` if given.

    All maximum speeds are equally frequent, although fewer windows of fast flights are clear: flights are drawn at the
    speeds of which too few windows have been found. Speeds at which no window fits into the world are left out.

    Raises:
        InputError: the world has too little free space for flights of this kind.
    """
    quota = -(-count // _SPEEDS)
    windows: list[list[np.ndarray]] = [[] for _ in range(_SPEEDS)]
    missing, fruitless, batches = np.full(_SPEEDS, quota), 0, 0
    while missing.any() and fruitless < _PATIENCE:
        speed_class = rng.choice(_SPEEDS, FLIGHTS, p=missing / missing.sum())
        cut, flight = _cut(sources[batches % len(sources)](rng), speed_class, rng, config)
        kept, flight = _few_of_each(*_plausible(cut, flight, world, config), config.keep)
        for index in np.flatnonzero(missing):
            mine = kept[speed_class[flight] == index][: missing[index]]
            windows[index].append(mine)
            missing[index] -= len(mine)
        fruitless, batches = (0 if len(kept) else fruitless + 1), batches + 1
    found = np.concatenate([part for parts in windows for part in parts])
    if len(found) < count // 2:
        raise InputError(
            f"windows: have {len(found)} of {count} windows from {batches * FLIGHTS} flights; want a roomier world"
        )
    return found[rng.permutation(len(found))[:count]]


def _plausible(
    windows: Float[np.ndarray, "n l 3"], flight: Int[np.ndarray, "n"], world: World | None, config: WindowConfig
) -> tuple[Float[np.ndarray, "k l 3"], Int[np.ndarray, "k"]]:
    """The windows that a vehicle could fly and that are clear, with their flights."""
    change = np.linalg.norm(np.diff(windows, n=2, axis=1), axis=-1).max(axis=1)
    good = change <= config.max_acceleration * config.dt**2
    if world is not None:
        good &= (free_distance(world, windows) >= config.margin).all(axis=1)
    return windows[good], flight[good]


def _few_of_each(
    windows: Float[np.ndarray, "n l 3"], flight: Int[np.ndarray, "n"], keep: int
) -> tuple[Float[np.ndarray, "k l 3"], Int[np.ndarray, "k"]]:
    """The first windows of each flight, with their flights."""
    starts = np.flatnonzero(np.diff(flight, prepend=-1))
    place = np.arange(len(flight)) - np.repeat(starts, np.diff(np.append(starts, len(flight))))
    return windows[place < keep], flight[place < keep]


def chains(world: World, config: WindowConfig) -> WaypointSource:
    """Chains of free places, each a moderate step from the last and in sight of it."""
    lower, upper = np.asarray(world.bounds, dtype=float)

    def source(rng: np.random.Generator) -> Float[np.ndarray, "m+1 3 b"]:
        pool = rng.uniform(lower, upper, (_POOL, 3))
        pool = pool[free_distance(world, pool) > config.margin]
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
    config: WindowConfig,
    tries: int = 12,
) -> Float[np.ndarray, "b 3"]:
    """For each place another: at a moderate distance, in sight, often ahead; the farthest of some where none fits."""
    choice = pool[rng.integers(len(pool), size=(tries, len(places)))]
    step = choice - places
    distance = np.linalg.norm(step, axis=-1)
    fits = (distance >= config.step[0]) & (distance <= config.step[1])
    onward = rng.random(len(places)) < config.ahead
    fits &= ~onward | ((step * heading).sum(axis=-1) >= 0.0)
    shares = np.linspace(0.0, 1.0, 1 + int(config.step[1] / _SIGHT_STEP))[:, None, None, None]
    fits &= (free_distance(world, places + shares * step) > 0.5 * config.margin).all(axis=0)
    rank = np.where(fits, 1e3 - np.arange(tries)[:, None], distance)
    return choice[rank.argmax(axis=0), np.arange(len(places))]


def walks(config: WindowConfig) -> WaypointSource:
    """Random walks in open space, mostly level. Each flight has a scale and a restlessness of its own, so that there
    are straight flights and tight turns at every speed."""
    shape = (config.waypoints - 1, FLIGHTS)

    def source(rng: np.random.Generator) -> Float[np.ndarray, "m+1 3 b"]:
        turns = rng.standard_normal(shape) * rng.uniform(0.0, config.restlessness, FLIGHTS)
        climb = np.clip(0.3 * rng.standard_normal(shape), -1.0, 1.0)
        least, largest = np.log(config.step)
        scale = np.exp(rng.uniform(least, largest, FLIGHTS))
        length = scale * rng.uniform(0.5, 1.5, shape)
        heading, level = rng.uniform(-np.pi, np.pi, FLIGHTS) + np.cumsum(turns, axis=0), length * np.cos(climb)
        steps = np.stack([level * np.cos(heading), level * np.sin(heading), length * np.sin(climb)], axis=1)
        return np.concatenate([np.zeros((1, 3, FLIGHTS)), np.cumsum(steps, axis=0)])

    return source


def _cut(
    waypoints: Float[np.ndarray, "m+1 3 b"],
    speed_class: Int[np.ndarray, "b"],
    rng: np.random.Generator,
    config: WindowConfig,
) -> tuple[Float[np.ndarray, "n l 3"], Int[np.ndarray, "n"]]:
    """Windows at random times of the flights through ``waypoints``, in order, and the flight of each."""
    steps = np.diff(waypoints, axis=0)
    durations = np.maximum(np.linalg.norm(steps, axis=1), 1e-3)
    initial = np.zeros((4, 3, waypoints.shape[-1]))
    initial[0] = steps[0] / durations[0]
    solved = minimum_snap_batch(waypoints, durations, initial=initial)
    coefficients = np.moveaxis(np.asarray(solved.splines.position), -1, 0)
    fastest = _fastest(coefficients, durations.T)
    slowest, swiftest = config.speeds
    speed = slowest + (speed_class + rng.random(len(fastest))) * (swiftest - slowest) / _SPEEDS
    rate = speed / np.maximum(fastest, 1e-9)
    whole = durations.sum(axis=0)
    span = (config.length - 1) * config.dt * rate
    usable = np.flatnonzero((np.asarray(solved.status) == 0) & (span < whole))
    starts = rng.uniform(0.0, 1.0, (config.cuts, len(usable))) * (whole - span)[usable]
    times = starts[..., None] + np.arange(config.length) * (config.dt * rate[usable])[:, None]
    cut = _positions(coefficients[usable], durations.T[usable], times.transpose(1, 0, 2).reshape(len(usable), -1))
    return cut.reshape(-1, config.length, 3), np.repeat(usable, config.cuts)


def _positions(
    coefficients: Float[np.ndarray, "b m n 3"], durations: Float[np.ndarray, "b m"], times: Float[np.ndarray, "b t"]
) -> Float[np.ndarray, "b t 3"]:
    """Each flight at its own times [s]."""
    ends = np.cumsum(durations, axis=1)
    segment = np.minimum((times[..., None] >= ends[:, None]).sum(axis=-1), durations.shape[1] - 1)
    lane = np.arange(len(times))[:, None]
    local = 1.0 - (ends[lane, segment] - times) / durations[lane, segment]
    powers = local[..., None] ** np.arange(coefficients.shape[2])
    return np.einsum("btn,btna->bta", powers, coefficients[lane, segment])


def _fastest(coefficients: Float[np.ndarray, "b m n 3"], durations: Float[np.ndarray, "b m"]) -> np.ndarray:
    """Maximum speed of each flight as solved [m/s], from samples."""
    degrees = np.arange(1, coefficients.shape[2])
    slopes = np.linspace(0.0, 1.0, _SPEED_SAMPLES)[:, None] ** (degrees - 1) * degrees
    velocity = np.einsum("sn,bmna->bmsa", slopes, coefficients[:, :, 1:]) / durations[:, :, None, None]
    return np.linalg.norm(velocity, axis=-1).max(axis=(1, 2))


@in_float64
def free_distance(world: World, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
    """Distance [m] to the nearest obstacle or face of the room."""
    flat = points.reshape(-1, 3)
    padded = np.zeros((-(-len(flat) // _CHUNK) * _CHUNK, 3))
    padded[: len(flat)] = flat
    parts = [np.asarray(_distance(world, part)) for part in padded.reshape(-1, _CHUNK, 3)]
    return np.concatenate(parts)[: len(flat)].reshape(points.shape[:-1])


_CHUNK = 16384
"""Points in one compiled call, so that nothing compiles twice."""


_distance = jax.jit(clearance.free_distance)
