"""Which lattice to search, and the paths from the defender to all candidates (host, NumPy).

The lattice grows with the distance between the drones (interception paper, section III.A). Where a coarse search does
not reach a goal, the next finer lattice is tried for the goals that are left; only the finest one's failure is
``NO_PATH``.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt32
from scipy import ndimage

from jaxplan.errors import InputError
from jaxplan.numerics import in_float64
from jaxplan.records import record, static
from jaxplan.search import astar
from jaxplan.search.graph import NO_ENTRY, Frame, Graph, make_frame, permitted_moves
from jaxplan.status import Note, Reason
from jaxplan.world.obstacles import World
from jaxplan.world.occupancy import (
    CHUNK,
    PADDING,
    RESOLUTIONS,
    Lattice,
    cell_centres,
    compiled_clearance,
    occupancy_lattices,
)

_ESCAPES = 128
"""Free cells near a padded start whose line of sight is examined; arbitrary."""
_SAMPLES = CHUNK // _ESCAPES
"""Points per line of sight, 64: one line of 1 m is resolved to 16 mm, and all lines are one compiled chunk."""
_ESCAPE_RADIUS = 1.5
"""m; arbitrary, three times the padding."""
_GOALS = 512
"""Goals per compiled call of the exact clearance."""


@dataclass(frozen=True, kw_only=True)
class SearchConfig:
    """Options of the search; the defaults are the interception paper's."""

    resolutions: tuple[float, ...] = RESOLUTIONS
    """Cell sizes [m], finest first, each a multiple of the first."""
    distance_fractions: tuple[float, ...] = (0.1, 0.2, 0.4)
    """Up to which inter-drone distance, as a fraction of the room's diagonal, each but the last resolution is used."""
    padding: float = PADDING
    """Distance that paths keep from obstacles [m]."""
    node_budget: int = 2_000_000
    """Cells settled at most per search of ``find_paths`` (arbitrary: about half a second)."""
    first_budget: int = 6_000
    """Cells that ``find_routes`` settles on a lattice before it turns to the next coarser one (measured: 2 ms)."""
    last_budget: int = 30_000
    """Cells that ``find_routes`` settles on a lattice once no coarser one has reached a goal (measured: 10 ms)."""

    def __post_init__(self) -> None:
        fractions = self.distance_fractions
        if len(fractions) != len(self.resolutions) - 1 or list(fractions) != sorted(fractions):
            raise InputError(
                f"distance_fractions: have {fractions}, want {len(self.resolutions) - 1} ascending fractions, "
                "one per resolution but the last"
            )
        if not 0.0 <= self.padding < np.inf:
            raise InputError(f"padding: have {self.padding!r}, want a distance of at least 0 m")
        for name in ("node_budget", "first_budget", "last_budget"):
            if not getattr(self, name) >= 1:
                raise InputError(f"{name}: have {getattr(self, name)!r}, want at least 1 cell")


@record
class SearchLattice:
    """An occupancy lattice and what the search needs to know about it beforehand."""

    grid: Lattice
    moves: UInt32[np.ndarray, "n"]
    """Per cell (C order) the bit mask of permitted steps, ``graph.STEPS``."""
    components: Int[np.ndarray, "n"]
    """Per cell (C order) the label of its connected component, 0 if occupied."""


@record
class Lattices:
    """The lattices of one world, finest first."""

    levels: tuple[SearchLattice, ...]
    config: SearchConfig = static()


