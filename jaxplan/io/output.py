"""An output folder whose files appear whole or not at all.

Files are written under a hidden staging folder inside the output folder (the same file system, so that a
rename is atomic), flushed to the disk, and renamed into place one by one when the run is complete. A run
that fails leaves the files of an earlier run untouched.
"""

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from jaxplan.errors import ResourceError


class OutputFolder:
    """A context manager: ``write`` stages files, ``publish`` puts them in place, leaving without it drops them.

    Building one creates the folder and proves that it can be written, before any work is done; raises
    ``ResourceError`` where it cannot.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._created: list[Path] = []
        try:
            self._create_folders()
            self._staging = Path(tempfile.mkdtemp(prefix=".partial-", dir=self.path))
            _write_through(self._staging / "probe", b"probe")
            (self._staging / "probe").unlink()
        except OSError as error:
            self._clean_up()
            raise _refusal(self.path, error) from error
        self._names: list[str] = []

    def __enter__(self) -> "OutputFolder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._clean_up()

    def write(self, name: str, writer: Callable[[Path], None]) -> None:
        """Stage the file ``name`` by calling ``writer`` with the path to write to.

        The path keeps the ending of ``name``. Raises ``ResourceError`` where the disk refuses.
        """
        if Path(name).name != name or name.startswith("."):
            raise ValueError(f"an output file needs a plain name, have {name!r}")
        staged = self._staging / name
        try:
            writer(staged)
            _flush(staged)
        except OSError as error:
            raise _refusal(self.path / name, error) from error
        if name not in self._names:
            self._names.append(name)

    def publish(self) -> None:
        """Rename the staged files into place, in the order they were written first."""
        try:
            for name in self._names:
                os.replace(self._staging / name, self.path / name)
            _flush(self.path)
        except OSError as error:
            raise _refusal(self.path, error) from error
        self._names.clear()
        self._created.clear()

    def _create_folders(self) -> None:
        missing = [folder for folder in (self.path, *self.path.parents) if not folder.exists()]
        for folder in reversed(missing):
            folder.mkdir(exist_ok=True)
            self._created.append(folder)

    def _clean_up(self) -> None:
        staging = getattr(self, "_staging", None)
        if staging is not None:
            shutil.rmtree(staging, ignore_errors=True)
        for folder in reversed(self._created):
            try:
                folder.rmdir()
            except OSError:
                return


def _write_through(path: Path, content: bytes) -> None:
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _flush(path: Path) -> None:
    """Force a file or a folder to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _refusal(path: Path, error: OSError) -> ResourceError:
    reason = error.strerror or type(error).__name__
    return ResourceError(f"cannot write {str(path)!r}: {reason}; choose another --out or free the disk")
