"""Stops, for when the committed plan may not be flown any more and there is no other (host).

A stop is a flight from the present state to rest, at one of several decelerations, straight on in one of several
directions around that of the velocity, or along the committed plan, which is clear up to what is in its way. All are
checked at once like any other plan, but for the deviation: there is no path to keep. A slow vehicle that stands in the
way of something steps aside.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxplan.batching import pick
from jaxplan.knots import MAX_WAYPOINTS
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.planner.border import usual_spline, usual_state
from jaxplan.planner.fallbacks import Stops
from jaxplan.planner.parts import Parts
from jaxplan.planner.stations import Routes, shortened
from jaxplan.polynomials import derivative_table
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.status import Reason
from jaxplan.validation import as_number

INSTANTS = 64
"""Of a trajectory, to see how fast it runs into something (arbitrary: 1 to 3 cm apart in a stop)."""
DECELERATIONS = (28.0, 20.0, 14.0, 9.0, 6.0)
"""Mean ones [m/s^2], along the way (arbitrary; the first is near what the preset ``mfrl`` can)."""
TURNS = ((0, 0), (25, 0), (-25, 0), (50, 0), (-50, 0), (80, 0), (-80, 0), (0, 25), (0, -25))
"""From the direction of the velocity to that of the stop: sideways and upwards [degrees] (arbitrary)."""
REACTION = 0.12
"""Seconds in which the thrust is turned around: so long the acceleration is taken to go on (arbitrary)."""
SHORTEST_TIMES = (0.4, 0.55, 0.75, 1.0, 1.5)
"""Of a stop [s] at each deceleration, for slow starts whose thrust points elsewhere (arbitrary)."""
LEGS = (2, 3)
"""Of stops along a plan: the more, the nearer they keep to it and the more they turn (arbitrary)."""
SLOW = 4.0
"""m/s; up to which a vehicle steps aside."""
ASIDE = ((0.4, 0.55), (0.8, 0.75), (1.5, 1.05), (2.5, 1.4), (0.4, 0.9), (0.8, 1.25), (1.5, 1.7))
"""How far [m] and in what time [s] it does: from rest that takes 10 m/s^2, and 4 m/s^2 where there is time."""


class _Ways(NamedTuple):
    """Stops before they are solved, batch last."""

    waypoints: Float[np.ndarray, "n 3 k"]
    """The last one repeated [m, world]."""
    legs: Int[np.ndarray, "k"]
    times: Float[np.ndarray, "k"]
    """Of the whole stop [s]."""


def brake(
    parts: Parts,
    state: FlatState,
    along: PiecewisePolynomial | None = None,
    since: float = 0.0,
    aside: bool = False,
) -> Stops:
    """Stops from one state, each at a deceleration and in a direction of its own; bad arguments raise ``InputError``.

    Args:
        parts: of the planner.
        state: where they begin.
        along: the plan that is flown; some stops go the way that it goes from ``since`` [s of its own time] on.
        since: when they begin.
        aside: whether there are also steps aside, where the vehicle is slow.
    """
    state = usual_state(state)
    every = [_straight(state)]
    if along is not None:
        plan, begin = usual_spline(along), as_number("brake: since", since)
        every += [_along(state, plan, begin, number) for number in LEGS]
    if aside and np.linalg.norm(np.asarray(state.vel)) <= SLOW:
        every.append(_aside(state))
    waypoints, legs, times = (np.concatenate(kind, axis=-1) for kind in zip(*every, strict=True))
    count, start = len(times), np.asarray(state.pos)[:, None]
    shares = np.linspace(0.0, 1.0, parts.config.knots.samples)[:, None, None]
    samples = start + shares * (waypoints[-1] - start)
    meet = legs.astype(np.int32)  # as those of searched paths are: other types are another program
    routes = shortened(
        Routes(waypoints, meet + 1, meet, samples, np.zeros(count, np.uint32), np.full((3, count), np.nan))
    )
    segments = np.arange(len(routes.waypoints) - 1)[:, None]
    durations = np.where(segments < legs, times / legs, 0.0)
    least = parts.config.checks.least_probability

    found = parts.clear(parts.solve(state, routes, durations, start[:, 0], least), np.arange(count))
    reasons = np.asarray(found.margins.reasons)
    endless = (reasons & np.uint32(Reason.NONFINITE)) != 0
    touching = np.flatnonzero(((reasons & np.uint32(Reason.CLEARANCE)) != 0) & ~endless)
    hits = np.where(endless, np.inf, 0.0)
    hits[touching] = _impacts(parts, pick(found.splines, touching))
    return Stops(
        goals=waypoints[-1].T,
        arrival_times=times,
        reasons=reasons & ~np.uint32(Reason.DEVIATION),
        splines=found.splines,
        margins=found.margins,
        impact=hits,
        thrust=_thrusts(parts, found.splines),
    )


def impact(parts: Parts, spline: PiecewisePolynomial, since: float) -> float:
    """Speed [m/s] where a trajectory, from ``since`` [s] on, first touches something; 0 for nowhere."""
    times = np.linspace(min(since, float(spline.duration)), float(spline.duration), INSTANTS)
    if not np.isfinite(np.asarray(spline.position)).all():
        return np.inf
    touching = parts.room.free_distance(np.asarray(spline.evaluate(times))[:, :3]) < parts.radius
    speeds = np.linalg.norm(np.asarray(spline.evaluate(times, 1))[:, :3], axis=1)
    return float(speeds[np.argmax(touching)]) if touching.any() else 0.0


def _impacts(parts: Parts, splines: SplineBatch) -> Float[np.ndarray, "k"]:
    """The same for many at once that are finite, from their beginnings on."""
    times = np.linspace(0.0, 1.0, INSTANTS)[:, None] * np.asarray(splines.durations).sum(axis=0)
    ways, velocities = (np.asarray(splines.positions(times, derivative)) for derivative in (0, 1))
    touching = parts.room.free_distance(np.moveaxis(ways, 1, 2)) < parts.radius
    first = np.argmax(touching, axis=0)[None]
    speeds = np.take_along_axis(np.linalg.norm(velocities, axis=1), first, axis=0)[0]
    return np.where(touching.any(axis=0), speeds, 0.0)


def _thrusts(parts: Parts, splines: SplineBatch) -> Float[np.ndarray, "k"]:
    """The most that each trajectory asks for [m/s^2, per mass], without drag."""
    segments, terms, axes, count = splines.position.shape
    table = derivative_table(terms, np.linspace(0.0, 1.0, INSTANTS), 2)
    even = np.matmul(table, np.asarray(splines.position).reshape(segments, terms, axes * count))
    durations = np.asarray(splines.durations)[:, None, None]
    squared = np.where(durations > 0.0, durations, np.inf) ** 2  # padding: a hover, as at every end
    upwards = np.array([0.0, 0.0, float(parts.vehicle.gravity)])[:, None]
    acceleration = even.reshape(segments, INSTANTS, axes, count) / squared + upwards
    most = np.linalg.norm(acceleration, axis=2).max(axis=(0, 1))
    return np.where(np.isfinite(most), most, np.inf)


def _straight(state: FlatState) -> _Ways:
    """Evenly slower in all directions."""
    carried, velocity = _carried(state)
    speed, (vx, vy, vz) = float(np.linalg.norm(velocity)), velocity
    course, climb = np.arctan2(vy, vx), np.arctan2(vz, np.hypot(vx, vy))
    aside, up = np.radians(np.array(TURNS, float)).T
    heading, pitch = course + aside, np.clip(climb + up, -0.5 * np.pi, 0.5 * np.pi)
    directions = np.stack([np.cos(heading) * np.cos(pitch), np.sin(heading) * np.cos(pitch), np.sin(pitch)], axis=1)
    times, lengths = _times_and_lengths(speed)
    ways = (carried + directions[:, None] * lengths[None, :, None]).reshape(-1, 3)
    return _straight_ways(state, ways, np.tile(times, len(directions)))


def _aside(state: FlatState) -> _Ways:
    """From where the vehicle would evenly come to rest, so far towards the faces and edges of a cube."""
    grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    directions = grid[np.isin(np.abs(grid).sum(axis=1), (1.0, 2.0))]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lengths, times = np.array(ASIDE).T
    carried = 0.5 * times[:, None] * np.asarray(state.vel)
    ways = carried[:, None] + lengths[:, None, None] * directions
    return _straight_ways(state, ways.reshape(-1, 3), np.repeat(times, len(directions)))


def _straight_ways(state: FlatState, ways: Float[np.ndarray, "k 3"], times: Float[np.ndarray, "k"]) -> _Ways:
    """To so far [m] from where the vehicle is, each in a time [s]."""
    waypoints = np.repeat((np.asarray(state.pos) + ways).T[None], MAX_WAYPOINTS, axis=0)
    waypoints[0] = np.asarray(state.pos)[:, None]
    return _Ways(waypoints, np.ones(len(ways), np.int64), times)


def _along(state: FlatState, plan: PiecewisePolynomial, since: float, legs: int) -> _Ways:
    """The way that a plan goes, in so many legs, evenly slower; to its end at most."""
    end = float(plan.duration)
    path = np.asarray(plan.evaluate(np.linspace(min(since, end), end, 10 * INSTANTS)))[:, :3]
    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    carried, velocity = _carried(state)
    times, lengths = _times_and_lengths(float(np.linalg.norm(velocity)))
    whole = np.minimum(np.linalg.norm(carried) + lengths, gone[-1])
    shares = np.arange(legs + 1) / legs
    at = (1.0 - (1.0 - shares[:, None]) ** 2) * whole
    waypoints = np.stack([np.interp(at, gone, path[:, axis]) for axis in range(3)], axis=1)
    waypoints[0] = np.asarray(state.pos)[:, None]
    rest = np.repeat(waypoints[-1:], MAX_WAYPOINTS - legs - 1, axis=0)
    return _Ways(np.concatenate([waypoints, rest]), np.full(len(times), legs), times)


def _carried(state: FlatState) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """How far the vehicle goes [m] before it reacts, and its velocity then [m/s]."""
    velocity, acceleration = np.asarray(state.vel), np.asarray(state.acc)
    return velocity * REACTION + 0.5 * acceleration * REACTION**2, velocity + acceleration * REACTION


def _times_and_lengths(speed: float) -> tuple[Float[np.ndarray, "d"], Float[np.ndarray, "d"]]:
    """How long stops take [s], and how far [m] they go after the reaction, by deceleration."""
    times = np.maximum(REACTION + speed / np.array(DECELERATIONS), SHORTEST_TIMES)
    return times, 0.5 * speed * (times - REACTION)
