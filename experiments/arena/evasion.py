"""Targets that react to the defender: a point mass that looks a moment ahead and takes what serves it best.

In each twentieth of a second it tries accelerations in all directions, looks where each would lead, and which of them
leave room to stop before an obstacle, and takes the best of those. What is best is its way: to flee, to fly on until
the last moment and then dodge, or to hide behind obstacles.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.io.targets import Target
from jaxplan.world.host_distance import host_free_distance
from jaxplan.world.obstacles import World

from .sight import in_sight

WAYS = ("flee", "dodge", "hide")
STEP, CYCLE = 0.05, 0.1
"""s; how long an acceleration lasts, and how long a target decides ahead: until the defender is seen again."""
AHEAD = (0.15, 0.3, 0.5)
"""s; at which it looks where an acceleration leads (arbitrary)."""
CLEARANCE = 0.5
"""m that it keeps from everything."""
BRAKING = 0.8
"""Share of the acceleration by which it counts on stopping."""
ALARM, CLOSE = 0.8, 1.5
"""s until the closest approach, and m between the two then, from which on a target dodges."""
NEAR = 0.7
"""m from a place at which it has been reached."""
PLACES = 256


class Agility(NamedTuple):
    """What a point mass can do."""

    speed: float
    """[m/s]"""
    acceleration: float
    """[m/s^2]"""


class _Leg(NamedTuple):
    """A while of constant acceleration."""

    start: float
    position: Float[np.ndarray, "3"]
    velocity: Float[np.ndarray, "3"]
    acceleration: Float[np.ndarray, "3"]


class Evader:
    """One target in one episode: its ``react`` decides, its ``motion`` is what it has flown and will until then."""

    def __init__(self, world: World, way: str, agility: Agility, seed: int) -> None:
        self._world, self._way, self._agility = world, way, agility
        self._rng = np.random.default_rng((seed, 2))
        lower, upper = np.asarray(world.bounds, dtype=float)
        places = self._rng.uniform(lower, upper, (20 * PLACES, 3))
        free = host_free_distance(world, places, 2048)
        self._places = places[free > CLEARANCE + 0.2][:PLACES]
        self._goal = self._places[1]
        still = np.zeros(3)
        self._legs = [_Leg(0.0, self._places[0], still, still)]
        self._directions = _directions()

    def target(self, name: str, duration: float) -> Target:
        """As an episode knows it."""
        return Target(name, duration, self._agility.speed, (), self.motion, 1.0)

    def motion(self, times: Float[np.ndarray, "*n"], derivative: int) -> Float[np.ndarray, "*n 3"]:
        """Position [m] or velocity [m/s] at ``times`` [s]; the newest acceleration goes on."""
        starts = np.array([leg.start for leg in self._legs])
        times = np.asarray(times, dtype=float)
        place = np.clip(np.searchsorted(starts, times.ravel() + 1e-9, side="right") - 1, 0, None)
        since = (times.ravel() - starts[place])[:, None]
        position, velocity, acceleration = (np.stack([leg[kind] for leg in self._legs])[place] for kind in (1, 2, 3))
        found = (
            position + since * velocity + 0.5 * since**2 * acceleration
            if derivative == 0
            else velocity + since * acceleration
        )
        return found.reshape(*times.shape, 3)

    def react(self, now: float, position: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"]) -> None:
        """Decide until the next cycle; the defender is taken to fly on evenly [m, m/s]."""
        for step in range(round(CYCLE / STEP)):
            begin = now + step * STEP
            here, moving = (self.motion(np.array([begin]), order)[0] for order in (0, 1))
            there = position + step * STEP * velocity
            self._legs.append(_Leg(begin, here, moving, self._best(here, moving, there, velocity)))

    def _best(
        self,
        here: Float[np.ndarray, "3"],
        moving: Float[np.ndarray, "3"],
        there: Float[np.ndarray, "3"],
        velocity: Float[np.ndarray, "3"],
    ) -> Float[np.ndarray, "3"]:
        """The acceleration that is worth most among those that leave room to stop, or leaves most room."""
        most = self._agility.acceleration
        tried = np.concatenate(
            [most * self._directions, 0.5 * most * self._directions, np.zeros((1, 3)), -moving[None]]
        )
        tried *= np.minimum(1.0, most / np.maximum(np.linalg.norm(tried, axis=1), 1e-9))[:, None]
        after = moving + STEP * tried
        fast = np.maximum(np.linalg.norm(after, axis=1) / self._agility.speed, 1.0)[:, None]
        tried = (after / fast - moving) / STEP
        room = self._room(here, moving, tried)
        worth = self._worth(here, moving, tried, there, velocity)
        safe = room >= 0.0
        return tried[int(np.argmax(np.where(safe, worth, -1e6 + room)))]

    def _room(
        self, here: Float[np.ndarray, "3"], moving: Float[np.ndarray, "3"], tried: Float[np.ndarray, "a 3"]
    ) -> Float[np.ndarray, "a"]:
        """Least distance [m] beyond what is kept, during a step with each acceleration and a stop behind it."""
        after = moving + STEP * tried
        reached = here + STEP * moving + 0.5 * STEP**2 * tried
        speed = np.linalg.norm(after, axis=1, keepdims=True)
        stop = 0.5 * speed * after / (BRAKING * self._agility.acceleration)
        points = reached[None] + np.linspace(0.0, 1.0, 5)[:, None, None] * stop[None]
        return np.asarray(host_free_distance(self._world, points, 512).min(axis=0)) - CLEARANCE

    def _worth(
        self,
        here: Float[np.ndarray, "3"],
        moving: Float[np.ndarray, "3"],
        tried: Float[np.ndarray, "a 3"],
        there: Float[np.ndarray, "3"],
        velocity: Float[np.ndarray, "3"],
    ) -> Float[np.ndarray, "a"]:
        """What each acceleration is worth to this target [m]."""
        after, reached = moving + STEP * tried, here + STEP * moving + 0.5 * STEP**2 * tried
        later = [reached + time * after for time in AHEAD]
        apart = [
            np.linalg.norm(place - there - time * velocity, axis=1) for place, time in zip(later, AHEAD, strict=True)
        ]
        away = np.min(apart, axis=0)
        if self._way == "dodge" and not self._is_threatened(here, moving, there, velocity):
            return self._onward(here, later[1])
        if self._way == "hide":
            hidden = ~in_sight(self._world, there, later[1])
            return np.asarray(away + 4.0 * hidden)
        return np.asarray(away)

    def _is_threatened(self, here: np.ndarray, moving: np.ndarray, there: np.ndarray, velocity: np.ndarray) -> bool:
        """Whether the defender will soon come close if both fly on evenly."""
        apart, relative = there - here, velocity - moving
        closest = -float(apart @ relative) / max(float(relative @ relative), 1e-9)
        passing = np.linalg.norm(apart + closest * relative)
        return bool(0.0 <= closest <= ALARM and passing <= CLOSE) or bool(np.linalg.norm(apart) <= CLOSE)

    def _onward(self, here: Float[np.ndarray, "3"], later: Float[np.ndarray, "a 3"]) -> Float[np.ndarray, "a"]:
        """How near each acceleration leads to the place that is flown to; another one in sight once it is reached."""
        if np.linalg.norm(self._goal - here) < NEAR or not in_sight(self._world, here, self._goal[None])[0]:
            seen = self._places[in_sight(self._world, here, self._places)]
            if len(seen):
                self._goal = seen[self._rng.integers(len(seen))]
        return -np.asarray(np.linalg.norm(later - self._goal, axis=1))


def _directions() -> Float[np.ndarray, "26 3"]:
    """To the faces, edges and corners of a cube."""
    grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = grid[np.abs(grid).sum(axis=1) > 0.0]
    return np.asarray(grid / np.linalg.norm(grid, axis=1, keepdims=True))
