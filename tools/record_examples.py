"""Run the examples and keep what they print and draw: ``python -m tools.record_examples [NUMBER ...]``.

Each runs in an empty folder of its own; its output becomes ``examples/outputs/NAME.txt``, its picture ``NAME.png``.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from tools.site.examples import OUTPUTS, scripts

COLOURS = 64
"""Of the pictures that are kept: a third of the bytes, and nobody sees it."""


def run_example(script: Path, folder: Path) -> str:
    """What a script prints. Raises ``CalledProcessError`` where it fails."""
    root = script.parent.parent
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, str(script)]
    done = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return done.stdout


def record(script: Path) -> None:
    """Run one script and keep its output."""
    with tempfile.TemporaryDirectory() as folder:
        text = run_example(script, Path(folder))
        (OUTPUTS / f"{script.stem}.txt").write_text(text, encoding="utf-8")
        for picture in Path(folder).rglob(f"{script.stem}.png"):
            reduced = Image.open(picture).convert("RGB").quantize(COLOURS)
            reduced.save(OUTPUTS / picture.name, optimize=True)
    print(f"{script.name}\n{text}")


def main() -> None:
    """Record those whose numbers are given, or all."""
    OUTPUTS.mkdir(exist_ok=True)
    wanted = set(sys.argv[1:])
    for script in scripts():
        if not wanted or script.name.split("_")[0] in wanted:
            record(script)


if __name__ == "__main__":
    main()
