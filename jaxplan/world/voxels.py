"""Voxel worlds: occupied cells, and the grid of exact distances to them behind ``clearance``.

The nodes of the distance grid are the corners of the cells. The point of a box of cells that is nearest to a corner is
a corner itself, so the Euclidean distance transform over corners is exact at every node. Between nodes the bound of
``jaxplan.world.clearance`` holds: never above the truth, and below it by at most ``3/4 h^2`` in the square where one
flat or pointed feature is nearest, ``sqrt(3)/2 h`` more in the distance where several compete. Distances are held at
``FARTHEST``; that keeps the bound, and a changed cell changes the grid only nearby.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int, Num
from scipy import ndimage

from jaxplan.errors import FileError
from jaxplan.world.obstacles import DEFAULT_KEEP_IN, DistanceGrid, World, make_obstacles

SPACING = 0.1
"""m; point clouds become cells of this side, and coarser cells of a grid are cut until they are no larger."""
FARTHEST = 1.5
"""m; three times the padding of the interception paper."""
MAX_CELLS = 2**24
"""128 MB of distances."""


def voxel_world(
    path: Path,
    kind: str,
    occupied: Bool[np.ndarray, "nx ny nz"],
    origin: Float[np.ndarray, "3"],
    resolution: float,
    finest: float = SPACING,
) -> World:
    """The world of occupied cells of side ``resolution`` [m] from ``origin`` on; its room is the box of all cells.

    Cells are cut until they are no larger than ``finest`` [m].
    """
    factor = max(1, int(np.ceil(resolution / finest - 1e-9)))
    check_cells(path, np.array(occupied.shape) * factor, resolution / factor)
    extent = np.array(occupied.shape) * resolution
    if not (extent > 2.0 * DEFAULT_KEEP_IN).all():
        raise FileError(
            f"{path}: the map spans {extent_text(extent)} m, want more than {2 * DEFAULT_KEEP_IN:g} m along each axis; "
            "give the whole room, in metres"
        )
    cells = occupied.repeat(factor, 0).repeat(factor, 1).repeat(factor, 2) if factor > 1 else occupied
    return World(
        name=path.stem,
        bounds=np.stack([origin, origin + extent]),
        obstacles=make_obstacles(voxels=distance_grid(cells, origin, resolution / factor)),
        keep_in=np.float64(DEFAULT_KEEP_IN),
        provenance=f"{path} ({kind})",
    )


def check_cells(path: Path, shape: Num[np.ndarray, "3"], resolution: float) -> None:
    """Refuse a map of too many cells before anything is allocated."""
    count = float(np.prod(np.asarray(shape, dtype=float)))
    if not count <= MAX_CELLS:
        raise FileError(
            f"{path}: have {' x '.join(f'{n:.6g}' for n in shape)} = {count:.3g} cells of {resolution:.3g} m, want at "
            f"most {MAX_CELLS}; crop the map, make it coarser, or scale it to metres"
        )


def extent_text(extent: Float[np.ndarray, "3"]) -> str:
    """``"10 x 5 x 2"``."""
    return " x ".join(f"{side:.4g}" for side in extent)


def distance_grid(
    occupied: Bool[np.ndarray, "nx ny nz"], origin: Float[np.ndarray, "3"], resolution: float
) -> DistanceGrid:
    """Occupied cells with the squared distance from each of their corners to the nearest of them."""
    return DistanceGrid(
        occupied=occupied,
        squared=_squared_distances(occupied, resolution),
        origin=np.asarray(origin, dtype=np.float64),
        spacing=np.float64(resolution),
    )


def set_cells(
    grid: DistanceGrid, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"], occupied: bool
) -> DistanceGrid:
    """The grid with all cells that touch the box from ``lower`` to ``upper`` [m] set; only its surroundings are redone.

    A node's distance can change only within ``FARTHEST`` of a changed cell, and depends on cells that far from itself.
    """
    shape, spacing = np.array(grid.occupied.shape), float(grid.spacing)
    origin = np.asarray(grid.origin)
    first = np.floor((lower - origin) / spacing + 1e-9).astype(int)
    last = np.ceil((upper - origin) / spacing - 1e-9).astype(int)
    first, last = np.clip(first, 0, shape), np.clip(last, 0, shape)
    cells, squared = np.array(grid.occupied), np.array(grid.squared)
    cells[_window(first, last)] = occupied
    if (first < last).all():
        reach = int(np.ceil(FARTHEST / spacing))
        low, high = np.maximum(first - reach, 0), np.minimum(last + reach, shape) + 1
        near = _window(low, high)
        if occupied:
            squared[near] = np.minimum(squared[near], _squared_distances_to_box(low, high, first, last, spacing))
        else:
            wide_low, wide_high = np.maximum(first - 2 * reach, 0), np.minimum(last + 2 * reach, shape)
            fresh = _squared_distances(cells[_window(wide_low, wide_high)], spacing)
            squared[near] = fresh[_window(low - wide_low, high - wide_low)]
    return DistanceGrid(occupied=cells, squared=squared, origin=grid.origin, spacing=grid.spacing)


def _window(first: Int[np.ndarray, "3"], last: Int[np.ndarray, "3"]) -> tuple[slice, ...]:
    return tuple(slice(int(a), int(b)) for a, b in zip(first, last, strict=True))


def _squared_distances_to_box(
    low: Int[np.ndarray, "3"],
    high: Int[np.ndarray, "3"],
    first: Int[np.ndarray, "3"],
    last: Int[np.ndarray, "3"],
    spacing: float,
) -> Float[np.ndarray, "mx my mz"]:
    """[m^2] from the nodes from ``low`` to before ``high`` to the nearest of those from ``first`` to ``last``."""
    nodes = [np.arange(a, b) for a, b in zip(low, high, strict=True)]
    steps = [np.maximum(np.maximum(first[i] - nodes[i], nodes[i] - last[i]), 0) ** 2 for i in range(3)]
    return (steps[0][:, None, None] + steps[1][None, :, None] + steps[2][None, None, :]) * spacing**2


def _squared_distances(occupied: Bool[np.ndarray, "nx ny nz"], resolution: float) -> Float[np.ndarray, "mx my mz"]:
    """[m^2] at the (nx + 1) x (ny + 1) x (nz + 1) corners, at most ``FARTHEST`` squared."""
    padded = np.pad(occupied, 1)
    corners = np.zeros(tuple(n + 1 for n in occupied.shape), dtype=bool)
    for i in range(2):
        for j in range(2):
            for k in range(2):
                corners |= padded[i : i + corners.shape[0], j : j + corners.shape[1], k : k + corners.shape[2]]
    if not corners.any():
        return np.full(corners.shape, FARTHEST**2)
    steps = np.rint(ndimage.distance_transform_edt(~corners) ** 2)
    return np.asarray(np.minimum(steps * resolution**2, FARTHEST**2))
