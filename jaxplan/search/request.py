"""The opening and the end of every search: unusable goals sorted out, the way out of padding, reasons (host, NumPy)."""

import dataclasses
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from jaxplan.errors import InputError
from jaxplan.records import replace
from jaxplan.search.kernels.sight import clearances
from jaxplan.search.lattice import Lattices, Paths
from jaxplan.status import Note, Reason
from jaxplan.validation import as_numbers
from jaxplan.world.obstacles import World
from jaxplan.world.occupancy import Lattice, cell_centres, exact_clearance

_ESCAPES = 128
"""Free cells near a padded start whose line of sight is examined; arbitrary."""
_SAMPLES = 64
"""Points per line of sight: one of 1 m is resolved to 16 mm."""
_CLOSE = 0.4
"""Share of the padding from which on a start needs no way out of its own (arbitrary)."""
_ESCAPE_RADIUS = 1.5
"""m; arbitrary, three times the padding."""


class Request(NamedTuple):
    """A search under way."""

    head: Float[np.ndarray, "h 3"]
    """The points before the search [m]: the start, and a free cell to escape to if the start's own is occupied; no
    point at all where there is no way out."""
    goals: Float[np.ndarray, "k 3"]
    """[m]; unusable ones are 0."""
    start_clearance: float
    """From the last point of the head to the nearest obstacle [m]."""
    open: Bool[np.ndarray, "k"]
    """Usable goals without a path so far."""
    paths: Paths
    """What is found; its arrays are written in place."""


def open_request(
    lattices: Lattices,
    world: World,
    start: Annotated[ArrayLike, "3"],
    goals: Annotated[ArrayLike, "k 3"],
    capacity: int,
    from_free_cell: bool = True,
) -> Request:
    """Check and copy the arguments of a search, sort out unusable goals and find the way out of padding.

    ``from_free_cell``: the search needs a free cell to begin in; one over roads needs it only where the start is so
    close to an obstacle that the way out comes first.
    """
    begin, ends = _points(start, "start", (3,)), _points(goals, "goals", (-1, 3))
    if capacity < 3:
        raise InputError(f"capacity: have {capacity!r}, want at least 3 points per path")
    paths = _no_paths(begin, len(ends), capacity)
    usable = _usable_goals(lattices, world, ends)
    ends[~usable] = 0.0
    head, to_obstacle, padded = _path_head(lattices, world, begin, from_free_cell)
    if padded:
        paths.notes[:] |= np.uint32(Note.START_PADDED)
    return Request(head=head, goals=ends, start_clearance=to_obstacle, open=usable, paths=paths)


def with_more_rows(paths: Paths, rows: int) -> Paths:
    """The same paths, at least one, and behind them ``rows`` without a path."""
    none = _no_paths(paths.points[0, 0], rows, paths.points.shape[1])
    names = [field.name for field in dataclasses.fields(paths) if field.name != "expanded"]
    return replace(paths, **{name: np.concatenate([getattr(paths, name), getattr(none, name)]) for name in names})


def mark_finer(lattices: Lattices, first: int, paths: Paths) -> None:
    """Note which paths needed a finer lattice than the ``first`` one."""
    paths.notes[paths.resolution < lattices.levels[first].grid.resolution] |= np.uint32(Note.FINER_LATTICE)


def finish(paths: Paths, expanded: int) -> Paths:
    """Reasons from what was found, and counts that respect the capacity."""
    capacity = paths.points.shape[1]
    reasons = np.where(paths.count == 0, np.uint32(Reason.NO_PATH), np.uint32(0))
    reasons |= np.where(paths.count > capacity, np.uint32(Reason.PREFIX_ONLY), np.uint32(0))
    reasons |= paths.reasons & np.uint32(Reason.PREFIX_ONLY)
    return Paths(
        points=paths.points,
        count=np.minimum(paths.count, capacity),
        reasons=reasons,
        notes=paths.notes,
        resolution=paths.resolution,
        length=paths.length,
        expanded=expanded,
    )


def _points(values: ArrayLike, name: str, shape: tuple[int, ...]) -> Float[np.ndarray, "*k 3"]:
    """A writable float64 copy in C order."""
    points = np.array(as_numbers(name, values), order="C")
    if points.ndim != len(shape) or points.shape[-1] != 3:
        raise InputError(
            f"{name}: have shape {points.shape}, want {'(3,)' if len(shape) == 1 else '(K, 3)'}; pass points in m"
        )
    return points


