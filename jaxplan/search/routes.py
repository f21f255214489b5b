"""Taut routes to all candidates (host, compiled): what the planner calls.

1. The roadmap gives the path to every goal that the start or a place on its roads sees: near the shortest there is, at
   the padding from all obstacles.
2. Where the start or a goal sees roads only from above, as in a niche, those may be entered at any angle.
3. Where no road leads, the roadmap closer to obstacles is asked, if there is one, and then the finest lattice, as long
   as it takes: what is connected is found. Such paths may come closer to obstacles than the padding, and then say so.
   With a budget of cells it is found, or the way to where the search ended, and that is said, too.

With the method "multi-resolution" lattices are searched instead (``jaxplan.search.lattice_routes``).
"""

from typing import Annotated

import numpy as np
from jaxtyping import Bool
from numpy.typing import ArrayLike

from jaxplan.errors import InputError
from jaxplan.precision import in_float64
from jaxplan.search.kernels import astar
from jaxplan.search.kernels.alternatives import find_alternatives
from jaxplan.search.kernels.follow import Limits, follow
from jaxplan.search.kernels.roads import TANGENT
from jaxplan.search.kernels.sight import paths_keep_clear
from jaxplan.search.lattice import MOST_ALTERNATIVES, Lattices, Paths
from jaxplan.search.lattice_routes import search_lattice, search_lattices
from jaxplan.search.request import Request, finish, open_request, with_more_rows
from jaxplan.search.roadmap import Roadmap, connected, update_field, update_roadmap
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
    alternatives: int = 1,
) -> Paths:
    """Taut paths from ``start`` to each of ``goals`` [m, world]; ``length`` is that of the taut path.

    Args:
        lattices: of ``world``.
        world: what the lattices were made of.
        start: where all paths begin.
        goals: K of them. One that is not finite, outside the room's keep-in box or closer to an obstacle than the
            padding has NO_PATH, as has every goal if the start sees no free cell.
        target_distance: between the drones [m]; selects the lattice of a "multi-resolution" search.
        capacity: points of the longest path; longer ones are given as prefixes.
        alternatives: up to so many clearly different routes to each goal, of which something stands between any two:
            row ``k`` has the shortest path to goal k, rows ``k + K``, ``k + 2 K`` those around other sides, at the
            padding and at most half as long again; NO_PATH where there is none. A roadmap knows them.

    Raises:
        InputError: an argument is none of the above.
    """
    _check_alternatives(lattices, alternatives)
    request = open_request(lattices, world, start, goals, capacity, from_free_cell=lattices.roadmap is None)
    expanded = 0
    if len(request.head):
        if lattices.roadmap is None:
            expanded = search_lattices(lattices, world, request, target_distance)
        else:
            expanded = _search_roads(lattices, lattices.roadmap, request)
    if alternatives > 1 and lattices.roadmap is not None and len(request.goals):
        request, settled = _with_alternatives(lattices.roadmap, request, alternatives)
        expanded += settled
    return finish(request.paths, expanded)


def _check_alternatives(lattices: Lattices, alternatives: int) -> None:
    if not 1 <= alternatives <= MOST_ALTERNATIVES or (alternatives > 1 and lattices.roadmap is None):
        want = f"1 to {MOST_ALTERNATIVES}, and 1 without a roadmap"
        raise InputError(f"alternatives: have {alternatives!r}, want {want}; search with the method 'roadmap'")


def _with_alternatives(roadmap: Roadmap, request: Request, alternatives: int) -> tuple[Request, int]:
    """The request with more rows: further routes for goals around a corner, over the roads at the padding.

    And how many places were settled.
    """
    level, known = roadmap.levels[0], request.paths
    paths = with_more_rows(known, len(request.goals) * (alternatives - 1))
    bent = (known.count > len(request.head) + 1) & (known.count <= known.points.shape[1])
    bent &= known.notes & np.uint32(Note.LESS_PADDING | Note.SEARCH_ENDED) == 0
    settled = 0
    if bent.any():
        limits = Limits(level.limit, min(level.limit, request.start_clearance))
        found = paths.points, paths.count, paths.length
        settled = find_alternatives(
            tuple(roadmap.field), limits, level.roads, request.head, request.goals, bent, *found
        )
    paths.notes[:] = np.tile(known.notes, alternatives)
    paths.resolution[:] = np.where(paths.count > 0, np.tile(known.resolution, alternatives), np.nan)
    return request._replace(paths=_shortest_first(paths, alternatives)), settled


def _shortest_first(paths: Paths, alternatives: int) -> Paths:
    """The rows of each goal by their length: an alternative is sometimes a little shorter."""
    order = np.argsort(paths.length.reshape(alternatives, -1), axis=0, kind="stable")
    rows = (order * order.shape[1] + np.arange(order.shape[1])).ravel()
    return paths.some(rows)


def warmup(lattices: Lattices, world: World, capacity: int = 32) -> None:
    """Compile everything that ``find_routes`` and ``update_lattices`` may call for this world.

    The search too where all is in sight, and what a change takes where there was none.
    """
    middle = np.asarray(world.bounds).mean(axis=0)
    astar.warmup()
    exact_clearance(world.obstacles, middle[None])
    if lattices.roadmap is not None:
        paths_keep_clear(lattices.roadmap.field, 0.0, np.zeros((1, capacity, 3)), np.zeros(1, np.int64))
        update_roadmap(lattices.roadmap, *update_field(lattices.roadmap.field, world, middle, middle), middle, middle)
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
        cells = lattices.levels[0].grid.occupied.size
        budget = lattices.config.fallback_budget or cells
        settled += search_lattice(lattices, 0, budget, request, anytime=True)
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
