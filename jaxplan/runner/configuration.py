"""Configurations as plain JSON: what is saved beside a result and read again."""

import dataclasses
import json
from pathlib import Path
from typing import Any, TypeVar

from jaxplan.errors import FileError, InputError

T = TypeVar("T")


def as_plain(config: Any) -> dict[str, Any]:
    """The fields of a configuration as JSON values."""
    return json.loads(json.dumps(dataclasses.asdict(config)))


def from_plain(kind: type[T], values: dict[str, Any]) -> T:
    """The configuration with these fields; lists become tuples. Raises ``InputError`` for unknown fields."""
    known = {field.name for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    unknown = sorted(set(values) - known)
    if unknown:
        raise InputError(f"configuration: unknown {', '.join(unknown)}, want {', '.join(sorted(known))}")
    return kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in values.items()})


def read_config(path: Path, name: str) -> tuple[str, dict[str, Any]]:
    """Preset and fields of a saved ``config.json`` of the experiment called ``name``.

    Raises:
        FileError: it cannot be read or is no configuration.
        InputError: it belongs to another experiment.
    """
    try:
        saved = json.loads(path.read_text(encoding="utf-8"))
        experiment, preset, values = saved["experiment"], str(saved["preset"]), dict(saved["config"])
    except (OSError, UnicodeDecodeError, ValueError, KeyError, TypeError) as error:
        raise FileError(f"{path}: cannot be read as an experiment's config.json; give one that a run wrote") from error
    if experiment != name:
        raise InputError(f"{path}: is of experiment {experiment!r}, want {name!r}; choose another file or folder")
    return preset, values
