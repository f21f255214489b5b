"""Build the site into site/: ``python -m tools.site``. Exit code 1 for a warning or a dead link."""

import shutil
import subprocess
import sys
import time
from pathlib import Path

from tools.site.links import faults
from tools.site.nav import as_toml, navigation
from tools.site.source import ROOT, write_source

SETTINGS = Path(__file__).with_name("zensical.toml")
ASSETS = Path(__file__).with_name("assets")


def build(work: Path, out: Path) -> list[str]:
    """Work in ``work``, put the site into ``out`` where it could be built; what is wrong with it, a line each."""
    pages = write_source(work / "source")
    shutil.copytree(ASSETS, work / "source" / "assets")
    settings = SETTINGS.read_text(encoding="utf-8")
    for name, value in {"@NAV@": as_toml(navigation(pages)), "@ROOT@": ROOT.as_posix()}.items():
        settings = settings.replace(name, value)
    (work / "zensical.toml").write_text(settings, encoding="utf-8")
    command = [sys.executable, "-m", "zensical", "build", "--strict", "--clean"]
    done = subprocess.run(command, cwd=work, capture_output=True, text=True, check=False)
    if done.returncode:
        return [(done.stdout + done.stderr).strip()]
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(work / "html", out)
    warnings = [line for line in (done.stdout + done.stderr).splitlines() if "warning" in line.lower()]
    return warnings + faults(out)


def main() -> None:
    """Build, say how long it took, and what is wrong."""
    out, began = ROOT / "site", time.perf_counter()
    try:
        found = build(ROOT / "build" / "site", out)
    except LookupError as error:  # a dead link in the source, or something without a docstring
        sys.exit(f"site: {error}")
    pages = len(list(out.rglob("*.html")))
    print(f"{pages} pages in {time.perf_counter() - began:.0f} s, {len(found)} faults: {out / 'index.html'}")
    for line in found:
        print(line, file=sys.stderr)
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
