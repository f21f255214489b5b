"""Files beyond the limit of their kind cost no memory."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from oracles.fresh_reader import Read, fresh_reader
from oracles.peak_memory import peak_memory, start_peak_memory

ENDINGS = (".xml", ".json", ".bt", ".stl", ".obj", ".ply", ".pcd", ".npy", ".npz")


def beyond_the_limit(path: Path) -> Path:
    with path.open("wb") as stream:
        stream.truncate(2**40)  # a file without blocks
    return path


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Read]:
    """Reads in a process where nothing else runs, and that has refused a file of every kind before."""
    folder = tmp_path_factory.mktemp("before")
    with fresh_reader() as ask:
        for ending in ENDINGS:
            ask(beyond_the_limit(folder / f"map{ending}"))
        yield ask


def test_the_record_of_the_peak_sees_what_was_freed() -> None:
    before = start_peak_memory()
    np.ones(10**7)
    assert peak_memory() - before > 70 * 10**6


@pytest.mark.parametrize("ending", ENDINGS)
def test_files_beyond_the_limit_are_refused_unread(read: Read, tmp_path: Path, ending: str) -> None:
    said, grown = read(beyond_the_limit(tmp_path / f"large{ending}"))
    assert said is not None
    assert "bytes" in said
    assert grown <= 2**20
