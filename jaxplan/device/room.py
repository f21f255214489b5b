"""A world as the programs of this package want it: obstacles, and a roadmap with all distances known beforehand."""

from dataclasses import fields
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from jaxplan.arrays import AnyArray
from jaxplan.errors import InputError
from jaxplan.records import record, replace
from jaxplan.search.kernels.roads import Roads
from jaxplan.search.lattice import Lattices, SearchConfig, build_lattices
from jaxplan.world.obstacles import World

MOST_PLACES = 8192
"""Places of a roadmap between which all distances are kept: 400 MB (arbitrary)."""
FAR = 1e6
"""m; where places are that only fill arrays up, and how far all is from such obstacles (arbitrary)."""
_SIZES = ("half", "radius", "offset")
"""Fields of primitives without which a point's distance would be larger by as much."""


@record
class Room:
    """Obstacles and roadmap; float32, as what is searched needs no more. Usable as an argument of what is traced."""

    world: World
    places: Float[AnyArray, "n 3"]
    """Where shortest paths can bend [m, world]."""
    lengths: Float[AnyArray, "n n"]
    """Of the shortest ways between them [m]; infinite where there is none."""
    onward: Int[AnyArray, "n n"]
    """``onward[i, j]`` is the place behind i on the way to j; j itself where that is next, or where there is no way."""
    padding: Float[AnyArray, ""]
    """Distance that paths keep from obstacles [m]."""
    from_faces: Float[AnyArray, ""]
    """Distance that they keep from the room's faces [m]."""


def room_of(world: World, padding: float, from_faces: float, resolution: float = 0.1) -> Room:
    """Make a world ready (host); seconds for thousands of places.

    Args:
        world: obstacles and faces.
        padding: distance that paths keep from obstacles [m].
        from_faces: distance that they keep from the faces [m], where that is more than the world's ``keep_in``.
        resolution: side of the cells by which places are looked for [m].

    Raises:
        InputError: the room has more places than all-pairs distances are kept for, or too many cells.
    """
    config = SearchConfig(
        resolutions=(resolution,), distance_fractions=(), padding=padding, least_padding=None, from_faces=from_faces
    )
    lattices = build_lattices(world, config)
    roads = _roads(lattices)
    if len(roads.points) > MOST_PLACES:
        raise InputError(
            f"world {world.name!r}: its roadmap has {len(roads.points)} places, and all distances are kept for at most "
            f"{MOST_PLACES}; choose a larger resolution, or plan on the host"
        )
    if len(roads.points) == 0:  # one place, where nobody gets
        none = np.zeros(0, np.int32)
        roads = Roads(np.full((1, 3), FAR), np.zeros((1, 3)), np.zeros(2, np.int32), none, none.astype(np.float32))
    lengths, onward = all_pairs(roads)
    kept = max(float(world.keep_in), from_faces)
    bare = replace(world, name="", provenance="", start=None)
    room = Room(
        world=bare,
        places=np.asarray(roads.points),
        lengths=lengths,
        onward=onward,
        padding=np.asarray(padding),
        from_faces=np.asarray(kept),
    )
    return jax.tree.map(_in_single_precision, room)


def all_pairs(roads: Roads) -> tuple[Float[np.ndarray, "n n"], Int[np.ndarray, "n n"]]:
    """Lengths of the shortest ways between all places [m], and where each goes next (``Room.onward``)."""
    count = len(roads.points)
    graph = csr_array((np.asarray(roads.lengths, np.float64), roads.ends, roads.first), shape=(count, count))
    lengths, before = dijkstra(graph, return_predecessors=True)
    onward = before.T.astype(
        np.int32
    )  # roads lead both ways: what is before i on the way from j is next on the way to j
    columns = np.broadcast_to(np.arange(count, dtype=np.int32), onward.shape)
    return lengths, np.where(onward < 0, columns, onward)


def alike(rooms: list[Room]) -> list[Room]:
    """The same rooms with arrays of the same shapes, so that one program serves all: what fills them up is far away.

    Raises InputError where some have meshes or cells, whose grids cannot be filled up.
    """
    if len(rooms) > 1 and any(room.world.mesh is not None or room.world.voxels is not None for room in rooms):
        raise InputError("rooms of meshes or cells cannot share a program with others; take one at a time")
    most = max(len(room.places) for room in rooms)
    kinds = [
        max(len(jax.tree.leaves(kind)[0]) for kind in group)
        for group in zip(*(_kinds(room.world) for room in rooms), strict=True)
    ]
    return [_filled_up(room, most, kinds) for room in rooms]


def _roads(lattices: Lattices) -> Roads:
    roadmap = lattices.roadmap
    assert roadmap is not None, "the roadmap is asked for"
    return roadmap.levels[0].roads


def _kinds(world: World) -> list[Any]:
    return [world.boxes, world.cylinders, world.spheres, world.capsules, world.planes]


def _filled_up(room: Room, places: int, kinds: list[int]) -> Room:
    obstacles, missing = room.world.obstacles, places - len(room.places)
    names = ("boxes", "cylinders", "spheres", "capsules", "planes")
    wider = {name: _more(kind, count) for name, kind, count in zip(names, _kinds(room.world), kinds, strict=True)}
    pairs = ((0, missing), (0, missing))
    return replace(
        room,
        world=replace(room.world, obstacles=replace(obstacles, **wider)),
        places=np.pad(room.places, ((0, missing), (0, 0)), constant_values=FAR),
        lengths=np.pad(room.lengths, pairs, constant_values=np.inf),
        onward=np.pad(room.onward, pairs),
    )


def _more(kind: Any, count: int) -> Any:
    """``count`` primitives of a kind: those that are missing have a size of ``-FAR``, so that all is far from them."""

    def grown(name: str, leaf: AnyArray) -> AnyArray:
        array = np.asarray(leaf)
        shape = (count - len(array), *array.shape[1:])
        return np.concatenate([array, np.full(shape, -FAR if name in _SIZES else 0.0, array.dtype)])

    return replace(kind, **{field.name: grown(field.name, getattr(kind, field.name)) for field in fields(kind)})


def _in_single_precision(leaf: ArrayLike) -> AnyArray:
    array = np.asarray(leaf)
    return array.astype(np.float32) if array.dtype.kind == "f" else array
