"""Messages that Foxglove draws, as JSON, with the schemas by which it knows them (host).

Names and fields are those of Foxglove's own schemas (docs.foxglove.dev, message schemas); of each only what is used
here. World frame, z up, metres; colours from 0 to 1.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

Json = dict[str, Any]
Colour = tuple[float, float, float, float]
"""Red, green, blue and opacity."""

LINE_STRIP, LINE_LOOP = 0, 1
INFO = 2
"""Level of a ``foxglove.Log``."""
WORLD = "world"
"""The fixed frame."""


def stamp(seconds: float) -> Json:
    """An instant, or how long something lasts."""
    nanoseconds = nanosecond(seconds)
    return {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9}


def nanosecond(seconds: float) -> int:
    """Seconds as whole nanoseconds; nothing is before 0."""
    return max(round(1e9 * seconds), 0)


def vector(values: Float[np.ndarray, "3"]) -> Json:
    """A point, or the sides of a box."""
    return dict(zip("xyz", np.asarray(values, dtype=float).tolist(), strict=True))


def quaternion(quat_wxyz: Float[np.ndarray, "4"]) -> Json:
    """An attitude."""
    return dict(zip("wxyz", np.asarray(quat_wxyz, dtype=float).tolist(), strict=True))


def pose(position: Float[np.ndarray, "3"], quat_wxyz: Float[np.ndarray, "4"] | None = None) -> Json:
    """Where something is and how it is turned; not at all where nothing is said."""
    turned = np.array([1.0, 0.0, 0.0, 0.0]) if quat_wxyz is None else quat_wxyz
    return {"position": vector(position), "orientation": quaternion(turned)}


def colour(rgba: Colour) -> Json:
    """A colour."""
    return dict(zip("rgba", rgba, strict=True))


def pose_in_frame(time: float, position: Float[np.ndarray, "3"], quat_wxyz: Float[np.ndarray, "4"]) -> Json:
    """``foxglove.PoseInFrame`` in the world."""
    return {"timestamp": stamp(time), "frame_id": WORLD, "pose": pose(position, quat_wxyz)}


def transform(time: float, child: str, position: Float[np.ndarray, "3"], quat_wxyz: Float[np.ndarray, "4"]) -> Json:
    """``foxglove.FrameTransform`` from a body to the world."""
    frames = {"parent_frame_id": WORLD, "child_frame_id": child}
    return {
        "timestamp": stamp(time),
        **frames,
        "translation": vector(position),
        "rotation": quaternion(quat_wxyz),
    }


def log(time: float, text: str) -> Json:
    """``foxglove.Log``."""
    return {"timestamp": stamp(time), "level": INFO, "message": text, "name": "jaxplan", "file": "", "line": 0}


def line(points: Float[np.ndarray, "n 3"], rgba: Colour, kind: int = LINE_STRIP) -> Json:
    """A line of two pixels."""
    return {
        "type": kind,
        "pose": pose(np.zeros(3)),
        "thickness": 2.0,
        "scale_invariant": True,
        "points": [vector(point) for point in points],
        "color": colour(rgba),
        "colors": [],
        "indices": [],
    }


def solid(
    center: Float[np.ndarray, "3"], quat_wxyz: Float[np.ndarray, "4"] | None, size: Float[np.ndarray, "3"], rgba: Colour
) -> Json:
    """A cube or a sphere; a cylinder has ``ROUND`` besides."""
    return {"pose": pose(center, quat_wxyz), "size": vector(size), "color": colour(rgba)}


ROUND: Json = {"bottom_scale": 1.0, "top_scale": 1.0}
"""A cylinder that is no cone."""
KINDS = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
"""What a scene's entity is made of."""


def triangles(vertices: Float[np.ndarray, "n 3"], indices: Sequence[int], rgba: Colour) -> Json:
    """Triangles, three indices each."""
    return {
        "pose": pose(np.zeros(3)),
        "points": [vector(point) for point in vertices],
        "color": colour(rgba),
        "colors": [],
        "indices": list(indices),
    }


def scene(time: float, name: str, **parts: list[Json]) -> Json:
    """``foxglove.SceneUpdate`` that puts an entity in the place of the last one of this name.

    Args:
        time: when [s].
        name: of the entity.
        parts: some of ``KINDS``.
    """
    entity = {
        "timestamp": stamp(time),
        "frame_id": WORLD,
        "id": name,
        "lifetime": stamp(0.0),
        "frame_locked": False,
        "metadata": [],
        **{kind: parts.get(kind, []) for kind in KINDS},
    }
    return {"deletions": [], "entities": [entity]}
