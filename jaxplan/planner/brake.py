"""Stops, for when the committed plan may not be flown any more and there is no other (host).

A stop is a straight flight from the present state to rest, at one of several decelerations and directions around that
of the velocity, all checked at once like any other plan, but for the deviation: there is no path to keep.
"""

import numpy as np
from jaxtyping import Float, Int

from jaxplan.batching import at_fixed_width, pick
from jaxplan.knots import MAX_WAYPOINTS
from jaxplan.planner.border import usual_state
from jaxplan.planner.parts import Parts
from jaxplan.planner.records import Stops
from jaxplan.planner.stations import Routes, Trajectories, shortened
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.status import Reason

INSTANTS = 64
"""Of a trajectory, to see how fast it runs into something (arbitrary: 1 to 3 cm apart in a stop)."""
DECELERATIONS = (28.0, 20.0, 14.0, 9.0)
"""Mean ones [m/s^2], along the way (arbitrary; the first is near what the preset ``mfrl`` can)."""
TURNS = ((0, 0), (25, 0), (-25, 0), (50, 0), (-50, 0), (80, 0), (-80, 0), (0, 25), (0, -25), (30, 25), (-30, 25))
"""From the direction of the velocity to that of the stop: sideways and upwards [degrees] (arbitrary)."""
REACTION = 0.12
"""Seconds in which the thrust is turned around: so long the acceleration is taken to go on (arbitrary)."""
SHORTEST_TIME = 0.4
"""Of a stop [s], for slow starts (arbitrary)."""


def brake(parts: Parts, state: FlatState) -> Stops:
    """Stops from one state, each at a deceleration and in a direction of its own."""
    state = usual_state(state)
    ways, times = _ways(state)
    count = len(times)
    start = np.asarray(state.pos)[:, None]
    waypoints = np.repeat((start + ways.T)[None], MAX_WAYPOINTS, axis=0)
    waypoints[0] = start
    shares = np.linspace(0.0, 1.0, parts.config.knots.samples)[:, None, None]
    two = np.full(count, 2)
    routes = shortened(Routes(waypoints, two, two - 1, start + shares * ways.T, np.zeros(count, np.uint32)))
    durations = np.zeros((len(routes.waypoints) - 1, count))
    durations[0] = times
    least = parts.config.checks.least_probability

    def check(some: Int[np.ndarray, "n"]) -> Trajectories:
        solved = parts.stations.solve(state, pick(routes, some), durations[:, some], start[:, 0], least)
        return parts.stations.clear_finely(parts.world, solved)

    found = at_fixed_width(check, np.arange(count), parts.config.width)
    unfit = np.asarray(found.margins.reasons) & ~np.uint32(Reason.DEVIATION)
    splines = [found.splines.spline(one) for one in range(count)]
    return Stops(
        goals=waypoints[1].T,
        arrival_times=times,
        reasons=unfit,
        splines=found.splines,
        margins=found.margins,
        impact=np.array([impact(parts, spline, 0.0) for spline in splines]),
    )


def impact(parts: Parts, spline: PiecewisePolynomial, since: float) -> float:
    """Speed [m/s] where a trajectory, from ``since`` [s] on, first touches something; 0 for nowhere."""
    times = np.linspace(min(since, float(spline.duration)), float(spline.duration), INSTANTS)
    if not np.isfinite(np.asarray(spline.position)).all():
        return np.inf
    touching = parts.room.free_distance(np.asarray(spline.evaluate(times))[:, :3]) < parts.radius
    speeds = np.linalg.norm(np.asarray(spline.evaluate(times, 1))[:, :3], axis=1)
    return float(speeds[np.argmax(touching)]) if touching.any() else 0.0


def _ways(state: FlatState) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k"]]:
    """Where to [m from here] and how long [s]: on for a moment, then evenly slower."""
    velocity, acceleration = np.asarray(state.vel), np.asarray(state.acc)
    carried = velocity * REACTION + 0.5 * acceleration * REACTION**2
    velocity = velocity + acceleration * REACTION
    speed, (vx, vy, vz) = float(np.linalg.norm(velocity)), velocity
    course, climb = np.arctan2(vy, vx), np.arctan2(vz, np.hypot(vx, vy))
    aside, up = np.radians(np.array(TURNS, float)).T
    heading, pitch = course + aside, np.clip(climb + up, -0.5 * np.pi, 0.5 * np.pi)
    directions = np.stack([np.cos(heading) * np.cos(pitch), np.sin(heading) * np.cos(pitch), np.sin(pitch)], axis=1)
    decelerations = np.array(DECELERATIONS)
    ways = carried + directions[:, None] * (speed**2 / (2.0 * decelerations))[None, :, None]
    times = np.maximum(REACTION + speed / decelerations, SHORTEST_TIME)
    return ways.reshape(-1, 3), np.tile(times, len(directions))
