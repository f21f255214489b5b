"""An output folder whose files appear whole or not at all.

Files are written under a hidden staging folder inside the output folder (the same file system, so that a
rename is atomic), flushed to the disk, and renamed into place one by one when the run is complete. A run
that fails leaves the files of an earlier run untouched.

The last file vouches for the others: it goes before any of them is replaced and comes when all are there, so that a run
that is killed in between leaves no mixture that looks whole. One run at a time has a folder; what one that was killed
has left in it the next one removes.
"""

import fcntl
import os
import shutil
import tempfile
from pathlib import Path
from types import TracebackType

from jaxplan.errors import ResourceError
from jaxplan.files import Writer, cannot_write, create_folder, flush, remove_folders, write_through

_STAGING = ".partial-"


class OutputFolder:
    """A context manager: ``write`` stages files, ``publish`` puts them in place, leaving without it drops them.

    Building one creates the folder and proves that it can be written, before any work is done; raises
    ``ResourceError`` where it cannot, and where another run has it.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._created = create_folder(self.path)
        self._lock = _locked(self.path)
        try:
            for stale in self.path.glob(f"{_STAGING}*"):
                shutil.rmtree(stale, ignore_errors=True)
            self._staging = Path(tempfile.mkdtemp(prefix=_STAGING, dir=self.path))
        except OSError as error:
            os.close(self._lock)
            remove_folders(self._created)
            raise cannot_write(self.path, error) from error
        self._names: list[str] = []

    def __enter__(self) -> "OutputFolder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._clean_up()

    def write(self, name: str, content: str | bytes | Writer) -> None:
        """Stage the file ``name``: text, bytes, or what writes it. Raises ``ResourceError`` where the disk refuses."""
        if Path(name).name != name or name.startswith("."):
            raise ValueError(f"an output file needs a plain name, have {name!r}")
        try:
            write_through(self._staging / name, content)
        except OSError as error:
            raise cannot_write(self.path / name, error) from error
        if name not in self._names:
            self._names.append(name)

    def publish(self) -> None:
        """Rename the staged files into place, in the order they were written first; the old last one goes before."""
        try:
            if len(self._names) > 1:
                (self.path / self._names[-1]).unlink(missing_ok=True)
                flush(self.path)
            for name in self._names:
                os.replace(self._staging / name, self.path / name)
            flush(self.path)
        except OSError as error:
            raise cannot_write(self.path, error) from error
        self._names.clear()
        self._created.clear()

    def _clean_up(self) -> None:
        shutil.rmtree(self._staging, ignore_errors=True)
        os.close(self._lock)
        remove_folders(self._created)


def _locked(folder: Path) -> int:
    """The folder, open, and no one else's until it is closed or the process ends, however it ends."""
    try:
        lock = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise cannot_write(folder, error) from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(lock)
        raise ResourceError(
            f"cannot write {str(folder)!r}: another run is writing there; choose another --out"
        ) from error
    except OSError:  # a file system without locks
        return lock
    return lock
