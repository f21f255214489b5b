"""The graph that the search walks on: an occupancy lattice as flat arrays (NumPy)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt32

STEPS = np.array([(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) != (0, 0, 0)])
"""The 26 steps, in cells; bit b of a cell's ``moves`` permits step b."""

LENGTHS = np.linalg.norm(STEPS, axis=1)
"""Length of each step, in cells."""

EVERY_STEP = np.uint32(2**26 - 1)
"""The ``moves`` of a cell that is free with all of its neighbours."""
NO_STEP = 26
"""Where a step is stored: none led here."""

NO_ENTRY = -1
"""The goal was not reached."""
DIRECT = -2
"""The goal is joined to the start by one segment."""
IF_SEEN = -3
"""The goal is to be joined to the end of the head by one segment, if that sees it."""


class Frame(NamedTuple):
    """Where a lattice's cells lie: counts per axis, lower corner [m, world] and side of a cell [m].

    Scalars only, which compiled code passes around at no cost.
    """

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
    nx, ny, nz = (int(n) for n in shape)
    x, y, z = (float(corner) for corner in origin)
    return Frame(nx, ny, nz, x, y, z, float(resolution))


def two_free_cells() -> Graph:
    """The smallest graph with a step: cells of 1 m in a row, the first at the origin."""
    occupied = np.zeros((2, 1, 1), dtype=bool)
    frame = make_frame(occupied.shape, np.zeros(3), 1.0)
    return Graph(permitted_moves(occupied), np.ones(2, np.int32), frame, occupied, frame)


def plain(graph: Graph) -> tuple:
    """A graph as nested plain tuples."""
    return (*graph[:2], tuple(graph.frame), graph.fine, tuple(graph.fine_frame))


def permitted_moves(occupied: Bool[np.ndarray, "nx ny nz"]) -> UInt32[np.ndarray, "n"]:
    """Per cell the bit mask of steps that stay in free cells and cut no corner.

    The box of a step is free where it is free along x, and that line one step further in y, and that face in z.
    """
    free = np.pad(~occupied, 1)
    moves = np.zeros(occupied.shape, dtype=np.uint32)
    lines = {i: _both(free, 0, i) for i in (-1, 0, 1)}
    faces = {(i, j): _both(lines[i], 1, j) for i in (-1, 0, 1) for j in (-1, 0, 1)}
    for bit, (i, j, k) in enumerate(STEPS.tolist()):
        allowed = _both(faces[i, j], 2, k)[1:-1, 1:-1, 1:-1]
        moves |= allowed.astype(np.uint32) << np.uint32(bit)
    return moves.reshape(-1)


def _both(free: Bool[np.ndarray, "x y z"], axis: int, step: int) -> Bool[np.ndarray, "x y z"]:
    """Where a place and the one a step further are free; the outermost places are not."""
    if step == 0:
        return free
    here, there = [slice(None)] * 3, [slice(None)] * 3
    here[axis], there[axis] = (slice(-1), slice(1, None))[::step]
    both = np.zeros_like(free)
    np.logical_and(free[tuple(here)], free[tuple(there)], out=both[tuple(here)])
    return both


def onward_steps() -> tuple[Int[np.ndarray, "27 26"], Int[np.ndarray, "27"]]:
    """The steps e worth taking after a step d through free surroundings, in order, and their number; all 26 after none.

    From the cell before, p, to the one after, p + d + e, there may be another way over a neighbour y of the middle. If
    it is shorter, or as short with a shorter last step, e is left out. Optimal costs survive: among the optimal
    predecessors of a cell take one whose step to it is shortest; whatever precedes that one, no y can replace it.
    (Natural neighbours of jump point search, Harabor and Grastien 2011, without its jumps.)
    """
    steps, counts = np.zeros((27, 26), np.int64), np.zeros(27, np.int64)
    for d in range(27):
        kept = [e for e in range(26) if d == NO_STEP or not _has_better_way(STEPS[d], STEPS[e])]
        steps[d, : len(kept)], counts[d] = kept, len(kept)
    return steps, counts


def _has_better_way(d: Int[np.ndarray, "3"], e: Int[np.ndarray, "3"]) -> bool:
    """Whether a way from -d to e over the neighbours of 0, but not over 0, makes the step e after d needless."""
    rounding = 1e-9
    length = np.linalg.norm(d) + np.linalg.norm(e)
    if np.abs(d + e).max() <= 1:  # back, or beside: one step or none
        return True
    for y in STEPS:
        first, last = y + d, e - y
        if 0 < np.abs(first).max() <= 1 and 0 < np.abs(last).max() <= 1:
            saved = length - np.linalg.norm(first) - np.linalg.norm(last)
            shorter_last = np.linalg.norm(last) < np.linalg.norm(e) - rounding
            if saved > rounding or (saved > -rounding and shorter_last):
                return True
    return False


class Goals(NamedTuple):
    """Goals in lists by cell. ``head`` and ``following`` hold goal index + 1, so that 0 ends a list."""

    points: Float[np.ndarray, "k 3"]
    """[m, world]"""
    head: Int[np.ndarray, "n"]
    """By cell, the first goal in its list."""
    following: Int[np.ndarray, "k"]
    """The next goal in the same list."""
    nearby: Bool[np.ndarray, "n"]
    """Cells with a goal among the 27 around them."""
    cost: Float[np.ndarray, "k"]
    """Length of the best path so far [m]."""
    entry: Int[np.ndarray, "k"]
    """The last cell before the goal, or ``NO_ENTRY`` or ``DIRECT``."""
    alias: Int[np.ndarray, "k"]
    """The first goal at the same point; itself if there is none."""
    heuristic: Float[np.ndarray, "k"]
    """h at the goal [m]."""
    wanted: Bool[np.ndarray, "k"]
    """Goals whose best path may still be found."""
    listed: Bool[np.ndarray, "k"]
    """The goals that were wanted at first; those in the lists, and their aliases."""


def make_goals(
    points: Float[np.ndarray, "k 3"],
    wanted: Bool[np.ndarray, "k"],
    centre: Float[np.ndarray, "3"],
    head: Int[np.ndarray, "n"],
    nearby: Bool[np.ndarray, "n"],
) -> Goals:
    """Goals [m, world] that are not listed yet; ``centre``: where h is 0; ``head`` and ``nearby``: zeros."""
    count = len(points)
    return Goals(
        points=points,
        head=head,
        following=np.zeros(count, np.int32),
        nearby=nearby,
        cost=np.full(count, np.inf),
        entry=np.full(count, NO_ENTRY, np.int64),
        alias=np.arange(count),
        heuristic=np.linalg.norm(points - centre, axis=1),
        wanted=wanted.copy(),
        listed=wanted,
    )
