"""The goals of corrections, and the stops behind each, those first whose straight ways are clear; compiled (host).

Of the many stops behind a goal only those are looked at that may be among the best: a way that comes too close only
adds to what a stop costs, so they are tried in the order of the rest of it until none can be better any more.
"""

import functools
import math
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from jaxplan.planner.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.solids import clearance_at


class StopTable(NamedTuple):
    """Stops behind a goal, in the order in which they are tried. Compiled code takes it as a plain tuple."""

    cost: Float[np.ndarray, "s"]
    """But for what is too close."""
    number: Int[np.ndarray, "s"]
    """Of two that cost the same the lower one is the better."""
    deceleration: Float[np.ndarray, "s"]
    """[m/s^2]"""
    turn: Float[np.ndarray, "s"]
    """To the side [rad]."""
    climb: Float[np.ndarray, "s"]
    """Upwards [rad]."""


class Trial(NamedTuple):
    """How ways are tried. Compiled code takes it as a plain tuple."""

    wanted: float
    """Clearance [m] of a way that costs nothing."""
    near_cost: float
    """By metre that is missing."""
    points: int
    """Of a way, whose clearance is looked at."""
    slow: float
    """m/s; what passes its goal more slowly stops along the way to it."""
    reaction: float
    """s; in which the thrust is turned around."""
    shortest: float
    """s; what a stop takes at least."""
    reach: float
    """Of the way that is flown evenly in the time of a stop, how much a stop takes."""


class Ways(NamedTuple):
    """Goals and the stops behind them."""

    goals: Float[np.ndarray, "n 3"]
    """[m, world]; each as often as there are stops behind it."""
    stops: Float[np.ndarray, "n 3"]
    """[m, world]"""
    times: Float[np.ndarray, "n"]
    """When the goals are reached [s]."""
    rests: Float[np.ndarray, "n"]
    """How long each stop takes [s]."""


@runtime_checkable
class _Find(Protocol):
    def __call__(
        self,
        solids: tuple,
        corners: tuple,
        start: Float[np.ndarray, "2 3"],
        goals: Float[np.ndarray, "g 3"],
        times: Float[np.ndarray, "g"],
        table: tuple,
        trial: tuple,
        missing: Float[np.ndarray, "g"],
        found: tuple,
    ) -> None:
        """Write ``found``, the arrays of ``Ways``; ``missing`` is overwritten."""


def find_ways(
    solids: tuple,
    bounds: Float[np.ndarray, "2 3"],
    start: Float[np.ndarray, "2 3"],
    goals: Float[np.ndarray, "g 3"],
    times: Float[np.ndarray, "g"],
    table: StopTable,
    trial: Trial,
    sizes: tuple[int, int],
) -> Ways:
    """The most promising of some goals, and the best stops behind each.

    Args:
        solids: what is solid in the room.
        bounds: corners of the room [m].
        start: position [m] and velocity [m/s], from which goals are reached at a constant acceleration.
        goals: that may be taken [m, world]; equally clear ones are taken in this order.
        times: when they are reached [s].
        table: of the stops.
        trial: how they are tried.
        sizes: how many goals are taken, and how many stops behind each.
    """
    chosen, behind = sizes
    to, stops = np.zeros((chosen, behind, 3)), np.zeros((chosen, behind, 3))
    when, rests, missing = np.zeros((chosen, behind)), np.zeros((chosen, behind)), np.zeros(len(goals))
    corners = tuple(bounds.ravel().tolist())
    found = to, stops, when, rests
    _compiled()(solids, corners, start, goals, times, tuple(table), tuple(trial), missing, found)
    return Ways(to.reshape(-1, 3), stops.reshape(-1, 3), when.ravel(), rests.ravel())