def _no_paths(start: Float[np.ndarray, "3"], count: int, capacity: int) -> Paths:
    return Paths(
        points=np.broadcast_to(start, (count, capacity, 3)).copy(),
        count=np.zeros(count, np.int64),
        reasons=np.full(count, np.uint32(Reason.NO_PATH)),
        notes=np.zeros(count, np.uint32),
        resolution=np.full(count, np.nan),
        length=np.full(count, np.inf),
        expanded=0,
    )


def _usable_goals(lattices: Lattices, world: World, goals: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, "k"]:
    """Goals that are finite, in the room and not padded.

    For a goal in an occupied finest cell its own exact clearance decides, so that the rounding to cells excludes
    nothing.
    """
    lower, upper = np.asarray(world.bounds)
    usable = ((goals >= lower) & (goals <= upper)).all(axis=1)
    grid = lattices.levels[0].grid
    index = np.where(usable[:, None], goals, lower) - grid.origin
    index = np.minimum((index / grid.resolution).astype(np.int64), np.array(grid.shape) - 1)
    doubtful = np.flatnonzero(usable & grid.occupied[tuple(index.T)])
    to_obstacle, to_wall = _exact_margins(lattices, world, goals[doubtful])
    usable[doubtful] = (to_obstacle >= lattices.config.padding) & (to_wall >= float(world.keep_in))
    return usable


def _path_head(
    lattices: Lattices, world: World, start: Float[np.ndarray, "3"], from_free_cell: bool
) -> tuple[Float[np.ndarray, "h 3"], float, bool]:
    """The points before the search, the clearance of the last one [m], and whether the start is padded.

    Padded: too close to an obstacle or to a face of the room. No points: there is no way out.
    """
    if not np.isfinite(start).all():
        return np.zeros((0, 3)), 0.0, False
    grid = lattices.levels[0].grid
    index = np.floor((start - grid.origin) / grid.resolution)
    inside = ((index >= 0) & (index < grid.shape)).all()
    free = bool(inside and not grid.occupied[tuple(index.astype(np.int64))])
    if free and from_free_cell:
        return start[None], np.inf, False
    (to_obstacle,), (to_wall,) = _exact_margins(lattices, world, start[None])
    padded = not free and not (to_obstacle >= lattices.config.padding and to_wall >= float(world.keep_in))
    if not from_free_cell and to_obstacle >= _CLOSE * lattices.config.padding and to_wall >= 0.0:
        return start[None], float(to_obstacle), padded
    centres = _free_cells_near(grid, start)
    clear = np.asarray(_lines_are_clear(world, start, centres))
    if not clear.any():
        return np.zeros((0, 3)), 0.0, padded
    return np.stack([start, centres[np.argmax(clear)]]), np.inf, padded


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


def _exact_margins(
    lattices: Lattices, world: World, points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Distances [m] to the nearest obstacle and to the nearest face."""
    lower, upper = np.asarray(world.bounds)
    to_wall = np.minimum(points - lower, upper - points).min(axis=-1)
    if lattices.roadmap is not None:
        return clearances(lattices.roadmap.field.solids, points), to_wall
    return exact_clearance(world.obstacles, points), to_wall


def _lines_are_clear(
    world: World, start: Float[np.ndarray, "3"], ends: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, "n"]:
    """Whether the segments from ``start`` to each of ``_ESCAPES`` ends touch no real obstacle.

    Clearance is 1-Lipschitz: between two samples, s apart, whose clearances sum to more than s, nothing can be touched.
    A NaN end is not clear.
    """
    fraction = np.linspace(0.0, 1.0, _SAMPLES)
    samples = start + fraction[:, None] * (ends[:, None] - start)
    margin = exact_clearance(world.obstacles, samples.reshape(-1, 3)).reshape(samples.shape[:-1])
    gap = np.linalg.norm(ends - start, axis=-1)[:, None] / (_SAMPLES - 1)
    return np.asarray((margin[:, 1:] + margin[:, :-1] > gap).all(axis=1))
