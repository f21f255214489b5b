"""What was traced and compiled, kept on disk for the next start; not where a user says ``jaxplan cache off``.

JAX's persistent compilation cache does the work: the name of an entry is the hash of the whole program and of how it is
compiled, so other code, another world or other weights never get a program that is not theirs. Around it:

* every kind of machine and every version has a folder of its own (``folder_name``): a program of another processor may
  do what this one cannot;
* every entry has its SHA-256 beside it, written after a warm-up and when the process that compiled it ends. What has
  none, or another one, is removed before JAX can see it, and compiled anew;
* what was traced is beside it, with its sum inside (``jaxplan.kept``);
* XLA's warnings about tuning flags, pages of them at every start, are silenced where JAX is not yet imported.

Nothing here imports JAX.
"""

import atexit
import contextlib
import hashlib
import os
import platform
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from jaxplan.errors import InputError
from jaxplan.files import FOLDER_VARIABLE, cache_root, cannot_write, write_atomically
from jaxplan.versions import installed_versions

KEPT = 512 * 2**20
"""Bytes of one folder's entries (arbitrary: some twenty configurations)."""
_ENTRY, _SUM = "-cache", ".sha256"
_TRACED = "-traced"
_SETTINGS = {
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
}
"""Everything is kept: the hundred small programs take a second together."""


class Status(NamedTuple):
    """What is kept."""

    on: bool
    folder: Path
    """Of this machine and version."""
    programs: int
    """That were compiled."""
    size: int
    """Bytes, with what was traced."""
    others: int
    """Folders of other machines or versions, which are not used."""


def status() -> Status:
    """Whether programs are kept, and how many are; ``InputError`` where nothing may be kept at all."""
    root = _root()
    folder = root / folder_name()
    everything = [*_entries(folder), *_traced(folder)]
    others = [path for path in root.glob("*") if path.is_dir() and path != folder]
    size = sum(path.stat().st_size for path in everything)
    return Status(not _marker(root).is_file(), folder, len(list(_entries(folder))), size, len(others))


def switch(on: bool) -> None:
    """Keep programs from now on, or no longer; those that are there stay. Raises ``ResourceError``, ``InputError``."""
    marker = _marker(_root())
    try:
        if on:
            marker.unlink(missing_ok=True)
        else:
            marker.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(marker, "")
    except OSError as error:
        raise cannot_write(marker, error) from error


def clear() -> None:
    """Remove all programs, those of other machines and versions too. Raises ``ResourceError``, ``InputError``."""
    for path in _root().glob("*"):
        if path.is_dir():
            try:
                shutil.rmtree(path)
            except OSError as error:
                raise cannot_write(path, error) from error


def use() -> str | None:
    """Load programs that are kept and keep new ones, in this process and its children, unless that is switched off.

    To be called before JAX compiles anything; before JAX is imported, where XLA's warnings are to be silenced. Whoever
    has set JAX_COMPILATION_CACHE_DIR keeps that.

    Returns:
        One line about what was wrong with what is kept, if anything was; then it is not used.
    """
    root = cache_root()
    if root is None or _marker(root / "programs").is_file() or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return None
    folder = root / "programs" / folder_name()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        removed = _remove_unsound(folder)
    except OSError as error:
        return (
            f"cache: {folder} cannot be used ({error.strerror}), everything is compiled; name another folder in "
            f"{FOLDER_VARIABLE}, or leave it empty"
        )
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
    os.environ.update({name: value for name, value in _SETTINGS.items() if name not in os.environ})
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    if "jax" in sys.modules:
        import jax

        for name in ("JAX_COMPILATION_CACHE_DIR", *_SETTINGS):
            value = os.environ[name]
            jax.config.update(name.lower(), value if name.endswith("DIR") else int(value))
    atexit.register(seal, folder)
    return f"cache: {removed} damaged entries removed from {folder}" if removed else None


def vouch() -> None:
    """Write the sums of what was compiled so far now, not only when this process ends: another one may start before."""
    folder = folder_in_use()
    if folder is not None:
        seal(folder)


def folder_in_use() -> Path | None:
    """Where this process keeps programs; None where it does not."""
    root, used = cache_root(), os.environ.get("JAX_COMPILATION_CACHE_DIR")
    folder = None if root is None else root / "programs" / folder_name()
    return folder if used is not None and used == str(folder) else None


def read_traced(folder: Path, key: str) -> bytes | None:
    """What was kept under this key; None where there is nothing whole."""
    try:
        return _without_sum((folder / f"{key}{_TRACED}").read_bytes())
    except OSError:
        return None


def write_traced(folder: Path, key: str, content: bytes) -> None:
    """Keep something under a key, as far as the disk allows."""
    with contextlib.suppress(OSError):
        write_atomically(folder / f"{key}{_TRACED}", hashlib.sha256(content).digest() + content)


def seal(folder: Path) -> None:
    """Write the sums of entries that are whole and have none, and forget the oldest ones beyond ``KEPT``."""
    from jax._src.compilation_cache import decompress_executable

    with contextlib.suppress(OSError):
        for entry in _entries(folder):
            if not _sum_of(entry).is_file():
                content = entry.read_bytes()
                with contextlib.suppress(Exception):  # whatever a damaged archive raises: no sum, so it is not used
                    decompress_executable(content)
                    write_atomically(_sum_of(entry), hashlib.sha256(content).hexdigest())
        total = 0
        for entry in sorted([*_entries(folder), *_traced(folder)], key=lambda path: -path.stat().st_mtime):
            total += entry.stat().st_size
            if total > KEPT:
                _remove(entry)


def folder_name() -> str:
    """Of what this machine, these versions and these flags compile."""
    versions = installed_versions()
    parts = [*(versions[name] for name in ("jaxplan", "jax", "jaxlib")), _processor(), os.environ.get("XLA_FLAGS", "")]
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:20]


def _processor() -> str:
    """Name and features of the processor; of the first one where there are several."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").split("\n\n")[0].splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    names = ("model name", "flags", "Features", "CPU implementer", "CPU part")
    return "\n".join([platform.machine(), *(line for line in lines if line.startswith(names))])


def _root() -> Path:
    root = cache_root()
    if root is None:
        raise InputError(f"cache: {FOLDER_VARIABLE} is empty, so nothing may be kept; unset it or name a folder")
    return root / "programs"


def _marker(root: Path) -> Path:
    return root / "off"


def _entries(folder: Path) -> Iterator[Path]:
    return folder.glob(f"*{_ENTRY}")


def _traced(folder: Path) -> Iterator[Path]:
    return folder.glob(f"*{_TRACED}")


def _sum_of(entry: Path) -> Path:
    return entry.with_name(entry.name + _SUM)


def _remove(entry: Path) -> None:
    entry.unlink(missing_ok=True)
    _sum_of(entry).unlink(missing_ok=True)


def _remove_unsound(folder: Path) -> int:
    """Remove what no sum vouches for; how much of it has another sum, and is not just of a process that still runs."""
    damaged = 0
    for entry in _entries(folder):
        stated = _sum_of(entry)
        known = stated.read_text(errors="replace") if stated.is_file() else None
        if known != hashlib.sha256(entry.read_bytes()).hexdigest():
            _remove(entry)
            damaged += known is not None
    for path in _traced(folder):
        if _without_sum(path.read_bytes()) is None:
            path.unlink(missing_ok=True)
            damaged += 1
    return damaged


def _without_sum(content: bytes) -> bytes | None:
    """What follows its own SHA-256; None where it is not that."""
    size = hashlib.sha256().digest_size
    return content[size:] if hashlib.sha256(content[size:]).digest() == content[:size] else None