@record
class Paths:
    """Paths from the start to K goals, NumPy arrays; world frame, metres."""

    points: Float[np.ndarray, "k capacity 3"]
    """Exact start, an escape point if the start is padded, cell centres, exact goal; then the last point repeated.
    Rows without a path hold the start everywhere."""
    count: Int[np.ndarray, "k"]
    """Points before the repetition, at least 2; 0 where there is no path."""
    reasons: UInt32[np.ndarray, "k"]
    """``Reason.NO_PATH``, or ``Reason.PREFIX_ONLY`` where the path is longer than the capacity."""
    notes: UInt32[np.ndarray, "k"]
    """``Note.START_PADDED`` and ``Note.FINER_LATTICE``."""
    resolution: Float[np.ndarray, "k"]
    """Cell size of the lattice that found the path [m]; NaN where there is none."""
    length: Float[np.ndarray, "k"]
    """Length of the whole path to the goal [m], also where ``points`` holds its prefix; inf where there is none."""
    expanded: int
    """Cells settled, over all lattices tried."""


class Request(NamedTuple):
    """A search under way."""

    head: Any
    """The points before the search, (h, 3) [m]: the start, and a free cell to escape to if the start's own is
    occupied; None where there is no way out."""
    goals: Float[np.ndarray, "k 3"]
    """[m]; unusable ones are 0."""
    open: Bool[np.ndarray, "k"]
    """Usable goals without a path so far."""
    paths: Paths
    """What is found; its arrays are written in place."""


def build_lattices(world: World, config: SearchConfig | None = None) -> Lattices:
    """The occupancy lattices of ``world``, prepared for search. Raises ``InputError`` for a room that is too large."""
    config = SearchConfig() if config is None else config
    grids = occupancy_lattices(world, config.resolutions, config.padding)
    return Lattices(levels=tuple(_prepare(grid) for grid in grids), config=config)


def choose_level(lattices: Lattices, distance: float, diagonal: float) -> int:
    """Index of the lattice to search first, from the inter-drone distance and the room's diagonal [m]."""
    fractions = lattices.config.distance_fractions
    fits = [index for index, fraction in enumerate(fractions) if distance <= fraction * diagonal]
    return fits[0] if fits else len(fractions)


@in_float64
def find_paths(
    lattices: Lattices,
    world: World,
    start: Float[np.ndarray, "3"],
    goals: Float[np.ndarray, "k 3"],
    target_distance: float,
    capacity: int = 256,
) -> Paths:
    """Shortest 26-connected paths from ``start`` to each of ``goals`` [m, world].

    ``target_distance`` [m] between the drones selects the lattice. A goal that is not finite, outside the room's
    keep-in box or closer to an obstacle than the padding has NO_PATH, as has every goal if the start sees no free cell.
    """
    request = open_request(lattices, world, start, goals, capacity)
    if request.head is None:
        return request.paths
    expanded = 0
    first = choose_level(lattices, target_distance, world.diagonal)
    for level in range(first, -1, -1):
        if not request.open.any():
            break
        expanded += _search_level(lattices, level, request)
    mark_finer(lattices, first, request.paths)
    return finish(request.paths, expanded)


def open_request(lattices: Lattices, world: World, start: object, goals: object, capacity: int) -> Request:
    """Check and copy the arguments of a search, sort out unusable goals and find the way out of padding."""
    start, goals = _points(start, "start", (3,)), _points(goals, "goals", (-1, 3))
    if capacity < 3:
        raise InputError(f"capacity: have {capacity!r}, want at least 3 points per path")
    paths = _no_paths(start, len(goals), capacity)
    usable = _usable_goals(lattices, world, goals)
    goals[~usable] = 0.0
    head, padded = _path_head(lattices, world, start)
    if padded:
        paths.notes[:] |= np.uint32(Note.START_PADDED)
    return Request(head=head, goals=goals, open=usable, paths=paths)


def warmup(lattices: Lattices, world: World, capacity: int = 256) -> None:
    """Compile everything that ``find_paths`` may call for this world."""
    astar.warmup()
    warm_up_clearance(world)
    middle = np.asarray(world.bounds).mean(axis=0)
    for distance in (0.0, np.inf):
        find_paths(lattices, world, middle, middle[None], distance, capacity)


