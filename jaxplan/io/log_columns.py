"""Where time and position stand in a recorded flight, and in which units: headers as people have them.

Names are those of plain logs (``t,x,y,z``, ``timestamp tx ty tz``), ROS topics (``field.pose.position.x``, ``%time``),
PlotJuggler (``/odom/pose/pose/position/x``, ``__time``), cflib (``stateEstimate.x``) and PX4 (``timestamp`` beside
``xy_valid``). A unit in a header (``t [ms]``, ``x (mm)``, ``time_us``) counts; one that is not known is refused.
"""

import dataclasses
import re
from typing import NamedTuple

from jaxplan.config import FRAMES, TIME_UNITS, Frame, TimeUnit
from jaxplan.errors import InputError
from jaxplan.validation import checks_itself, require_one_of

WANT = "want t,x,y,z or timestamp tx ty tz in seconds and metres"
SECONDS = {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3}
SECONDS |= {"millisecond": 1e-3, "milliseconds": 1e-3, "us": 1e-6, "usec": 1e-6, "µs": 1e-6, "microseconds": 1e-6}
SECONDS |= {"ns": 1e-9, "nsec": 1e-9, "nanoseconds": 1e-9}
"""By the names of their units."""
_METRES = {"m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3}
_METRES |= {"ft": 0.3048, "feet": 0.3048}
_TIMES = ("t", "time", "timestamp", "stamp", "sec", "seconds", "%time", "__time", "rosbagtimestamp")
_AXES = {
    "x": ("x", "tx", "px", "p_x", "pos_x", "position[0]"),
    "y": ("y", "ty", "py", "p_y", "pos_y", "position[1]"),
    "z": ("z", "tz", "pz", "p_z", "pos_z", "position[2]"),
}
_PLACES = ("position", "pos", "point", "translation", "stateestimate", "pose")
"""What x, y and z may be of, where they are of something: not of a velocity."""
_UNIT = re.compile(r"^(?P<name>.*?)\s*[\[(]\s*(?P<unit>[^\])]*?)\s*[\])]$")
_PX4 = ("xy_valid", "timestamp_sample", "ref_timestamp")
"""Columns by which a log of PX4's local position is known: microseconds, north-east-down."""


@checks_itself
@dataclasses.dataclass(frozen=True)
class LogFormat:
    """What a file does not say of itself."""

    time_unit: TimeUnit | None = None
    """Of the times; None: what the header says, or seconds."""
    frame: Frame | None = None
    """ned: north, east, down; None: z up, unless the header or the log's format says otherwise."""
    columns: tuple[str, str, str, str] | None = None
    """Time, x, y and z by their names in the header, or by number from 1; by topic and field in a log with topics."""

    def __post_init__(self) -> None:
        if self.time_unit is not None:
            require_one_of("log", self, TIME_UNITS, "time_unit")
        if self.frame is not None:
            require_one_of("log", self, FRAMES, "frame")


class Layout(NamedTuple):
    """Four columns of a file."""

    places: tuple[int, int, int, int]
    """Of time, x, y and z, from 0."""
    scales: tuple[float, float, float, float]
    """By which their numbers become seconds and metres."""
    unit_stated: bool
    """Whether the header, or who reads it, said what time is counted in."""


class _Column(NamedTuple):
    place: int
    name: str
    """In lower case, without its unit."""
    unit: str | None


def layout_of(header: list[str] | None, how: LogFormat) -> Layout:
    """The layout of a file with this header, or with none.

    Raises:
        InputError: no such column, an unknown unit, or axes that the header says point elsewhere than is assumed.
    """
    named = [_column(place, field) for place, field in enumerate(header or [])]
    chosen = _chosen(named, how.columns) if how.columns else _found(named) if header else _first_four()
    time, *axes = chosen
    if how.frame is None and any(column.name in _PX4 for column in named):
        raise InputError(
            "the columns are PX4's, whose positions are north-east-down; give --frame ned, or enu if turned"
        )
    unit = how.time_unit or _time_unit(time, named)
    scales = (_scale(time, unit, SECONDS, "s"), *(_scale(axis, axis.unit, _METRES, "m") for axis in axes))
    return Layout(tuple(column.place for column in chosen), scales, unit is not None)  # type: ignore[arg-type]


def _first_four() -> list[_Column]:
    return [_Column(place, "", None) for place in range(4)]


def _column(place: int, field: str) -> _Column:
    """A field of the header; an index as in ``position[0]`` is no unit."""
    name = field.strip().lower()
    split = _UNIT.match(name)
    if split and not split["unit"].isdigit():
        return _Column(place, split["name"], split["unit"])
    base, _, suffix = name.rpartition("_")
    stands_for_unit = (base in _TIMES and suffix in SECONDS) or (_axis_of(base) is not None and suffix in _METRES)
    return _Column(place, base, suffix) if stands_for_unit else _Column(place, name, None)


def _axis_of(name: str) -> str | None:
    """The axis that a column is a position along; None for others."""
    *owners, last = re.split(r"[./]", name)
    if owners and owners[-1] not in ("", *_PLACES):
        return None
    return next((axis for axis, known in _AXES.items() if last in known), None)


def _is_time(name: str) -> bool:
    return name in _TIMES or name.endswith(("header.stamp", "header/stamp"))


def _found(named: list[_Column]) -> list[_Column]:
    """Time and axes by their names, the first of each."""
    found = {
        "time": [column for column in named if _is_time(column.name)],
        **{axis: [column for column in named if _axis_of(column.name) == axis] for axis in _AXES},
    }
    missing = [wanted for wanted, columns in found.items() if not columns]
    if missing:
        have = ", ".join(column.name for column in named)[:80]
        raise InputError(f"no column for {', '.join(missing)}; have {have!r}, {WANT}, or --columns that name them")
    return [columns[0] for columns in found.values()]


def _chosen(named: list[_Column], wanted: tuple[str, ...]) -> list[_Column]:
    """Columns by name or number."""
    found = []
    for name in wanted:
        if name.isdigit() and int(name) > 0:
            place = int(name) - 1
            found.append(named[place] if place < len(named) else _Column(place, "", None))
            continue
        bare = _column(0, name).name
        same = [column for column in named if column.name == bare]
        if not same:
            have = ", ".join(column.name for column in named)[:80] or "no header"
            raise InputError(f"--columns: have {name!r}, want a number from 1 or a name of the header; it has {have}")
        found.append(same[0])
    return found


def _time_unit(time: _Column, named: list[_Column]) -> str | None:
    """What the header says that time is counted in, by itself or by whose it is; None where it says nothing."""
    if time.unit is not None or not time.name:
        return time.unit
    if time.name in ("%time", "rosbagtimestamp") or time.name not in _TIMES:
        return "ns"
    if any(column.name in _PX4 for column in named):
        return "us"
    return "ms" if any(column.name.startswith("stateestimate") for column in named) else None


def _scale(column: _Column, unit: str | None, known: dict[str, float], usual: str) -> float:
    if (unit or usual) not in known:
        raise InputError(f"column {column.place + 1} is in {unit!r}, want one of {', '.join(known)}; convert it first")
    return known[unit or usual]
