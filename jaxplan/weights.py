"""Trained arrays as one file, and whether they are what they state.

An ``.npz`` of plain arrays with a JSON header: format, kind, and what the kind adds (sizes, golden outputs, a model
card, the vehicle that they are for). Behind it stands the SHA-256 of all that precedes, so that no bit changes unseen;
``numpy.load`` reads the file all the same. A file that is damaged, of another version or of another kind is refused by
name. ``jaxplan.prediction.target_model`` has a container of its own (docs/decisions/0017-files-of-what-was-learned.md).
"""

import hashlib
import io
import json
import os
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxplan.errors import FileError
from jaxplan.files import LARGEST_ARCHIVE, cannot_write, read_arrays, read_limited, write_atomically
from jaxplan.names import require_weights
from jaxplan.validation import require_path

FORMAT = 3
Arrays = dict[str, np.ndarray]


def write_weights(path: Path, kind: str, header: dict[str, Any], tree: Any) -> None:
    """Write a tree of arrays (as float32) with its header, whole or not at all; the same content has the same bytes.

    Raises:
        ResourceError: the disk refuses.
    """
    arrays = flatten(tree)
    stated = {"format": FORMAT, "kind": kind, **header}
    packed = io.BytesIO()
    np.savez(packed, allow_pickle=False, header=np.frombuffer(json.dumps(stated).encode(), np.uint8), **arrays)
    try:
        write_atomically(path, signed(packed.getvalue()))
    except OSError as error:
        raise cannot_write(path, error) from error


def signed(content: bytes) -> bytes:
    """``content`` with its hash behind it."""
    return content + hashlib.sha256(content).digest()


def read_weights(path: Path, kind: str) -> tuple[dict[str, Any], Arrays]:
    """Header and arrays of a file of this ``kind``.

    Raises:
        FileError: not there, too large, damaged, of another format or kind, or of another hash than the file states.
    """
    content = read_limited(path, LARGEST_ARCHIVE, f"a {kind}, written by jaxplan train")
    try:
        arrays = read_arrays(content)
        header = json.loads(arrays.pop("header").tobytes())
        version, found = header["format"], header["kind"]
    except Exception as error:  # zip, JSON, key, ... : a damaged file can fail anywhere
        raise FileError(f"{path}: cannot be read as a {kind}; the file is damaged or something else") from error
    if version != FORMAT:
        raise FileError(f"{path}: has format {version}, want {FORMAT}; use weights made for this version of jaxplan")
    if found != kind:
        raise FileError(f"{path}: holds a {found}, want a {kind}; correct the name")
    if signed(content[: -hashlib.sha256().digest_size]) != content:
        raise FileError(f"{path}: does not have the hash that it states; the file is damaged")
    return header, arrays


def resolve_weights(source: str | Path, folder: Path, kind: str) -> tuple[Path, str]:
    """File and name of weights: those shipped in ``folder`` by name, or a file."""
    require_path(kind, source)
    shipped = folder / f"{source}.npz"
    if os.path.isfile(shipped):
        return shipped, str(source)
    require_weights(source, kind, folder)
    path = Path(source)
    return path, path.stem


def flatten(tree: Any) -> Arrays:
    """Leaves by their path, as float32."""
    return {name: np.asarray(leaf, np.float32) for name, leaf in _by_path(tree).items()}


def unflatten(arrays: Arrays) -> dict[str, Any]:
    """A tree of dictionaries with these leaves."""
    tree: dict[str, Any] = {}
    for name, array in arrays.items():
        *folders, last = name.split("/")
        place = tree
        for folder in folders:
            place = place.setdefault(folder, {})
        place[last] = array
    return tree


def restore(template: Any, arrays: Arrays) -> Any:
    """``template``, of arrays or shapes, with the arrays of the same path; FileError where they do not fit."""
    wanted = _by_path(template)
    if {name: leaf.shape for name, leaf in wanted.items()} != {name: leaf.shape for name, leaf in arrays.items()}:
        raise FileError("the weights do not fit their network; the file is damaged")
    return jax.tree.unflatten(jax.tree.structure(template), [arrays[name] for name in wanted])


def _by_path(tree: Any) -> dict[str, Any]:
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="/"): leaf for path, leaf in leaves}
