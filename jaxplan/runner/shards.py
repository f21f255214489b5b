"""Shards and the folder that keeps them: each is one small file that appears whole as soon as it is finished.

A run that is killed loses nothing that was finished, and ``--resume`` evaluates only what is missing. The folder also
says what it belongs to (``config.json``), so that two experiments never mix.
"""

import fcntl
import json
import os
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NamedTuple

from jaxplan.errors import FileError, InputError, ResourceError
from jaxplan.files import cannot_write, create_folder, require_configuration, state_configuration, write_atomically
from jaxplan.io.files import plain
from jaxplan.runner.definition import Item, Row


class Shard(NamedTuple):
    """Consecutive items of one group."""

    number: int
    group: str
    items: tuple[Item, ...]


class Outcome(NamedTuple):
    """What became of an item."""

    row: Row | None
    """None where it failed."""
    error: str
    seconds: float
    compiled: bool = False
    """Whether anything was compiled meanwhile, so that ``seconds`` says little of the next item."""
    prepare_seconds: float = 0.0
    """What preparing its group took just before, 0 where that was done already."""


def cut(items: list[Item], size: int) -> list[Shard]:
    """Shards of up to ``size`` items, none of two groups."""
    shards: list[Shard] = []
    for item in items:
        last = shards[-1] if shards else None
        if last is None or last.group != item.group or len(last.items) == size:
            shards.append(Shard(len(shards), item.group, (item,)))
        else:
            shards[-1] = last._replace(items=(*last.items, item))
    return shards


class Store:
    """The shards of one run in ``folder``; a context manager that keeps other runs out meanwhile.

    Raises:
        InputError: the folder holds something else, or results although ``resume`` is False.
        ResourceError: it cannot be written, or another run is using it.
    """

    def __init__(self, folder: Path, name: str, preset: str, config: dict[str, Any], resume: bool) -> None:
        self.folder = Path(folder)
        statement = {"experiment": name, "preset": preset, "config": config}
        self._check(statement, resume)
        create_folder(self.folder / "shards")
        try:
            self._lock = _locked(self.folder)
        except OSError as error:
            raise cannot_write(self.folder, error) from error
        state_configuration(self.folder, statement, may_differ=("preset",))

    def __enter__(self) -> "Store":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lock.close()

    def write(self, shard: Shard, outcomes: dict[str, Outcome]) -> None:
        """Keep a finished shard. Raises ``ResourceError`` where the disk refuses; what was kept before stays valid."""
        rows = [{"item": item.name, **outcomes[item.name]._asdict()} for item in shard.items]
        try:
            write_atomically(
                self._path(shard), json.dumps(plain({"shard": shard.number, "rows": rows}), allow_nan=False) + "\n"
            )
        except OSError as error:
            raise _refusal(self.folder, error) from error

    def read(self, shard: Shard) -> dict[str, Outcome] | None:
        """The outcomes of a finished shard by item; None where it is not finished or an item failed last time."""
        path = self._path(shard)
        if not os.path.isfile(path):
            return None
        try:
            rows = json.loads(path.read_text(encoding="utf-8"))["rows"]
            found = {row.pop("item"): Outcome(**row) for row in rows}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise FileError(f"{path}: is damaged; delete it, and its shard is evaluated again") from error
        if list(found) != [item.name for item in shard.items]:
            raise FileError(f"{path}: holds other items than this configuration's; choose another --out")
        return found

    def unfinished(self, shards: list[Shard]) -> list[Shard]:
        """Shards without a file, or with an item that was quarantined: that one is tried again."""
        found = [(shard, self.read(shard)) for shard in shards]
        return [s for s, outcomes in found if outcomes is None or any(o.row is None for o in outcomes.values())]

    def note_run(self, origin: dict[str, Any]) -> None:
        """Keep where a run that is about to evaluate shards comes from; resumed folders have several."""
        try:
            write_atomically(self.folder / "shards" / "runs.json", json.dumps([*self.runs(), origin], indent=1) + "\n")
        except OSError as error:
            raise _refusal(self.folder, error) from error

    def runs(self) -> list[dict[str, Any]]:
        """Every run that evaluated shards of this folder."""
        path = self.folder / "shards" / "runs.json"
        return json.loads(path.read_text(encoding="utf-8")) if os.path.isfile(path) else []

    def _path(self, shard: Shard) -> Path:
        return self.folder / "shards" / f"{shard.number:06d}.json"

    def _check(self, statement: dict[str, Any], resume: bool) -> None:
        path = self.folder
        if os.path.exists(path) and not os.path.isdir(path):
            raise InputError(f"--out {str(path)!r}: is a file, want a folder; choose another --out")
        if not os.path.isdir(path) or not any(not entry.name.startswith(".") for entry in path.iterdir()):
            return
        if not (path / "config.json").is_file():
            raise InputError(f"--out {str(path)!r}: holds other files, want a folder of its own; choose another --out")
        require_configuration(path, statement, may_differ=("preset",))
        if not resume:
            raise InputError(f"--out {str(path)!r}: holds results already; go on with --resume or choose another --out")


def _locked(folder: Path) -> IO[str]:
    """The folder's lock, which the system releases however the process ends."""
    lock = (folder / ".lock").open("w")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        lock.close()
        raise ResourceError(f"--out {str(folder)!r}: another run is writing here; wait for it or stop it") from error
    return lock


def _refusal(folder: Path, error: OSError) -> ResourceError:
    reason = error.strerror or type(error).__name__
    return ResourceError(
        f"cannot write in {str(folder)!r}: {reason}; what is finished there stays valid: free the disk and go on with "
        "--resume, or choose another --out"
    )
