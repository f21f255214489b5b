"""Obstacles that move: boxes that fly to and fro, and a replanner that is told of them.

In every cycle it is told where they will be when: where a box's way is known that is its way, where only its places are
seen what ``Foresight`` makes of them.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.io.targets import Target
from jaxplan.prediction.observations import Observations
from jaxplan.replanner import CommittedPlan, Cycle, Foresight, Measured, MovingBoxes, Replanner, Ways
from jaxplan.replanner.foresight import MEMORY, STRAYING
from jaxplan.spline import FlatState
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.obstacles import World

MOST = 8
"""Boxes that move, in one room: so many spare ones its planner has, whatever the level."""
HALF, SWING = (0.2, 0.4), (1.0, 2.5)
"""m; half sides, and how far they swing to either side (arbitrary)."""
APART, FIRST = 0.8, 1.2
"""m that they keep from the target all the time, and from the defender until it has been on its way for a second."""
AHEAD, ASIDE = 3.0, 0.8
"""s and m: they swing about places between the defender and where the target will be by then, and so far beside."""
TRIED, ROUNDS = 4096, 8
"""Boxes that are drawn at once, and how often, farther and farther aside, before a room is given up."""
FORESEEN, INSTANT = 1.8, 0.025
"""s for which it is told where they will be when, and from one instant to the next."""
INSTANTS = INSTANT * np.arange(round(FORESEEN / INSTANT) + 1)
STRAY = 0.15
"""m that plans keep from that beyond the vehicle's radius."""
SEEN, UNCERTAIN = 0.1, 0.005
"""s between two sightings of boxes, and m: the least standard deviation that their places are taken to have."""
TURNING = 10.0
"""m/s^2 with which boxes turn around that fly straight on before and after (arbitrary)."""


