"""Windows of random minimum-snap flights, from which a mixture learns how targets move (paper, Sec. III-C).

A window is what a predictor sees and what it has to say: N_obs observed and N_pred future positions, dt apart. The
waypoints of the flights come from a source (``jaxplan.prediction.waypoints``). Durations are proportional to distances,
as of the stored targets, and each flight is time-scaled to a random maximum speed. A window is kept when every one of
its points is clear; the rest of its flight does not matter.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from jaxplan.errors import InputError
from jaxplan.minsnap.many import minimum_snap_batch
from jaxplan.prediction.waypoints import FLIGHTS, WaypointSource
from jaxplan.validation import require_at_least, require_positive, require_range
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.obstacles import World

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
    max_acceleration: float = 30.0
    """Windows that accelerate more [m/s^2] are left out: no quadrotor flies them (a thrust-to-weight ratio of 3)."""
    cuts: int = 24
    """Windows tried in each flight."""
    keep: int = 5
    """Most windows kept of a flight."""

    def __post_init__(self) -> None:
        require_at_least("windows", self, 2, "observations", "steps", "cuts")
        require_at_least("windows", self, 1, "keep")
        require_positive("windows", self, "dt", "margin", "max_acceleration")
        require_range("windows", self, "speeds")

    @property
    def length(self) -> int:
        """Positions of a window."""
        return self.observations + self.steps


OPEN_SPACE = WindowConfig(speeds=(0.3, 8.0), max_acceleration=20.0)
"""For the generic model: slow and fast flights too, since it stands in for all that has no model of its own."""


def draw_windows(
    sources: Sequence[WaypointSource],
    world: World | None,
    count: int,
    rng: np.random.Generator,
    config: WindowConfig = WindowConfig(),
) -> Float[np.ndarray, "n l 3"]:
    """``count`` windows of l positions [m, world] of flights drawn from each source in turn, shuffled.

    All maximum speeds are equally frequent, although fewer windows of fast flights are clear: flights are drawn at the
    speeds of which too few windows have been found. Speeds at which no window fits into the world are left out.

    Args:
        sources: of the flights' waypoints.
        world: all windows are clear in it; None in open space.
        count: how many windows are wanted; there may be fewer, down to the half.
        rng: of all draws.
        config: which flights are drawn and how they are cut.

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
        good &= (host_free_distance(world, windows) >= config.margin).all(axis=1)
    return windows[good], flight[good]


def _few_of_each(
    windows: Float[np.ndarray, "n l 3"], flight: Int[np.ndarray, "n"], keep: int
) -> tuple[Float[np.ndarray, "k l 3"], Int[np.ndarray, "k"]]:
    """The first windows of each flight, with their flights."""
    starts = np.flatnonzero(np.diff(flight, prepend=-1))
    place = np.arange(len(flight)) - np.repeat(starts, np.diff(np.append(starts, len(flight))))
    return windows[place < keep], flight[place < keep]


def _cut(
    waypoints: Float[np.ndarray, "p 3 b"],
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
    flight = np.arange(len(times))[:, None]
    local = 1.0 - (ends[flight, segment] - times) / durations[flight, segment]
    powers = local[..., None] ** np.arange(coefficients.shape[2])
    return np.einsum("btn,btna->bta", powers, coefficients[flight, segment])


def _fastest(coefficients: Float[np.ndarray, "b m n 3"], durations: Float[np.ndarray, "b m"]) -> Float[np.ndarray, "b"]:
    """Maximum speed of each flight as solved [m/s], from samples."""
    degrees = np.arange(1, coefficients.shape[2])
    slopes = np.linspace(0.0, 1.0, _SPEED_SAMPLES)[:, None] ** (degrees - 1) * degrees
    velocity = np.einsum("sn,bmna->bmsa", slopes, coefficients[:, :, 1:]) / durations[:, :, None, None]
    return np.linalg.norm(velocity, axis=-1).max(axis=(1, 2))
