"""Makes the firmware from the package index's sources, once per user, and the clock library that it runs under.

Everything lies in the user's cache (``JAXPLAN_CACHE_DIR``, as roadmaps do): the source archive, checked against the
hash below, the program that ``make`` and ``gcc`` make of it, the clock library by the hash of its source, and the
firmware's settings by the hash of the commands that make them.
"""

import contextlib
import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from jaxplan.errors import FileError, ResourceError
from jaxplan.files import FOLDER_VARIABLE
from jaxplan.search.store import cache_folder

PACKAGE, VERSION = "betaflight", "0.0.6"
"""On the package index: sources of Betaflight 4.6.0 with a simulator's wrapper, which is not used."""
ARCHIVE_SHA256 = "2f37cc2fcdbf22d8042e0ac5095cc04145232a5a4923b7a58c5892fceef36ec3"
PROGRAM = "betaflight_4.6.0_SITL"
"""What ``make TARGET=SITL`` leaves in ``obj``."""
NEEDED = ("gcc", "make")
BUILD_SECONDS = 1800.0
"""Within which each step must end (it takes about half a minute on two cores; arbitrary)."""
CLOCK_SOURCE = Path(__file__).with_name("clock.c")


class Firmware(NamedTuple):
    """Files of a firmware that is ready to run."""

    program: Path
    clock: Path
    """The library to load before it."""


def build() -> Firmware:
    """The firmware, made now where it has not been made before.

    Raises:
        ResourceError: a tool is missing, nothing may be cached, or a step fails.
        FileError: the archive is not the one that this was written for.
    """
    found = _files()
    with one_at_a_time(found.program.parent):
        if not found.program.is_file():
            require_tools()
            _make(found.program)
        if not found.clock.is_file():
            require_tools()
            compile_clock(found.clock)
    return found


def require_buildable() -> None:
    """Raise ``ResourceError`` where the firmware is neither here nor can be made."""
    if not all(path.is_file() for path in _files()):
        require_tools()


@contextlib.contextmanager
def one_at_a_time(folder: Path) -> Iterator[None]:
    """Whoever makes something in a folder waits here for whoever does so already."""
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def require_tools() -> None:
    """Raise ``ResourceError`` for the first tool that is not here."""
    for tool in NEEDED:
        if shutil.which(tool) is None:
            raise ResourceError(
                f"firmware: {tool} is not on the path, and the firmware is built from source; install "
                f"{' and '.join(NEEDED)}"
            )


def compile_clock(path: Path) -> None:
    """Compile the clock library into ``path``."""
    with tempfile.TemporaryDirectory(dir=path.parent) as staged:
        made = Path(staged) / path.name
        flags = ("-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC")
        _run("compiling the clock", ("gcc", *flags, "-o", str(made), str(CLOCK_SOURCE), "-ldl", "-lm", "-lpthread"))
        made.replace(path)


def _files() -> Firmware:
    """Where everything is, or will be."""
    roadmaps = cache_folder()
    if roadmaps is None:
        raise ResourceError(f"firmware: nothing may be cached here; set {FOLDER_VARIABLE} to a folder for the firmware")
    folder = roadmaps.parent / f"firmware-{VERSION}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResourceError(f"firmware: cannot make {folder} ({error.strerror}); set {FOLDER_VARIABLE}") from error
    source = hashlib.sha256(CLOCK_SOURCE.read_bytes()).hexdigest()[:16]
    return Firmware(folder / PROGRAM, folder / f"clock-{source}.so")


def _make(program: Path) -> None:
    """Download, check, unpack, make; the program appears in one step, or not at all."""
    folder = program.parent
    with tempfile.TemporaryDirectory(dir=folder) as staged:
        archive = _archive(folder, Path(staged))
        with tarfile.open(archive) as packed:
            packed.extractall(staged, filter="data")
        sources = Path(staged) / f"{PACKAGE}-{VERSION}" / "betaflight" / "firmware"
        _run("building", ("make", "-C", str(sources), "TARGET=SITL"))
        made = sources / "obj" / PROGRAM
        if not made.is_file():
            raise ResourceError(f"firmware: make ended well but left no {PROGRAM}; remove {folder} and try again")
        made.replace(program)


def _archive(folder: Path, staged: Path) -> Path:
    """The source archive, downloaded where it is not kept."""
    path = folder / f"{PACKAGE}-{VERSION}.tar.gz"
    if not path.is_file():
        pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "download", "--quiet", "--no-deps")
        wanted = f"{PACKAGE}=={VERSION}"
        _run("downloading", (*pip, "--no-binary", PACKAGE, "--dest", str(staged), wanted))
        check_archive(staged / path.name)
        (staged / path.name).replace(path)
    check_archive(path)
    return path


def check_archive(path: Path) -> None:
    """Raise ``FileError`` for an archive that is not the one this was written for."""
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    if found != ARCHIVE_SHA256:
        raise FileError(f"{path}: its SHA-256 is {found}, want {ARCHIVE_SHA256}; remove it, and it is downloaded again")


def _run(step: str, command: Sequence[str]) -> None:
    environment = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MFLAGS")}
    settings = {"capture_output": True, "text": True, "errors": "replace", "env": environment, "check": False}
    try:
        done = subprocess.run(command, timeout=BUILD_SECONDS, **settings)
    except subprocess.TimeoutExpired as error:
        raise ResourceError(f"firmware: {step} took longer than {BUILD_SECONDS:g} s, and was stopped") from error
    if done.returncode:
        last = next((line for line in reversed(done.stderr.splitlines()) if line.strip()), "it said nothing")
        raise ResourceError(f"firmware: {step} failed with exit code {done.returncode}: {last.strip()}")
