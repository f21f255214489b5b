"""The cells that a segment crosses, by cutting it at every face between cells."""

import numpy as np


def crossed_cells(a: np.ndarray, b: np.ndarray, origin: np.ndarray, h: float) -> np.ndarray:
    """Indices of all cells in which the segment a-b has a piece longer than a millionth of it."""
    cuts = [0.0, 1.0]
    for axis in range(3):
        u, v = (a[axis] - origin[axis]) / h, (b[axis] - origin[axis]) / h
        faces = np.arange(np.ceil(min(u, v)), np.floor(max(u, v)) + 1)
        if u != v:
            cuts += list((faces - u) / (v - u))
    cuts = np.unique(np.clip(cuts, 0.0, 1.0))
    pieces = np.diff(cuts) > 1e-6
    middles = ((cuts[:-1] + cuts[1:]) / 2.0)[pieces]
    return np.floor((a + middles[:, None] * (b - a) - origin) / h).astype(int)
