"""Files that are there whole or not at all, read no further than they should be, and folders of one configuration.

Everything that the library writes for keeps goes through here: results, shards, states of training, weights' cards.
"""

import io
import json
import os
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from jaxplan.errors import FileError, InputError, ResourceError

FOLDER_VARIABLE = "JAXPLAN_CACHE_DIR"
"""Environment variable that names the folder of what is kept to be faster next time; empty: nothing is kept."""
LARGEST_ARCHIVE = 64 * 2**20
"""Bytes; arrays of ours that are larger are none of ours."""


@runtime_checkable
class Writer(Protocol):
    """Writes one file."""

    def __call__(self, path: Path, /) -> object:
        """Write everything into the file ``path``, whose ending is that of the file wanted."""
        ...


def cache_root() -> Path | None:
    """Where what makes the next start faster is kept: JAXPLAN_CACHE_DIR, else ``jaxplan`` in the user's cache."""
    named = os.environ.get(FOLDER_VARIABLE)
    if named is not None:
        return Path(named) if named else None
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(base) / "jaxplan" if os.path.isabs(base) else None


def write_atomically(path: Path, content: str | bytes | Writer) -> None:
    """Write a file that is there whole or not at all, and on the disk when this returns.

    It is written beside its place, under a hidden name, and renamed. What was there before stays until then.

    Raises:
        OSError: the disk refuses.
    """
    staged = path.with_name(f".{os.getpid()}-{path.name}")
    try:
        write_through(staged, content)
        os.replace(staged, path)
        flush(path.parent)
    finally:
        staged.unlink(missing_ok=True)


def write_through(path: Path, content: str | bytes | Writer) -> None:
    """Write a file that is on the disk when this returns; text as UTF-8. Raises ``OSError`` where the disk refuses."""
    if isinstance(content, str):
        path.write_text(content, encoding="utf-8")
    elif isinstance(content, bytes):
        path.write_bytes(content)
    else:
        content(path)
    flush(path)


def read_limited(path: Path, limit: int, want: str) -> bytes:
    """The whole of a file of at most ``limit`` bytes; never reads more than that.

    Args:
        path: of the file.
        limit: bytes; a larger file is something else.
        want: what the file should be, for messages: "a target model, written by jaxplan train gmm".

    Raises:
        FileError: no such file, unreadable or larger.
    """
    if not os.path.isfile(path):
        raise FileError(f"{path}: no such file; want {want}")
    try:
        with path.open("rb") as stream:
            content = stream.read(min(limit, os.fstat(stream.fileno()).st_size) + 1)  # what is asked for is allocated
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror}); check its permissions") from error
    if len(content) > limit:
        raise FileError(f"{path}: has more than {limit} bytes; want {want}")
    return content


def read_arrays(content: bytes, most: int = LARGEST_ARCHIVE) -> dict[str, np.ndarray]:
    """The arrays of an ``.npz`` that says it holds at most ``most`` bytes; nothing is unpacked before that is known.

    Raises:
        ValueError: it says that it holds more, or is not an ``.npz`` of plain arrays; other errors where it is damaged.
    """
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        stated = sum(member.file_size for member in archive.infolist())
    if stated > most:
        raise ValueError(f"states {stated} bytes, want at most {most}")
    with np.load(io.BytesIO(content), allow_pickle=False) as data:
        return {key: data[key] for key in data.files}


def flush(path: Path) -> None:
    """Force a file, or the names of a folder's files, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def create_folder(folder: Path) -> list[Path]:
    """Create a folder with those above it, and prove that it can be written before any work is done.

    Returns:
        The folders that were not there, from the top down.

    Raises:
        ResourceError: it cannot be created or written; nothing new is left then.
    """
    created: list[Path] = []
    try:
        for missing in reversed([place for place in (folder, *folder.parents) if not os.path.exists(place)]):
            missing.mkdir(exist_ok=True)
            created.append(missing)
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(b"probe")
            probe.flush()
            os.fsync(probe.fileno())
    except OSError as error:
        remove_folders(created)
        raise cannot_write(folder, error) from error
    return created


def remove_folders(created: list[Path]) -> None:
    """Remove what ``create_folder`` created, as far as it is still empty."""
    for folder in reversed(created):
        try:
            folder.rmdir()
        except OSError:
            return


def state_configuration(folder: Path, statement: Mapping[str, Any], may_differ: tuple[str, ...] = ()) -> None:
    """Create a folder if need be, and state in its ``config.json`` which configuration it belongs to.

    Args:
        statement: plain values; tuples are stated as lists.
        may_differ: names of values that may be other ones than the folder states; the new ones are stated.

    Raises:
        InputError: the folder belongs to another configuration.
        FileError: its ``config.json`` cannot be read.
        ResourceError: the folder or the file cannot be written.
    """
    require_configuration(folder, statement, may_differ)
    create_folder(folder)
    stated, text = folder / "config.json", json.dumps(statement, indent=1) + "\n"
    try:
        if not os.path.isfile(stated) or stated.read_text(encoding="utf-8") != text:
            write_atomically(stated, text)
    except OSError as error:
        raise cannot_write(folder, error) from error


def require_configuration(folder: Path, statement: Mapping[str, Any], may_differ: tuple[str, ...] = ()) -> None:
    """Raise what ``state_configuration`` raises where ``folder`` belongs to another configuration; write nothing."""
    stated = folder / "config.json"
    if not os.path.exists(stated):
        return
    try:
        saved = dict(json.loads(stated.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError) as error:
        raise FileError(f"{stated}: cannot be read as a configuration ({error}); choose another folder") from error
    wanted = json.loads(json.dumps(statement))
    for name in may_differ:
        saved[name] = wanted.get(name)
    if saved != wanted:
        raise InputError(
            f"folder {str(folder)!r}: holds results of another configuration ({_differences(saved, wanted)}); "
            "choose another folder"
        )


def cannot_write(path: Path, error: OSError) -> ResourceError:
    """The error that says that and why the disk refuses."""
    reason = error.strerror or type(error).__name__
    return ResourceError(f"cannot write {str(path)!r}: {reason}; choose another --out or free the disk")


def _differences(saved: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """The values in which two configurations differ, those within values by their own names."""
    parts = []
    for name in {**saved, **wanted}:
        there, here = saved.get(name), wanted.get(name)
        if isinstance(there, dict) and isinstance(here, dict):
            parts.append(_differences(there, here))
        elif there != here:
            parts.append(f"{name} is {there!r} there and {here!r} here")
    return "; ".join(part for part in parts if part)
