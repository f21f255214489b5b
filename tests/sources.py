"""The source tree as the tests of its structure read it: every file parsed once, nothing executed."""

import ast
import functools
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent


class Import(NamedTuple):
    """``module`` is imported at ``line``; ``typing`` where only the type checker sees it."""

    module: str
    line: int
    typing: bool


class Source(NamedTuple):
    """A file, read once."""

    root: Path
    path: Path
    text: str
    tree: ast.Module

    @property
    def name(self) -> str:
        return self.path.relative_to(self.root).as_posix()

    @property
    def station(self) -> str:
        """The layer member that the file belongs to."""
        parts = self.path.relative_to(self.root).parts
        if parts[0] != "jaxplan":
            return parts[0]
        return {"__init__.py": "jaxplan", "__main__.py": "cli"}.get(parts[1], parts[1].removesuffix(".py"))

    @property
    def module(self) -> str:
        """Its dotted name."""
        return ".".join(self.path.relative_to(self.root).with_suffix("").parts).removesuffix(".__init__")

    def imports(self) -> Iterator[Import]:
        """Every import, inside functions too, with relative ones made absolute."""
        yield from _imports(self.tree, self.path.relative_to(self.root).with_suffix("").parts)


def read(path: Path, root: Path = ROOT) -> Source:
    """Parse a file."""
    text = path.read_text(encoding="utf-8")
    return Source(root, path, text, ast.parse(text))


@functools.cache
def sources(*folders: str) -> list[Source]:
    """Every Python file below some folders of the repository."""
    return [read(path) for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def code() -> list[Source]:
    """What is not a test."""
    return sources("jaxplan", "experiments", "benchmarks", "tools")


def everything() -> list[Source]:
    """All Python files."""
    return [*code(), *sources("tests", "examples")]


def offenders(found: Iterable[tuple[Source, str]]) -> list[str]:
    """One line for each complaint."""
    return [f"{source.name}: {text}" for source, text in found]


def _imports(node: ast.AST, parts: tuple[str, ...], typing: bool = False) -> Iterator[Import]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import):
            yield from (Import(alias.name, child.lineno, typing) for alias in child.names)
        elif isinstance(child, ast.ImportFrom):
            package = parts[: -child.level] if child.level else ()
            base = ".".join((*package, *([child.module] if child.module else [])))
            yield from (Import(f"{base}.{alias.name}", child.lineno, typing) for alias in child.names)
        guarded = isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test)
        yield from _imports(child, parts, typing or guarded)
