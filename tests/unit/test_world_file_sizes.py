"""Files beyond the limit of their kind cost no memory."""

from pathlib import Path

import numpy as np
import pytest

from jaxplan.errors import FileError
from jaxplan.world.load import load_world
from oracles.peak_memory import peak_memory, start_peak_memory


def test_the_record_of_the_peak_sees_what_was_freed() -> None:
    before = start_peak_memory()
    np.ones(10**7)
    assert peak_memory() - before > 70 * 10**6


@pytest.mark.parametrize("ending", [".xml", ".json", ".bt", ".stl", ".obj", ".ply", ".pcd", ".npy", ".npz"])
def test_files_beyond_the_limit_are_refused_unread(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"large{ending}"
    with path.open("wb") as stream:
        stream.truncate(2**40)  # a file without blocks
    before = start_peak_memory()
    with pytest.raises(FileError, match="bytes"):
        load_world(path)
    assert peak_memory() - before <= 2**20
