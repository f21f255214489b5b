"""Reading MJCF text with suspicion, before MuJoCo sees it.

MJCF is a programming language of sorts: it includes files, repeats elements, allocates what it is told to and loads
plugins. Only elements that describe a static scene are let through, in a bounded number and depth.
"""

from pathlib import Path
from typing import NamedTuple, NoReturn
from xml.parsers import expat

from jaxplan.errors import FileError

ELEMENTS = frozenset(
    """
    mujoco compiler option visual global quality headlight map scale rgba statistic asset texture material default
    custom numeric text worldbody body frame geom site light camera mesh
    """.split()  # noqa: SIM905 (a list of 30 quoted words is harder to read)
)
"""Everything that a static scene of primitives and meshes needs. ``body`` without a joint is static."""
MAX_ELEMENTS = 10_000
MAX_DEPTH = 64
"""Both arbitrary, far above any hand-written room."""
_MAX_COUNT = 4096
"""Largest texture side in pixels and largest custom array; arbitrary."""

_COUNTS = {("texture", "width"), ("texture", "height"), ("numeric", "size"), ("texture", "nchannel")}
_REFUSED_ATTRIBUTES = frozenset(
    [
        "fileup",
        "filedown",
        "fileleft",
        "fileright",
        "filefront",
        "fileback",
        "hfield",
        "meshdir",
        "assetdir",
        "texturedir",
    ]
)
MESH_ENDINGS = (".stl", ".obj")
MAX_MESHES = 64


class Mjcf(NamedTuple):
    """A static, bounded MJCF file."""

    text: str
    meshes: tuple[str, ...]
    """The mesh files that it names, relative to its folder and inside it."""


def check_mjcf(path: Path, data: bytes) -> Mjcf:
    """The text of a static, bounded MJCF file and what it refers to; ``FileError`` for anything else."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: have bytes that are not UTF-8 text, want MJCF; write it again") from error
    try:
        scan = _Scan(path)
        scan.run(data)
    except expat.ExpatError as error:
        raise FileError(f"{path}: have no well-formed XML ({error}), want MJCF; correct it") from error
    return Mjcf(text, tuple(scan.meshes))


class _Scan:
    """One pass over the elements, without building a tree."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.depth = 0
        self.count = 0
        self.meshes: list[str] = []

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
                f"<{tag}> has the attribute {name!r}",
                "primitives, and meshes named by their path from the file's folder",
            )
        if name == "file":
            self._check_file(tag, value)
        if (tag, name) in _COUNTS:
            digits = value.strip()
            if not (digits.isascii() and digits.isdigit() and len(digits) < 10 and int(digits) <= _MAX_COUNT):
                self._refuse(f"<{tag} {name}={value[:20]!r}>", f"a whole number <= {_MAX_COUNT}")

    def _check_file(self, tag: str, value: str) -> None:
        """Mesh files only, in the file's own folder or below it, links resolved."""
        folder = self.path.parent.resolve()
        target = (folder / value).resolve()
        if tag != "mesh" or target.suffix.lower() not in MESH_ENDINGS or len(self.meshes) >= MAX_MESHES:
            self._refuse(
                f"<{tag}> has file={value[:40]!r}", f"at most {MAX_MESHES} .stl or .obj files of <mesh> elements"
            )
        if Path(value).is_absolute() or not target.is_relative_to(folder):
            self._refuse(f"<{tag}> has file={value[:40]!r}", "files in the folder of the MJCF file")
        self.meshes.append(value)

    def _end(self, tag: str) -> None:
        self.depth -= 1

    def _doctype(self, *declaration: object) -> None:
        self._refuse("have a document type or entity declaration", "plain MJCF")

    def _refuse(self, have: str, want: str) -> NoReturn:
        raise FileError(f"{self.path}: {have}, want {want}; remove it")
