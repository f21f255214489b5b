"""A flight that tests write into logs, and what they expect of readers."""

import contextlib
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from jaxplan.errors import FileError
from jaxplan.io.target_log import read_target_log

TIMES = 12.5 + 0.05 * np.arange(200)
NED = np.column_stack([np.sin(TIMES), 0.5 * TIMES, -1.0 - 0.1 * np.cos(TIMES)])
ENU = NED[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
"""The same with z up."""


@contextlib.contextmanager
def memory_below(most: float) -> Iterator[None]:
    """Bytes of Python's own."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


def read_or_refused(path: Path) -> None:
    """No other error than ours."""
    with contextlib.suppress(FileError):
        read_target_log(path)
