"""The code in README.md and docs/ runs: each file's ``python`` blocks in one fresh process, in order."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tools.docs_code import ROOT, code_of_page, pages, pages_with_code

PAGES, WITH_CODE = pages(), pages_with_code()
LONG = {
    *("docs/device.md", "docs/minsnap.md", "docs/plant.md", "docs/policy.md", "docs/runtime.md", "docs/start.md"),
    "docs/howto/predictor.md",
}
"""Pages whose code runs for more than ten seconds; `make test-docs` runs all."""
MODULES = r"device|replanner|runtime|mavlink|io\.export|prediction\.observations|prediction\.lookout|policy\.protocol"
"""Of ``jaxplan``, from which code of the docs may import."""
LINK = re.compile(r"\]\((?!https?://|#)([^)#]+)(?:#[^)]*)?\)")


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize(
    "path", [pytest.param(p, id=name(p), marks=[pytest.mark.slow] * (name(p) in LONG)) for p in WITH_CODE]
)
def test_code_blocks_run(path: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-c", code_of_page(path)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-3000:]


@pytest.mark.parametrize("path", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=name)
def test_links_lead_somewhere(path: Path) -> None:
    links = LINK.findall(path.read_text(encoding="utf-8"))
    assert [link for link in links if not (path.parent / link).exists()] == []


@pytest.mark.parametrize("path", WITH_CODE, ids=name)
def test_code_blocks_need_only_public_names(path: Path) -> None:
    """Those of ``jaxplan``, and of the modules that people write their own parts against."""
    assert re.findall(rf"(?:from|import) jaxplan\.(?!(?:{MODULES}) import).*", code_of_page(path)) == []
