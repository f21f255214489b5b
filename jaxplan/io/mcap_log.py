"""Recordings in MCAP (ROS 2's bags, Foxglove's, our own) as a target's flight.

Needs the extra ``logs``: ``mcap`` for the records (``mcap_records``), ``mcap_ros2`` for messages of ROS 2; messages in
JSON are read as well. A damaged or hostile file costs bounded memory.
"""

import json
import re
from array import array
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxplan.errors import FileError, InputError, ResourceError
from jaxplan.io.log_columns import SECONDS, LogFormat
from jaxplan.io.logged import Logged, tidied
from jaxplan.io.mcap_records import CHANNEL, MESSAGE, SCHEMA, records_of

LARGEST_MCAP = 16 * 2**30
_LARGEST_MESSAGE = 1 << 20
"""Bytes; a message that says where something is is smaller (arbitrary)."""
_MOST_SAMPLES = 10_000_000
_MOST_CHANNELS = 10_000
_LONGEST_NAME = 1000
_SCHEMAS = 64 * 2**20
"""Bytes of all schemas together (arbitrary)."""
PLACES = ("pose.pose.position", "pose.position", "position", "point", "transform.translation", "translation", "")
"""Where in a message its position may stand, the first that is there."""
_STAMPS = ("header.stamp", "timestamp", "stamp")
LOG_TIME = "log_time"
"""The name of the time at which a message was recorded."""
_LISTS = re.compile(r"^\s*(?P<kind>[\w/]+)\[(?P<size>[^\]]*)\]", re.MULTILINE)
_PLAIN = {"bool", "byte", "char", "string", "wstring", "float32", "float64"}
_PLAIN |= {f"{kind}{bits}" for kind in ("int", "uint") for bits in (8, 16, 32, 64)}


class _Channel(NamedTuple):
    """A topic, and how its messages are read."""

    topic: str
    schema: str
    decode: Callable[[bytes], Any]


class _Place(NamedTuple):
    """Where in a message time and place stand."""

    time: str
    axes: tuple[str, str, str]


class _Where(NamedTuple):
    """Where in the messages of a channel time and place stand."""

    number: int
    channel: _Channel
    time: str
    axes: tuple[str, str, str]


def read_mcap(path: Path, how: LogFormat) -> Logged:
    """Where something was, of the topic that ``how.columns`` names, or of the only one that says so.

    Columns are ``topic.field``, with dots or slashes between fields; time may be ``log_time``.

    Raises:
        FileError: it is no MCAP, is damaged, or holds no such topic. InputError: it holds no such field, or no flight.
        ResourceError: mcap is not installed.
    """
    try:
        import mcap.records  # noqa: F401
    except ImportError as error:
        raise ResourceError("an MCAP needs mcap, which is not installed; pip install 'jaxplan[logs]'") from error
    notes: list[str] = []
    channels, places = _survey(path, notes)
    where = _named(channels, how.columns) if how.columns else _found(channels, places)
    scale = None if how.time_unit is None else SECONDS[how.time_unit]
    values = array("d")
    for log_time, message in _messages(path, where):
        values.append(_seconds(message, log_time, where.time, scale))
        values.extend([_number(message, axis) for axis in where.axes])
    table = np.frombuffer(values, float).reshape(-1, 4)
    known = "ned" if where.channel.schema.startswith("px4_msgs") else "enu"
    named = f"{where.channel.topic} ({where.channel.schema or 'without a schema'}) by {where.time}"
    return tidied(table[:, 0], table[:, 1:], named, how.frame or known, notes)


def _survey(path: Path, notes: list[str]) -> tuple[dict[int, _Channel], dict[int, _Place]]:
    """The channels whose messages can be read, and where in their first message something is said to be."""
    schemas: dict[int, Any] = {}
    channels: dict[int, _Channel] = {}
    places: dict[int, _Place] = {}
    looked: set[int] = set()
    for kind, record in records_of(path, notes):
        if kind == SCHEMA and record.id not in schemas:
            schemas[record.id] = record
            if sum(len(schema.data) for schema in schemas.values()) > _SCHEMAS:
                raise FileError(f"has schemas of more than {_SCHEMAS} bytes; is it damaged?")
        elif kind == CHANNEL and record.id not in channels and len(record.topic) <= _LONGEST_NAME:
            schema = schemas.get(record.schema_id)
            decode = _decoder(record.message_encoding, schema) if len(channels) < _MOST_CHANNELS else None
            if decode is not None:
                channels[record.id] = _Channel(record.topic, "" if schema is None else schema.name, decode)
        elif kind == MESSAGE and record.channel_id in channels and record.channel_id not in looked:
            looked.add(record.channel_id)
            place = _place(channels[record.channel_id], record.data)
            if place is not None:
                places[record.channel_id] = place
    return channels, places


def _messages(path: Path, where: _Where) -> Iterator[tuple[int, Any]]:
    """When each message of a channel was recorded [ns], and what it says."""
    count = 0
    for kind, record in records_of(path, []):
        if kind == MESSAGE and record.channel_id == where.number:
            count += 1
            if count > _MOST_SAMPLES:
                raise FileError(f"{where.channel.topic}: has more than {_MOST_SAMPLES} messages; cut it first")
            yield record.log_time, _decoded(where.channel, record.data)


