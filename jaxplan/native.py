"""How code for the host is compiled by numba, and the key that keeps numba's cache on disk honest.

Numba keeps a compiled entry point until the time stamp or the size of the file that holds it changes; what it calls in
other files does not count, and files from a wheel all carry one constant time stamp. An entry point that reads
``digest_of`` its folder from its closure is compiled anew whenever any file there has changed.
"""

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba

from jaxplan.linking import PART, WHOLE

F = TypeVar("F", bound=Callable)

inner = numba.njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True, _nrt=False, **PART)
"""Compiles functions that only other compiled functions call: without wrappers for Python and C, which took a third of
the time of the first compilation, and without reference counts (``_nrt``), which took 7 %: they make and keep no
arrays. Each is compiled once per set of argument types, and a constant such as 0 is a type of its own."""

summing = numba.njit(
    nogil=True,
    error_model="numpy",
    fastmath={"reassoc", "contract", "nsz"},
    no_cpython_wrapper=True,
    no_cfunc_wrapper=True,
    _nrt=False,
)
"""The same for long sums of products, which may be added up in any order: several at a time. Made machine code on its
own, so that this order does not depend on who calls it."""

within = numba.njit(inline="always")
"""Puts functions into the one that calls them before that is compiled, while their types are not yet known: cheap where
there is one caller."""

_entries: list[Any] = []


def entry_point(function: F) -> F:
    """Compiles functions that Python calls, and keeps them on disk."""
    options = {"cache": True, "nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, **WHOLE}
    compiled: Any = numba.njit(**options)(function)
    _entries.append(compiled)
    return compiled


def specialisations() -> int:
    """How many functions that Python calls are compiled or loaded, each for one set of argument types."""
    return sum(len(entry.signatures) for entry in _entries)


@functools.cache
def digest_of(folder: Path) -> str:
    """Hash of all source files of a folder."""
    digest = hashlib.sha256()
    for path in sorted(folder.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
