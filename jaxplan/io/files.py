"""The small formats that results are written in: JSON and TUM trajectories."""

import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.errors import FileError, InternalError
from jaxplan.files import read_limited

TUM_HEADER = "timestamp tx ty tz qx qy qz qw"
_LARGEST_TRACK = 64 * 2**20
"""Bytes of a TUM file: an hour at 200 a second."""


class Track(NamedTuple):
    """Poses over time."""

    times: Float[np.ndarray, "n"]
    """Seconds."""
    positions: Float[np.ndarray, "n 3"]
    """Metres."""
    quat_wxyz: Float[np.ndarray, "n 4"]
    """Body to world."""


def write_json(path: Path, value: Any) -> None:
    """Write ``value`` as JSON that any reader accepts: numpy values as numbers and lists, NaN and inf as null."""
    text = json.dumps(plain(value), indent=2, allow_nan=False, ensure_ascii=False)
    Path(path).write_text(text + "\n", encoding="utf-8")


def write_tum(
    path: Path, times: Float[np.ndarray, "n"], positions: Float[np.ndarray, "n 3"], quat_wxyz: Float[np.ndarray, "n 4"]
) -> None:
    """Write a trajectory in TUM's format: s, m (world, z up), and the body's attitude as xyzw, space separated."""
    if not all(np.isfinite(part).all() for part in (times, positions, quat_wxyz)):
        raise InternalError(f"the trajectory for {Path(path).name!r} has NaN or infinite values; please report this")
    Path(path).write_text(tum_text(times, positions, quat_wxyz), encoding="utf-8")


def tum_text(
    times: Float[np.ndarray, "n"], positions: Float[np.ndarray, "n 3"], quat_wxyz: Float[np.ndarray, "n 4"]
) -> str:
    """The content of a TUM file, with a header that its readers skip."""
    table = np.column_stack([times, positions, np.roll(np.asarray(quat_wxyz, dtype=float), -1, axis=-1)])
    return "\n".join([f"# {TUM_HEADER}", *(" ".join(f"{value:.9f}" for value in row) for row in table), ""])


def read_tum(path: Path) -> Track:
    """The poses in a TUM file, as ``write_tum`` writes them.

    Raises:
        FileError: there is no such file, or it holds something else.
    """
    content = read_limited(path, _LARGEST_TRACK, "poses as TUM has them")
    try:
        rows = [line.split() for line in content.decode().splitlines() if not line.startswith("#")]
        table = np.array(rows, dtype=float)
        if table.ndim != 2 or table.shape[1] != 8 or not np.isfinite(table).all():
            raise ValueError("rows of eight finite numbers are wanted")
    except ValueError as error:
        raise FileError(f"{path}: is no TUM file ({error}); give another one") from error
    return Track(table[:, 0], table[:, 1:4], np.roll(table[:, 4:], 1, axis=-1))


def plain(value: Any) -> Any:
    """``value`` made of nothing but what JSON knows; NaN and infinity become None."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic) or hasattr(value, "__array__"):
        return plain(np.asarray(value).tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    return value
