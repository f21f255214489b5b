"""Box worlds in rotorpy's JSON schema, metres, z up.

``{"bounds": {"extents": [x0, x1, y0, y1, z0, z1]}, "blocks": [{"extents": [...]}, ...]}``; other keys, such as the
colour of a block, are ignored.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxplan.errors import FileError
from jaxplan.world.formats.streams import ByteStream
from jaxplan.world.obstacles import DEFAULT_KEEP_IN, World, aligned_boxes, make_obstacles

MAX_BLOCKS = 10_000
"""Arbitrary."""

_SCHEMA = '{"bounds": {"extents": [x0, x1, y0, y1, z0, z1]}, "blocks": [{"extents": [...]}, ...]}'


def load_boxes(path: Path, stream: ByteStream) -> World:
    """The world of a rotorpy JSON file."""
    tree = _parse(path, stream.read())
    if not isinstance(tree, dict) or "bounds" not in tree or not isinstance(tree.get("blocks", []), list):
        raise FileError(f"{path}: have JSON that is not a box world, want {_SCHEMA}; see rotorpy's worlds")
    blocks = tree.get("blocks", [])
    if len(blocks) > MAX_BLOCKS:
        raise FileError(f"{path}: have {len(blocks)} blocks, want at most {MAX_BLOCKS}; merge some")
    room = _corners(path, "bounds", tree["bounds"])
    if not (room[1] - room[0] > 2.0 * DEFAULT_KEEP_IN).all():
        raise FileError(
            f"{path}: bounds span {(room[1] - room[0]).tolist()} m, want more than {2 * DEFAULT_KEEP_IN:g} m along "
            "each axis; give the room in metres"
        )
    corners = [_corners(path, f"blocks[{index}]", block) for index, block in enumerate(blocks)]
    boxes = aligned_boxes(np.array([c[0] for c in corners]), np.array([c[1] for c in corners]))
    return World(
        name=path.stem,
        bounds=room,
        obstacles=make_obstacles(boxes=boxes),
        keep_in=np.float64(DEFAULT_KEEP_IN),
        provenance=f"{path} (rotorpy boxes, {len(corners)} blocks)",
    )


def _parse(path: Path, data: bytes) -> Any:
    try:
        return json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else " ".join(str(error).split())
        raise FileError(f"{path}: have no JSON ({reason}), want {_SCHEMA}; write it again") from error


def _corners(path: Path, where: str, item: Any) -> Float[np.ndarray, "2 3"]:
    """Lower and upper corner [m] from an item's extents."""
    extents = item.get("extents") if isinstance(item, dict) else None
    if not isinstance(extents, list) or len(extents) != 6 or not all(_is_length(value) for value in extents):
        raise FileError(
            f"{path}: {where}: have extents {_brief(extents)}, want six finite metres "
            "[x0, x1, y0, y1, z0, z1]; correct them"
        )
    corners = np.array(extents, dtype=np.float64).reshape(3, 2).T
    if not (corners[0] < corners[1]).all():
        raise FileError(
            f"{path}: {where}: have extents {_brief(extents)}, want each lower end below its upper end "
            "[x0, x1, y0, y1, z0, z1]; swap them"
        )
    return corners


def _is_length(value: Any) -> bool:
    """A finite number of metres; the limit is arbitrary and far above any room."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and math.isfinite(value) and abs(value) < 1e6


def _brief(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
