"""Taut routes to all candidates (host, compiled): what the planner calls.

1. The roadmap gives the path to every goal that the start or a place on its roads sees: near the shortest there is, at
   the padding from all obstacles.
2. Where the start or a goal sees roads only from above, as in a niche, those may be entered at any angle.
3. Where no road leads, the roadmap closer to obstacles is asked, if there is one, and then the finest lattice, as long
   as it takes: what is connected is found. Such paths may come closer to obstacles than the padding, and then say so.

With the method "multi-resolution" lattices are searched instead (``jaxplan.search.lattice_routes``).
"""

from typing import Annotated

import numpy as np
from jaxtyping import Bool
from numpy.typing import ArrayLike

from jaxplan.precision import in_float64
from jaxplan.search.kernels import astar
from jaxplan.search.kernels.follow import Limits, follow
from jaxplan.search.kernels.roads import TANGENT
from jaxplan.search.kernels.sight import paths_keep_clear
from jaxplan.search.lattice import Lattices, Paths
from jaxplan.search.lattice_routes import search_lattice, search_lattices
from jaxplan.search.request import Request, finish, open_request
from jaxplan.search.roadmap import Roadmap, connected
from jaxplan.status import Note
from jaxplan.world.obstacles import World
from jaxplan.world.occupancy import exact_clearance

_ROUNDING = 1e-3
"""m; a path that comes closer than the padding by less keeps it."""


@in_float64
def find_routes(
    lattices: Lattices,
    world: World,
    start: Annotated[ArrayLike, "3"],
    goals: Annotated[ArrayLike, "k 3"],
    target_distance: float,
    capacity: int = 32,
) -> Paths:
    """Taut paths from ``start`` to each of ``goals`` [m, world]; ``length`` is that of the taut path.

    ``target_distance`` [m] between the drones selects the lattice of a "multi-resolution" search. A goal that is not
    finite, outside the room's keep-in box or closer to an obstacle than the padding has NO_PATH, as has every goal if
    the start sees no free cell.
    """
    request = open_request(lattices, world, start, goals, capacity, from_free_cell=lattices.roadmap is None)
    if not len(request.head):
        return request.paths
    if lattices.roadmap is None:
        return finish(request.paths, search_lattices(lattices, world, request, target_distance))
    return finish(request.paths, _search_roads(lattices, lattices.roadmap, request))


def warmup(lattices: Lattices, world: World, capacity: int = 32) -> None:
    """Compile everything that ``find_routes`` may call for this world, the search too where all is in sight."""
    middle = np.asarray(world.bounds).mean(axis=0)
    astar.warmup()
    exact_clearance(world.obstacles, middle[None])
    if lattices.roadmap is not None:
        paths_keep_clear(lattices.roadmap.field, 0.0, np.zeros((1, capacity, 3)), np.zeros(1, np.int64))
    find_routes(lattices, world, middle, middle[None], 0.0, capacity)


def _search_roads(lattices: Lattices, roadmap: Roadmap, request: Request) -> int:
    """Write paths over roads, and over the finest lattice where there is no road; returns what was settled."""
    settled = 0
    for number, level in enumerate(roadmap.levels):
        within = connected(roadmap, level, request.head[-1], request.goals)
        for tangent in (TANGENT, 1.0):
            wanted = request.open & within
            if wanted.any():
                settled += _follow_roads(roadmap, number, tangent, request, wanted)
    if request.open.any():
        left = request.open.copy()
        settled += search_lattice(lattices, 0, lattices.levels[0].grid.occupied.size, request)
        _mark_close(lattices, roadmap, request, left & ~request.open)
    return settled


def _follow_roads(
    roadmap: Roadmap, number: int, tangent: float, request: Request, wanted: Bool[np.ndarray, "k"]
) -> int:
    """Write the path of every wanted goal that the roads of one level lead to; returns the places settled."""
    level, paths = roadmap.levels[number], request.paths
    limits = Limits(level.limit, min(level.limit, request.start_clearance), tangent)
    found = paths.points, paths.count, paths.length
    settled = follow(tuple(roadmap.field), limits, level.roads, request.head, request.goals, wanted, *found)
    reached = wanted & (paths.count > 0)
    request.open[reached] = False
    paths.resolution[reached] = roadmap.field.frame[-1]
    if number > 0:
        paths.notes[reached] |= np.uint32(Note.LESS_PADDING)
    return settled


def _mark_close(lattices: Lattices, roadmap: Roadmap, request: Request, some: Bool[np.ndarray, "k"]) -> None:
    """Note which of some paths come closer to obstacles than the padding, the way to the end of the head left out."""
    rows, paths = np.flatnonzero(some), request.paths
    first = np.full(len(rows), len(request.head) - 1)
    limit = min(lattices.config.padding, request.start_clearance) - _ROUNDING
    clear = paths_keep_clear(roadmap.field, limit, paths.points[rows], first)
    paths.notes[rows[~clear]] |= np.uint32(Note.LESS_PADDING)
