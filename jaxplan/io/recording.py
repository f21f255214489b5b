"""A whole episode as one MCAP file, for Foxglove and any other reader of MCAP (host).

Made of the files of ``jaxplan intercept``. Messages are JSON; times are nanoseconds on the episode's clock. Needs the
package ``mcap`` (extra ``logs``).
"""

import io
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxplan.errors import FileError, JaxplanError, ResourceError
from jaxplan.files import read_limited
from jaxplan.io.cycles import SavedCycle, read_cycles
from jaxplan.io.files import Track, plain, read_tum
from jaxplan.io.foxglove import (
    Colour,
    Json,
    line,
    log,
    nanosecond,
    pose_in_frame,
    scene,
    solid,
    transform,
    vector,
)
from jaxplan.io.foxglove_schemas import SCHEMAS, cycle_schema
from jaxplan.io.plans import SavedCommitment, read_commitments
from jaxplan.io.world_scene import world_scene
from jaxplan.status import PlanStatus
from jaxplan.world.load import load_world

BODY = "defender"
"""The frame of the defender's body, forward, left, up."""
_DEFENDER: Colour = (0.12, 0.47, 0.71, 1.0)
_GOAL: Colour = (0.84, 0.15, 0.16, 0.6)
_PLAN_STEP = 0.02
"""Seconds between the points of a plan's line."""
_LARGEST = 1 << 20
"""Bytes of a JSON file."""
TOPICS = {
    "/tf": "foxglove.FrameTransform",
    "/defender": "foxglove.PoseInFrame",
    "/target": "foxglove.PoseInFrame",
    "/flight": "jaxplan.Flight",
    "/world": "foxglove.SceneUpdate",
    "/plan": "foxglove.SceneUpdate",
    "/committed": "jaxplan.Plan",
    "/cycle": "jaxplan.Cycle",
    "/log": "foxglove.Log",
}
"""What is in a recording, by the names of their schemas."""


class Entry(NamedTuple):
    """A message of a recording."""

    time: float
    """Seconds on the episode's clock."""
    topic: str
    message: Json


class Recorded(NamedTuple):
    """A recording's content, and what is not in it."""

    content: bytes
    messages: int
    warnings: tuple[str, ...]


class _Saved(NamedTuple):
    """What the files of an episode hold."""

    flown: Track
    target: Track
    commitments: list[SavedCommitment]
    cycles: list[SavedCycle]
    outcome: str
    world: Json | None


def record_episode(folder: Path) -> Recorded:
    """The files that ``jaxplan intercept`` left in a folder, as the content of an MCAP file.

    A world that cannot be read again and cycles that were not saved are left out, with a warning each.

    Raises:
        FileError: a file is missing, or holds something else. ResourceError: ``mcap`` is not installed.
    """
    try:
        from mcap.writer import Writer
    except ImportError as error:
        raise ResourceError("--format mcap needs mcap, which is not installed; pip install 'jaxplan[logs]'") from error
    saved, warnings = _read(folder)
    entries = sorted(_entries(saved), key=lambda entry: entry.time)
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start(profile="", library="jaxplan")
    known = SCHEMAS | {"jaxplan.Cycle": cycle_schema(cycle.stage_ms for cycle in saved.cycles)}
    schemas = {
        name: writer.register_schema(name, "jsonschema", json.dumps(schema).encode()) for name, schema in known.items()
    }
    channels = {topic: writer.register_channel(topic, "json", schemas[name]) for topic, name in TOPICS.items()}
    for time, topic, message in entries:
        content = json.dumps(message, allow_nan=False).encode()
        writer.add_message(channels[topic], nanosecond(time), content, nanosecond(time))
    writer.finish()
    return Recorded(stream.getvalue(), len(entries), tuple(warnings))


