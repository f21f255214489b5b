"""Goals and stops of corrections as array arithmetic: every stop behind every goal is looked at."""

import numpy as np

from jaxplan.planner import corrections as options
from jaxplan.planner.validator import Room


def ways(
    room: Room, start: np.ndarray, goals: np.ndarray, times: np.ndarray, wanted: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """As ``jaxplan.planner.kernels.ways.find_ways`` with the settings of ``corrections``."""
    position, velocity = start
    since = np.linspace(0.0, 1.0, options.LOOKED_AT + 1)[1:, None, None]
    straight = position + since * times[:, None] * velocity
    way = straight + since**2 * (goals - position - times[:, None] * velocity)
    order = np.argsort(missing(room, way, wanted), kind="stable")[: options.GOALS]
    goals, times = goals[order], times[order]
    even = (goals - position) / times[:, None]
    passing = 2.0 * even - velocity
    slow = np.linalg.norm(passing, axis=1) < options.SLOW
    return behind(room, goals, times, np.where(slow[:, None], even, passing), wanted)


def behind(
    room: Room, goals: np.ndarray, times: np.ndarray, passing: np.ndarray, wanted: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The stops behind goals that are passed so [m/s]."""
    speed, axes = np.linalg.norm(passing, axis=1), (options.DECELERATIONS, options.TURNS, options.CLIMBS)
    decelerations, turns, climbs = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
    rests = np.maximum(options.SHORTEST_STOP, options.REACTION + speed[:, None] / decelerations)
    course, climb = np.arctan2(passing[:, 1], passing[:, 0]), np.arcsin(passing[:, 2] / np.maximum(speed, 1e-9))
    heading, pitch = course[:, None] + np.radians(turns), 0.5 * climb[:, None] + np.radians(climbs)
    directions = np.stack([np.cos(heading) * np.cos(pitch), np.sin(heading) * np.cos(pitch), np.sin(pitch)], axis=2)
    stops = goals[:, None] + options.STOP_REACH * (rests * speed[:, None])[..., None] * directions
    gentle = decelerations < max(options.DECELERATIONS)
    cost = options.TURN_COST * np.abs(turns) + options.CLIMB_COST * np.abs(climbs) + options.LONG_COST * gentle
    shares = np.linspace(0.0, 1.0, options.LOOKED_AT + 1)[1:, None, None, None]
    close = missing(room, goals[:, None] + shares * (stops - goals[:, None]), wanted)
    best = np.argsort(cost + options.NEAR_COST * close, axis=1, kind="stable")[:, : options.STOPS]
    chosen = np.take_along_axis(stops, best[..., None], axis=1).reshape(-1, 3)
    rest = np.take_along_axis(rests, best, axis=1).ravel()
    return np.repeat(goals, options.STOPS, axis=0), chosen, np.repeat(times, options.STOPS), rest


def missing(room: Room, points: np.ndarray, wanted: float) -> np.ndarray:
    """By how much [m] each way's points come closer to something than wanted."""
    free = room.free_distance(points.reshape(-1, 3)).reshape(points.shape[:-1])
    return np.maximum(wanted - free.min(axis=0), 0.0)
