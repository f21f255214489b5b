"""An output folder whose files appear whole or not at all.

Files are written under a hidden staging folder inside the output folder (the same file system, so that a
rename is atomic), flushed to the disk, and renamed into place one by one when the run is complete. A run
that fails leaves the files of an earlier run untouched.
"""

import os
import shutil
import tempfile
from pathlib import Path
from types import TracebackType

from jaxplan.files import Writer, cannot_write, create_folder, flush, remove_folders, write_through


class OutputFolder:
    """A context manager: ``write`` stages files, ``publish`` puts them in place, leaving without it drops them.

    Building one creates the folder and proves that it can be written, before any work is done; raises
    ``ResourceError`` where it cannot.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._created = create_folder(self.path)
        try:
            self._staging = Path(tempfile.mkdtemp(prefix=".partial-", dir=self.path))
        except OSError as error:
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
        """Rename the staged files into place, in the order they were written first."""
        try:
            for name in self._names:
                os.replace(self._staging / name, self.path / name)
            flush(self.path)
        except OSError as error:
            raise cannot_write(self.path, error) from error
        self._names.clear()
        self._created.clear()

    def _clean_up(self) -> None:
        shutil.rmtree(self._staging, ignore_errors=True)
        remove_folders(self._created)
