"""The site's source: docs/ and what its pages lead to, as plain Markdown in one folder.

Pages of docs/ keep their places. A link that leaves docs/ becomes a link to the page of that file: CHANGELOG.md and
CONTRIBUTING.md are pages of their own, any other text becomes a page under files/ that shows it.
"""

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

from tools.site.api import api_pages
from tools.site.examples import example_pages

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES_OF = {"README.md": "index.md", "CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}
"""Files outside docs/ with a page of another name."""
LANGUAGES = {".py": "python", ".json": "json", ".toml": "toml", ".xml": "xml", ".csv": "text", ".tex": "latex"}
"""What other files are shown as."""
_LINK = re.compile(r"(!?\[(?:[^\]\\]|\\.)*\]\()([^)\s#]+)(#[^)\s]*)?(\))")
_SHOWN = 200_000
"""Characters of a file that a page shows (arbitrary)."""


def write_source(folder: Path) -> list[str]:
    """Fill ``folder`` anew and give its pages, by their paths in it. Raises ``LookupError`` for a dead link."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(DOCS, folder, ignore=shutil.ignore_patterns(".*"))
    outside: set[str] = set()
    for page in sorted(DOCS.rglob("*.md")):
        _write(folder / page.relative_to(DOCS), _with_links(page, page.relative_to(DOCS).as_posix(), outside))
    for name, page in PAGES_OF.items():
        if name != "README.md":
            _write(folder / page, _with_links(ROOT / name, page, outside))
    for name in sorted(outside):
        _write(folder / _page_of(name), _shown(name))
    texts = [page.read_text(encoding="utf-8") for page in guides()]
    for path, text in (*api_pages(texts), *example_pages(folder / "examples"), _decisions()):
        _write(folder / path, text)
    return [page.relative_to(folder).as_posix() for page in sorted(folder.rglob("*.md"), key=_readable)]


def guides() -> list[Path]:
    """The pages that are written for users of the library: what they name is public."""
    return [*sorted(DOCS.glob("*.md")), *sorted(DOCS.glob("howto/*.md"))]


def _readable(page: Path) -> str:
    """Names are sorted without regard to their case."""
    return page.as_posix().casefold()


def _with_links(page: Path, place: str, outside: set[str]) -> str:
    """A page's text for its ``place`` in the site; files that it leads to are added to those ``outside``."""

    def lead(match: re.Match[str]) -> str:
        before, address, anchor, after = match.groups(default="")
        if re.match(r"[a-z]+:", address):
            return match.group()
        target = (page.parent / address).resolve()
        if not target.is_file() or ROOT not in target.parents:
            raise LookupError(f"{page.relative_to(ROOT)} leads to {address}, which is no file of the project")
        name = target.relative_to(ROOT).as_posix()
        there = _page_of(name)
        if there.startswith("files/"):
            outside.add(name)
        return f"{before}{os.path.relpath(there, Path(place).parent)}{anchor}{after}"

    return _outside_code(page.read_text(encoding="utf-8"), lambda text: _LINK.sub(lead, text))


def _outside_code(text: str, change: Callable[[str], str]) -> str:
    """Apply ``change`` to what is not in a fenced block."""
    parts = re.split(r"(^```.*?^```$)", text, flags=re.MULTILINE | re.DOTALL)
    return "".join(part if index % 2 else change(part) for index, part in enumerate(parts))


def _page_of(name: str) -> str:
    """Where a file of the project is in the site's source."""
    if name in PAGES_OF:
        return PAGES_OF[name]
    if re.fullmatch(r"examples/\d\d_\w+\.py", name):
        return name.removesuffix(".py") + ".md"
    return name.removeprefix("docs/") if name.startswith("docs/") else f"files/{name}.md"


def _shown(name: str) -> str:
    """A page that shows a file."""
    text = (ROOT / name).read_text(encoding="utf-8")[:_SHOWN]
    return f"# {name}\n\n````{LANGUAGES.get(Path(name).suffix, 'text')}\n{text.rstrip()}\n````\n"


def _decisions() -> tuple[str, str]:
    """A page that lists the decisions."""
    lines = [
        "# Decisions",
        "",
        "What others will ask about, each on a page: what was decided, why, and what was measured.",
        "",
    ]
    for page in sorted((DOCS / "decisions").glob("[0-9]*.md")):
        title = page.read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")
        number, _, words = title.partition(". ")
        lines.append(f"- {number}: [{words}]({page.name})")
    return "decisions/index.md", "\n".join(lines) + "\n"


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