class Mover(NamedTuple):
    """A box, along the room's axes, that moves to and fro about a place."""

    half: Float[np.ndarray, "3"]
    """Half sides [m]."""
    middle: Float[np.ndarray, "3"]
    """[m, world]"""
    swing: Float[np.ndarray, "3"]
    """To one of the two ends [m]."""
    rate: float
    """Speed in the middle by the length of ``swing`` [rad/s]."""
    phase: float
    """[rad]"""
    abrupt: bool = False
    """Whether it flies at one speed and turns around at its ends with ``TURNING``, or swings as a pendulum."""

    def positions(self, times: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n 3"]:
        """Of its centre [m, world] at ``times`` [s]."""
        share = self._to_and_fro(times) if self.abrupt else np.sin(self.rate * times + self.phase)
        return np.asarray(self.middle + share[:, None] * self.swing)

    def distances(self, times: Float[np.ndarray, "n"], points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """From each point [m, world] to the box at that point's time [s]; 0 inside."""
        beyond = np.maximum(np.abs(points - self.positions(times)) - self.half, 0.0)
        return np.asarray(np.linalg.norm(beyond, axis=1))

    def _to_and_fro(self, times: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Where between its ends, -1 and 1, it is: evenly, but for turns of one acceleration."""
        turn = TURNING / float(np.linalg.norm(self.swing))
        speed = min(self.rate, np.sqrt(2.0 * turn))
        quarter = 1.0 / speed + 0.5 * speed / turn
        since = (times + 0.5 * self.phase / np.pi * 4.0 * quarter) % (4.0 * quarter)
        way = np.where(since < 2.0 * quarter, 1.0, -1.0)
        left = np.abs(since % (2.0 * quarter) - quarter)
        slow = np.maximum(speed / turn - left, 0.0)
        return np.asarray(way * (1.0 - speed * left + 0.5 * speed**2 / turn - 0.5 * turn * slow**2))


class Traffic(NamedTuple):
    """All that moves in an episode, but the target and the defender."""

    movers: tuple[Mover, ...]
    known: bool
    """Whether their ways are told, or only where they are."""
    noise: float = 0.0
    """Standard deviation of the places that are seen, along each axis [m]."""
    seed: int = 0
    """Of that."""
    straying: float = STRAYING
    """Acceleration [m/s^2] beside what is foreseen that is to be survived, where their ways are not told."""

    def distances(self, times: Float[np.ndarray, "n"], points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """From each point [m, world] to the nearest of them at that point's time [s]; 0 inside."""
        return np.min([mover.distances(times, points) for mover in self.movers], axis=0)

    def ways(self, now: float, keep: float) -> Ways:
        """Where all of them will be when, as far as that is known ``now`` [s]; plans are to ``keep`` so far [m]."""
        half = np.stack([mover.half for mover in self.movers])
        if self.known:
            places = np.stack([mover.positions(now + INSTANTS) for mover in self.movers])
            return Ways(now + INSTANTS, places - half[:, None], places + half[:, None], keep)
        foresight = Foresight(half, max(self.noise, UNCERTAIN), self.straying)
        for time in now - SEEN * np.arange(round(MEMORY / SEEN) + 1)[::-1]:
            foresight.see(time, self._seen(time))
        return foresight.ways(now, INSTANTS, keep)

    def _seen(self, time: float) -> Float[np.ndarray, "b 3"]:
        """Where they are seen [m, world] at a time [s]; the same whenever it is asked for."""
        if time < 0.0:
            return np.full((len(self.movers), 3), np.nan)
        rng = np.random.default_rng((self.seed, round(time / SEEN)))
        places = np.stack([mover.positions(np.array([time]))[0] for mover in self.movers])
        return places + self.noise * rng.normal(size=places.shape)


class Warned:
    """A replanner that is told what moves; stands where a ``Replanner`` stands in an episode."""

    def __init__(self, replanner: Replanner, traffic: Traffic, world: World, radius: float) -> None:
        """``world`` is the planner's room, whose last ``MOST`` boxes are spare; ``radius`` is the vehicle's [m]."""
        self._replanner, self._traffic, self._keep = replanner, traffic, radius + STRAY
        self.boxes = MovingBoxes(replanner, world, len(traffic.movers))
        """What the replanner is told by."""

    @property
    def plans(self) -> list[CommittedPlan]:
        """As the replanner's."""
        return self._replanner.plans

    @property
    def ever_planned(self) -> bool:
        """As the replanner's."""
        return self._replanner.ever_planned

    def reference(self, times: Float[np.ndarray, "n"]) -> FlatState:
        """As the replanner's."""
        return self._replanner.reference(times)

    def step(self, now: float, observations: Observations, measured: Measured | None = None) -> Cycle:
        """Tell what has changed, then decide."""
        here = np.asarray(self.reference(np.array([now])).pos)[0] if measured is None else measured.position
        self.boxes.tell(self._traffic.ways(now, self._keep), here)
        return self._replanner.step(now, observations, measured)


def traffic_in(
    world: World,
    target: Target,
    start: Float[np.ndarray, "3"],
    until: float,
    count: int,
    speed: float,
    seed: int,
    abrupt: bool = False,
) -> tuple[Mover, ...]:
    """Boxes that fly to and fro in free space at a maximum speed [m/s]; the same for the same seed.

    Args:
        world: they touch nothing in it.
        target: they stay out of its way.
        start: they stay away from there [m, world] ``until`` a time [s].
        count: how many.
        speed: in the middle of their way.
        seed: of all that is drawn.
        abrupt: whether they turn around at once, or swing.

    Raises ``InputError`` where the room has no place for them.
    """
    rng, found = np.random.default_rng((seed, 6)), list[Mover]()
    times = np.arange(0.0, target.duration, 0.05)
    flown, early = target.position(times), times[times < until]
    for attempt in range(ROUNDS):
        for drawn in _drawn(world, target, start, until, speed, (1.0 + attempt) * ASIDE, rng):
            mover = drawn._replace(abrupt=abrupt)
            beside = mover.distances(early, np.broadcast_to(start, (len(early), 3))).min() > FIRST
            if beside and mover.distances(times, flown).min() > APART:
                found.append(mover)
            if len(found) == count:
                return tuple(found)
    raise InputError(f"arena: world {world.name!r} has no place for {count} boxes that move; choose another --seed")


def _drawn(
    world: World,
    target: Target,
    start: Float[np.ndarray, "3"],
    until: float,
    speed: float,
    aside: float,
    rng: np.random.Generator,
) -> list[Mover]:
    """Boxes that touch nothing, so far [m] beside the ways to the target; arguments as ``traffic_in``."""
    lower, upper = np.asarray(world.bounds, dtype=float)
    half, meeting = rng.uniform(*HALF, (TRIED, 3)), target.position(rng.uniform(until, until + AHEAD, TRIED))
    between = start + rng.uniform(0.2, 1.0, (TRIED, 1)) * (meeting - start)
    middle = np.clip(between + rng.normal(scale=aside, size=(TRIED, 3)), lower, upper)
    course, climb = rng.uniform(0.0, 2.0 * np.pi, TRIED), rng.normal(scale=0.2, size=TRIED)
    way = np.stack([np.cos(course), np.sin(course), climb], axis=1)
    length, phase = rng.uniform(*SWING, TRIED), rng.uniform(0.0, 2.0 * np.pi, TRIED)
    swing = length[:, None] * way / np.linalg.norm(way, axis=1, keepdims=True)
    places = middle + np.linspace(-1.0, 1.0, 9)[:, None, None] * swing
    clear = (host_free_distance(world, places) > np.linalg.norm(half, axis=1)).all(axis=0)
    return [
        Mover(half[number], middle[number], swing[number], speed / float(length[number]), float(phase[number]))
        for number in np.flatnonzero(clear)
    ]
