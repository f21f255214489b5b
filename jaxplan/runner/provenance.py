"""Where a result comes from: commit, versions, machine, command, and the hashes of what it used and what it is."""

import hashlib
import os
import platform
import subprocess
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from jaxplan.versions import installed_versions


def origin(command: list[str], artefacts: list[Path]) -> dict[str, Any]:
    """What one run says about itself; ``artefacts`` are the files it depends on."""
    return {
        "command": " ".join(command),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": commit(),
        "versions": installed_versions(),
        "machine": {
            "processor": processor(),
            "cores": os.cpu_count(),
            "memory_gib": _memory(),
            "system": platform.platform(),
        },
        "artefacts": {"/".join(path.parts[-3:]): sha256(path) for path in artefacts},
    }


def sha256(path: Path) -> str:
    """The hash of a file's content."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def commit() -> str | None:
    """The source tree's commit, with ``-dirty`` where files were changed; None outside a source tree."""
    folder = Path(__file__).parent.parent.parent
    try:
        found = subprocess.run(
            ["git", "describe", "--always", "--abbrev=40", "--dirty", "--exclude=*"],
            cwd=folder,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return found.stdout.strip()


def processor() -> str:
    """The processor's name as the system states it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())


def _memory() -> float | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    except (OSError, ValueError):
        return None
