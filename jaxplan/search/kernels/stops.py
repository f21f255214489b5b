"""Where a vehicle comes to rest behind a goal: the first of some points that it can fly to (host, compiled)."""

import functools
import math
from typing import Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxplan.search.kernels.cells import at
from jaxplan.search.kernels.compiled import entry_point, inner, source_digest
from jaxplan.search.kernels.sight import keeps_clear
from jaxplan.search.kernels.solids import clearance_at


@runtime_checkable
class _FirstClear(Protocol):
    """The first point of several that each goal sees."""

    def __call__(
        self,
        field: tuple,
        limit: float,
        lower: tuple,
        upper: tuple,
        goals: Float[np.ndarray, "k 3"],
        directions: Float[np.ndarray, "k 3"],
        options: Float[np.ndarray, "o 3"],
        stops: Float[np.ndarray, "k 3"],
    ) -> None:
        """Write ``stops``."""


def first_clear(
    field: tuple,
    limit: float,
    room: Float[np.ndarray, "2 3"],
    goals: Float[np.ndarray, "k 3"],
    directions: Float[np.ndarray, "k 3"],
    options: Float[np.ndarray, "o 3"],
) -> Float[np.ndarray, "k 3"]:
    """For each goal [m] the first of the options that it sees at the distance ``limit`` [m]; itself if there is none.

    Options are in the box ``room`` [m], or at least no farther outside than the goal. An option is a distance [m], a
    turn about the vertical [rad] and a share of the direction's rise, all from the goal on along its direction, a unit
    vector. A goal whose direction is 0 stays where it is.
    """
    stops = goals.copy()
    corners = tuple(room[0].tolist()), tuple(room[1].tolist())
    _compiled_first_clear()(field, float(limit), *corners, goals, directions, options, stops)
    return stops


@functools.cache
def _compiled_first_clear() -> _FirstClear:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(field, limit, lower, upper, goals, directions, options, stops):
        _ = version
        for g in range(len(goals)):
            goal, along = at(goals, g), at(directions, g)
            if along[0] * along[0] + along[1] * along[1] + along[2] * along[2] < 0.25:
                continue
            for o in range(len(options)):
                far, turn, rise = options[o, 0], options[o, 1], options[o, 2]
                c, s = math.cos(turn), math.sin(turn)
                dx, dy, dz = c * along[0] - s * along[1], s * along[0] + c * along[1], rise * along[2]
                scale = far / max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-3)
                x, y, z = goal[0] + dx * scale, goal[1] + dy * scale, goal[2] + dz * scale
                if not _as_far_inside(goal, (x, y, z), lower, upper):
                    continue
                if clearance_at(field[3], x, y, z) >= limit and keeps_clear(field, limit, goal, (x, y, z)):
                    stops[g, 0], stops[g, 1], stops[g, 2] = x, y, z
                    break

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _as_far_inside(goal, p, lower, upper):
    """Whether p is in the box, or at least on no axis farther outside than the goal [m]."""
    inside = True
    for axis in range(3):
        inside = inside and min(lower[axis], goal[axis]) <= p[axis] <= max(upper[axis], goal[axis])
    return inside
