"""The kernel's record of a process's largest resident size (Linux)."""

import ctypes
from pathlib import Path

M_MMAP_THRESHOLD = -3
LARGE = 2**17
"""Bytes from which on a block of memory has pages of its own, glibc's first value."""


def start_peak_memory() -> int:
    """Start the record anew; the size now [bytes].

    From now on large blocks come and go with their pages. Else they take what is free between others, whose pages may
    have been given back, and an array that grows from one such place to the next would count several times.
    """
    ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, LARGE)
    Path("/proc/self/clear_refs").write_text("5")
    return peak_memory()


def peak_memory() -> int:
    """The largest size of this process since the record began [bytes]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
