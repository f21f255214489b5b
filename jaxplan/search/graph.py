"""The graph that the search walks on: an occupancy lattice as flat arrays (NumPy)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt32

STEPS = np.array([(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) != (0, 0, 0)])
"""The 26 steps, in cells; bit b of a cell's ``moves`` permits step b."""


class Frame(NamedTuple):
    """Where a lattice's cells lie: counts per axis, lower corner [m, world] and side of a cell [m]. Scalars only, which
    compiled code passes around at no cost."""

    nx: int
    ny: int
    nz: int
    x: float
    y: float
    z: float
    h: float


class Graph(NamedTuple):
    """A lattice as the search wants it: flat arrays over cells in C order."""

    moves: UInt32[np.ndarray, "n"]
    """Bit mask of permitted steps."""
    components: Int[np.ndarray, "n"]
    """Label of the cell's connected component, 0 for occupied cells."""
    frame: Frame
    fine: Bool[np.ndarray, "fx fy fz"]
    """Cells of the finest lattice that are too close to an obstacle: what blocks sight."""
    fine_frame: Frame


def make_frame(shape: tuple[int, ...], origin: Float[np.ndarray, "3"], resolution: float) -> Frame:
    """The frame of a lattice of ``shape`` cells with its lower corner at ``origin`` [m]."""
    return Frame(*(int(n) for n in shape), *(float(x) for x in origin), float(resolution))


def permitted_moves(occupied: Bool[np.ndarray, "nx ny nz"]) -> UInt32[np.ndarray, "n"]:
    """Per cell the bit mask of steps that stay in free cells and cut no corner."""
    free = np.pad(~occupied, 1)
    inner = tuple(slice(1, n + 1) for n in occupied.shape)
    moves = np.zeros(occupied.shape, dtype=np.uint32)
    for bit, step in enumerate(STEPS):
        allowed = free[inner].copy()
        for corner in np.unique(np.array(np.meshgrid(*([0, s] for s in step))).reshape(3, -1).T, axis=0):
            allowed &= free[tuple(slice(1 + c, n + 1 + c) for c, n in zip(corner, occupied.shape, strict=True))]
        moves |= allowed.astype(np.uint32) << np.uint32(bit)
    return moves.reshape(-1)
