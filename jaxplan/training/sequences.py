"""Waypoint sequences and initial states, as the planner meets them.

At rest: routes between far places of a random room, cut into waypoints like the planner's. In flight: the fastest
flight along such a route is cut at a random time, and routes lead from there to the same goal, to one nearby or to
another one, as in a replan. Free sequences, without a room, fill in what rooms rarely ask for.
"""

import math
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplan.knots import MAX_WAYPOINTS, KnotConfig, select_routes
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.precision import in_float64
from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices
from jaxplan.search.routes import find_routes
from jaxplan.spline import FlatState
from jaxplan.training.labels import Queries, sped_up
from jaxplan.world.obstacles import World

PADDING = 0.5
"""As the planner's [m]."""
CORNERS = 32
"""Corners of the longest taut path; as the planner's."""
GOALS_PER_SEARCH = 32
SPEED_UP = (0.4, 2.5)
"""Range of the factor alpha by which some initial states are sped up, k-th derivative times alpha^k."""


class Room(NamedTuple):
    """A random world, ready to be searched."""

    world: World
    lattices: Lattices


def open_room(world: World) -> Room:
    """Search a world's lattices once."""
    return Room(world, build_lattices(world, SearchConfig(method="multi-resolution", padding=PADDING)))


def rest_queries(room: Room, rng: np.random.Generator, count: int) -> Queries | None:
    """``count`` sequences from hover; None where the room is too full to find them."""
    parts: list[Queries] = []
    for _ in range(8 * count // GOALS_PER_SEARCH):
        start = _places(room, rng, 1)[0]
        found = _routed(room, rng, start, _places(room, rng, GOALS_PER_SEARCH))
        if found is None:
            continue
        width = found.waypoints.shape[-1]
        yaw = np.zeros((3, width))
        step = found.waypoints[1] - found.waypoints[0]
        along = rng.random(width) < 0.5
        yaw[0] = np.where(along, np.arctan2(step[1], step[0]), rng.uniform(-np.pi, np.pi, width))
        parts.append(found._replace(yaw=yaw))
        if sum(part.waypoints.shape[-1] for part in parts) >= count:
            return take(join(parts), np.arange(count))
    return None


def replan_queries(
    room: Room, rng: np.random.Generator, flown: Queries, flights: SplineBatch, count: int
) -> Queries | None:
    """``count`` sequences from states in flight; ``flights`` are the trajectories of the sequences ``flown``."""
    parts: list[Queries] = []
    for _ in range(4 * count // GOALS_PER_SEARCH):
        lane = int(rng.integers(flown.waypoints.shape[-1]))
        state = _state_in_flight(flights, lane, rng)
        goal = flown.waypoints[-1, :, lane]
        goals = goal + rng.normal(size=(GOALS_PER_SEARCH, 3)) * rng.choice([0.05, 1.0, 3.0]) * [1.0, 1.0, 0.3]
        goals[-GOALS_PER_SEARCH // 4 :] = _places(room, rng, GOALS_PER_SEARCH // 4)
        found = _routed(room, rng, np.asarray(state.pos), goals)
        if found is None:
            continue
        parts.append(in_flight(found, state, rng))
        if sum(part.waypoints.shape[-1] for part in parts) >= count:
            return take(join(parts), np.arange(count))
    return None


def free_queries(rng: np.random.Generator, count: int) -> Queries:
    """``count`` sequences from hover in open space: 2 to 14 waypoints, with steps of 0.3 to 8 m."""
    counts = rng.integers(2, MAX_WAYPOINTS + 1, count)
    scale = np.exp(rng.uniform(np.log(0.4), np.log(6.0), count))
    lengths = scale * rng.uniform(0.4, 1.6, (MAX_WAYPOINTS - 1, count))
    wander = rng.uniform(0.1, 1.2, count)
    direction = rng.normal(size=(3, count)) * np.array([1.0, 1.0, 0.3])[:, None]
    points = np.zeros((MAX_WAYPOINTS, 3, count))
    for step in range(MAX_WAYPOINTS - 1):
        direction = direction / np.linalg.norm(direction, axis=0)
        points[step + 1] = points[step] + lengths[step] * direction * (step + 1 < counts)
        direction = direction + wander * rng.normal(size=(3, count)) * np.array([1.0, 1.0, 0.3])[:, None]
    yaw = np.zeros((3, count))
    yaw[0] = rng.uniform(-np.pi, np.pi, count)
    return Queries(points, counts, np.zeros((4, 3, count)), yaw)


def suffix_queries(rng: np.random.Generator, flown: Queries, flights: SplineBatch) -> Queries:
    """The rest of every free sequence from a state in flight, its waypoints moved a little."""
    parts = []
    for lane in range(flown.waypoints.shape[-1]):
        time = rng.random()
        state, passed = _cut(flights, lane, time)
        rest = flown.waypoints[passed + 1 :, :, lane]
        points = np.concatenate([state.pos[None], rest, np.repeat(rest[-1:], passed, axis=0)])
        moved = points + rng.normal(size=points.shape) * rng.choice([0.0, 0.1, 0.5])
        last = int(flown.count[lane]) - 1 - passed
        moved[0], moved[last:] = state.pos, moved[last]
        found = Queries(moved[..., None], np.array([last + 1]), np.zeros((4, 3, 1)), np.zeros((3, 1)))
        parts.append(in_flight(found, state, rng))
    return join(parts)


def in_flight(found: Queries, state: FlatState, rng: np.random.Generator) -> Queries:
    """The same sequences from a state in flight, in part sped up or slowed down as the arrival matching does."""
    width = found.waypoints.shape[-1]
    alpha = np.where(
        rng.random(width) < 0.4, 1.0, np.exp(rng.uniform(math.log(SPEED_UP[0]), math.log(SPEED_UP[1]), width))
    )
    derivatives = np.repeat(state.derivatives[1:, :, None], width, axis=-1)
    return sped_up(found._replace(derivatives=derivatives, yaw=np.repeat(state.yaw[:, None], width, axis=-1)), alpha)


def join(parts: list[Queries]) -> Queries:
    """All of them, one batch after the other."""
    return Queries(*(np.concatenate(leaves, axis=-1) for leaves in zip(*parts, strict=True)))


def take(queries: Queries, members: Int[np.ndarray, "n"]) -> Queries:
    """Some of the sequences, by their index."""
    return Queries(*(leaf[..., members] for leaf in queries))


def _places(room: Room, rng: np.random.Generator, count: int) -> Float[np.ndarray, "n 3"]:
    lower, upper = np.asarray(room.world.bounds)
    return rng.uniform(lower + PADDING, upper - PADDING, (count, 3))


def _routed(
    room: Room, rng: np.random.Generator, start: Float[np.ndarray, "3"], goals: Float[np.ndarray, "k 3"]
) -> Queries | None:
    """Waypoints to the goals that can be reached, from rest with yaw 0; None where there are none."""
    distance = float(np.linalg.norm(goals[0] - start))
    paths = find_routes(room.lattices, room.world, start, goals, distance, capacity=CORNERS)
    good = np.flatnonzero((paths.reasons == 0) & (np.linalg.norm(goals - start, axis=1) > 0.2))
    if not len(good):
        return None
    waypoints, counts = _knots(paths.points, rng.uniform(0.3, 1.0))
    return Queries(
        np.moveaxis(np.asarray(waypoints)[good], 0, -1),
        np.asarray(counts)[good],
        np.zeros((4, 3, len(good))),
        np.zeros((3, len(good))),
    )


@in_float64
def _knots(paths: Float[np.ndarray, "k l 3"], share: float) -> tuple[Float[Array, "k n 3"], Int[Array, "k"]]:
    """Most paths whole, one in four cut as an approach does."""
    shares = np.where(np.arange(len(paths)) % 4 == 0, share, 1.0)
    return _select_all(paths, shares)


@jax.jit
def _select_all(
    paths: Float[Array, "k l 3"], shares: Float[Array, "k"]
) -> tuple[Float[Array, "k n 3"], Int[Array, "k"]]:
    routes = select_routes(paths, KnotConfig(), shares)
    return routes.knots.waypoints, routes.knots.count


def _state_in_flight(flights: SplineBatch, lane: int, rng: np.random.Generator) -> FlatState:
    return _cut(flights, lane, rng.random())[0]


def _cut(flights: SplineBatch, lane: int, share: float) -> tuple[FlatState, int]:
    """The state at a share of a flight's duration, and how many segments lie behind it."""
    spline = flights.spline(lane)
    time = share * float(spline.duration)
    ends = np.cumsum(spline.durations)
    return spline.state(time), int(np.sum(ends[:-1] <= time))
