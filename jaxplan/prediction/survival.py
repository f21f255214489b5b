"""Which flights hit something, and the goals that the others give: compiled with the search's distances (host).

A cycle asks for the distances of thousands of points, and most need no answer: who was d away from everything is still
d - l away after a way l. What is left is little work, done on one core whatever else runs.
"""

import functools
import math
from pathlib import Path
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxplan.search.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.sight import clearances
from jaxplan.search.kernels.solids import clearance_at, solids_of
from jaxplan.world.obstacles import World, make_obstacles

LEAST_CLEARANCE = 0.1
"""m between a particle and what it hits: a small drone's radius; less where the target is seen nearer."""
CAPTURE_RADIUS = 0.36
"""m; as the replanner's ``reach``: who passes within that of the expected target meets it."""
ROUNDING = 1e-6
"""m; by which goals are farther from the room's faces than they must be."""
_FAR = 1e6
"""m; where a room ends of which nothing is known."""


class Surroundings(NamedTuple):
    """What compiled code knows of a room."""

    solids: tuple
    """As ``jaxplan.search.kernels.solids.Solids``."""
    bounds: Float[np.ndarray, "2 3"]
    """Corners [m, world]."""
    goals: Float[np.ndarray, "2 3"]
    """Corners of the box in which goals are [m, world]."""

    def free_distances(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """To the nearest obstacle or face of the room [m], at most ``solids.REACH``."""
        to_wall = np.minimum(points - self.bounds[0], self.bounds[1] - points).min(axis=1)
        return np.minimum(clearances(self.solids, np.clip(points, *self.bounds)), to_wall)


def surroundings_of(world: World | None) -> Surroundings:
    """A room for compiled code; None: nothing is known of it, and nothing is in the way."""
    if world is None:
        cube = np.array([[0.0] * 3, [1.0] * 3])
        small = World(name="", bounds=cube, obstacles=make_obstacles(), keep_in=np.array(0.0), provenance="")
        everywhere = np.array([[-_FAR] * 3, [_FAR] * 3])
        return Surroundings(tuple(solids_of(small)), everywhere, everywhere)
    lower, upper = np.asarray(world.bounds, np.float64)
    middle, least = 0.5 * (lower + upper), float(world.keep_in) + ROUNDING
    goals = np.stack([np.minimum(lower + least, middle), np.maximum(upper - least, middle)])
    return Surroundings(tuple(solids_of(world)), np.stack([lower, upper]), goals)


def believable(
    room: Surroundings,
    start: Float[np.ndarray, "3"],
    flights: Float[np.ndarray, "n s 3"],
    longest: float = np.inf,
) -> tuple[Float[np.ndarray, "n s 3"], Bool[np.ndarray, "n s"]]:
    """Particles that stop before what they would hit, and where one counts: it has hit nothing, or is the last of all.

    Looked at are the steps, and the middles between them, as far as they are not clear for sure.

    Args:
        room: where they fly.
        start: where the target was seen last [m, world].
        flights: where each particle is at the steps [m, world].
        longest: m; who takes a longer step takes one of this length in the same direction.
    """
    stopped, lasted = np.array(flights, np.float64, order="C"), np.zeros(len(flights), np.int64)
    least = min(LEAST_CLEARANCE, float(room.free_distances(start[None])[0]))
    _compiled_survival()(room.solids, room.bounds, start, stopped, longest, least, lasted)
    return stopped, lasted[:, None] >= np.minimum(np.arange(1, stopped.shape[1] + 1), lasted.max())


def goals_among(
    room: Surroundings, flights: Float[np.ndarray, "n s 3"], counts: Bool[np.ndarray, "n s"], batch: int
) -> tuple[Float[np.ndarray, "s b 3"], Float[np.ndarray, "s b"]]:
    """The first particles that count, after their mean, as goals [m, world]; the probability that each captures."""
    steps = flights.shape[1]
    goals, share = np.zeros((steps, batch, 3)), np.zeros((steps, batch))
    _compiled_goals()(room.solids, room.bounds, room.goals, np.ascontiguousarray(flights), counts, goals, share)
    return goals, share


@inner
@no_type_check
def _free(solids, bounds, x, y, z):
    """Distance [m] from a point to the nearest obstacle or face of the room; negative infinity for what is no point."""
    if (x + y + z) * 0.0 != 0.0:  # NaN or infinite
        return -math.inf
    wall = min(min(x - bounds[0, 0], bounds[1, 0] - x), min(y - bounds[0, 1], bounds[1, 1] - y))
    wall = min(wall, min(z - bounds[0, 2], bounds[1, 2] - z))
    if wall <= 0.0:  # the obstacles' bins end with the room
        return wall
    return min(wall, clearance_at(solids, x, y, z))


@functools.cache
def _version() -> str:
    """All that is compiled here, for numba's cache (``jaxplan.search.kernels.compiled``)."""
    return source_digest() + Path(__file__).read_text(encoding="utf-8")


@runtime_checkable
class _Survival(Protocol):
    """The flights of ``believable`` as they are flown."""

    def __call__(
        self,
        solids: tuple,
        bounds: Float[np.ndarray, "2 3"],
        start: Float[np.ndarray, "3"],
        flights: Float[np.ndarray, "n s 3"],
        longest: float,
        least: float,
        lasted: Int[np.ndarray, "n"],
    ) -> None:
        """Write ``flights``, slowed and stopped, and how many steps each ``lasted``."""


@functools.cache
def _compiled_survival() -> _Survival:
    version = _version()

    @entry_point
    @no_type_check
    def entry(solids, bounds, start, flights, longest, least, lasted):
        _ = version
        here = _free(solids, bounds, start[0], start[1], start[2])
        for n in range(flights.shape[0]):
            x, y, z, free = start[0], start[1], start[2], here
            behind_x, behind_y, behind_z = 0.0, 0.0, 0.0  # by how much shorter steps are behind
            steps, flying = 0, True
            for s in range(flights.shape[1]):
                if flying:
                    u = flights[n, s, 0] - behind_x
                    v = flights[n, s, 1] - behind_y
                    w = flights[n, s, 2] - behind_z
                    way = math.sqrt((u - x) ** 2 + (v - y) ** 2 + (w - z) ** 2)
                    if way > longest:
                        left = 1.0 - longest / way
                        dx, dy, dz = left * (u - x), left * (v - y), left * (w - z)
                        behind_x, behind_y, behind_z = behind_x + dx, behind_y + dy, behind_z + dz
                        u, v, w, way = u - dx, v - dy, w - dz, longest
                    if not free - 0.5 * way >= least:
                        flying = _free(solids, bounds, 0.5 * (x + u), 0.5 * (y + v), 0.5 * (z + w)) >= least
                    free -= way
                    if flying and not free >= least:
                        free = _free(solids, bounds, u, v, w)
                        flying = free >= least
                    if flying:
                        x, y, z = u, v, w
                        steps += 1
                flights[n, s, 0], flights[n, s, 1], flights[n, s, 2] = x, y, z
            lasted[n] = steps

    return entry  # type: ignore[no-any-return]


@runtime_checkable
class _Goals(Protocol):
    """``goals_among``."""

    def __call__(
        self,
        solids: tuple,
        bounds: Float[np.ndarray, "2 3"],
        inside: Float[np.ndarray, "2 3"],
        flights: Float[np.ndarray, "n s 3"],
        counts: Bool[np.ndarray, "n s"],
        goals: Float[np.ndarray, "s b 3"],
        share: Float[np.ndarray, "s b"],
    ) -> None:
        """Write ``goals`` and ``share``; both are 0 before."""


@functools.cache
def _compiled_goals() -> _Goals:
    version = _version()

    @entry_point
    @no_type_check
    def entry(solids, bounds, inside, flights, counts, goals, share):
        _ = version
        batch = goals.shape[1]
        some = np.zeros((flights.shape[0], 3))
        for s in range(goals.shape[0]):
            number, mean = 0, np.zeros(3)
            for n in range(flights.shape[0]):
                if counts[n, s]:
                    for axis in range(3):
                        some[number, axis] = flights[n, s, axis]
                        mean[axis] += flights[n, s, axis]
                    number += 1
            mean /= number
            possible = _free(solids, bounds, mean[0], mean[1], mean[2]) >= LEAST_CLEARANCE
            for b in range(batch):
                for axis in range(3):
                    wanted = mean[axis] if b == 0 and possible else some[b % number, axis]
                    goals[s, b, axis] = min(max(wanted, inside[0, axis]), inside[1, axis])
                near = 0
                for n in range(number):
                    apart = 0.0
                    for axis in range(3):
                        apart += (some[n, axis] - goals[s, b, axis]) ** 2
                    near += apart <= CAPTURE_RADIUS * CAPTURE_RADIUS
                share[s, b] = max(near, 1) / number

    return entry  # type: ignore[no-any-return]
