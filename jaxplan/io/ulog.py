"""PX4's flight logs (ULog, docs.px4.io/main/en/dev_log/ulog_file_format) as a target's flight.

pyulog (extra ``logs``) reads what is wanted of a log. It is handed a log that holds one topic and nothing else: so a
damaged or hostile file costs no more memory than it has bytes.
"""

import contextlib
import io
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxplan.errors import FileError, InputError, ResourceError
from jaxplan.files import read_limited
from jaxplan.io.log_columns import SECONDS, LogFormat
from jaxplan.io.logged import Logged, tidied

MAGIC = b"ULog\x01\x12\x35"
LARGEST_ULOG = 512 * 2**20
_HEADER = 16
_SYNC = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
_MOST_FIELDS = 4096
"""Values in a message, arrays and nested messages written out (arbitrary; a message has 65,533 bytes at most)."""
_APPENDED = 1
"""The one incompatible flag that is understood: that data was appended, after the vehicle had crashed."""
_KINDS = b"BFIMPQALCDRSO"
"""Messages that a log is made of."""
_PLAIN = {"float", "double", "bool", "char"} | {
    f"{kind}{bits}_t" for kind in ("int", "uint") for bits in (8, 16, 32, 64)
}
POSITIONS = {
    "vehicle_local_position": ("x", "y", "z"),
    "vehicle_odometry": ("position[0]", "position[1]", "position[2]"),
    "vehicle_visual_odometry": ("position[0]", "position[1]", "position[2]"),
    "vehicle_local_position_groundtruth": ("x", "y", "z"),
}
"""Topics that say where a vehicle is, the first one first, and the fields that do; all of them north, east, down."""
_VALID = ("xy_valid", "z_valid")
_POSE_FRAME_NED = 1


class _Topic(NamedTuple):
    """One instance of a topic."""

    name: str
    instance: int

    def __str__(self) -> str:
        return f"{self.name}[{self.instance}]" if self.instance else self.name


class _Outline(NamedTuple):
    """What a log holds, without its data."""

    formats: dict[str, bytes]
    """Definitions, whole, by name."""
    topics: dict[_Topic, tuple[int, bytes]]
    """Number and subscription, whole, of each."""
    notes: list[str]


def read_ulog(path: Path, how: LogFormat) -> Logged:
    """Where a vehicle was, of the topic that ``how.columns`` names or of the first that says so (``POSITIONS``).

    Columns are ``topic.field`` or ``topic[instance].field``, or ``field`` of that first topic.

    Raises:
        FileError: it is no ULog, or holds no such topic. InputError: it holds no such field, or no flight.
        ResourceError: pyulog is not installed.
    """
    content = read_limited(path, LARGEST_ULOG, "a ULog file")
    outline = _outline(content)
    topic, fields = _choice(outline, how.columns)
    data = _data(content, outline, topic)
    missing = [field for field in fields if field not in data]
    if missing:
        raise InputError(f"--columns: {topic} has no {missing[0]!r}, want one of {', '.join(data)[:200]}")
    table = np.column_stack([np.asarray(data[field], dtype=float) for field in fields])
    positions, notes = table[:, 1:], list(outline.notes)
    if how.columns is None:
        valid = np.ones(len(positions), dtype=bool)
        for flag in _VALID:
            valid &= np.asarray(data.get(flag, valid), dtype=bool)
        positions = np.where(valid[:, None], positions, np.nan)
    if how.frame is None and "pose_frame" in data and (np.asarray(data["pose_frame"]) != _POSE_FRAME_NED).any():
        raise InputError(f"{topic}: its axes do not all point north, east, down (pose_frame); give --frame ned or enu")
    return tidied(table[:, 0] * SECONDS[how.time_unit or "us"], positions, str(topic), how.frame or "ned", notes)


def _outline(content: bytes) -> _Outline:
    """Definitions and subscriptions."""
    formats: dict[str, bytes] = {}
    topics: dict[_Topic, tuple[int, bytes]] = {}
    end = _HEADER
    for kind, begin, end in _messages(content):
        if kind == b"F":
            name = content[begin + 3 : end].partition(b":")[0].decode(errors="replace")
            formats.setdefault(name, content[begin:end])
        elif kind == b"B" and int.from_bytes(content[begin + 11 : min(begin + 19, end)], "little") > _APPENDED:
            raise FileError("it says of itself that it cannot be read by who does not know how (incompatible flags)")
        elif kind == b"A" and end - begin > 6:
            instance, number = struct.unpack_from("<BH", content, begin + 3)
            name = content[begin + 6 : end].decode(errors="replace")
            topics.setdefault(_Topic(name, instance), (number, content[begin:end]))
    cut = len(content) - end
    return _Outline(formats, topics, [f"the last {cut} bytes are damaged or cut off"] if cut else [])


