"""Roadmaps on disk, so that a world is prepared once and not by every process (host).

A file's name is the hash of all that a roadmap depends on: what is solid in the world and where its room ends, the
resolution, the limits and the code that makes roadmaps. So a file is never out of date, and one that is damaged or
cannot be written costs time only. The folder holds the files used last, up to ``KEPT`` bytes.
"""

import hashlib
import os
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from jaxplan.files import cache_root, write_atomically
from jaxplan.search.kernels.compiled import source_digest
from jaxplan.search.kernels.roads import Roads
from jaxplan.search.kernels.sight import Field
from jaxplan.search.roadmap import Level, Roadmap, build_roadmap, corners_of, field_of
from jaxplan.world.obstacles import World

KEPT = 512 * 2**20
"""Bytes of all files together (arbitrary: some hundred rooms)."""


def load_roadmap(world: World, resolution: float, limits: tuple[float, ...]) -> Roadmap:
    """``build_roadmap``, or the same from disk where any process has built it before."""
    folder = cache_folder()
    if folder is None:
        return build_roadmap(world, resolution, limits)
    empty = field_of(world, resolution)
    path = folder / f"{_key(world, empty, limits)}.npz"
    roadmap = _read(path, world, empty, limits)
    if roadmap is None:
        roadmap = build_roadmap(world, resolution, limits)
        _write(path, roadmap)
    return roadmap


def cache_folder() -> Path | None:
    """Where roadmaps are stored; None where nothing is."""
    root = cache_root()
    return None if root is None else root / "roadmaps"


def _key(world: World, empty: Field, limits: tuple[float, ...]) -> str:
    """Hash of all that a roadmap depends on."""
    digest = hashlib.blake2b(digest_size=20)
    digest.update(_code_digest().encode())
    digest.update(repr((empty.frame, empty.shortfall, limits, corners_of(world).tolist())).encode())
    for part in empty.solids:
        array = np.asarray(part)
        digest.update(repr((array.shape, array.dtype.str)).encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _code_digest() -> str:
    """Hash of the code that makes roadmaps."""
    here = Path(__file__).parent
    sources = b"\0".join((here / name).read_bytes() for name in ("roadmap.py", "components.py", "store.py"))
    return source_digest() + hashlib.sha256(sources).hexdigest()


def _read(path: Path, world: World, empty: Field, limits: tuple[float, ...]) -> Roadmap | None:
    """A stored roadmap; None where there is none that can be read."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            values, levels = stored["values"], tuple(_levels(stored, limits))
        os.utime(path)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    return Roadmap(empty._replace(values=values), corners_of(world), levels)


def _levels(stored: "np.lib.npyio.NpzFile", limits: tuple[float, ...]) -> Iterator[Level]:
    """The levels of a stored roadmap."""
    for number, limit in enumerate(limits):
        roads = Roads(*(stored[f"{number}_{name}"] for name in Roads._fields))
        tiles, components = stored[f"{number}_tiles"], stored[f"{number}_components"]
        yield Level(limit, roads, len(roads.points) - int(tiles.sum()), tiles, components)


def _write(path: Path, roadmap: Roadmap) -> None:
    """Store a roadmap, as far as the disk allows, and forget the oldest ones."""
    arrays = {"values": roadmap.field.values}
    for number, level in enumerate(roadmap.levels):
        arrays |= {f"{number}_{name}": array for name, array in level.roads._asdict().items()}
        arrays |= {f"{number}_tiles": level.tiles, f"{number}_components": level.components}

    def save(staged: Path) -> None:
        with staged.open("wb") as stream:
            np.savez(stream, allow_pickle=False, **arrays)

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, save)
        _forget_oldest(path.parent)
    except OSError:
        return


def _forget_oldest(folder: Path) -> None:
    """Remove the files that were not used for longest, until the others fit."""
    files = sorted(((file.stat(), file) for file in folder.glob("*.npz")), key=lambda one: -one[0].st_mtime)
    total = 0
    for state, file in files:
        total += state.st_size
        if total > KEPT:
            file.unlink(missing_ok=True)