@in_float64
def warm_up_clearance(world: World) -> None:
    """Compile the clearance for the shapes that the search asks for."""
    _exact_margins(world, np.zeros((1, 3)))
    _lines_are_clear(world, np.zeros(3), np.zeros((_ESCAPES, 3)))


def _prepare(grid: Lattice) -> SearchLattice:
    """Without corner cutting, 26-connected cells are connected exactly if they are 6-connected: a diagonal step can be
    taken axis by axis through its free bounding box. So SciPy's default labelling finds the components."""
    labels, _ = ndimage.label(~grid.occupied)
    return SearchLattice(
        grid=grid, moves=permitted_moves(grid.occupied), components=labels.astype(np.int32).reshape(-1)
    )


def _points(values: object, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """A writable float64 copy in C order."""
    points = np.array(values, dtype=np.float64, order="C")
    if points.ndim != len(shape) or points.shape[-1] != 3:
        raise InputError(
            f"{name}: have shape {points.shape}, want {'(3,)' if len(shape) == 1 else '(K, 3)'}; pass points in m"
        )
    return points


def _no_paths(start: np.ndarray, count: int, capacity: int) -> Paths:
    return Paths(
        points=np.broadcast_to(start, (count, capacity, 3)).copy(),
        count=np.zeros(count, np.int64),
        reasons=np.full(count, np.uint32(Reason.NO_PATH)),
        notes=np.zeros(count, np.uint32),
        resolution=np.full(count, np.nan),
        length=np.full(count, np.inf),
        expanded=0,
    )


def mark_finer(lattices: Lattices, first: int, paths: Paths) -> None:
    """Note which paths needed a finer lattice than the ``first`` one."""
    paths.notes[paths.resolution < lattices.levels[first].grid.resolution] |= np.uint32(Note.FINER_LATTICE)


def finish(paths: Paths, expanded: int) -> Paths:
    """Reasons from what was found, and counts that respect the capacity."""
    capacity = paths.points.shape[1]
    reasons = np.where(paths.count == 0, np.uint32(Reason.NO_PATH), np.uint32(0))
    reasons |= np.where(paths.count > capacity, np.uint32(Reason.PREFIX_ONLY), np.uint32(0))
    return Paths(
        points=paths.points,
        count=np.minimum(paths.count, capacity),
        reasons=reasons,
        notes=paths.notes,
        resolution=paths.resolution,
        length=paths.length,
        expanded=expanded,
    )


def _search_level(lattices: Lattices, level: int, request: Request) -> int:
    """Search one lattice for the open goals and write what is found; returns the settled cells."""
    graph, head, paths = level_graph(lattices, level), request.head, request.paths
    found = astar.search(graph, head[-1], request.goals, request.open, lattices.config.node_budget)
    astar.write_paths(graph, found, head, request.goals, paths.points, paths.count)
    reached = found.entry != NO_ENTRY
    paths.resolution[reached] = graph.frame.h
    paths.length[reached] = found.cost[reached] + np.linalg.norm(np.diff(head, axis=0), axis=1).sum()
    request.open[reached] = False
    return found.expanded


def level_graph(lattices: Lattices, level: int) -> Graph:
    """What the search walks on at one level."""
    lattice, finest = lattices.levels[level], lattices.levels[0].grid
    return Graph(
        moves=lattice.moves,
        components=lattice.components,
        frame=grid_frame(lattice.grid),
        fine=finest.near_obstacle,
        fine_frame=grid_frame(finest),
    )


def grid_frame(grid: Lattice) -> Frame:
    """Where the cells of a lattice lie."""
    return make_frame(grid.shape, grid.origin, grid.resolution)


def _usable_goals(lattices: Lattices, world: World, goals: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, "k"]:
    """Goals that are finite, in the room and not padded. A goal in an occupied finest cell is judged by its own exact
    clearance, so that the rounding to cells excludes nothing."""
    lower, upper = np.asarray(world.bounds)
    usable = ((goals >= lower) & (goals <= upper)).all(axis=1)
    grid = lattices.levels[0].grid
    index = np.where(usable[:, None], goals, lower) - grid.origin
    index = np.minimum((index / grid.resolution).astype(np.int64), np.array(grid.shape) - 1)
    doubtful = np.flatnonzero(usable & grid.occupied[tuple(index.T)])
    for part in np.split(doubtful, range(_GOALS, len(doubtful), _GOALS)) if len(doubtful) else ():
        to_obstacle, to_wall = _exact_margins(world, goals[part])
        usable[part] = (to_obstacle >= lattices.config.padding) & (to_wall >= float(world.keep_in))
    return usable


def _path_head(lattices: Lattices, world: World, start: Float[np.ndarray, "3"]) -> tuple[np.ndarray | None, bool]:
    """The points before the search: the start, and the free cell to escape to if the start's own is occupied.

    Also whether the start is truly padded, or too close to a face of the room. None: there is no way out.
    """
    if not np.isfinite(start).all():
        return None, False
    grid = lattices.levels[0].grid
    index = np.floor((start - grid.origin) / grid.resolution)
    inside = ((index >= 0) & (index < grid.shape)).all()
    if inside and not grid.occupied[tuple(index.astype(np.int64))]:
        return start[None], False
    to_obstacle, to_wall = _exact_margins(world, start[None])
    padded = not (to_obstacle[0] >= lattices.config.padding and to_wall[0] >= float(world.keep_in))
    centres = _free_cells_near(grid, start)
    clear = np.asarray(_lines_are_clear(world, start, centres))
    if not clear.any():
        return None, padded
    return np.stack([start, centres[np.argmax(clear)]]), padded


def _free_cells_near(grid: Lattice, start: Float[np.ndarray, "3"]) -> Float[np.ndarray, "escapes 3"]:
    """Centres of the nearest free cells [m], nearest first; NaN where there are fewer."""
    axes = cell_centres(grid.origin, grid.resolution, grid.shape)
    near = [np.flatnonzero(np.abs(axis - x) <= _ESCAPE_RADIUS) for axis, x in zip(axes, start, strict=True)]
    free = np.argwhere(~grid.occupied[np.ix_(*near)])
    centres = np.stack([axes[axis][near[axis]][free[:, axis]] for axis in range(3)], axis=-1)
    distance = np.linalg.norm(centres - start, axis=1)
    nearest = np.argsort(distance, kind="stable")[:_ESCAPES]
    result = np.full((_ESCAPES, 3), np.nan)
    result[: len(nearest)] = centres[nearest]
    return result


def _exact_margins(world: World, points: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Distances [m] to the nearest obstacle and to the nearest face, for at most ``_GOALS`` points."""
    filled = np.zeros((_GOALS, 3))
    filled[: len(points)] = points
    to_obstacle = np.asarray(compiled_clearance(world.obstacles, filled))[: len(points)]
    lower, upper = np.asarray(world.bounds)
    return to_obstacle, np.minimum(points - lower, upper - points).min(axis=-1)


def _lines_are_clear(
    world: World, start: Float[np.ndarray, "3"], ends: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, "n"]:
    """Whether the segments from ``start`` to each of ``_ESCAPES`` ends touch no real obstacle.

    Clearance is 1-Lipschitz: between two samples, s apart, whose clearances sum to more than s, nothing can be touched.
    A NaN end is not clear.
    """
    fraction = np.linspace(0.0, 1.0, _SAMPLES)
    samples = start + fraction[:, None] * (ends[:, None] - start)
    margin = np.asarray(compiled_clearance(world.obstacles, samples.reshape(-1, 3))).reshape(samples.shape[:-1])
    gap = np.linalg.norm(ends - start, axis=-1)[:, None] / (_SAMPLES - 1)
    return np.asarray((margin[:, 1:] + margin[:, :-1] > gap).all(axis=1))