def _messages(content: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Kind, begin and end of every whole message; behind a damaged place it goes on at the next mark."""
    at = _HEADER
    while at + 3 <= len(content):
        size, kind = struct.unpack_from("<Hc", content, at)
        end = at + 3 + size
        if size and kind in _KINDS and end <= len(content):
            yield kind, at, end
            at = end
            continue
        found = content.find(_SYNC, at)
        if found < 0:
            return
        at = found + len(_SYNC)


def _choice(outline: _Outline, columns: tuple[str, ...] | None) -> tuple[_Topic, list[str]]:
    """A topic, and its fields for time, x, y and z."""
    usual = next((topic for name in POSITIONS for topic in sorted(outline.topics) if topic.name == name), None)
    if columns is None:
        if usual is None:
            have = ", ".join(sorted({topic.name for topic in outline.topics}))[:200] or "none"
            raise FileError(f"have topics {have}, want {' or '.join(POSITIONS)}; name another one by --columns")
        return usual, ["timestamp", *POSITIONS[usual.name]]
    pairs = [_named(column, outline, usual) for column in columns]
    topics = sorted({topic for topic, _ in pairs})
    if len(topics) != 1:
        raise InputError(f"--columns: have topics {', '.join(map(str, topics))}, want all columns of one")
    return topics[0], [field for _, field in pairs]


def _named(column: str, outline: _Outline, usual: _Topic | None) -> tuple[_Topic, str]:
    """The topic and the field that a column's name means."""
    split = re.match(r"(?P<name>\w+?)(\[(?P<instance>\d{1,3})\])?\.(?P<field>.+)", column)
    if split is not None:
        topic = _Topic(split["name"], int(split["instance"] or 0))
        if topic in outline.topics:
            return topic, split["field"]
    if split is None and usual is not None:
        return usual, column
    have = ", ".join(sorted(map(str, outline.topics)))[:200]
    raise InputError(f"--columns: have {column!r}, want topic.field of {have}")


def _data(content: bytes, outline: _Outline, topic: _Topic) -> dict[str, Any]:
    """The values of a topic by field, as pyulog has them."""
    try:
        from pyulog import ULog
    except ImportError as error:
        raise ResourceError("a ULog needs pyulog, which is not installed; pip install 'jaxplan[logs]'") from error
    number, subscription = outline.topics[topic]
    wanted = struct.pack("<H", number)
    reduced = bytearray(b"".join([content[:_HEADER], *_needed(outline.formats, topic.name), subscription]))
    for kind, begin, end in _messages(content):
        if kind == b"D" and content[begin + 3 : begin + 5] == wanted:
            reduced += content[begin:end]
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            found = ULog(io.BytesIO(reduced)).data_list
    except Exception as error:  # whatever a damaged log raises
        raise FileError(f"{topic} cannot be read ({type(error).__name__}: {error})") from error
    if not found:
        raise FileError(f"{topic} is announced and has no data; name another topic by --columns")
    return dict(found[0].data)


def _needed(formats: dict[str, bytes], name: str) -> list[bytes]:
    """The definitions that a topic is made of. Raises ``FileError`` where one is missing, endless or too large."""
    counted: dict[str, int] = dict.fromkeys(_PLAIN, 1)

    def count(kind: str, above: tuple[str, ...]) -> int:
        """Values in a message of this kind."""
        if kind not in counted:
            if kind not in formats or kind in above:
                what = "endless" if kind in above else "missing"
                raise FileError(f"the definition of {name} is damaged: {kind[:40]!r} is {what}")
            counted[kind] = sum(times * count(base, (*above, kind)) for base, times in _fields(formats[kind]))
        if counted[kind] > _MOST_FIELDS:
            raise FileError(f"the definition of {name} has more than {_MOST_FIELDS} values; want a topic of fewer")
        return counted[kind]

    count(name, ())
    return [formats[kind] for kind in counted if kind not in _PLAIN]


def _fields(definition: bytes) -> Iterator[tuple[str, int]]:
    """The type of each field of a definition, and how many of it."""
    for field in definition[3:].decode(errors="replace").partition(":")[2].split(";"):
        base, _, size = field.split(" ")[0].partition("[")
        digits = size.rstrip("]")[:9]
        if base:
            yield base, int(digits) if digits.isdecimal() else 1
