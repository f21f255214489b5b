"""Where a target is met: within a radius of its predicted position, on the last leg of the path to it (host, NumPy)."""

import numpy as np
from jaxtyping import Float

from jaxplan.records import replace
from jaxplan.search.lattice import Paths

LEFT = 0.5
"""Share of the last leg that is kept at least, so that a path keeps its corners and its direction (arbitrary)."""


def ending_before(paths: Paths, radius: float) -> Paths:
    """Whole paths that end ``radius`` [m] before their goals, or nearer where their last leg is short."""
    if radius == 0.0 or not len(paths.points):
        return paths
    rows, last = np.arange(len(paths.points)), np.clip(paths.count - 1, 1, paths.points.shape[1] - 1)
    goals = paths.points[rows, last]
    leg = paths.points[rows, last - 1] - goals
    length = np.linalg.norm(leg, axis=1)
    off = np.where((paths.reasons == 0) & (length > 0.0), np.minimum(radius, (1.0 - LEFT) * length), 0.0)
    ends = goals + leg * (off / np.where(length > 0.0, length, 1.0))[:, None]
    behind = np.arange(paths.points.shape[1])[None] >= last[:, None]
    return replace(paths, points=np.where(behind[..., None], ends[:, None], paths.points), length=paths.length - off)


def beginning_at(paths: Paths, start: Float[np.ndarray, "3"]) -> Paths:
    """The same paths with a straight way from ``start`` [m, world] to where they begin before them."""
    first = np.broadcast_to(start, (len(paths.points), 1, 3))
    lengths = np.linalg.norm(paths.points[:, 0] - start, axis=1)
    return replace(
        paths,
        points=np.concatenate([first, paths.points], axis=1),
        count=np.where(paths.count > 0, paths.count + 1, 0),
        length=paths.length + lengths,
    )
