"""Whether a built site holds together: every link leads somewhere, and nothing is fetched from elsewhere."""

from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

FETCHED = {("script", "src"), ("img", "src"), ("iframe", "src"), ("source", "src"), ("video", "src"), ("link", "href")}
"""Attributes whose addresses a browser loads by itself; ``link`` only where it is no hint for machines."""
_HINTS = {"canonical", "prev", "next", "alternate", "edit"}


class Link(NamedTuple):
    """An address in a page."""

    address: str
    fetched: bool
    """Whether a browser loads it without being asked."""


class Page(HTMLParser):
    """The links and the anchors of one page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[Link] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep what leads somewhere and what can be led to."""
        given = dict(attrs)
        self.anchors |= {value for name, value in attrs if name in {"id", "name"} and value}
        for name in ("href", "src"):
            address = given.get(name)
            if address:
                hint = tag == "link" and bool(_HINTS & set((given.get("rel") or "").split()))
                self.links.append(Link(address, (tag, name) in FETCHED and not hint))


def faults(site: Path) -> list[str]:
    """One line for each dead link, missing anchor, and address that is fetched from elsewhere."""
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    return [f"{path.relative_to(site)}: {fault}" for path in pages for fault in _faults(site, path, pages)]


def _faults(site: Path, path: Path, pages: dict[Path, Page]) -> Iterator[str]:
    for address, fetched in pages[path].links:
        parts = urlsplit(address)
        if parts.scheme or parts.netloc:
            if fetched and parts.scheme != "data":
                yield f"fetches {address}"
            continue
        target = _target(site, path, unquote(parts.path))
        if not target.is_file():
            yield f"dead link {address}"
        elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors | {"__skip"}:
            yield f"no anchor {address}"


def _target(site: Path, path: Path, address: str) -> Path:
    if not address:
        return path
    base = site if address.startswith("/") else path.parent
    found = (base / address.lstrip("/")).resolve()
    return found / "index.html" if found.is_dir() else found
