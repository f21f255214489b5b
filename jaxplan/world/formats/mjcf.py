"""Scenes in MuJoCo's MJCF: one source of a world for simulation, occupancy, clearance and pictures.

Besides geoms a file holds a box site "room" (the room's faces), optionally a site "start" and a custom numeric
"keep_in" [m]. Geoms with contype = conaffinity = 0 collide with nothing: they are decoration, and no obstacles.

MJCF is a programming language of sorts: it includes files, repeats elements, allocates what it is told to and loads
plugins. So the text is looked through before MuJoCo sees it: only elements that describe a static scene are let
through, in a bounded number and depth.
"""

from pathlib import Path
from typing import NamedTuple, NoReturn
from xml.parsers import expat

import mujoco
import numpy as np
from jaxtyping import Float, Int

from jaxplan.errors import FileError, InputError
from jaxplan.mjcf_probe import probe_mjcf
from jaxplan.world.formats.streams import ByteStream, file_size
from jaxplan.world.mesh import check_mesh, mesh_with_distances
from jaxplan.world.obstacles import (
    DEFAULT_KEEP_IN,
    Boxes,
    Capsules,
    Cylinders,
    Mesh,
    Obstacles,
    Planes,
    Spheres,
    World,
    make_obstacles,
)

ELEMENTS = frozenset(
    """
    mujoco compiler option visual global quality headlight map scale rgba statistic asset texture material default
    custom numeric text worldbody body frame geom site light camera mesh
    """.split()  # noqa: SIM905 (a list of 30 quoted words is harder to read)
)
"""Everything that a static scene of primitives and meshes needs. ``body`` without a joint is static."""
MAX_ELEMENTS = 10_000
MAX_DEPTH = 64
"""Both arbitrary, far above any hand-written room."""
_MAX_COUNT = 4096
"""Largest texture side in pixels and largest custom array; arbitrary."""

_COUNTS = {("texture", "width"), ("texture", "height"), ("numeric", "size"), ("texture", "nchannel")}
_REFUSED_ATTRIBUTES = frozenset(
    [
        "fileup",
        "filedown",
        "fileleft",
        "fileright",
        "filefront",
        "fileback",
        "hfield",
        "meshdir",
        "assetdir",
        "texturedir",
    ]
)
MESH_ENDINGS = (".stl", ".obj")
MAX_MESHES = 64
_MAX_MESH_BYTES = 16 * 2**20
"""Of all mesh files that an MJCF file names: MuJoCo wants them in memory at once."""


def load_mjcf(path: Path, stream: ByteStream) -> World:
    """The world of somebody's MJCF file, which a child process with limits compiles first."""
    scene = check_mjcf(path, stream.read())
    probe_mjcf(path, scene.text, scene.meshes)
    return _world(path, scene)


def load_own_mjcf(path: Path, stream: ByteStream) -> World:
    """The world of an MJCF file of this package, which needs no child process."""
    return _world(path, check_mjcf(path, stream.read()))


class Mjcf(NamedTuple):
    """A static, bounded MJCF file."""

    text: str
    meshes: dict[str, Path]
    """The mesh files by the names that it gives them; all lie in its folder or below."""


