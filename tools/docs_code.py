"""The code of README.md and docs/: the blocks marked ``python`` of a page, which run one after the other."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def pages() -> list[Path]:
    """README.md and all pages of docs/."""
    return [path for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))) if path.is_file()]


def code_of_page(page: Path) -> str:
    """All of a page's code; empty where it has none."""
    return "\n".join(_BLOCK.findall(page.read_text(encoding="utf-8")))


def pages_with_code() -> list[Path]:
    """Those that have any."""
    return [page for page in pages() if code_of_page(page)]
