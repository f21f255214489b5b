"""What can be asked for by name, and whether there is such a thing: known without JAX, in milliseconds.

The loaders ask here, and so does the command line before it imports anything slow: a typo is answered at once, in the
same words.
"""

import difflib
import json
import os
from collections.abc import Iterable
from pathlib import Path

from jaxplan.errors import FileError, InputError

_PACKAGE = Path(__file__).parent

ENVIRONMENTS = ("env1", "env2", "env3")
"""Names of the stored worlds."""
MAP_ENDINGS = (".xml", ".stl", ".obj", ".ply", ".pcd", ".npy", ".npz", ".bt", ".json")
"""Of the files that a world can be read from."""
SHIPPED = {
    "policy": _PACKAGE / "policy" / "weights",
    "placing policy": _PACKAGE / "policy" / "placing_weights",
    "classifier": _PACKAGE / "feasibility" / "weights",
    "flight network": _PACKAGE / "prediction" / "mdn" / "weights",
}
"""Where the weights are that come with the library, by their kind."""


def meant(name: object, known: Iterable[str]) -> str:
    """``; did you mean 'env1'?`` where one of the known names is near, else nothing."""
    near = difflib.get_close_matches(str(name), list(known), n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


def stored_targets(world: str) -> list[str]:
    """Names of the trajectories stored for a world, in order; none for a world from a file."""
    path = _PACKAGE / "world" / "environments" / f"{world}_targets.json"
    return list(json.loads(path.read_text())["trajectories"]) if os.path.isfile(path) else []


def list_presets() -> list[str]:
    """The names of the vehicle presets, sorted."""
    return sorted(path.stem for path in (_PACKAGE / "vehicle" / "presets").glob("*.toml"))


def require_world(name_or_path: str | Path) -> None:
    """Raise ``InputError`` where there is no such world, ``FileError`` where there is no such map."""
    if str(name_or_path) in ENVIRONMENTS:
        return
    path, endings = Path(name_or_path), ", ".join(MAP_ENDINGS)
    if path.suffix.lower() in MAP_ENDINGS:
        require_map(path)
    elif os.path.exists(path):
        raise FileError(f"{path}: have the ending {path.suffix!r}, want one of {endings}; convert the map")
    else:
        raise InputError(
            f"world: have {str(name_or_path)!r}, want a stored world ({', '.join(ENVIRONMENTS)}) or a file ending in "
            f"{endings}{meant(name_or_path, ENVIRONMENTS) or '; check the name'}"
        )


def require_map(path: Path) -> None:
    """Raise ``FileError`` unless it is a regular file."""
    if not os.path.isfile(path):
        have = "no such file" if not os.path.exists(path) else "something that is not a file"
        raise FileError(f"{path}: {have}, want a readable map; check the path")


def require_target(name_or_path: str | None, world: str) -> None:
    """Raise ``InputError`` where a world has no such target and there is no such file."""
    names = stored_targets(world)
    if name_or_path is None:
        if not names:
            raise InputError(f"target: world {world!r} has no stored trajectories; give --target a recorded flight")
    elif name_or_path not in names and not Path(name_or_path).suffix and not os.path.exists(name_or_path):
        known = f"want one of {', '.join(names)} or a file" if names else "want a file"
        raise InputError(f"target: unknown name {name_or_path!r}, {known}{meant(name_or_path, names)}")


def require_vehicle(name_or_path: str | Path) -> None:
    """Raise ``InputError`` where there is no such preset, ``FileError`` where there is no such file."""
    path, presets = Path(name_or_path), list_presets()
    if path.suffix or path.parent != Path("."):
        if not os.path.isfile(path):
            raise FileError(f"Cannot read the vehicle file {path} (no such file): give the path of a readable file.")
    elif str(name_or_path) not in presets:
        raise InputError(
            f"There is no vehicle preset {str(name_or_path)!r}: use one of {', '.join(presets)}, or the path of a "
            f".toml file{meant(name_or_path, presets) or '.'}"
        )


def require_weights(source: str | Path, kind: str, folder: Path | None = None) -> None:
    """Raise ``FileError`` where there are neither shipped weights of this kind and name nor a file of this name."""
    names = sorted(file.stem for file in (folder or SHIPPED[kind]).glob("*.npz"))
    if str(source) not in names and not os.path.isfile(source):
        raise FileError(
            f"{kind} {str(source)!r}: neither a file nor a shipped {kind} ({', '.join(names) or 'none'})"
            f"{meant(source, names) or '; correct the name'}"
        )