def _decoded(channel: _Channel, content: bytes) -> Any:
    if len(content) > _LARGEST_MESSAGE:
        raise FileError(f"{channel.topic}: has a message of {len(content)} bytes, want at most {_LARGEST_MESSAGE}")
    try:
        return channel.decode(content)
    except Exception as error:  # whatever a damaged message raises
        raise FileError(f"{channel.topic}: has a message that cannot be read ({type(error).__name__})") from error


def _decoder(encoding: str, schema: Any) -> Callable[[bytes], Any] | None:
    """What reads the messages of a channel; None where nothing here does."""
    if encoding == "json":
        return json.loads
    if encoding != "cdr" or schema is None or schema.encoding != "ros2msg":
        return None
    text = schema.data.decode(errors="replace")
    # A list of messages may state more of them than the file has bytes; nothing that says where it is has one.
    if any(found["kind"] not in _PLAIN for found in _LISTS.finditer(text)):
        return None
    try:
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as error:
        raise ResourceError(
            "an MCAP of ROS 2 needs mcap-ros2-support, which is not installed; pip install 'jaxplan[logs]'"
        ) from error
    try:
        return DecoderFactory().decoder_for(encoding, schema)
    except Exception:  # whatever a damaged definition raises
        return None


def _found(channels: dict[int, _Channel], places: dict[int, _Place]) -> _Where:
    """The only channel that says where something is, or the only one that has ``target`` in its name."""
    named = [number for number in places if "target" in channels[number].topic.lower()]
    chosen = list(places) if len(places) == 1 else named
    topics = ", ".join(channels[number].topic for number in places)[:200]
    if len(chosen) != 1:
        have = f"several topics with positions: {topics}" if places else "no topic with a position that can be read"
        raise FileError(f"has {have}; name one by --columns log_time TOPIC.x TOPIC.y TOPIC.z")
    (number,) = chosen
    return _Where(number, channels[number], *places[number])


def _place(channel: _Channel, content: bytes) -> _Place | None:
    """Where a message says something is; None where it does not, or cannot be read."""
    try:
        message = _decoded(channel, content)
    except FileError:
        return None
    stamp = next((stamp for stamp in _STAMPS if _stamp(_dig(message, stamp), None) not in (None, 0.0)), LOG_TIME)
    for path in PLACES:
        for names in (("x", "y", "z"), ("0", "1", "2")):
            x, y, z = (f"{path}.{name}".lstrip(".") for name in names)
            if all(_is_number(_dig(message, axis)) for axis in (x, y, z)):
                return _Place(stamp, (x, y, z))
    return None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _as_float(number: float) -> float:
    """Infinite where it is beyond what a float holds: JSON's whole numbers have no end."""
    try:
        return float(number)
    except OverflowError:
        return np.inf


def _named(channels: dict[int, _Channel], columns: tuple[str, ...]) -> _Where:
    """The channel and the paths that columns name."""
    numbers: set[int] = set()
    paths: list[str] = []
    for column in columns:
        if column == LOG_TIME and not paths:
            paths.append(LOG_TIME)
            continue
        fitting = [n for n, channel in channels.items() if column[len(channel.topic) :][:1] in (".", "/")]
        fitting = [n for n in fitting if column.startswith(channels[n].topic)]
        if not fitting:
            have = ", ".join(sorted({channel.topic for channel in channels.values()}))[:200] or "none that can be read"
            raise InputError(f"--columns: have {column!r}, want {LOG_TIME}, or TOPIC.field of {have}")
        number = max(fitting, key=lambda n: len(channels[n].topic))
        numbers.add(number)
        paths.append(column[len(channels[number].topic) + 1 :].replace("/", "."))
    if len(numbers) != 1:
        raise InputError("--columns: have several topics, want all columns of one")
    (number,) = numbers
    return _Where(number, channels[number], paths[0], (paths[1], paths[2], paths[3]))


def _dig(message: Any, path: str) -> Any:
    """A field of a field of a message; None where there is none."""
    for name in path.split("."):
        if isinstance(message, dict):
            message = message.get(name)
        elif name.isdecimal():
            listed = not isinstance(message, str | bytes) and hasattr(message, "__len__")
            message = message[int(name)] if listed and int(name) < len(message) else None
        else:
            message = getattr(message, name, None)
    return message


def _number(message: Any, path: str) -> float:
    value = _dig(message, path)
    if not _is_number(value):
        raise InputError(f"--columns: have {path!r}, want a number in every message; one has {str(value)[:40]!r}")
    return _as_float(value)


def _seconds(message: Any, log_time: int, path: str, scale: float | None) -> float:
    """The time of a message; a bare number is in seconds, or what is told, or PX4's microseconds."""
    if path == LOG_TIME:
        return 1e-9 * log_time
    found = _stamp(_dig(message, path), scale)
    if found is None:
        raise InputError(f"--columns: have {path!r}, want a time in every message, or {LOG_TIME}")
    return found


def _stamp(value: Any, scale: float | None) -> float | None:
    """Seconds and nanoseconds, or a number; None for anything else."""
    seconds = _dig(value, "sec")
    if _is_number(seconds):
        nanoseconds = next((n for name in ("nanosec", "nsec") if isinstance(n := _dig(value, name), int)), 0)
        return _as_float(seconds) + 1e-9 * _as_float(nanoseconds)
    if _is_number(value):
        # Whole numbers are counts of PX4's clock.
        return _as_float(value) * (scale if scale is not None else 1e-6 if isinstance(value, int) else 1.0)
    return None