@functools.cache
def _compiled() -> _Find:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(solids, corners, start, goals, times, table, trial, missing, found):
        _ = version
        to, stops, when, rests = found
        for g in range(len(goals)):
            missing[g] = _missing_to_goal(solids, corners, start, goals[g], times[g], trial)
        cost, number = np.zeros(stops.shape[1]), np.zeros(stops.shape[1], np.int64)
        for row in range(len(to)):
            g = 0
            for other in range(1, len(goals)):
                if missing[other] < missing[g]:
                    g = other
            missing[g] = math.inf
            for i in range(stops.shape[1]):
                when[row, i] = times[g]
                for axis in range(3):
                    to[row, i, axis] = goals[g, axis]
            _behind(solids, corners, start, goals[g], times[g], table, trial, stops[row], rests[row], cost, number)

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _behind(solids, corners, start, goal, time, table, trial, stops, rests, cost, number):
    """Write the best stops behind one goal, the best first, and how long they take [s]."""
    passing = _passing(start, goal, time, trial)
    speed = _length(passing[0], passing[1], passing[2])
    course = math.atan2(passing[1], passing[0])
    climb = 0.5 * math.asin(passing[2] / max(speed, 1e-9))
    count, last = 0, len(cost) - 1
    for s in range(len(table[0])):
        if count > last and table[0][s] > cost[last]:
            break
        rest = max(trial[5], trial[4] + speed / table[2][s])
        heading, pitch = course + table[3][s], climb + table[4][s]
        far, level = trial[6] * (rest * speed), math.cos(pitch)
        x = goal[0] + far * (math.cos(heading) * level)
        y = goal[1] + far * (math.sin(heading) * level)
        z = goal[2] + far * math.sin(pitch)
        own = table[0][s] + trial[1] * _missing_straight(solids, corners, goal, x, y, z, trial)
        place = count
        while place > 0 and (own < cost[place - 1] or (own == cost[place - 1] and table[1][s] < number[place - 1])):
            place -= 1
        if place > last:
            continue
        count = min(count + 1, last + 1)
        for i in range(count - 1, place, -1):
            cost[i], number[i], rests[i] = cost[i - 1], number[i - 1], rests[i - 1]
            stops[i, 0], stops[i, 1], stops[i, 2] = stops[i - 1, 0], stops[i - 1, 1], stops[i - 1, 2]
        cost[place], number[place], rests[place] = own, table[1][s], rest
        stops[place, 0], stops[place, 1], stops[place, 2] = x, y, z


@inner
@no_type_check
def _passing(start, goal, time, trial):
    """How a goal is passed [m/s] at a constant acceleration, or evenly where that is slow."""
    x, y, z = (goal[0] - start[0, 0]) / time, (goal[1] - start[0, 1]) / time, (goal[2] - start[0, 2]) / time
    u, v, w = 2.0 * x - start[1, 0], 2.0 * y - start[1, 1], 2.0 * z - start[1, 2]
    return (x, y, z) if _length(u, v, w) < trial[3] else (u, v, w)


@inner
@no_type_check
def _missing_to_goal(solids, corners, start, goal, time, trial):
    """By how much [m] the way to a goal at a constant acceleration comes closer to something than wanted."""
    free = math.inf
    for i in range(trial[2]):
        share = (i + 1.0) / trial[2]
        even, bent = share * time, share * share
        x = start[0, 0] + even * start[1, 0] + bent * (goal[0] - start[0, 0] - time * start[1, 0])
        y = start[0, 1] + even * start[1, 1] + bent * (goal[1] - start[0, 1] - time * start[1, 1])
        z = start[0, 2] + even * start[1, 2] + bent * (goal[2] - start[0, 2] - time * start[1, 2])
        free = min(free, free_at(solids, corners, x, y, z))
    return max(trial[0] - free, 0.0)


@inner
@no_type_check
def _missing_straight(solids, corners, goal, x, y, z, trial):
    """The same of the straight way behind a goal."""
    free = math.inf
    for i in range(trial[2]):
        share = (i + 1.0) / trial[2]
        u, v, w = goal[0] + share * (x - goal[0]), goal[1] + share * (y - goal[1]), goal[2] + share * (z - goal[2])
        free = min(free, free_at(solids, corners, u, v, w))
    return max(trial[0] - free, 0.0)


@inner
@no_type_check
def free_at(solids, corners, x, y, z):
    """Distance [m] from a point to the nearest obstacle or face of the room, as ``validator.Room.free_distance``."""
    wall = min(min(x - corners[0], corners[3] - x), min(y - corners[1], corners[4] - y))
    wall = min(wall, min(z - corners[2], corners[5] - z))
    u = min(max(x, corners[0]), corners[3])
    v = min(max(y, corners[1]), corners[4])
    w = min(max(z, corners[2]), corners[5])
    return min(wall, clearance_at(solids, u, v, w))


@inner
@no_type_check
def _length(x, y, z):
    return math.sqrt(x * x + y * y + z * z)
