"""From where a refinement begins: the chosen plan's own waypoints and times, and those that the placing policy gives.

Both are six segments on what is left of the chosen plan; the better start is descended from (``descent.py``). The
policy is asked for several meetings along the target's way at once, and of its plans the soonest counts that is there
in time.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.arrays import AnyArray
from jaxplan.optimizer.margins import FARTHEST_STOP, LONGEST, SHORTEST
from jaxplan.optimizer.problem import Variables
from jaxplan.planner.refined import RefinementConfig, Seed
from jaxplan.planner.validator import Room
from jaxplan.policy.placing import SEGMENTS, Courses, Place, look_around
from jaxplan.spline import FlatState

STOP_TIME, SHORT = 0.5, 0.2
"""s; how long the way to rest takes where a plan rests at its goal, or is there sooner than the second (arbitrary)."""
MEETINGS = np.linspace(0.5, 1.2, 12)
"""Shares of the seed's time to the meeting at which the policy is asked to meet the target instead (arbitrary)."""
INSIDE = 0.99
"""Share of the meeting ball and of the farthest stop within which starts are."""
FINE = 33
"""Instants of what is left of a seed before it is cut evenly (arbitrary)."""


class Expected(NamedTuple):
    """The mean of the target's predicted motion, at even intervals from the plan's start on."""

    interval: float
    """[s]"""
    position: Float[np.ndarray, "n 3"]
    """[m]"""
    spread: Float[np.ndarray, "n"]
    """Of the predicted positions around it [m]."""
    horizon: float
    """Until when it is known [s]; it rests behind that."""

    def at(self, time: Float[np.ndarray, "*t"] | float) -> Float[np.ndarray, "*t 3"]:
        """Where the target is at one instant or at several [s]."""
        return np.stack([np.interp(time, self._times, self.position[:, axis]) for axis in range(3)], axis=-1)

    def meet_radius(self, time: float, config: RefinementConfig) -> float:
        """How far from there it may be met at that time [m]: the less certain it is, the nearer."""
        spread = float(np.interp(time, self._times, self.spread))
        return max(config.meet_radius - config.caution * spread, config.least_radius)

    @property
    def _times(self) -> Float[np.ndarray, "n"]:
        return self.interval * np.arange(len(self.position))


def seed_start(seed: Seed, target: Float[np.ndarray, "3"], radius: float, segments: int) -> Variables:
    """The seed's own waypoints at even intervals of time, for one start.

    Where it passes the target farther than ``radius`` [m] they are moved on to meet it, as an even acceleration would.
    """
    rest = _rest(seed)
    times = np.r_[np.linspace(0.0, seed.meeting, segments), seed.meeting + rest]
    points = np.asarray(seed.spline.evaluate(seed.since + times))[:, :3]
    offset = _shortened((points[-2] - target) / radius, 0.9)
    moved = target + radius * offset - points[-2]
    shares = np.minimum(times / seed.meeting, 1.0)[:, None] ** 2
    return _variables(np.diff(times), points + shares * moved, offset)


def placed_start(
    place: Place,
    numbers: Float[np.ndarray, "6"],
    room: Room,
    state: FlatState,
    seed: Seed,
    expected: Expected,
    offset: Float[np.ndarray, "3"],
    radius: float,
) -> Variables:
    """The policy's plan to the soonest of a few meetings at which it is in time, for one start.

    Args:
        place: the policy, compiled for as many courses as there are ``MEETINGS``.
        numbers: of the vehicle that flies (``vehicle_numbers``).
        room: for what is around the courses.
        state: where the plan begins.
        seed: along which the courses lead.
        expected: the target's motion.
        offset: of the target that is to be met from there [m].
        radius: within which it must be passed [m].
    """
    meetings = MEETINGS * seed.meeting
    targets = expected.at(meetings) + offset
    points = _courses(seed, targets)

    def distance(places: Float[AnyArray, "12 4 3 k"]) -> Float[AnyArray, "12 4 k"]:
        return room.free_distance(np.moveaxis(np.asarray(places), 2, -1).reshape(-1, 3)).reshape(12, 4, -1)

    width = len(meetings)
    courses = Courses(
        points=points,
        room=look_around(distance, points),
        meet_radius=np.full(width, radius),
        vehicle=np.repeat(numbers[:, None], width, axis=1),
    )
    placed = place(courses, state.repeated(width))
    durations, through = np.asarray(placed.durations, float), np.asarray(placed.points, float)
    early = durations[:-1].sum(axis=0) <= meetings
    best = int(np.argmax(early)) if early.any() else width - 1
    meet = through[-2, :, best]
    return _variables(durations[:, best], through[..., best], (meet - targets[best]) / radius)


def _courses(seed: Seed, targets: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "7 3 k"]:
    """What is left of a seed, cut evenly and moved on to each of the targets."""
    times = np.r_[np.linspace(0.0, seed.meeting, FINE), seed.meeting + _rest(seed)]
    path = np.asarray(seed.spline.evaluate(seed.since + times))[:, :3]
    travelled = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path[:-1], axis=0), axis=1))]
    shares = np.linspace(0.0, 1.0, SEGMENTS)
    even = np.stack([np.interp(shares * travelled[-1], travelled, path[:-1, axis]) for axis in range(3)], axis=1)
    points, moved = np.concatenate([even, path[-1:]]), targets.T - even[-1][:, None]
    return points[:, :, None] + np.r_[shares**2, 1.0][:, None, None] * moved[None]


def _variables(
    durations: Float[np.ndarray, "m"], points: Float[np.ndarray, "n 3"], offset: Float[np.ndarray, "3"]
) -> Variables:
    """For one start, within the optimiser's bounds."""
    return Variables(
        log_durations=np.log(np.clip(durations, 1.05 * SHORTEST, 0.95 * LONGEST))[:, None],
        inner=points[1:-2, :, None],
        offset=_shortened(offset, INSIDE)[:, None],
        stop=_shortened(points[-1] - points[-2], INSIDE * FARTHEST_STOP)[:, None],
    )


def _rest(seed: Seed) -> float:
    """How long the way from the meeting to rest takes [s]."""
    rest = float(seed.spline.duration) - seed.since - seed.meeting
    return rest if rest >= SHORT else STOP_TIME


def _shortened(vector: Float[np.ndarray, "3"], most: float) -> Float[np.ndarray, "3"]:
    """The vector, no longer than ``most``."""
    return vector * min(1.0, most / max(float(np.linalg.norm(vector)), 1e-9))
