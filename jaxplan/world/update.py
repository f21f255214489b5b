"""Change a world in flight: boxes that come, move and go, cells that become occupied or free (host).

Arrays keep their shapes and dtypes and everything static stays as it was, so that nothing is compiled anew: boxes go
into slots that ``with_spare_boxes`` reserved. ``jaxplan.search.update`` brings the lattices up to date.
"""

from collections.abc import Iterable
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from jaxplan.errors import InputError
from jaxplan.records import replace
from jaxplan.validation import as_shaped
from jaxplan.world.obstacles import Boxes, World
from jaxplan.world.voxels import set_cells

_ABSENT = 1e6
"""m; where boxes wait that are not there, below every room. Their distance is finite and never the least."""

Corners = tuple[Annotated[ArrayLike, "3"], Annotated[ArrayLike, "3"]]
"""Lower and upper corner of a box along the room's axes [m, world]."""


class Change(NamedTuple):
    """A world after a change, and the box outside of which all obstacles are what they were."""

    world: World
    lower: Float[np.ndarray, "3"]
    """[m]"""
    upper: Float[np.ndarray, "3"]
    """[m]"""


def with_spare_boxes(world: World, count: int = 16) -> World:
    """The same world with ``count`` more boxes that are not there yet."""
    boxes = world.boxes
    spare = Boxes(
        center=np.concatenate([np.asarray(boxes.center), np.full((count, 3), -_ABSENT)]),
        half=np.concatenate([np.asarray(boxes.half), np.full((count, 3), 0.5)]),
        rotation=np.concatenate([np.asarray(boxes.rotation), np.tile(np.eye(3), (count, 1, 1))]),
    )
    return replace(world, obstacles=replace(world.obstacles, boxes=spare))


def update_world(
    world: World,
    *,
    add_box: Corners | None = None,
    remove_box: int | None = None,
    move_box: tuple[int, Corners] | None = None,
    occupy: Corners | None = None,
    free: Corners | None = None,
) -> Change:
    """``world`` with one change, and the box outside of which nothing has changed; ``world`` itself stays as it is.

    Args:
        world: of NumPy arrays or on a device; the changed arrays are NumPy.
        add_box: corners [m] of a new box along the room's axes, which takes a spare slot (``with_spare_boxes``).
        remove_box: the number of a box in ``world.boxes``; its slot is spare from then on.
        move_box: the number of a box, or of a spare slot, and the corners [m] between which it is from then on.
        occupy: corners [m]; all cells of a voxel world that touch this box become occupied.
        free: corners [m]; all cells that touch this box become free.

    Raises:
        InputError: not one change but none or several, corners that are not two finite points with lower < upper,
            no spare slot, no such box, or cells in a world without them.
    """
    if sum(change is not None for change in (add_box, remove_box, move_box, occupy, free)) != 1:
        kinds = "add_box, remove_box, move_box, occupy or free"
        raise InputError(f"world: want one change: {kinds}; call update_world once for each")
    if add_box is not None:
        return _add_box(world, *_corners(add_box))
    if remove_box is not None:
        return _remove_box(world, remove_box)
    if move_box is not None:
        return _move_box(world, move_box[0], *_corners(move_box[1]))
    if occupy is not None:
        return _set_occupied(world, *_corners(occupy), True)
    assert free is not None
    return _set_occupied(world, *_corners(free), False)


def without_boxes(world: World, numbers: Iterable[int]) -> World:
    """The world without some boxes of ``world.boxes``, whose slots are spare then."""
    for number in numbers:
        world = _place_box(world, number, np.full(3, -_ABSENT), np.full(3, 0.5))
    return world


def _add_box(world: World, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]) -> Change:
    """Add an axis-aligned box from ``lower`` to ``upper`` [m] in a spare slot."""
    free = np.flatnonzero(np.asarray(world.boxes.center)[:, 2] <= -_ABSENT)
    if not len(free):
        raise InputError("world: have no spare box left, want one; reserve more with with_spare_boxes")
    moved = _place_box(world, int(free[0]), (lower + upper) / 2.0, (upper - lower) / 2.0)
    return Change(moved, lower, upper)


def _remove_box(world: World, index: int) -> Change:
    """Take away box ``index``, whatever its attitude; its slot is spare from then on."""
    centers = np.asarray(world.boxes.center)
    if not 0 <= index < len(centers) or centers[index, 2] <= -_ABSENT:
        raise InputError(f"world {world.name!r}: there is no box {index}; want the number of one in world.boxes")
    reach = np.abs(np.asarray(world.boxes.rotation)[index]) @ np.asarray(world.boxes.half)[index]
    moved = _place_box(world, index, np.full(3, -_ABSENT), np.full(3, 0.5))
    return Change(moved, centers[index] - reach, centers[index] + reach)


def _move_box(world: World, index: int, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]) -> Change:
    """Put box ``index``, or one that is not there yet, from ``lower`` to ``upper`` [m]."""
    centers = np.asarray(world.boxes.center)
    if not 0 <= index < len(centers):
        raise InputError(f"world {world.name!r}: there is no box {index}; want a number below {len(centers)}")
    moved = _place_box(world, index, (lower + upper) / 2.0, (upper - lower) / 2.0)
    if centers[index, 2] <= -_ABSENT:
        return Change(moved, lower, upper)
    reach = np.abs(np.asarray(world.boxes.rotation)[index]) @ np.asarray(world.boxes.half)[index]
    return Change(moved, np.minimum(lower, centers[index] - reach), np.maximum(upper, centers[index] + reach))


def _set_occupied(world: World, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"], occupied: bool) -> Change:
    """Set all cells of a voxel world that touch the box from ``lower`` to ``upper`` [m]."""
    if world.voxels is None:
        raise InputError(f"world {world.name!r}: have no cells, want a world of cells; add or remove a box")
    voxels = set_cells(world.voxels, lower, upper, occupied)
    moved = replace(world, obstacles=replace(world.obstacles, voxels=voxels))
    side = float(world.voxels.spacing)
    return Change(moved, lower - side, upper + side)


def _place_box(world: World, index: int, center: Float[np.ndarray, "3"], half: Float[np.ndarray, "3"]) -> World:
    """The world with box ``index`` somewhere else, along the room's axes."""
    boxes = world.boxes
    centers, halves, rotations = np.array(boxes.center), np.array(boxes.half), np.array(boxes.rotation)
    centers[index], halves[index], rotations[index] = center, half, np.eye(3)
    moved = Boxes(center=centers, half=halves, rotation=rotations)
    return replace(world, obstacles=replace(world.obstacles, boxes=moved))


def _corners(corners: Corners) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Both corners [m] as float64, checked."""
    if not isinstance(corners, tuple | list) or len(corners) != 2:
        raise InputError(f"box: have {corners!r}, want its lower and its upper corner")
    low, high = (as_shaped("box: corner", corner, (3,)) for corner in corners)
    if not (np.isfinite(low) & np.isfinite(high) & (low < high)).all():
        raise InputError(
            f"box: have corners {low.tolist()} and {high.tolist()}, want three finite metres each, lower < upper"
        )
    return low, high
