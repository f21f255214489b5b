"""From where the optimisation begins: taut routes that pass obstacles differently, flown slowly (host)."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

from jaxplan.optimizer.problem import Variables
from jaxplan.search.lattice import Lattices
from jaxplan.search.routes import find_routes
from jaxplan.world.obstacles import World

VIAS = 400
"""Points of the room by which routes are sent."""
APART = 0.6
"""Routes whose points at equal shares of their lengths are nearer than this [m] along every axis count as one."""
LONGER, MORE = 1.7, 1.0
"""Routes longer than the shortest by this factor and these metres are left out."""
ACCELERATION, DELAY = 5.0, 0.5
"""m/s^2 and s, of the guess how long a route takes: slow, since the target is not where a faster plan would meet it."""
GUESSES = np.linspace(0.4, 6.0, 29)
"""s; meeting times that are tried for the guess."""
STOPS = (1.2, 0.2)
"""Metres straight on behind the meeting, in the order in which they are tried."""
STOP_TIME = 0.8
"""s from the meeting to the stop."""
GATHERING = 1.4
"""Exponent of the waypoints' places along the route: the vehicle gathers speed, segments take equal times."""
_POINTS = 25
"""By which routes are compared."""

Route = Float[np.ndarray, "_ 3"]


class Sought(NamedTuple):
    """Where routes are looked for. All numbers below are arbitrary but for the world's own."""

    lattices: Lattices
    world: World
    start: Float[np.ndarray, "3"]


def first_guesses(
    sought: Sought, target: Callable[[Float[np.ndarray, "n"]], Float[np.ndarray, "n 3"]], segments: int, width: int
) -> Variables:
    """Variables of ``width`` starts, every route with the first stop before any with the second.

    Args:
        sought: world and start.
        target: where the target is so many seconds after the plan's start [m, world].
        segments: m of every start.
        width: how many.
    """
    goals = target(GUESSES)
    direct = find_routes(sought.lattices, sought.world, sought.start, goals, 0.0)
    late = _duration(direct.length) - GUESSES
    chosen = int(np.argmax(late <= 0.0)) if (late <= 0.0).any() else int(np.argmin(late))
    points = direct.points[chosen, : max(int(direct.count[chosen]), 1)]
    shortest = points if direct.count[chosen] else np.stack([sought.start, goals[chosen]])
    routes = _different([shortest, *_detours(sought, goals[chosen])], width)
    return _variables([(route, stop) for stop in STOPS for route in routes], segments, width)


def _duration(length: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """A guess how long routes of some ``length`` [m] take [s]."""
    return DELAY + np.sqrt(2.0 * length / ACCELERATION)


def _detours(sought: Sought, goal: Float[np.ndarray, "3"]) -> list[Route]:
    """Routes by points all over the room, shortest first: the taut ways from both ends, joined there."""
    lower, upper = np.asarray(sought.world.bounds, dtype=float)
    vias = lower + qmc.Halton(3, scramble=False).random(VIAS) * (upper - lower)
    ways = [find_routes(sought.lattices, sought.world, end, vias, 0.0) for end in (sought.start, goal)]
    lengths = ways[0].length + ways[1].length
    found = []
    for place in np.argsort(lengths, kind="stable")[: int(np.isfinite(lengths).sum())]:
        first, second = (way.points[place, : way.count[place]] for way in ways)
        found.append(np.concatenate([first, second[-2::-1]]))
    return found


def _different(routes: list[Route], most: int) -> list[Route]:
    """Of routes in the order of their lengths those that differ from all before."""
    limit = LONGER * _along(routes[0])[-1] + MORE
    found: list[Route] = []
    for route in routes:
        if len(found) == most or _along(route)[-1] > limit:
            break
        if all(np.abs(_resampled(route, 1.0) - _resampled(other, 1.0)).max() > APART for other in found):
            found.append(route)
    return found


def _variables(choices: list[tuple[Route, float]], segments: int, width: int) -> Variables:
    """Starts on the routes; the first ones again where there are too few."""
    columns = []
    for place in range(width):
        route, stop = choices[place % len(choices)]
        points = _resampled(route, GATHERING, segments)
        ahead = points[-1] - points[-2]
        step = float(_duration(_along(route)[-1:])[0]) / (segments - 1)
        columns.append(
            Variables(
                log_durations=np.log(np.r_[np.full(segments - 1, step), STOP_TIME]),
                inner=points[1:-1],
                offset=np.zeros(3),
                stop=stop * ahead / max(float(np.linalg.norm(ahead)), 1e-9),
            )
        )
    return Variables(*(np.stack(parts, axis=-1) for parts in zip(*columns, strict=True)))


def _along(route: Route) -> Float[np.ndarray, "n"]:
    """Arc length at each point [m]."""
    return np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=1))]


def _resampled(route: Route, exponent: float, count: int = _POINTS) -> Float[np.ndarray, "{count} 3"]:
    """``count`` points at the arc lengths L (i / (count - 1))^exponent."""
    along = _along(route)
    at = along[-1] * (np.arange(count) / (count - 1)) ** exponent
    return np.stack([np.interp(at, along, route[:, axis]) for axis in range(3)], axis=1)
