"""The code in README.md and docs/ runs: each file's ``python`` blocks in one fresh process, in order."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
PAGES = [path for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))) if path.is_file()]
WITH_CODE = [path for path in PAGES if BLOCK.search(path.read_text(encoding="utf-8"))]
LONG = {"docs/minsnap.md", "docs/plant.md", "docs/policy.md"}
"""Pages whose code runs for more than ten seconds; `make docs` runs all."""
LINK = re.compile(r"\]\((?!https?://|#)([^)#]+)(?:#[^)]*)?\)")


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize(
    "path", [pytest.param(p, id=name(p), marks=[pytest.mark.slow] * (name(p) in LONG)) for p in WITH_CODE]
)
def test_code_blocks_run(path: Path, tmp_path: Path) -> None:
    code = "\n".join(BLOCK.findall(path.read_text(encoding="utf-8")))
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]


@pytest.mark.parametrize("path", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=name)
def test_links_lead_somewhere(path: Path) -> None:
    links = LINK.findall(path.read_text(encoding="utf-8"))
    assert [link for link in links if not (path.parent / link).exists()] == []


@pytest.mark.parametrize("path", WITH_CODE, ids=name)
def test_code_blocks_need_only_public_names(path: Path) -> None:
    """Those of ``jaxplan``, and of its three public modules."""
    code = "\n".join(BLOCK.findall(path.read_text(encoding="utf-8")))
    assert re.findall(r"(?:from|import) jaxplan\.(?!runtime import|mavlink import|io\.export import).*", code) == []
