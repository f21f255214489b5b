"""The lattices of a world as a search wants them, which of them to search, and what is found (host, NumPy).

The lattice grows with the distance between the drones (interception paper, section III.A). Where a coarse search does
not reach a goal, the next finer lattice is tried for the goals that are left; only the finest one's failure is
``NO_PATH``.
"""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int, UInt32

from jaxplan.errors import InputError
from jaxplan.records import record, replace, static
from jaxplan.search.components import label_components
from jaxplan.search.kernels.graph import Frame, Graph, make_frame, permitted_moves
from jaxplan.search.roadmap import Roadmap
from jaxplan.search.store import load_roadmap
from jaxplan.validation import require_at_least, require_one_of
from jaxplan.world.obstacles import World
from jaxplan.world.occupancy import (
    PADDING,
    RESOLUTIONS,
    Lattice,
    occupancy_lattices,
)

METHODS = ("roadmap", "multi-resolution")
MOST_ALTERNATIVES = 3
"""Routes to one goal (arbitrary)."""


@dataclass(frozen=True, kw_only=True)
class SearchConfig:
    """Options of the search; the defaults are the interception paper's."""

    method: str = "roadmap"
    """How ``find_routes`` searches: "roadmap", or "multi-resolution", the paper's rule: the lattice grows with the
    distance between the drones."""
    resolutions: tuple[float, ...] = RESOLUTIONS
    """Cell sizes [m], finest first, each a multiple of the first."""
    distance_fractions: tuple[float, ...] = (0.1, 0.2, 0.4)
    """Up to which inter-drone distance, as a fraction of the room's diagonal, each but the last resolution is used."""
    padding: float = PADDING
    """Distance that paths keep from obstacles [m]."""
    least_padding: float | None = None
    """Distance [m] that a roadmap's paths keep where no path keeps the padding; None: there are no such paths."""
    from_faces: float = 0.0
    """Distance [m] that paths keep from the faces of a room, where that is more than its ``keep_in``; a room that is
    too small for that keeps its own."""
    fallback_budget: int | None = None
    """Cells of the finest lattice settled at most for goals that no road leads to (a million take half a second). Where
    that ends the search, goals get the best path known, with ``Note.SEARCH_ENDED``; if it does not reach them, its
    reason is ``PREFIX_ONLY``, never ``NO_PATH``. None: as many cells as there are."""
    node_budget: int = 2_000_000
    """Cells settled at most per search of ``find_paths`` (arbitrary: about half a second)."""
    first_budget: int = 6_000
    """Cells that ``find_routes`` settles on a lattice before it turns to the next coarser one (measured: 2 ms)."""
    last_budget: int = 30_000
    """Cells that ``find_routes`` settles on a lattice once no coarser one has reached a goal (measured: 10 ms)."""

    def __post_init__(self) -> None:
        require_one_of("search", self, METHODS, "method")
        fractions = self.distance_fractions
        if len(fractions) != len(self.resolutions) - 1 or list(fractions) != sorted(fractions):
            raise InputError(
                f"distance_fractions: have {fractions}, want {len(self.resolutions) - 1} ascending fractions, "
                "one per resolution but the last"
            )
        require_at_least("search", self, 0.0, "padding", "from_faces")
        if self.least_padding is not None and not 0.0 <= self.least_padding <= self.padding:
            raise InputError(
                f"search: have least_padding {self.least_padding:g} m, want at least 0 and at most the padding, "
                f"{self.padding:g} m"
            )
        budgets = ("node_budget", "first_budget", "last_budget", "fallback_budget")
        require_at_least("search", self, 1, *budgets[: 3 + (self.fallback_budget is not None)])


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
    roadmap: Roadmap | None
    """None where only lattices are searched."""
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
    """``Reason.NO_PATH``, or ``Reason.PREFIX_ONLY`` where the path is longer than the capacity or the search ended
    before the goal."""
    notes: UInt32[np.ndarray, "k"]
    """``Note.START_PADDED``, ``FINER_LATTICE``, ``LESS_PADDING`` and ``SEARCH_ENDED``."""
    resolution: Float[np.ndarray, "k"]
    """Cell size of the lattice that found the path, the finest one's for roads [m]; NaN where there is none."""
    length: Float[np.ndarray, "k"]
    """Length of the whole path to the goal [m], also where ``points`` holds its prefix; inf where there is none."""
    expanded: int
    """Places and cells settled, over all that was tried."""

    def some(self, rows: Int[np.ndarray, "n"]) -> "Paths":
        """Those of some rows, in that order."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return Paths(**{name: value[rows] if np.ndim(value) else value for name, value in values.items()})


def build_lattices(world: World, config: SearchConfig | None = None) -> Lattices:
    """The occupancy lattices of ``world`` with all that a search wants to know.

    Raises ``InputError`` for a room with too many cells, with the resolution that would fit.
    """
    config = SearchConfig() if config is None else config
    world, roadmap, padded = inside_faces(world, config), None, None
    if config.method == "roadmap":
        limits = (config.padding,) if config.least_padding is None else (config.padding, config.least_padding)
        roadmap = load_roadmap(world, config.resolutions[0], limits)
        padded = roadmap.field.values < config.padding
    grids = occupancy_lattices(world, config.resolutions, config.padding, padded)
    return Lattices(levels=tuple(_search_lattice(grid) for grid in grids), roadmap=roadmap, config=config)


def inside_faces(world: World, config: SearchConfig) -> World:
    """The world as paths see it, which keep away from the room's faces by what the configuration says, too."""
    keep_in = max(float(world.keep_in), config.from_faces)
    narrowest = float((np.asarray(world.bounds)[1] - np.asarray(world.bounds)[0]).min())
    if keep_in == float(world.keep_in) or 2.0 * keep_in >= narrowest:
        return world
    return replace(world, keep_in=np.asarray(keep_in))


def choose_level(lattices: Lattices, distance: float, diagonal: float) -> int:
    """Index of the lattice to search first, from the inter-drone distance and the room's diagonal [m]."""
    fractions = lattices.config.distance_fractions
    fits = [index for index, fraction in enumerate(fractions) if distance <= fraction * diagonal]
    return fits[0] if fits else len(fractions)


def _search_lattice(grid: Lattice) -> SearchLattice:
    """Permitted moves and connected components of one lattice."""
    labels = label_components(~grid.occupied)
    return SearchLattice(grid=grid, moves=permitted_moves(grid.occupied), components=labels.reshape(-1))


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
