"""What a room is made of: its faces, solid primitives and surface meshes, as records of arrays.

Arrays of JAX or of NumPy: a file's reader makes NumPy arrays, ``jax.device_put`` the others. World frame, z up, metres.
Every kind of primitive is a record of arrays with a leading axis n, which may be 0.
"""

from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from jaxplan.arrays import AnyArray
from jaxplan.errors import InputError
from jaxplan.records import record, replace, static

DEFAULT_KEEP_IN = 0.2
"""m; distance that the vehicle's centre keeps from the room's faces where a file says nothing. The default vehicle's
motors are 0.113 m from its centre; with propellers that is about 0.2 m."""


@record
class Boxes:
    """Solid boxes."""

    center: Float[AnyArray, "n 3"]
    """[m]"""
    half: Float[AnyArray, "n 3"]
    """Half of the side lengths, along the box's own axes [m]."""
    rotation: Float[AnyArray, "n 3 3"]
    """R_world_box: its columns are the box's axes in the world frame."""


@record
class Cylinders:
    """Solid cylinders with flat ends."""

    center: Float[AnyArray, "n 3"]
    """[m]"""
    axis: Float[AnyArray, "n 3"]
    """Unit vector."""
    radius: Float[AnyArray, "n"]
    """[m]"""
    half_length: Float[AnyArray, "n"]
    """[m]"""


@record
class Spheres:
    """Solid spheres."""

    center: Float[AnyArray, "n 3"]
    """[m]"""
    radius: Float[AnyArray, "n"]
    """[m]"""


@record
class Capsules:
    """Cylinders with hemispherical ends: all points within ``radius`` of a segment."""

    center: Float[AnyArray, "n 3"]
    """The segment's middle [m]."""
    axis: Float[AnyArray, "n 3"]
    """Unit vector along the segment."""
    radius: Float[AnyArray, "n"]
    """[m]"""
    half_length: Float[AnyArray, "n"]
    """Half of the segment's length, without the hemispheres [m]."""


@record
class Planes:
    """Half spaces: everything with ``normal . p < offset`` is solid."""

    normal: Float[AnyArray, "n 3"]
    """Unit vector that points into the free side."""
    offset: Float[AnyArray, "n"]
    """[m]"""


@record
class Mesh:
    """A surface mesh, a hollow shell without thickness, with the squared distance to it on a regular grid."""

    vertices: Float[AnyArray, "v 3"]
    """[m]"""
    faces: Int[AnyArray, "f 3"]
    """Three vertex indices per triangle."""
    squared: Float[AnyArray, "nx ny nz"]
    """Exact squared distance from each grid node to the surface [m^2]."""
    origin: Float[AnyArray, "3"]
    """Position of node (0, 0, 0) [m]."""
    spacing: Float[AnyArray, ""] | float
    """Distance between neighbouring nodes [m]."""


@record
class DistanceGrid:
    """Occupied cells, with the squared distance to them at the cells' corners, held at a largest value."""

    occupied: Bool[AnyArray, "nx ny nz"]
    squared: Float[AnyArray, "mx my mz"]
    """One node more than cells along each axis [m^2]."""
    origin: Float[AnyArray, "3"]
    """Lower corner of cell (0, 0, 0), and node (0, 0, 0) [m]."""
    spacing: Float[AnyArray, ""] | float
    """Side of a cell [m]."""


@record
class Obstacles:
    """All that is solid in a room, without the room's own faces."""

    boxes: Boxes
    cylinders: Cylinders
    spheres: Spheres
    capsules: Capsules
    planes: Planes
    mesh: Mesh | None = None
    voxels: DistanceGrid | None = None


