"""The folder of a training run: one configuration, and files that are whole or not there."""

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

from jaxplan.errors import FileError


def claim(folder: Path, config: Any, free: tuple[str, ...] = ()) -> None:
    """State the configuration (a dataclass) of a run in its folder.

    Args:
        free: fields that a run may be continued with other values of.

    Raises:
        FileError: the folder holds a run of another configuration.
    """
    folder.mkdir(parents=True, exist_ok=True)
    stated = folder / "config.json"
    wanted = json.loads(json.dumps(dataclasses.asdict(config)))
    if stated.exists() and json.loads(stated.read_text()) | {name: wanted[name] for name in free} != wanted:
        raise FileError(f"{folder}: holds a run of another configuration; choose another folder")
    write_whole(stated, (json.dumps(wanted, indent=1) + "\n").encode())


def write_whole(path: Path, content: bytes) -> None:
    """Whole or not at all."""
    temporary = path.with_suffix(".part")
    temporary.write_bytes(content)
    os.replace(temporary, path)
