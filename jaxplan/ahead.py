"""A second process that compiles for the host what a planner will call, while this one compiles with XLA.

Numba compiles on one core and holds Python's lock; XLA leaves the other core idle for much of the time. The other
process fills numba's cache on disk, from which this one loads. Who compiles an entry point is who claims it first, so
neither waits for what the other has not begun, and nothing is compiled twice. Whatever goes wrong there is compiled
here: later, and that is all.

``python -m jaxplan.ahead CLAIMS STAMP`` is what ``begin`` starts; it ends when its input does, so with its parent.
"""

import atexit
import contextlib
import functools
import gc
import hashlib
import importlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jaxplan import programs
from jaxplan.files import write_atomically
from jaxplan.versions import installed_versions

TABLE = Path(__file__).with_name("ahead.json")
"""Entry points with the argument types that a planner calls them with, the longest first; ``tools.record_ahead``."""
PATIENCE = 120.0
"""s; how long an entry point that the other process has begun is waited for (arbitrary)."""


class _Helper:
    """The other process, from this one's side."""

    def __init__(self, claims: Path, child: subprocess.Popen) -> None:
        self.claims, self.child = claims, child
        self._ended: set[str] = set()
        self._change = threading.Condition()
        self._listener = threading.Thread(target=self._listen, name="jaxplan-ahead", daemon=True)
        self._listener.start()

    def wait_for(self, name: str) -> None:
        """Until that is in the cache, if the other process has begun it."""
        if _claimed(self.claims, name):
            return
        with self._change:
            self._change.wait_for(lambda: name in self._ended or "" in self._ended, PATIENCE)

    def end(self, patience: float) -> None:
        """Wait so long, then stop it."""
        self._listener.join(patience)
        with contextlib.suppress(OSError):
            self.child.kill()
        self._listener.join()

    def _listen(self) -> None:
        assert self.child.stdout is not None
        with contextlib.suppress(OSError), self.child:
            for line in self.child.stdout:
                self._tell(line.strip())
        self._tell("")
        shutil.rmtree(self.claims, ignore_errors=True)

    def _tell(self, name: str) -> None:
        with self._change:
            self._ended.add(name)
            self._change.notify_all()


_helpers: list[_Helper] = []


def begin() -> None:
    """Start the other process, once, where programs are kept, there is a core for it, and it has something to do."""
    folder = programs.folder_in_use()
    if folder is None or _helpers or _cores() < 2 or not sys.executable or _is_compiled(_stamp(folder)):
        return
    with contextlib.suppress(OSError):
        claims = Path(tempfile.mkdtemp(prefix="jaxplan-ahead-"))
        path = os.pathsep.join([str(Path(__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])])
        child = subprocess.Popen(
            [sys.executable, "-m", "jaxplan.ahead", str(claims), str(_stamp(folder))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": path},
            text=True,
        )
        _helpers.append(_Helper(claims, child))
        atexit.register(_helpers[-1].end, 0.0)


def wait_for(name: str) -> None:
    """Until the entry point of this name is in numba's cache, if that is being compiled beside this process."""
    for helper in _helpers:
        helper.wait_for(name)


def end(patience: float = PATIENCE) -> None:
    """Until nothing is compiled beside this process any more."""
    for helper in _helpers:
        helper.end(patience)


def name_of(function: Any) -> str:
    """Of an entry point: what makes it, as ``module:function``."""
    return f"{function.__module__}:{function.__qualname__.partition('.')[0]}"


def _claimed(claims: Path, name: str) -> bool:
    """Whether nobody has claimed that before; then it is claimed now. Also where that cannot be told."""
    try:
        os.close(os.open(claims / hashlib.sha256(name.encode()).hexdigest(), os.O_CREAT | os.O_EXCL))
    except FileExistsError:
        return False
    except OSError:
        return True
    return True


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _stamp(folder: Path) -> Path:
    """Where it says which files of numba's cache there are once all is compiled, for these sources and versions."""
    digest = hashlib.sha256(repr(sorted(installed_versions().items())).encode())
    digest.update(os.environ.get("NUMBA_CACHE_DIR", "").encode())
    here = Path(__file__).parent
    for path in sorted([TABLE, here / "native.py", here / "parts.py", *here.glob("*/kernels/*.py")]):
        digest.update(path.read_bytes())
    return folder / f"{digest.hexdigest()[:20]}.ahead"


def _is_compiled(stamp: Path) -> bool:
    try:
        return all(Path(path).is_file() for path in json.loads(stamp.read_text()))
    except (OSError, ValueError):
        return False


def _compile_all(claims: Path, stamp: Path) -> None:
    """Compile what nobody else does, and say so, a name a line; then write down what there is."""
    files: list[str] = []
    complete = True
    for name, signatures in json.loads(TABLE.read_text()).items():
        if _claimed(claims, name):
            module, _, factory = name.partition(":")
            entry = getattr(importlib.import_module(module), factory)()
            for signature in signatures:
                entry.compile(tuple(map(_type, signature)))
            sys.stdout.write(f"{name}\n")
            sys.stdout.flush()
        complete &= claims.is_dir()
        files += [str(path) for path in _files_of(name)]
    if complete:
        write_atomically(stamp, json.dumps(files))


def _files_of(name: str) -> Iterator[Path]:
    """Numba's, about an entry point."""
    module, _, factory = name.partition(":")
    entry: Any = getattr(importlib.import_module(module), factory)()
    stem = f"{module.rpartition('.')[2]}.{entry.py_func.__qualname__.replace('<', '').replace('>', '')}-"
    return Path(entry.stats.cache_path).glob(f"{stem}*.nbi")


@functools.cache
def _class(name: str) -> Any:
    module, _, kind = name.partition(":")
    return getattr(importlib.import_module(module), kind)


def _type(written: Any) -> Any:
    """The type of an argument from what the table says: a name, a name with dimensions and layout, or parts."""
    from numba import types

    if isinstance(written, str):
        kind, *rest = written.split()
        scalar = getattr(types, kind)
        return types.Array(scalar, int(rest[0]), rest[1]) if rest else scalar
    if isinstance(written, list):
        return types.Tuple(tuple(map(_type, written)))
    parts = [_type(part) for part in written["parts"]]
    uniform = len(set(parts)) == 1
    kind = _class(written["class"])
    return types.NamedUniTuple(parts[0], len(parts), kind) if uniform else types.NamedTuple(parts, kind)


def _main(claims: Path, stamp: Path) -> None:
    def die_with_parent() -> None:
        sys.stdin.buffer.read()
        os._exit(0)

    threading.Thread(target=die_with_parent, daemon=True).start()
    gc.disable()  # numba keeps nearly all that it makes; a tenth of the time
    _compile_all(claims, stamp)


if __name__ == "__main__":
    _main(Path(sys.argv[1]), Path(sys.argv[2]))
