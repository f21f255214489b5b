"""Memory of a process that runs for hours: what compiling has left is given back, and what follows is kept small."""

import contextlib
import ctypes
import gc


def settle() -> None:
    """Before the flight: collect, set aside all that stays, and give freed pages back to the system.

    What is set aside is not looked through again, hundreds of thousands of objects of JAX: later collections take
    microseconds instead of a third of a second, in which a plan or a setpoint would be late. The planner's process does
    it after its warm-up; the process that asks for setpoints should, once it has imported and built what it needs.
    """
    gc.collect()
    gc.freeze()
    with contextlib.suppress(AttributeError, OSError):  # another C library than glibc keeps the pages
        ctypes.CDLL(None).malloc_trim(0)
