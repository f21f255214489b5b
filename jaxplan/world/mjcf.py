"""Reading MJCF text with suspicion, before MuJoCo sees it.

MJCF is a programming language of sorts: it includes files, repeats elements, allocates what it is told to and loads
plugins. Only elements that describe a static scene are let through, in a bounded number and depth.
"""

from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from jaxplan.errors import FileError

ELEMENTS = frozenset(
    """
    mujoco compiler option visual global quality headlight map scale rgba statistic asset texture material default
    custom numeric text worldbody body frame geom site light camera
    """.split()  # noqa: SIM905 (a list of 30 quoted words is harder to read)
)
"""Everything that a static scene of primitives needs. ``body`` without a joint is static."""
MAX_ELEMENTS = 10_000
MAX_DEPTH = 64
"""Both arbitrary, far above any hand-written room."""
_MAX_COUNT = 4096
"""Largest texture side in pixels and largest custom array; arbitrary."""

_COUNTS = {("texture", "width"), ("texture", "height"), ("numeric", "size"), ("texture", "nchannel")}
_REFUSED_ATTRIBUTES = frozenset(
    ["file", "fileup", "filedown", "fileleft", "fileright", "filefront", "fileback", "mesh", "hfield"]
)


def check_mjcf(path: Path, data: bytes) -> str:
    """The text of a static, bounded MJCF file; ``FileError`` for anything else."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: have bytes that are not UTF-8 text, want MJCF; write it again") from error
    try:
        _Scan(path).run(data)
    except expat.ExpatError as error:
        raise FileError(f"{path}: have no well-formed XML ({error}), want MJCF; correct it") from error
    return text


class _Scan:
    """One pass over the elements, without building a tree."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.depth = 0
        self.count = 0

    def run(self, data: bytes) -> None:
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.StartDoctypeDeclHandler = self._doctype
        parser.Parse(data, True)

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self.depth += 1
        self.count += 1
        if self.count == 1 and tag != "mujoco":
            self._refuse(f"have the XML element <{tag}>", "<mujoco> as the outermost element")
        if tag not in ELEMENTS:
            self._refuse(
                f"have the element <{tag}>", "a static scene of boxes, cylinders, spheres, capsules and planes"
            )
        if self.depth > MAX_DEPTH or self.count > MAX_ELEMENTS:
            self._refuse("too large or nested too deeply", f"at most {MAX_ELEMENTS} elements on {MAX_DEPTH} levels")
        for name, value in attributes.items():
            self._check_attribute(tag, name, value)

    def _check_attribute(self, tag: str, name: str, value: str) -> None:
        if name in _REFUSED_ATTRIBUTES:
            self._refuse(
                f"<{tag}> has the attribute {name!r}", "primitives only; give a mesh as an .stl file of its own"
            )
        if (tag, name) in _COUNTS:
            digits = value.strip()
            if not (digits.isascii() and digits.isdigit() and len(digits) < 10 and int(digits) <= _MAX_COUNT):
                self._refuse(f"<{tag} {name}={value[:20]!r}>", f"a whole number <= {_MAX_COUNT}")

    def _end(self, tag: str) -> None:
        self.depth -= 1

    def _doctype(self, *declaration: object) -> None:
        self._refuse("have a document type or entity declaration", "plain MJCF")

    def _refuse(self, have: str, want: str) -> NoReturn:
        raise FileError(f"{self.path}: {have}, want {want}; remove it")
