"""The order of the site's pages. Pages that are not there yet are left out; pages that nobody named come last."""

import json
from collections.abc import Iterable, Iterator
from typing import Any

from tools.site.api import GROUPS

NAV: list[Any] = [
    {"Start": ["index.md", "start.md", "concepts.md"]},
    {
        "How to": [
            {"Your map": "howto/map.md"},
            {"Your flight": "howto/flight.md"},
            {"Your vehicle": "howto/vehicle.md"},
            {"Your predictor": "howto/predictor.md"},
            {"Your policy": "howto/policy.md"},
            {"Export": "howto/export.md"},
            {"Stream": "howto/stream.md"},
        ]
    },
    {"Examples": ["examples/index.md", "examples/*"]},
    {
        "Guides": [
            "worlds.md",
            "prediction.md",
            "minsnap.md",
            "policy.md",
            "vehicles.md",
            "plant.md",
            "safety.md",
            "runtime.md",
            "device.md",
            "view.md",
            "mavlink.md",
            "firmware.md",
            "files.md",
            "metrics.md",
        ]
    },
    {
        "API": [
            "api/index.md",
            *({title: [{name: f"api/{name}.md"} for name in names]} for title, names in GROUPS.items()),
            {"Modules": ["api/*"]},
        ]
    },
    {"Experiments": ["experiments.md", "arena.md", "performance.md", "results/*"]},
    {
        "Project": [
            "limitations.md",
            "glossary.md",
            "changelog.md",
            "contributing.md",
            {"Decisions": ["decisions/index.md", "decisions/*"]},
        ]
    },
]
"""Sections of pages, by their paths in the site; ``folder/*`` stands for all others of a folder, in their order."""

HIDDEN = "files/"
"""Folder of pages that are reached by links alone."""


def navigation(pages: Iterable[str]) -> list[Any]:
    """``NAV`` with the pages that there are, and a section for those that it does not name."""
    left = {page: None for page in pages if not page.startswith(HIDDEN)}
    named = {entry for entry in _entries(NAV) if not entry.endswith("*")}
    nav = _present(NAV, left, named)
    return [*nav, {"More": sorted(left)}] if left else nav


def _entries(nav: Any) -> Iterator[str]:
    if isinstance(nav, str):
        yield nav
    else:
        for part in nav.values() if isinstance(nav, dict) else nav:
            yield from _entries(part)


def _present(nav: list[Any], left: dict[str, None], named: set[str]) -> list[Any]:
    """Take what is there out of ``left``, in the order of ``nav``."""
    found: list[Any] = []
    for entry in nav:
        if isinstance(entry, str):
            match = [page for page in left if page == entry or (_under(page, entry) and page not in named)]
            found += [_entry(page) for page in match]
            for page in match:
                del left[page]
        else:
            ((title, value),) = entry.items()
            inside = _present([value] if isinstance(value, str) else value, left, named)
            if inside:
                found.append({title: inside[0] if isinstance(value, str) else inside})
    return found


def _entry(page: str) -> str | dict[str, str]:
    """A page under its own title; a report under the name of its folder, for titles of reports are alike."""
    folder, _, name = page.rpartition("/")
    return {folder.rpartition("/")[2]: page} if name == "report.md" else page


def _under(page: str, pattern: str) -> bool:
    return pattern.endswith("*") and page.startswith(pattern[:-1])


def as_toml(nav: list[Any]) -> str:
    """The value of ``nav`` in TOML; its strings are those of JSON."""
    parts = []
    for entry in nav:
        if isinstance(entry, str):
            parts.append(json.dumps(entry))
        else:
            ((title, value),) = entry.items()
            inside = json.dumps(value) if isinstance(value, str) else as_toml(value)
            parts.append(f"{{ {json.dumps(title)} = {inside} }}")
    return f"[{', '.join(parts)}]"
