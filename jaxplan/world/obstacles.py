"""What a room is made of: its faces, solid primitives and surface meshes, as records of arrays.

World frame, z up, metres. Every kind of primitive is a record of arrays with a leading axis n, which may be 0.
"""

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxplan.errors import InputError
from jaxplan.records import record, static

DEFAULT_KEEP_IN = 0.2
"""m; distance that the vehicle's centre keeps from the room's faces where a file says nothing. The default vehicle's
motors are 0.113 m from its centre; with propellers that is about 0.2 m."""


@record
class Boxes:
    """Solid boxes."""

    center: Float[Array, "n 3"]
    """[m]"""
    half: Float[Array, "n 3"]
    """Half of the side lengths, along the box's own axes [m]."""
    rotation: Float[Array, "n 3 3"]
    """R_world_box: its columns are the box's axes in the world frame."""


@record
class Cylinders:
    """Solid cylinders with flat ends."""

    center: Float[Array, "n 3"]
    """[m]"""
    axis: Float[Array, "n 3"]
    """Unit vector."""
    radius: Float[Array, "n"]
    """[m]"""
    half_length: Float[Array, "n"]
    """[m]"""


@record
class Spheres:
    """Solid spheres."""

    center: Float[Array, "n 3"]
    """[m]"""
    radius: Float[Array, "n"]
    """[m]"""


@record
class Capsules:
    """Cylinders with hemispherical ends: all points within ``radius`` of a segment."""

    center: Float[Array, "n 3"]
    """The segment's middle [m]."""
    axis: Float[Array, "n 3"]
    """Unit vector along the segment."""
    radius: Float[Array, "n"]
    """[m]"""
    half_length: Float[Array, "n"]
    """Half of the segment's length, without the hemispheres [m]."""


@record
class Planes:
    """Half spaces: everything with ``normal . p < offset`` is solid."""

    normal: Float[Array, "n 3"]
    """Unit vector that points into the free side."""
    offset: Float[Array, "n"]
    """[m]"""


@record
class Mesh:
    """A surface mesh, a hollow shell without thickness, with the squared distance to it on a regular grid."""

    vertices: Float[Array, "v 3"]
    """[m]"""
    faces: Int[Array, "f 3"]
    """Three vertex indices per triangle."""
    squared: Float[Array, "nx ny nz"]
    """Exact squared distance from each grid node to the surface [m^2]."""
    origin: Float[Array, "3"]
    """Position of node (0, 0, 0) [m]."""
    spacing: Float[Array, ""]
    """Distance between neighbouring nodes [m]."""


@record
class DistanceGrid:
    """Occupied cells, with the squared distance to them at the cells' corners, held at a largest value."""

    occupied: Bool[Array, "nx ny nz"]
    squared: Float[Array, "mx my mz"]
    """One node more than cells along each axis [m^2]."""
    origin: Float[Array, "3"]
    """Lower corner of cell (0, 0, 0), and node (0, 0, 0) [m]."""
    spacing: Float[Array, ""]
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
    bounds: Float[Array, "2 3"]
    """Lower and upper corner of the room [m]."""
    obstacles: Obstacles
    keep_in: Float[Array, ""]
    """Distance that the vehicle's centre keeps from the room's faces [m]."""
    start: Float[Array, "3"] | None = None
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
        return self.obstacles.boxes

    @property
    def cylinders(self) -> Cylinders:
        return self.obstacles.cylinders

    @property
    def spheres(self) -> Spheres:
        return self.obstacles.spheres

    @property
    def capsules(self) -> Capsules:
        return self.obstacles.capsules

    @property
    def planes(self) -> Planes:
        return self.obstacles.planes

    @property
    def mesh(self) -> Mesh | None:
        return self.obstacles.mesh

    @property
    def voxels(self) -> DistanceGrid | None:
        return self.obstacles.voxels

    @property
    def diagonal(self) -> float:
        """Length of the room's space diagonal [m] (host)."""
        return float(np.linalg.norm(np.asarray(self.bounds)[1] - np.asarray(self.bounds)[0]))


def no_boxes() -> Boxes:
    return Boxes(center=np.zeros((0, 3)), half=np.zeros((0, 3)), rotation=np.zeros((0, 3, 3)))


def aligned_boxes(lower: Float[np.ndarray, "n 3"], upper: Float[np.ndarray, "n 3"]) -> Boxes:
    """Axis-aligned boxes from their corners [m]."""
    lower, upper = np.asarray(lower, float).reshape(-1, 3), np.asarray(upper, float).reshape(-1, 3)
    rotation = np.broadcast_to(np.eye(3), (len(lower), 3, 3)).copy()
    return Boxes(center=(lower + upper) / 2.0, half=(upper - lower) / 2.0, rotation=rotation)


def no_cylinders() -> Cylinders:
    return Cylinders(center=np.zeros((0, 3)), axis=np.zeros((0, 3)), radius=np.zeros(0), half_length=np.zeros(0))


def no_spheres() -> Spheres:
    return Spheres(center=np.zeros((0, 3)), radius=np.zeros(0))


def no_capsules() -> Capsules:
    return Capsules(center=np.zeros((0, 3)), axis=np.zeros((0, 3)), radius=np.zeros(0), half_length=np.zeros(0))


def no_planes() -> Planes:
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
