"""Obstacles that move: boxes that swing to and fro, and how a planner that knows still ones is told of them.

A planner is told, in every cycle, of a still box for each that moves: what it will sweep within the next seconds. So a
plan that is committed keeps clear of where they may be until then, and what is left of it is looked at again whenever
they are told anew. Where a box's way is known the swept volume is that of its way; where only its places are seen, that
of flying straight on, and wider. Who is about to be hit is told of a shorter while, so that a plan can begin where the
vehicle is: where the boxes will be at which instant is told beside (``Replanner.expect``), so that it leaves in time.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.io.targets import Target
from jaxplan.prediction.observations import Observations
from jaxplan.replanner import CommittedPlan, Cycle, Measured, Replanner, Ways
from jaxplan.spline import FlatState
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.obstacles import World
from jaxplan.world.update import Corners, update_world

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
HORIZONS = (1.8, 1.2, 0.8, 0.4, 0.0)
"""s that are told; shorter ones where the vehicle is in the way."""
ENOUGH = 1.0
"""s; what is told is told anew once it does not hold what is swept within that time any more."""
FREE = 0.4
"""m that what is told must leave around the vehicle for plans to begin there."""
FORESEEN, INSTANT = 1.8, 0.025
"""s for which it is told where they will be when, and from one instant to the next."""
NEAR = 27.0
"""m from the vehicle, within which boxes are told: as far as it flies in that time at 15 m/s. At 12 m/s a stop takes
7 m, and what was told from 6 m on only came too late."""
STRAY = 0.15
"""m that plans keep from that beyond the vehicle's radius."""
BEFORE, WIDER = 0.1, 0.1
"""s since a box was seen before; and m by which what it sweeps is wider where its way is not known."""


class Mover(NamedTuple):
    """A box, along the room's axes, that swings about a place."""

    half: Float[np.ndarray, "3"]
    """Half sides [m]."""
    middle: Float[np.ndarray, "3"]
    """[m, world]"""
    swing: Float[np.ndarray, "3"]
    """To one of the two ends [m]."""
    rate: float
    """[rad/s]"""
    phase: float
    """[rad]"""

    def positions(self, times: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n 3"]:
        """Of its centre [m, world] at ``times`` [s]."""
        return np.asarray(self.middle + np.sin(self.rate * times + self.phase)[:, None] * self.swing)

    def distances(self, times: Float[np.ndarray, "n"], points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """From each point [m, world] to the box at that point's time [s]; 0 inside."""
        beyond = np.maximum(np.abs(points - self.positions(times)) - self.half, 0.0)
        return np.asarray(np.linalg.norm(beyond, axis=1))


class Traffic(NamedTuple):
    """All that moves in an episode, but the target and the defender."""

    movers: tuple[Mover, ...]
    known: bool
    """Whether their ways are told, or only where they are."""

    def distances(self, times: Float[np.ndarray, "n"], points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """From each point [m, world] to the nearest of them at that point's time [s]; 0 inside."""
        return np.min([mover.distances(times, points) for mover in self.movers], axis=0)

    def swept(self, mover: Mover, now: float, seconds: float) -> Corners:
        """The box around what one of them sweeps within ``seconds``, as far as that is known ``now`` [s]."""
        lower, upper = self._foreseen(mover, now, np.linspace(0.0, seconds, 32))
        return lower.min(axis=0), upper.max(axis=0)

    def ways(self, now: float, keep: float) -> Ways:
        """Where all of them will be when, as far as that is known ``now`` [s]; plans are to ``keep`` so far [m]."""
        ahead = INSTANT * np.arange(round(FORESEEN / INSTANT) + 1)
        lower, upper = (
            np.stack(part) for part in zip(*(self._foreseen(one, now, ahead) for one in self.movers), strict=True)
        )
        return Ways(now + ahead, lower, upper, keep)

    def _foreseen(self, mover: Mover, now: float, ahead: Float[np.ndarray, "n"]) -> Corners:
        """Lower and upper corners (n, 3) [m] of one of them so long [s] after ``now``."""
        if self.known:
            way, wider = mover.positions(now + ahead), 0.0
        else:
            before, here = mover.positions(np.array([now - BEFORE, now]))
            way, wider = here + ahead[:, None] / BEFORE * (here - before), WIDER
        reach = mover.half + wider
        return way - reach, way + reach


class Warned:
    """A replanner that is told what will be swept; stands where a ``Replanner`` stands in an episode."""

    def __init__(self, replanner: Replanner, traffic: Traffic, world: World, radius: float) -> None:
        """``world`` is the planner's room, whose last ``MOST`` boxes are spare; ``radius`` is the vehicle's [m]."""
        self._replanner, self._traffic, self._world, self._keep = replanner, traffic, world, radius + STRAY
        self._first = len(world.boxes.center) - MOST
        self._told: list[Corners | None] = [None] * len(traffic.movers)
        self.changes = 0
        """How often the planner was told something."""

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
        for number, mover in enumerate(self._traffic.movers):
            told = self._to_tell(mover, self._told[number], now, here)
            if told is not None:
                change = update_world(self._world, move_box=(self._first + number, told))
                self._world, self._told[number] = change.world, told
                self._replanner.update(change, moving=True)
                self.changes += 1
        self._replanner.expect(self._traffic.ways(now, self._keep))
        return self._replanner.step(now, observations, measured)

    def _to_tell(self, mover: Mover, told: Corners | None, now: float, here: Float[np.ndarray, "3"]) -> Corners | None:
        """What to tell anew of one of them; None where what was told will do, or it is too far away to matter."""
        soon = self._traffic.swept(mover, now, ENOUGH)
        if told is None and distance_to(soon, here) > NEAR:
            return None
        if told is not None and _holds(told, soon) and distance_to(told, here) >= FREE:
            return None
        every = [self._traffic.swept(mover, now, seconds) for seconds in HORIZONS]
        return next((box for box in every if distance_to(box, here) >= FREE), every[-1])


def distance_to(box: Corners, point: Float[np.ndarray, "3"]) -> float:
    """From a point to a box [m]; 0 inside."""
    lower, upper = box
    return float(np.linalg.norm(np.maximum(np.maximum(lower - point, point - upper), 0.0)))


def _holds(outer: Corners, inner: Corners) -> bool:
    """Whether one box is in another."""
    return bool((np.asarray(outer[0]) <= inner[0]).all() and (np.asarray(outer[1]) >= inner[1]).all())


def traffic_in(
    world: World, target: Target, start: Float[np.ndarray, "3"], until: float, count: int, speed: float, seed: int
) -> tuple[Mover, ...]:
    """Boxes that swing in free space at a maximum speed [m/s]; the same for the same seed.

    Args:
        world: they touch nothing in it.
        target: they stay out of its way.
        start: they stay away from there [m, world] ``until`` a time [s].
        count: how many.
        speed: in the middle of their swing.
        seed: of all that is drawn.

    Raises ``InputError`` where the room has no place for them.
    """
    rng, found = np.random.default_rng((seed, 6)), list[Mover]()
    times = np.arange(0.0, target.duration, 0.05)
    flown, early = target.position(times), times[times < until]
    for attempt in range(ROUNDS):
        for mover in _drawn(world, target, start, until, speed, (1.0 + attempt) * ASIDE, rng):
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
