"""JSON schemas of the messages in a recording: Foxglove's by its names, and three tables of numbers of our own."""

from collections.abc import Iterable
from typing import Any

from jaxplan.io.foxglove import KINDS

Json = dict[str, Any]

_NUMBER, _WHOLE = {"type": "number"}, {"type": "integer"}
_TEXT, _YES = {"type": "string"}, {"type": "boolean"}


def _object(**properties: Json) -> Json:
    return {"type": "object", "properties": properties}


def _list(of: Json) -> Json:
    return {"type": "array", "items": of}


def _numbers(*names: str) -> Json:
    return _object(**dict.fromkeys(names, _NUMBER))


_TIME = _object(sec=_WHOLE, nsec=_WHOLE)
_VECTOR, _QUATERNION, _COLOUR = _numbers(*"xyz"), _numbers(*"xyzw"), _numbers(*"rgba")
_POSE = _object(position=_VECTOR, orientation=_QUATERNION)
_SOLID: dict[str, Json] = {"pose": _POSE, "size": _VECTOR, "color": _COLOUR}
_POINTS: dict[str, Json] = {"pose": _POSE, "points": _list(_VECTOR), "color": _COLOUR, "colors": _list(_COLOUR)}
_PARTS: dict[str, Json] = {
    "cubes": _object(**_SOLID),
    "spheres": _object(**_SOLID),
    "cylinders": _object(**_SOLID, bottom_scale=_NUMBER, top_scale=_NUMBER),
    "lines": _object(**_POINTS, type=_WHOLE, thickness=_NUMBER, scale_invariant=_YES, indices=_list(_WHOLE)),
    "triangles": _object(**_POINTS, indices=_list(_WHOLE)),
}
_ENTITY = _object(
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_TIME,
    frame_locked=_YES,
    metadata=_list(_object(key=_TEXT, value=_TEXT)),
    **{kind: _list(_PARTS.get(kind, _object())) for kind in KINDS},
)

SCHEMAS: dict[str, Json] = {
    "foxglove.PoseInFrame": _object(timestamp=_TIME, frame_id=_TEXT, pose=_POSE),
    "foxglove.FrameTransform": _object(
        timestamp=_TIME,
        parent_frame_id=_TEXT,
        child_frame_id=_TEXT,
        translation=_VECTOR,
        rotation=_QUATERNION,
    ),
    "foxglove.SceneUpdate": _object(
        deletions=_list(_object(timestamp=_TIME, type=_WHOLE, id=_TEXT)), entities=_list(_ENTITY)
    ),
    "foxglove.Log": _object(timestamp=_TIME, level=_WHOLE, message=_TEXT, name=_TEXT, file=_TEXT, line=_WHOLE),
    "jaxplan.Plan": _object(
        number=_WHOLE,
        status=_TEXT,
        goal=_VECTOR,
        duration=_NUMBER,
        arrival_time=_NUMBER,
        alpha=_NUMBER,
        probability=_NUMBER,
    ),
    "jaxplan.Flight": _object(distance=_NUMBER),
}
"""By the name under which a viewer knows them; ``jaxplan.Cycle`` besides."""


def cycle_schema(stages: Iterable[Iterable[str]]) -> Json:
    """``jaxplan.Cycle``: what a cycle came to, and the milliseconds of each of its stages.

    ``stages`` are those of every cycle.
    """
    names = [*_CYCLE, *dict.fromkeys(f"{name}_ms" for some in stages for name in some)]
    return _object(**{name: _TEXT if name == "status" else _NUMBER for name in names})


_CYCLE = ("time", "status", "chosen", "generated", "rejected", "deviation", "latency", "sooner", "computed_ms")
"""s; the name of a ``jaxplan.status.PlanStatus``; an index or -1; counts; m, s, s; ms in all."""