@record
class World:
    """A room: its faces, what stands in it, and where it came from. Usable as an argument of a jitted function."""

    name: str = static()
    """The stored world's name, or the file's name without its ending."""
    bounds: Float[AnyArray, "2 3"]
    """Lower and upper corner of the room [m]."""
    obstacles: Obstacles
    keep_in: Float[AnyArray, ""] | float
    """Distance that the vehicle's centre keeps from the room's faces [m]."""
    start: Float[AnyArray, "3"] | None = None
    """Where the defender hovers when nothing else is said [m]; None where the file has no such place."""
    provenance: str = static(default="")
    """Which file and which reader made this world."""

    def __post_init__(self) -> None:
        bounds = np.asarray(self.bounds)
        if bounds.shape != (2, 3) or not np.isfinite(bounds).all() or not (bounds[0] < bounds[1]).all():
            raise InputError(
                f"world {self.name!r}: have bounds {bounds.tolist()}, want two finite corners, lower < upper"
            )
        if not 0.0 <= float(self.keep_in) < float((bounds[1] - bounds[0]).min()) / 2.0:
            raise InputError(
                f"world {self.name!r}: have keep_in {float(self.keep_in):g} m, "
                "want at least 0 and less than half of the room's smallest side"
            )

    @property
    def boxes(self) -> Boxes:
        """Solid boxes."""
        return self.obstacles.boxes

    @property
    def cylinders(self) -> Cylinders:
        """Solid cylinders."""
        return self.obstacles.cylinders

    @property
    def spheres(self) -> Spheres:
        """Solid spheres."""
        return self.obstacles.spheres

    @property
    def capsules(self) -> Capsules:
        """Solid capsules."""
        return self.obstacles.capsules

    @property
    def planes(self) -> Planes:
        """Half spaces."""
        return self.obstacles.planes

    @property
    def mesh(self) -> Mesh | None:
        """Surfaces of meshes, if there are any."""
        return self.obstacles.mesh

    @property
    def voxels(self) -> DistanceGrid | None:
        """Occupied cells, in worlds that are made of them."""
        return self.obstacles.voxels

    @property
    def diagonal(self) -> float:
        """Length of the room's space diagonal [m] (host)."""
        return float(np.linalg.norm(np.asarray(self.bounds)[1] - np.asarray(self.bounds)[0]))

    def nameless(self) -> "World":
        """The same without its names: what is compiled for a world with a name is for that name alone (host)."""
        return replace(self, name="", provenance="") if self.name or self.provenance else self


def no_boxes() -> Boxes:
    """No boxes: arrays of length 0."""
    return Boxes(center=np.zeros((0, 3)), half=np.zeros((0, 3)), rotation=np.zeros((0, 3, 3)))


def aligned_boxes(lower: Annotated[ArrayLike, "n 3"], upper: Annotated[ArrayLike, "n 3"]) -> Boxes:
    """Axis-aligned boxes from their corners [m]."""
    low, high = np.asarray(lower, float).reshape(-1, 3), np.asarray(upper, float).reshape(-1, 3)
    rotation = np.broadcast_to(np.eye(3), (len(low), 3, 3)).copy()
    return Boxes(center=(low + high) / 2.0, half=(high - low) / 2.0, rotation=rotation)


def no_cylinders() -> Cylinders:
    """No cylinders."""
    return Cylinders(center=np.zeros((0, 3)), axis=np.zeros((0, 3)), radius=np.zeros(0), half_length=np.zeros(0))


def no_spheres() -> Spheres:
    """No spheres."""
    return Spheres(center=np.zeros((0, 3)), radius=np.zeros(0))


def no_capsules() -> Capsules:
    """No capsules."""
    return Capsules(center=np.zeros((0, 3)), axis=np.zeros((0, 3)), radius=np.zeros(0), half_length=np.zeros(0))


def no_planes() -> Planes:
    """No half spaces."""
    return Planes(normal=np.zeros((0, 3)), offset=np.zeros(0))


def make_obstacles(
    *,
    boxes: Boxes | None = None,
    cylinders: Cylinders | None = None,
    spheres: Spheres | None = None,
    capsules: Capsules | None = None,
    planes: Planes | None = None,
    mesh: Mesh | None = None,
    voxels: DistanceGrid | None = None,
) -> Obstacles:
    """Obstacles of the kinds that are given; the other kinds are empty."""
    return Obstacles(
        boxes=no_boxes() if boxes is None else boxes,
        cylinders=no_cylinders() if cylinders is None else cylinders,
        spheres=no_spheres() if spheres is None else spheres,
        capsules=no_capsules() if capsules is None else capsules,
        planes=no_planes() if planes is None else planes,
        mesh=mesh,
        voxels=voxels,
    )
