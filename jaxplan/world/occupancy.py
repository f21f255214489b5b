"""Occupancy lattices of a world at several resolutions (host, NumPy).

Which cells are occupied:

* finest lattice: the exact clearance of the cell's centre is below the padding. Clearance is 1-Lipschitz, so every
  point of a free cell keeps at least the padding minus half of the cell's diagonal (0.087 m at 0.1 m), and so does
  every segment between the centres of neighbouring free cells. The test is not made stricter by that half diagonal:
  it would close passages that the paper's padding leaves open, and the emitted polynomial is checked exactly anyway.
* coarser lattices: any finest cell in it is too close to an obstacle.
* all lattices: the cell's centre is closer than ``keep_in`` to a face of the room. This test is made per lattice and
  is not handed from fine to coarse cells, or a room of 2 m height would have no free cell of 1 m.
"""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxplan.errors import InputError
from jaxplan.precision import in_float64
from jaxplan.records import record
from jaxplan.world.clearance import clearance
from jaxplan.world.obstacles import Obstacles, World

PADDING = 0.5
"""m, from the interception paper: distance that paths keep from obstacles."""
RESOLUTIONS = (0.1, 0.2, 0.5, 1.0)
"""m, from the interception paper."""
MAX_CELLS = 2**24
"""Cells of the finest lattice; 16 MB of occupancy, and about 0.5 GB behind a search on it."""
BYTES_PER_CELL = 32
"""Of all that a search keeps of a world and needs on its way."""

CHUNK = 2**11
"""Points per compiled call of the clearance: few enough for the handful of a search, enough for a million cells."""
_BLOCK = 2**16
"""Cells whose centres are in memory at a time."""
_ROUNDING = 1e-9
"""m; a centre at exactly ``keep_in`` from a face counts as inside, whatever the rounding."""


@record
class Lattice:
    """A regular lattice of cubic cells over a room."""

    occupied: Bool[np.ndarray, "nx ny nz"]
    """No path may enter these cells."""
    near_obstacle: Bool[np.ndarray, "nx ny nz"]
    """The part of ``occupied`` that obstacles and their padding cause, without the room's faces."""
    origin: Float[np.ndarray, "3"]
    """Lower corner of cell (0, 0, 0) [m, world]: the room's lower corner."""
    resolution: float
    """Side of a cell [m]."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Cells along each axis."""
        return self.occupied.shape  # type: ignore[return-value]


def occupancy_lattices(
    world: World,
    resolutions: tuple[float, ...] = RESOLUTIONS,
    padding: float = PADDING,
    padded: Bool[np.ndarray, "nx ny nz"] | None = None,
) -> tuple[Lattice, ...]:
    """One lattice per resolution [m], finest first; each resolution is a multiple of the first. ``padding`` [m].

    ``padded``: cells of the finest lattice that are too close to an obstacle, where that is known already.
    """
    factors = _factors(resolutions)
    if not 0.0 <= padding < np.inf:
        raise InputError(f"padding: have {padding!r}, want a distance of at least 0 m")
    shape = finest_shape(world, resolutions[0])
    if padded is None:
        origin = np.asarray(world.bounds, dtype=np.float64)[0]
        padded = padded_cells(
            world.obstacles, origin, np.array(shape), resolutions[0], padding, np.zeros(3, dtype=np.int64)
        )
    return tuple(
        _lattice(world, coarsen(padded, factor), resolution)
        for factor, resolution in zip(factors, resolutions, strict=True)
    )


def cell_centres(
    origin: Float[np.ndarray, "3"], resolution: float, shape: tuple[int, ...]
) -> list[Float[np.ndarray, "_"]]:
    """Coordinates of the cells' centres along each axis [m]."""
    return [origin[axis] + (np.arange(shape[axis]) + 0.5) * resolution for axis in range(3)]


def _factors(resolutions: tuple[float, ...]) -> list[int]:
    """How many finest cells each cell spans per axis."""
    usable = len(resolutions) > 0 and bool(np.isfinite(resolutions).all()) and resolutions[0] > 0.0
    ratios = [resolution / resolutions[0] for resolution in resolutions] if usable else [0.0]
    factors = [round(ratio) for ratio in ratios]
    ascending = factors[0] == 1 and all(a < b for a, b in itertools.pairwise(factors))
    if not ascending or not np.allclose(ratios, factors, rtol=0.0, atol=1e-6):
        raise InputError(
            f"resolutions: have {resolutions}, want positive metres, ascending, each a multiple of the first; "
            "correct them"
        )
    return factors