def check_mjcf(path: Path, data: bytes) -> Mjcf:
    """The text of a static, bounded MJCF file and what it refers to; ``FileError`` for anything else."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: have bytes that are not UTF-8 text, want MJCF; write it again") from error
    try:
        scan = _Scan(path)
        scan.run(data)
    except expat.ExpatError as error:
        raise FileError(f"{path}: have no well-formed XML ({error}), want MJCF; correct it") from error
    meshes = {name: path.parent / name for name in scan.meshes}
    if sum(file_size(file) for file in meshes.values()) > _MAX_MESH_BYTES:
        raise FileError(f"{path}: its meshes have more than {_MAX_MESH_BYTES} bytes, want at most that; simplify them")
    return Mjcf(text, meshes)


class _Scan:
    """One pass over the elements, without building a tree."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.depth = 0
        self.count = 0
        self.meshes: list[str] = []

    def run(self, data: bytes) -> None:
        """Go through the text; ``FileError`` at the first thing that is not let through."""
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.StartDoctypeDeclHandler = self._doctype
        parser.Parse(data, True)

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self.depth += 1
        self.count += 1
        if self.count == 1 and tag != "mujoco":
            self._refuse(f"have the XML element <{tag}>", "<mujoco> as the outermost element")
        if tag not in ELEMENTS:
            self._refuse(
                f"have the element <{tag}>", "a static scene of boxes, cylinders, spheres, capsules and planes"
            )
        if self.depth > MAX_DEPTH or self.count > MAX_ELEMENTS:
            self._refuse("too large or nested too deeply", f"at most {MAX_ELEMENTS} elements on {MAX_DEPTH} levels")
        for name, value in attributes.items():
            self._check_attribute(tag, name, value)

    def _check_attribute(self, tag: str, name: str, value: str) -> None:
        if name in _REFUSED_ATTRIBUTES:
            self._refuse(
                f"<{tag}> has the attribute {name!r}",
                "primitives, and meshes named by their path from the file's folder",
            )
        if name == "file":
            self._check_file(tag, value)
        if (tag, name) in _COUNTS:
            digits = value.strip()
            if not (digits.isascii() and digits.isdigit() and len(digits) < 10 and int(digits) <= _MAX_COUNT):
                self._refuse(f"<{tag} {name}={value[:20]!r}>", f"a whole number <= {_MAX_COUNT}")

    def _check_file(self, tag: str, value: str) -> None:
        """Mesh files only, in the file's own folder or below it, links resolved."""
        folder = self.path.parent.resolve()
        target = (folder / value).resolve()
        if tag != "mesh" or target.suffix.lower() not in MESH_ENDINGS or len(self.meshes) >= MAX_MESHES:
            self._refuse(
                f"<{tag}> has file={value[:40]!r}", f"at most {MAX_MESHES} .stl or .obj files of <mesh> elements"
            )
        if Path(value).is_absolute() or not target.is_relative_to(folder):
            self._refuse(f"<{tag}> has file={value[:40]!r}", "files in the folder of the MJCF file")
        self.meshes.append(value)

    def _end(self, tag: str) -> None:
        self.depth -= 1

    def _doctype(self, *declaration: object) -> None:
        self._refuse("have a document type or entity declaration", "plain MJCF")

    def _refuse(self, have: str, want: str) -> NoReturn:
        raise FileError(f"{self.path}: {have}, want {want}; remove it")


def _world(path: Path, scene: Mjcf) -> World:
    """What MuJoCo makes of a scene, as a world."""
    assets = {name: file.read_bytes() for name, file in scene.meshes.items()}
    try:
        model = mujoco.MjModel.from_xml_string(scene.text, assets)
    except ValueError as error:
        raise FileError(f"{path}: MuJoCo refuses it ({' '.join(str(error).split())[:200]}); correct it") from error
    state = mujoco.MjData(model)
    mujoco.mj_kinematics(model, state)
    if not (
        np.isfinite(state.geom_xpos).all() and np.isfinite(model.geom_size).all() and np.isfinite(state.site_xpos).all()
    ):
        raise FileError(f"{path}: a position or size is NaN or infinite, want finite metres; correct it")
    try:
        return World(
            name=path.stem,
            bounds=_room(path, model, state),
            obstacles=_obstacles(path, model, state),
            keep_in=np.float64(_keep_in(model)),
            start=_start(model, state),
            provenance=f"{path} (MJCF)",
        )
    except InputError as error:
        raise FileError(f"{path}: {error}; correct the file") from error


