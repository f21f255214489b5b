"""The lattices of a world as a search wants them, which of them to search, and what is found (host, NumPy).

The lattice grows with the distance between the drones (interception paper, section III.A). Where a coarse search does
not reach a goal, the next finer lattice is tried for the goals that are left; only the finest one's failure is
``NO_PATH``.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt32
from scipy import ndimage

from jaxplan.errors import InputError
from jaxplan.records import record, static
from jaxplan.search.kernels.graph import Frame, Graph, make_frame, permitted_moves
from jaxplan.validation import require_at_least
from jaxplan.world.obstacles import World
from jaxplan.world.occupancy import (
    PADDING,
    RESOLUTIONS,
    Lattice,
    occupancy_lattices,
)


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
        require_at_least("search", self, 0.0, "padding")
        require_at_least("search", self, 1, "node_budget", "first_budget", "last_budget")


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


def build_lattices(world: World, config: SearchConfig | None = None) -> Lattices:
    """The occupancy lattices of ``world`` with all that a search wants to know.

    Raises ``InputError`` for a room that is too large.
    """
    config = SearchConfig() if config is None else config
    grids = occupancy_lattices(world, config.resolutions, config.padding)
    return Lattices(levels=tuple(_search_lattice(grid) for grid in grids), config=config)


def choose_level(lattices: Lattices, distance: float, diagonal: float) -> int:
    """Index of the lattice to search first, from the inter-drone distance and the room's diagonal [m]."""
    fractions = lattices.config.distance_fractions
    fits = [index for index, fraction in enumerate(fractions) if distance <= fraction * diagonal]
    return fits[0] if fits else len(fractions)


def _search_lattice(grid: Lattice) -> SearchLattice:
    """Permitted moves and connected components of one lattice.

    Without corner cutting, 26-connected cells are connected exactly if they are 6-connected: a diagonal step can be
    taken axis by axis through its free bounding box. So SciPy's default labelling finds the components.
    """
    labels, _ = ndimage.label(~grid.occupied)
    return SearchLattice(
        grid=grid, moves=permitted_moves(grid.occupied), components=labels.astype(np.int32).reshape(-1)
    )


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