def fitting_resolution(world: World, resolution: float = RESOLUTIONS[0]) -> float:
    """That side of a cell [m], or the smallest whole centimetres with which a room has few enough cells."""
    bounds = np.asarray(world.bounds, dtype=np.float64)
    cells = float(np.prod(np.maximum(np.ceil((bounds[1] - bounds[0]) / resolution - 1e-6), 1.0)))
    return resolution if cells <= MAX_CELLS else _fitting(resolution, cells)


def _fitting(resolution: float, cells: float) -> float:
    """Whole centimetres [m], with a hundredth to spare, where cells of side ``resolution`` [m] are too many."""
    return float(np.ceil(100.0 * resolution * np.cbrt(cells / MAX_CELLS) * 1.01) / 100.0)


def finest_shape(world: World, resolution: float) -> tuple[int, int, int]:
    """Cells of that side [m] along each axis of a room.

    Raises ``InputError`` where they are too many, with what they would take and which side would fit.
    """
    bounds = np.asarray(world.bounds, dtype=np.float64)
    sides = np.maximum(np.ceil((bounds[1] - bounds[0]) / resolution - 1e-6), 1.0)
    cells = float(np.prod(sides))
    if not cells <= MAX_CELLS:
        fits = _fitting(resolution, cells)
        raise InputError(
            f"world {world.name!r}: have {cells:.3g} cells of {resolution:g} m, which take "
            f"{cells * BYTES_PER_CELL / 1e6:.0f} MB, want at most {MAX_CELLS * BYTES_PER_CELL / 1e6:.0f} MB; "
            f"use a smaller room or a resolution of {fits:g} m (--resolution {fits:g})"
        )
    nx, ny, nz = (int(side) for side in sides)
    return nx, ny, nz


@in_float64
def padded_cells(
    obstacles: Obstacles,
    origin: Float[np.ndarray, "3"],
    shape: Int[np.ndarray, "3"],
    resolution: float,
    padding: float,
    first: Int[np.ndarray, "3"],
) -> Bool[np.ndarray, "nx ny nz"]:
    """Which cells' centres are closer than ``padding`` to an obstacle.

    ``origin`` is the lower corner of the lattice [m]; of its cells those from ``first`` on are looked at, ``shape`` of
    them along each axis.
    """
    count = int(np.prod(shape))
    padded = np.empty(count, dtype=bool)
    obstacles = jax.tree.map(
        lambda a: jnp.asarray(a) if np.size(a) > CHUNK else a, obstacles
    )  # one copy, not one a chunk
    for begin in range(0, count, _BLOCK):
        index = np.arange(begin, min(begin + _BLOCK, count))
        cells = np.stack(np.unravel_index(index, shape), axis=-1) + first
        far = exact_clearance(obstacles, origin + (cells + 0.5) * resolution) >= padding
        padded[begin : begin + _BLOCK] = ~far
    return padded.reshape(shape)


@in_float64
def exact_clearance(obstacles: Obstacles, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """Distance [m] to the nearest obstacle of any number of points; one program serves lattices and searches (host)."""
    filled = np.resize(points, (-(-len(points) // CHUNK), CHUNK, 3))
    parts = [np.asarray(_compiled_clearance(obstacles, part)) for part in filled]
    return np.concatenate([np.zeros(0), *parts])[: len(points)]


_compiled_clearance = jax.jit(clearance)


def coarsen(padded: Bool[np.ndarray, "nx ny nz"], factor: int) -> Bool[np.ndarray, "mx my mz"]:
    """A coarse cell is set if any fine cell in it is."""
    filled = np.pad(padded, [(0, -n % factor) for n in padded.shape])
    mx, my, mz = (n // factor for n in filled.shape)
    return np.asarray(filled.reshape(mx, factor, my, factor, mz, factor).any(axis=(1, 3, 5)))


def kept_in(
    world: World, resolution: float, shape: tuple[int, ...], window: tuple[slice, ...] = (slice(None),) * 3
) -> Bool[np.ndarray, "nx ny nz"]:
    """Which cells' centres keep the world's margin from the room's faces; of the cells in ``window`` only."""
    bounds, margin = np.asarray(world.bounds, dtype=np.float64), float(world.keep_in) - _ROUNDING
    inside = [
        ((centre >= bounds[0, axis] + margin) & (centre <= bounds[1, axis] - margin))[window[axis]]
        for axis, centre in enumerate(cell_centres(bounds[0], resolution, shape))
    ]
    return np.asarray(inside[0][:, None, None] & inside[1][None, :, None] & inside[2][None, None, :])


def _lattice(world: World, near_obstacle: Bool[np.ndarray, "nx ny nz"], resolution: float) -> Lattice:
    bounds = np.asarray(world.bounds, dtype=np.float64)
    return Lattice(
        occupied=near_obstacle | ~kept_in(world, resolution, near_obstacle.shape),
        near_obstacle=near_obstacle,
        origin=bounds[0].copy(),
        resolution=float(resolution),
    )
