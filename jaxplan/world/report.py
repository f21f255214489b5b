"""What a map amounts to, in numbers that tell whether it was read as meant (host)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool
from scipy import ndimage

from jaxplan.world.obstacles import World
from jaxplan.world.occupancy import PADDING, RESOLUTIONS, occupancy_lattices


class LatticeReport(NamedTuple):
    """One lattice of a world, inflated by the padding."""

    resolution: float
    """Side of a cell [m]."""
    cells: int
    occupied: float
    """Share of the cells that no path may enter."""
    largest: float
    """Share of the free cells that the largest connected part holds; NaN where none is free."""
    parts: int
    """Connected parts of the free cells."""


def lattice_reports(
    world: World, resolutions: tuple[float, ...] = RESOLUTIONS, padding: float = PADDING
) -> list[LatticeReport]:
    """Occupied share and connection of each lattice, finest first."""
    return [
        _report(lattice.occupied, lattice.resolution) for lattice in occupancy_lattices(world, resolutions, padding)
    ]


def obstacle_counts(world: World) -> dict[str, int]:
    """How many obstacles of each kind a world has; kinds without any are left out."""
    counts = {
        "boxes": len(world.boxes.center),
        "cylinders": len(world.cylinders.center),
        "spheres": len(world.spheres.center),
        "capsules": len(world.capsules.center),
        "planes": len(world.planes.offset),
        "triangles": 0 if world.mesh is None else len(world.mesh.faces),
        "occupied cells": 0 if world.voxels is None else int(np.sum(world.voxels.occupied)),
    }
    return {kind: count for kind, count in counts.items() if count}


def _report(occupied: Bool[np.ndarray, "nx ny nz"], resolution: float) -> LatticeReport:
    labels, parts = ndimage.label(~occupied)
    sizes = np.bincount(labels.reshape(-1))[1:]
    largest = float(sizes.max() / sizes.sum()) if parts else float("nan")
    return LatticeReport(resolution, occupied.size, float(occupied.mean()), largest, int(parts))