def _read(folder: Path) -> tuple[_Saved, list[str]]:
    """The files of an episode; a file that earlier versions did not write may be missing."""
    if not folder.is_dir():
        raise FileError(f"{folder}: is no folder; want the one that jaxplan intercept wrote, for --format mcap")
    warnings, cycles, world = [], [], None
    flown, target = read_tum(folder / "flown.csv"), read_tum(folder / "target.csv")
    commitments = read_commitments(folder)
    outcome, room = (
        _json(folder / name).get(key) for name, key in (("metrics.json", "outcome"), ("config.json", "world"))
    )
    if (folder / "cycles.npz").exists():
        cycles = read_cycles(folder / "cycles.npz", len(commitments))
    else:
        warnings.append("no cycles.npz in the folder: the numbers of the cycles are left out")
    try:
        world = world_scene(load_world(str(room)))
    except JaxplanError as error:
        warnings.append(f"the world is left out: {error}")
    return _Saved(flown, target, commitments, cycles, str(outcome), world), warnings


def _json(path: Path) -> dict[str, Any]:
    content = read_limited(path, _LARGEST, "a file that jaxplan intercept wrote")
    try:
        return dict(json.loads(content))
    except (ValueError, TypeError, RecursionError) as error:
        raise FileError(f"{path}: is none of jaxplan intercept ({error}); give another folder") from error


def _entries(saved: _Saved) -> Iterator[Entry]:
    """Every message, topic by topic."""
    flown, target = saved.flown, saved.target
    if saved.world is not None:
        yield Entry(0.0, "/world", saved.world)
    for time, position, quat in zip(*flown, strict=True):
        yield Entry(time, "/tf", transform(time, BODY, position, quat))
        yield Entry(time, "/defender", pose_in_frame(time, position, quat))
    for time, position, quat in zip(*target, strict=True):
        yield Entry(time, "/target", pose_in_frame(time, position, quat))
    for time, own, other in zip(flown.times, flown.positions, target.positions, strict=False):
        yield Entry(time, "/flight", {"distance": float(np.linalg.norm(own - other))})
    for number, commitment in enumerate(saved.commitments):
        yield from _committed(number, commitment)
    for cycle in saved.cycles:
        yield Entry(cycle.time, "/cycle", _numbers(cycle))
    yield Entry(float(flown.times[-1]), "/log", log(float(flown.times[-1]), f"the episode ends: {saved.outcome}"))


def _numbers(cycle: SavedCycle) -> Json:
    """What a cycle came to; ``rejected`` counts reasons, of which a candidate may have several."""
    counts = {"chosen": cycle.chosen, "generated": cycle.generated, "rejected": sum(cycle.rejected.values())}
    seconds = {"deviation": cycle.deviation, "latency": cycle.latency, "sooner": cycle.sooner}
    computed = {f"{station}_ms": took for station, took in cycle.stage_ms.items()}
    total = {"computed_ms": sum(cycle.stage_ms.values())}
    status = PlanStatus(cycle.status).name.lower()
    return dict(plain({"time": cycle.time, "status": status, **counts, **seconds, **total, **computed}))


def _committed(number: int, commitment: SavedCommitment) -> Iterator[Entry]:
    """A plan as a line to its end and a ball at its goal, its numbers, and a word."""
    start, spline, goal = commitment.start_time, commitment.spline, np.array(commitment.goal)
    count = max(math.ceil(float(spline.duration) / _PLAN_STEP), 1) + 1
    points = np.asarray(spline.sample(count)[1])[:, :3]
    status = PlanStatus(commitment.status).name.lower()
    parts = {"lines": [line(points, _DEFENDER)]}
    if np.isfinite(goal).all():
        parts["spheres"] = [solid(goal, None, np.full(3, 0.2), _GOAL)]
    yield Entry(start, "/plan", scene(start, "plan", **parts))
    numbers: Json = {
        "duration": float(spline.duration),
        "arrival_time": commitment.arrival_time,
        "alpha": commitment.alpha,
    }
    numbers |= {"probability": commitment.probability, "goal": vector(goal)}
    yield Entry(start, "/committed", plain({"number": number, "status": status, **numbers}))
    yield Entry(start, "/log", log(start, f"plan {number} takes over: {status}"))