def _room(path: Path, model: mujoco.MjModel, state: mujoco.MjData) -> Float[np.ndarray, "2 3"]:
    """The room's lower and upper corner [m], from the site "room"."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "room")
    aligned = site >= 0 and np.allclose(state.site_xmat[site], np.eye(3).reshape(-1), atol=1e-9)
    if not aligned or model.site_type[site] != mujoco.mjtGeom.mjGEOM_BOX:
        raise FileError(
            f"{path}: the room's faces are missing, want an axis-aligned box site: "
            '<site name="room" type="box" pos="X Y Z" size="HALF_X HALF_Y HALF_Z"/> in <worldbody>; add it'
        )
    return np.stack([state.site_xpos[site] - model.site_size[site], state.site_xpos[site] + model.site_size[site]])


def _start(model: mujoco.MjModel, state: mujoco.MjData) -> Float[np.ndarray, "3"] | None:
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "start")
    return None if site < 0 else np.array(state.site_xpos[site])


def _keep_in(model: mujoco.MjModel) -> float:
    numeric = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, "keep_in")
    return DEFAULT_KEEP_IN if numeric < 0 else float(model.numeric_data[model.numeric_adr[numeric]])


def _obstacles(path: Path, model: mujoco.MjModel, state: mujoco.MjData) -> Obstacles:
    """All geoms that collide, as records."""
    kinds = mujoco.mjtGeom
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    known = [kinds.mjGEOM_BOX, kinds.mjGEOM_CYLINDER, kinds.mjGEOM_SPHERE, kinds.mjGEOM_CAPSULE, kinds.mjGEOM_PLANE]
    unknown = solid & ~np.isin(model.geom_type, [int(kind) for kind in (*known, kinds.mjGEOM_MESH)])
    if unknown.any():
        index = int(np.flatnonzero(unknown)[0])
        kind = kinds(int(model.geom_type[index])).name.removeprefix("mjGEOM_").lower()
        raise FileError(
            f"{path}: geom {model.geom(index).name or index!r} is of type {kind}, "
            "want box, cylinder, sphere, capsule, plane or mesh; replace it"
        )
    rotation = state.geom_xmat.reshape(-1, 3, 3)
    chosen = [np.flatnonzero(solid & (model.geom_type == int(kind))) for kind in known]
    position, size, axis = state.geom_xpos, model.geom_size, rotation[:, :, 2]
    box, cylinder, sphere, capsule, plane = chosen
    return make_obstacles(
        boxes=Boxes(center=position[box], half=size[box], rotation=rotation[box]),
        cylinders=Cylinders(
            center=position[cylinder], axis=axis[cylinder], radius=size[cylinder, 0], half_length=size[cylinder, 1]
        ),
        spheres=Spheres(center=position[sphere], radius=size[sphere, 0]),
        capsules=Capsules(
            center=position[capsule], axis=axis[capsule], radius=size[capsule, 0], half_length=size[capsule, 1]
        ),
        planes=Planes(normal=axis[plane], offset=np.sum(axis[plane] * position[plane], axis=1)),
        mesh=_meshes(path, model, state, np.flatnonzero(solid & (model.geom_type == int(kinds.mjGEOM_MESH)))),
    )


def _meshes(path: Path, model: mujoco.MjModel, state: mujoco.MjData, geoms: Int[np.ndarray, "g"]) -> Mesh | None:
    """The surfaces of all mesh geoms as one; MuJoCo itself collides with their convex hulls."""
    vertices, faces, count = [], [], 0
    for geom in geoms:
        mesh = model.mesh(int(model.geom_dataid[geom]))
        first, number = int(mesh.vertadr[0]), int(mesh.vertnum[0])
        own = model.mesh_vert[first : first + number].astype(np.float64)
        vertices.append(own @ state.geom_xmat[geom].reshape(3, 3).T + state.geom_xpos[geom])
        start = int(mesh.faceadr[0])
        faces.append(model.mesh_face[start : start + int(mesh.facenum[0])].astype(np.int64) + count)
        count += number
    if not vertices:
        return None
    check_mesh(path, np.concatenate(vertices), np.concatenate(faces))
    return mesh_with_distances(np.concatenate(vertices), np.concatenate(faces))
