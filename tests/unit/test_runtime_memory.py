"""What is set aside before a flight is not looked through again."""

import gc
import platform
import subprocess
import sys

import pytest

from jaxplan.runtime import settle


def test_what_was_there_is_set_aside_and_what_comes_later_is_still_collected():
    kept = [[number] for number in range(1000)]
    before = len(gc.get_objects())
    settle()
    try:
        assert gc.get_freeze_count() >= 1000
        assert len(gc.get_objects()) < before / 10
        later: list[object] = []
        later.append(later)
        del later
        assert gc.collect() >= 1
    finally:
        gc.unfreeze()
    assert kept[999] == [999]


FAULTS = """
import resource
import numpy as np
from jaxplan.runtime import settle
settle()
def faults():
    np.ones(1_000_000)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
first, *later = (faults() for _ in range(6))
print(max(np.diff([first, *later])))
"""


@pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc", reason="glibc keeps what is freed; other libraries do as they do"
)
def test_what_is_freed_afterwards_is_used_again() -> None:
    """Pages of an array that has gone: 1,954 of them would be fetched anew each time."""
    answer = subprocess.run([sys.executable, "-c", FAULTS], check=True, stdout=subprocess.PIPE, text=True)
    assert int(answer.stdout) < 200
