"""Corrections of a flight: short plans straight towards where the target is expected, without a search (host).

Routes and the times allotted to them are for going somewhere from rest. In fast flight, near a target that does what
was not expected, most of them turn too hard to be flown. A correction begins from where the flight would go by itself:
its goal is so large a share of the way from there to where the target is expected, in about the least time that takes,
and it comes to rest behind that, in whatever direction is free. Those goals and stops are taken whose straight ways are
clear. All are solved and checked at once like any other plan, but for the deviation: there is no path to keep.
"""

import functools

import numpy as np
from jaxtyping import Float

from jaxplan.planner.border import usual_state
from jaxplan.planner.capture import Prospect
from jaxplan.planner.fallbacks import Corrections
from jaxplan.planner.kernels.ways import StopTable, Trial, Ways, find_ways
from jaxplan.planner.parts import Parts
from jaxplan.planner.stations import LENGTHS, Routes
from jaxplan.spline import FlatState
from jaxplan.status import Reason

SHARES = (1.0, 0.75, 0.5, 0.25)
"""Of what is missing at the goal's time if nothing changes; 1 leads to where the target is expected (arbitrary)."""
PACES = (0.8, 1.0, 1.25, 1.6, 2.0, 2.5)
"""Times of the goals, in multiples of the least in which ``ACCELERATION`` gets there (arbitrary)."""
ACCELERATION = 15.0
"""m/s^2 (arbitrary: about half of what the preset ``mfrl`` has)."""
TIMES = (0.2, 1.95)
"""s; the shortest and the longest."""
DECELERATIONS, TURNS, CLIMBS = (12.0, 8.0), (0.0, 30.0, -30.0, 60.0, -60.0, 90.0, -90.0), (0.0, 20.0, -20.0)
"""Of the stops behind a goal [m/s^2], and how far to the side and upwards they lead [degrees] (arbitrary)."""
TURN_COST, CLIMB_COST, LONG_COST = 1.0 / 90.0, 1.0 / 40.0, 0.2
"""By degree, and for the gentler deceleration: in which order stops are tried (arbitrary)."""
NEAR_COST = 10.0
"""By metre of clearance that is missing on a straight line."""
GOALS, STOPS = 16, 4
"""That are solved: the most promising goals, and stops behind each. Half as many are flown 0.014 s later (measured)."""
REACTION, SHORTEST_STOP = 0.12, 0.35
"""s; in which the thrust is turned around, and what a stop takes at least."""
STOP_REACH = 0.45
"""Share of the way flown evenly in the time of a stop that the stop leads on."""
CARRIED = 0.15
"""s; so long the acceleration is taken to go on if nothing changes (arbitrary)."""
SPARE = 0.1
"""m of clearance beyond what is kept at least, that ways are looked for with."""
LOOKED_AT = 5
"""Points of a way whose clearance is looked at (arbitrary: what is found is checked anyway)."""
LEAST_PROBABILITY = 0.8
"""Of being tracked, as for the profile of speeds."""
SLOW = 0.5
"""m/s; what passes its goal more slowly stops along the way to it."""


def correct(parts: Parts, state: FlatState, prospect: Prospect) -> Corrections:
    """Corrections from one state, their arrival times those of their goals."""
    state = usual_state(state)
    goals, stops, times, rests = _ways(parts, state, prospect)
    count, start = len(times), np.asarray(state.pos)
    waypoints = np.repeat(stops.T[None], LENGTHS[0], axis=0)
    waypoints[0], waypoints[1] = start[:, None], goals.T
    along = np.linspace(0.0, 1.0, parts.config.knots.samples)[:, None, None]
    samples = start[:, None] + along * (stops.T - start[:, None])
    none, free = np.zeros(count, np.uint32), np.full((3, count), np.nan)
    routes = Routes(waypoints, np.full(count, 3, np.int32), np.ones(count, np.int32), samples, none, free)
    durations = np.zeros((len(waypoints) - 1, count))
    durations[0], durations[1] = times, rests

    solved = parts.solve(state, routes, durations, start, LEAST_PROBABILITY)
    against = np.asarray(solved.margins.reasons) & ~np.uint32(Reason.DEVIATION)
    found = parts.clear(solved, np.flatnonzero(against == 0))
    return Corrections(
        goals=goals,
        arrival_times=times,
        reasons=np.asarray(found.margins.reasons) & ~np.uint32(Reason.DEVIATION),
        splines=found.splines,
        margins=found.margins,
    )


def _ways(parts: Parts, state: FlatState, prospect: Prospect) -> Ways:
    """Goals, those first whose ways are clear, and stops behind them."""
    goals, times = _goals(state, prospect)
    trial = Trial(parts.keep.least + SPARE, NEAR_COST, LOOKED_AT, SLOW, REACTION, SHORTEST_STOP, reach=STOP_REACH)
    start = np.array(state.derivatives[:2], float, order="C")
    return find_ways(parts.room.solids, parts.room.bounds, start, goals, times, _stops(), trial, (GOALS, STOPS))


def _goals(state: FlatState, prospect: Prospect) -> tuple[Float[np.ndarray, "g 3"], Float[np.ndarray, "g"]]:
    """All goals [m, world] and their times [s]."""
    mean = prospect.mean
    paces = np.clip(np.array(PACES) * _least_time(state, prospect.times, mean), *TIMES)
    there = np.stack([np.interp(paces, prospect.times, mean[:, axis]) for axis in range(3)], axis=1)
    carried, shares = _carried(state, paces), np.array(SHARES)[None, :, None]
    goals = carried[:, None] + shares * (there - carried)[:, None]
    return goals.reshape(-1, 3), np.repeat(paces, len(SHARES))


@functools.cache
def _stops() -> StopTable:
    """All stops behind a goal."""
    decelerations, turns, climbs = (axis.ravel() for axis in np.meshgrid(DECELERATIONS, TURNS, CLIMBS, indexing="ij"))
    cost = TURN_COST * np.abs(turns) + CLIMB_COST * np.abs(climbs) + LONG_COST * (decelerations < max(DECELERATIONS))
    order = np.argsort(cost, kind="stable")
    return StopTable(cost[order], order, decelerations[order], np.radians(turns)[order], np.radians(climbs)[order])


def _carried(state: FlatState, times: Float[np.ndarray, "t"]) -> Float[np.ndarray, "t 3"]:
    """Where the vehicle is [m, world] at ``times`` [s] if its acceleration is over soon."""
    begun, times = np.minimum(times, CARRIED)[:, None], times[:, None]
    turned = np.asarray(state.acc) * (0.5 * begun**2 + begun * (times - begun))
    return np.asarray(np.asarray(state.pos) + np.asarray(state.vel) * times + turned)


def _least_time(state: FlatState, times: Float[np.ndarray, "u"], mean: Float[np.ndarray, "u 3"]) -> float:
    """The first of the instants [s] behind the first at which the expected target can be reached with ``ACCELERATION``.

    ``mean``: where it is expected [m, world].
    """
    times = times[1:]
    missing = np.linalg.norm(mean[1:] - _carried(state, times), axis=1)
    near = missing <= 0.5 * ACCELERATION * times**2
    return float(times[np.argmax(near)]) if near.any() else TIMES[1]
