"""Maps read in a process of its own, whose memory nothing else has used: what a reader takes there is what it needs."""

import multiprocessing
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Protocol

from oracles.peak_memory import peak_memory, start_peak_memory

PATIENCE = 120.0
"""s."""


class Read(Protocol):
    """Asks the process."""

    def __call__(self, path: Path) -> tuple[str | None, int]:
        """What the file was refused with, if it was, and by how much the process grew at most [bytes]."""


def _serve(asked: Connection) -> None:
    from jaxplan.errors import FileError
    from jaxplan.world.load import load_world

    while (path := asked.recv()) is not None:
        before, said = start_peak_memory(), None
        try:
            load_world(path)
        except FileError as error:
            said = str(error)
        asked.send((said, peak_memory() - before))


@contextmanager
def fresh_reader() -> Iterator[Read]:
    """The process, as long as the context lasts."""
    ours, theirs = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=_serve, args=(theirs,), daemon=True)
    process.start()

    def read(path: Path) -> tuple[str | None, int]:
        ours.send(path)
        assert ours.poll(PATIENCE), "no answer"
        said, grown = ours.recv()
        return said, grown

    yield read
    ours.send(None)
    process.join(PATIENCE)
