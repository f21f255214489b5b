"""Worlds from files: ``load_world`` and the reader of MJCF scenes.

An MJCF file is the single source of a world: simulation, occupancy, clearance and pictures read the same file. Besides
geoms it holds a box site "room" (the room's faces), optionally a site "start" and a custom numeric "keep_in" [m]. Geoms
with contype = conaffinity = 0 collide with nothing: they are decoration, and no obstacles.
"""

from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import IO

import mujoco
import numpy as np
from jaxtyping import Float

from jaxplan.errors import FileError, InputError
from jaxplan.mjcf_probe import probe_mjcf
from jaxplan.world.formats.box_json import load_box_json
from jaxplan.world.formats.mesh_files import load_obj, load_ply, load_stl
from jaxplan.world.formats.mjcf import check_mjcf
from jaxplan.world.formats.npz_grid import load_npz_grid
from jaxplan.world.formats.octomap import load_octomap
from jaxplan.world.formats.points import load_npy, load_pcd
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

__all__ = ["ENVIRONMENTS", "World", "environment_path", "load_world"]

ENVIRONMENTS = ("env1", "env2", "env3")
"""Names of the stored worlds."""

_MAX_BYTES = {".xml": 4 * 2**20, ".json": 2 * 2**20, ".bt": 16 * 2**20}
_MAX_BYTES |= dict.fromkeys((".stl", ".obj", ".ply", ".pcd", ".npy", ".npz"), 128 * 2**20)
"""Largest file per ending; arbitrary, far above any room. The first three are read at once: a few bytes of JSON become
an object of many."""
_MAX_MESH_BYTES = 16 * 2**20
"""Of all mesh files that an MJCF file names: MuJoCo wants them in memory at once."""


def load_world(name_or_path: str | Path) -> World:
    """The world of a stored name (``ENVIRONMENTS``) or of a file.

    Files, by their ending: MJCF (.xml), surface meshes (.stl, .obj, .ply), point clouds (.pcd, .npy, and .ply without
    faces), OctoMap's binary trees (.bt), occupancy grids (.npz), rotorpy's boxes (.json).

    World frame z up, metres. Raises ``InputError`` for an unknown name, ``FileError`` for a file that cannot be used.
    """
    if str(name_or_path) in ENVIRONMENTS:
        return _load_file(environment_path(str(name_or_path)))
    path = Path(name_or_path)
    if path.suffix.lower() not in _READERS:
        if path.exists():
            endings = ", ".join(_READERS)
            raise FileError(f"{path}: have the ending {path.suffix!r}, want one of {endings}; convert the map")
        raise InputError(
            f"world: have {str(name_or_path)!r}, want a stored world ({', '.join(ENVIRONMENTS)}) or a file ending in "
            f"{', '.join(_READERS)}; check the name"
        )
    return _load_file(path)


def environment_path(name: str) -> Path:
    """The MJCF file of a stored world."""
    if name not in ENVIRONMENTS:
        raise InputError(f"world: have {name!r}, want one of {', '.join(ENVIRONMENTS)}; check the name")
    return Path(str(resources.files("jaxplan.world").joinpath("environments", f"{name}.xml")))


def _load_file(path: Path) -> World:
    ending = path.suffix.lower()
    limit = _MAX_BYTES[ending]
    if _size(path) > limit:  # before any of it takes memory
        raise FileError(f"{path}: have more than {limit} bytes, want a map of at most that; simplify it")
    try:
        with path.open("rb") as stream:
            return _READERS[ending](path, stream)
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror}); check its permissions") from error


def _size(path: Path) -> int:
    """Bytes of a regular file."""
    if not path.is_file():
        have = "no such file" if not path.exists() else "something that is not a file"
        raise FileError(f"{path}: {have}, want a readable map; check the path")
    return path.stat().st_size


def _load_mjcf(path: Path, stream: IO[bytes]) -> World:
    """The world of an MJCF file."""
    scene = check_mjcf(path, stream.read())
    meshes = {name: path.parent / name for name in scene.meshes}
    if sum(_size(file) for file in meshes.values()) > _MAX_MESH_BYTES:
        raise FileError(f"{path}: its meshes have more than {_MAX_MESH_BYTES} bytes, want at most that; simplify them")
    if path.parent != environment_path(ENVIRONMENTS[0]).parent:
        probe_mjcf(path, scene.text, meshes)
    assets = {name: file.read_bytes() for name, file in meshes.items()}
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


def _meshes(path: Path, model: mujoco.MjModel, state: mujoco.MjData, geoms: np.ndarray) -> Mesh | None:
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


_READERS: dict[str, Callable[[Path, IO[bytes]], World]] = {
    ".xml": _load_mjcf,
    ".stl": load_stl,
    ".obj": load_obj,
    ".ply": load_ply,
    ".pcd": load_pcd,
    ".npy": load_npy,
    ".npz": load_npz_grid,
    ".bt": load_octomap,
    ".json": load_box_json,
}
"""Which reader takes a file, by its ending."""
