"""What the planner's process and its pilot tell each other, as bytes of fixed layout."""

import json
import struct
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.replanner import Cycle, Measured
from jaxplan.runtime.table import COLUMNS, DEGREES, PlanHead, PlanTable
from jaxplan.status import Note, PlanStatus

MOST_PIECES = 32
"""Of a plan; twice what the planner's longest have."""
_PLAN = struct.Struct("<4q7d")
"""``PlanHead``."""
PLAN_BYTES = _PLAN.size + 8 * MOST_PIECES * (1 + DEGREES * COLUMNS)
_SAMPLE = struct.Struct("<4d")
SAMPLE_BYTES = _SAMPLE.size
_ODOMETRY = struct.Struct("<14d")
ODOMETRY_BYTES = _ODOMETRY.size
_ANSWER = struct.Struct("<2q")
ANSWER_BYTES = _ANSWER.size
REPORT_BYTES = 8192
CHANGE_BYTES = 1024


class Answer(NamedTuple):
    """What the pilot has made of the plans so far."""

    seen: int
    """The newest that it has looked at."""
    accepted: int
    """The newest that it flies, or is going to fly."""


class Odometry(NamedTuple):
    """The vehicle at one instant."""

    time: float
    """[s]"""
    measured: Measured


def pack_plan(table: PlanTable) -> bytes:
    """Raises ``ValueError`` for a plan of more pieces than fit."""
    if len(table.durations) > MOST_PIECES:
        raise ValueError(f"runtime: a plan has {len(table.durations)} pieces, want at most {MOST_PIECES}")
    *numbers, goal = table.head
    return _PLAN.pack(*numbers, *goal) + table.durations.tobytes() + table.table.tobytes()


def unpack_plan(message: bytes) -> PlanTable:
    """The inverse of ``pack_plan``."""
    number, predecessor, status, measured, start, arrival, alpha, probability, *goal = _PLAN.unpack_from(message)
    head = PlanHead(
        number, predecessor, status, measured, start, arrival, alpha, probability, (goal[0], goal[1], goal[2])
    )
    values = np.frombuffer(message, offset=_PLAN.size)
    pieces = len(values) // (1 + DEGREES * COLUMNS)
    return PlanTable(head, values[:pieces], values[pieces:].reshape(pieces, DEGREES, COLUMNS))


def pack_sample(time: float, position: Float[np.ndarray, "3"]) -> bytes:
    """Where the target was seen [s, m]."""
    return _SAMPLE.pack(time, *position.tolist())


def unpack_sample(message: bytes) -> tuple[float, Float[np.ndarray, "3"]]:
    """The inverse of ``pack_sample``."""
    time, *position = _SAMPLE.unpack(message)
    return time, np.array(position)


def pack_odometry(odometry: Odometry) -> bytes:
    """What is not known becomes NaN."""
    parts = [_or_nan(part, 4 if name == "attitude" else 3) for name, part in odometry.measured._asdict().items()]
    return _ODOMETRY.pack(odometry.time, *np.concatenate(parts).tolist())


def unpack_odometry(message: bytes) -> Odometry:
    """The inverse of ``pack_odometry``."""
    time, *values = _ODOMETRY.unpack(message)
    position, velocity, acceleration, attitude = np.split(np.array(values), [3, 6, 9])
    return Odometry(time, Measured(position, velocity, _or_none(acceleration), _or_none(attitude)))


def _or_nan(values: Float[np.ndarray, "n"] | None, count: int) -> Float[np.ndarray, "n"]:
    return np.full(count, np.nan) if values is None else values


def _or_none(values: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"] | None:
    return values if np.isfinite(values).all() else None


def pack_answer(answer: Answer) -> bytes:
    """What the pilot says of the plans."""
    return _ANSWER.pack(*answer)


def unpack_answer(message: bytes) -> Answer:
    """The inverse of ``pack_answer``."""
    return Answer(*_ANSWER.unpack(message))


def pack_json(values: dict[str, Any], most: int) -> bytes:
    """Plain JSON; what is longer than ``most`` bytes loses its details to a note."""
    message = json.dumps(values).encode()
    return message if len(message) <= most else json.dumps({"reason": "a report was too long"}).encode()


def unpack_json(message: bytes) -> dict[str, Any]:
    """The inverse of ``pack_json``."""
    return dict(json.loads(message))


def cycle_as_json(cycle: Cycle) -> dict[str, Any]:
    """A cycle without its candidates."""
    return {
        "time": cycle.time,
        "status": int(cycle.status),
        "stage_ms": cycle.stage_ms,
        "generated": cycle.generated,
        "rejected": cycle.rejected,
        "jump": None if cycle.jump is None else np.asarray(cycle.jump).tolist(),
        "note": int(cycle.note),
        "refused": cycle.refused,
        "deviation": cycle.deviation,
        "latency": cycle.latency,
        "sooner": cycle.sooner,
    }


def cycle_from_json(values: dict[str, Any]) -> Cycle:
    """The inverse of ``cycle_as_json``: a cycle that does not know its candidates."""
    jump = values["jump"]
    return Cycle(
        time=values["time"],
        status=PlanStatus(values["status"]),
        plans=None,
        chosen=-1,
        stage_ms=values["stage_ms"],
        generated=values["generated"],
        rejected=values["rejected"],
        jump=None if jump is None else np.array(jump),
        note=Note(values["note"]),
        refused=values["refused"],
        deviation=values["deviation"],
        latency=values["latency"],
        sooner=values["sooner"],
    )
