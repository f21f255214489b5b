"""Compile an MJCF file in a process of its own, with limits, before this process does.

The scan of ``jaxplan.world.formats.mjcf`` lets no known bomb through; this is the second wall, for what nobody knows
yet. A file that crashes MuJoCo, or asks for too much memory or time, ends the child and becomes an error message.
"""

import json
import subprocess
import sys
from pathlib import Path

from jaxplan.errors import FileError

MEMORY = 2 * 2**30
"""Bytes of address space for the child."""
SECONDS = 20

_CHILD = """
import json, resource, sys
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]), int(sys.argv[1])))
resource.setrlimit(resource.RLIMIT_CPU, (int(sys.argv[2]), int(sys.argv[2])))
import mujoco
text, meshes = json.load(sys.stdin)
try:
    mujoco.MjModel.from_xml_string(text, {name: open(file, "rb").read() for name, file in meshes.items()})
except (ValueError, MemoryError) as error:
    print(" ".join(str(error).split())[:300])
"""


def probe_mjcf(path: Path, text: str, meshes: dict[str, Path]) -> None:
    """Raise ``FileError`` unless MuJoCo compiles the text within limits; ``meshes`` are the files it names."""
    message = json.dumps([text, {name: str(file.resolve()) for name, file in meshes.items()}])
    command = [sys.executable, "-I", "-c", _CHILD, str(MEMORY), str(SECONDS)]
    try:
        child = subprocess.run(command, input=message, capture_output=True, text=True, timeout=2 * SECONDS, check=False)
    except subprocess.TimeoutExpired as error:
        raise FileError(f"{path}: MuJoCo takes more than {SECONDS} s to compile it; simplify it") from error
    if child.returncode != 0:
        raise FileError(
            f"{path}: MuJoCo crashes on it, or needs more than {MEMORY >> 30} GB or {SECONDS} s; simplify it"
        )
    if child.stdout.strip():
        raise FileError(f"{path}: MuJoCo refuses it ({child.stdout.strip()[:200]}); correct it")
