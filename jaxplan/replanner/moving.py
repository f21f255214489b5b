"""Boxes that move, told to a replanner of still ones.

Plans keep clear of boxes at the instants at which they will be where (``Replanner.expect``). Searches know none: they
are told, for each box, of a still one that holds what it will sweep soon (``Replanner.update``), anew only when that
does not do any more. Where a vehicle stands in the way of what is swept a shorter while is told, so that a plan can
begin there; that it has to leave is a matter of instants.
"""

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.replanner.loop import Replanner
from jaxplan.replanner.passing import Ways
from jaxplan.world.obstacles import World
from jaxplan.world.update import Corners, update_world

HORIZONS = (1.8, 1.2, 0.8, 0.4, 0.0)
"""s that searches are told; shorter ones where the vehicle is in the way."""
ENOUGH = 1.0
"""s; what is told is told anew once it does not hold what is swept within that time any more."""
FREE = 0.4
"""m that what is told must leave around the vehicle for plans to begin there."""
NEAR = 27.0
"""m from the vehicle, within which searches are told: as far as it flies in that time at 15 m/s. At 12 m/s a stop takes
7 m, and what was told from 6 m on only came too late."""


class MovingBoxes:
    """Keeps a replanner informed of boxes that move; they take the place of spare ones in its world."""

    def __init__(self, replanner: Replanner, world: World, count: int) -> None:
        """``world`` is the replanner's, its last ``count`` boxes those of ``with_spare_boxes``: one for each.

        Raises ``InputError`` where it has not as many.
        """
        if not 0 <= count <= len(world.boxes.center):
            raise InputError(f"moving boxes: have {count}, want as many as the world has spare boxes at most")
        self._replanner, self._world = replanner, world
        self._first = len(world.boxes.center) - count
        self._told: list[Corners | None] = [None] * count
        self.changes = 0
        """How often the searches' world was changed."""

    def tell(self, ways: Ways, here: Float[np.ndarray, "3"]) -> None:
        """Before each ``Replanner.step``: where the boxes will be when, and where the vehicle is [m, world].

        A box whose corners are NaN is not known of: searches keep out of what was told of it last.
        Raises ``InputError`` for what are no ways, or of another number of boxes.
        """
        if len(ways.lower) != len(self._told):
            raise InputError(f"moving boxes: have ways of {len(ways.lower)}, want those of {len(self._told)}")
        self._replanner.expect(ways)
        for number in map(int, np.flatnonzero(np.isfinite(ways.lower).all(axis=(1, 2)))):
            told = _to_tell(ways, number, self._told[number], here)
            if told is not None:
                change = update_world(self._world, move_box=(self._first + number, told))
                self._world, self._told[number] = change.world, told
                self._replanner.update(change, moving=True)
                self.changes += 1


def _to_tell(ways: Ways, number: int, told: Corners | None, here: Float[np.ndarray, "3"]) -> Corners | None:
    """What to tell anew of one of them; None where what was told will do, or it is too far away to matter."""
    soon = _swept(ways, number, ENOUGH)
    if told is None and _distance_to(soon, here) > NEAR:
        return None
    if told is not None and _holds(told, soon) and _distance_to(told, here) >= FREE:
        return None
    every = [_swept(ways, number, seconds) for seconds in HORIZONS]
    return next((box for box in every if _distance_to(box, here) >= FREE), every[-1])


def _swept(ways: Ways, number: int, seconds: float) -> Corners:
    """The box around what one of them sweeps within ``seconds``; rounding takes no instant away."""
    until = ways.times - ways.times[0] <= seconds + 1e-9
    return ways.lower[number, until].min(axis=0), ways.upper[number, until].max(axis=0)


def _distance_to(box: Corners, point: Float[np.ndarray, "3"]) -> float:
    """From a point to a box [m]; 0 inside."""
    lower, upper = box
    return float(np.linalg.norm(np.maximum(np.maximum(lower - point, point - upper), 0.0)))


def _holds(outer: Corners, inner: Corners) -> bool:
    """Whether one box is in another."""
    return bool((np.asarray(outer[0]) <= inner[0]).all() and (np.asarray(outer[1]) >= inner[1]).all())
