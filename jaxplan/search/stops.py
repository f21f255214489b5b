"""Stop points: where a plan that flies through its goal comes to rest behind it (host).

Every plan ends at rest, so that a vehicle whose next plan never comes stops in free space. A stop point straight on
costs the meeting least time; the more the flight has to turn behind the goal, and the shorter it is, the more.
"""

import numpy as np
from jaxtyping import Float

from jaxplan.search.kernels.stops import first_clear
from jaxplan.search.lattice import Lattices, Paths
from jaxplan.world.obstacles import World

DISTANCES = {2.0: 0.42, 1.0: 0.33, 0.5: 0.26}
"""Distances behind the goal [m], and what one straight on saves [s]: `mfrl`, from hover to a goal 6 m away."""
TURNS = {0.0: 1.0, 30.0: 0.8, 60.0: 0.57, 90.0: 0.42}
"""Turns [degrees], and the share of that which is left, likewise."""
RISES = (1.0, 0.0)
"""Shares of the rise of the path that are kept."""


def stop_points(
    lattices: Lattices, world: World, paths: Paths, velocities: Float[np.ndarray, "k 3"] | None = None
) -> Float[np.ndarray, "k 3"]:
    """For every path a point behind its goal that can be flown to from there [m, world]; the goal where there is none.

    Both keep the padding from obstacles, and from the faces of the room what the goal keeps. The way to it is as much
    the path's continuation as there is room for, or that of the ``velocities`` [m/s] at the goals, where given.
    """
    rows, last = np.arange(len(paths.points)), np.clip(paths.count - 1, 1, paths.points.shape[1] - 1)
    goals = paths.points[rows, last]
    along = goals - paths.points[rows, last - 1]
    if velocities is not None:
        moving = np.linalg.norm(velocities, axis=1, keepdims=True) > 1e-6
        along = np.where(moving, velocities, along)
    length = np.linalg.norm(along, axis=1, keepdims=True)
    usable = (paths.reasons == 0)[:, None] & (length > 1e-6)
    directions = np.where(usable, along / np.where(usable, length, 1.0), 0.0)
    if lattices.roadmap is None:
        return goals
    padding = lattices.config.padding
    room = np.asarray(world.bounds, dtype=np.float64) + padding * np.array([[1.0], [-1.0]])
    return first_clear(tuple(lattices.roadmap.field), padding, room, goals, directions, OPTIONS)


def _options() -> Float[np.ndarray, "o 3"]:
    """Distance [m], turn [rad] and kept rise of each option, what saves most first."""
    found = [
        (saved * left, rise, distance, sign * turn)
        for distance, saved in DISTANCES.items()
        for turn, left in TURNS.items()
        for sign in ((1.0, -1.0) if turn else (1.0,))
        for rise in RISES
    ]
    ordered = sorted(found, key=lambda one: (-one[0], -one[1]))
    return np.array([(distance, np.radians(turn), rise) for _, rise, distance, turn in ordered])


OPTIONS = _options()
