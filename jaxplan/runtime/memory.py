"""Memory of a process that runs for hours: what compiling has left is given back, and what follows is kept small."""

import contextlib
import ctypes
import gc

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Of glibc's ``mallopt`` (``malloc.h``)."""
_KEPT = 256 << 20
"""Bytes that are free and not given back from then on (arbitrary)."""
_LARGEST = 32 << 20
"""Bytes of the largest arrays that are taken from them: glibc allows no more."""
_CURRENT_FUTURE_AND_ON_FAULT = 1 | 2 | 4
"""Of Linux's ``mlockall`` (``asm-generic/mman.h``)."""


def settle() -> None:
    """Before the flight: collect, set aside all that stays, give freed pages back, and keep those that are freed later.

    What is set aside is not looked through again, hundreds of thousands of objects of JAX: later collections take
    microseconds instead of a third of a second, in which a plan or a setpoint would be late. The planner's process does
    it after its warm-up; the process that asks for setpoints should, once it has imported and built what it needs.
    What is freed in flight stays with the process: arrays that change with the world are as large as it is, and fresh
    pages for them took as long as to copy them. And what is in memory stays there, the code of the libraries too, where
    the process may lock all of it (``CAP_IPC_LOCK``, or no ``ulimit -l``): a page that has to be read again takes
    milliseconds.
    """
    gc.collect()
    gc.freeze()
    with contextlib.suppress(AttributeError, OSError):  # another C library than glibc keeps the pages
        library = ctypes.CDLL(None)
        library.malloc_trim(0)
        library.mallopt(_TRIM_THRESHOLD, _KEPT)
        library.mallopt(_MMAP_THRESHOLD, _LARGEST)
        library.mlockall(
            _CURRENT_FUTURE_AND_ON_FAULT
        )  # refused as a whole where it is not allowed, which changes nothing
