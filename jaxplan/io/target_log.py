"""Recorded flights of a target: ``t,x,y,z`` or ``timestamp tx ty tz``, comma, semicolon or space separated.

Logs with many topics, PX4's (``ulog``) and MCAP (``mcap_log``), are known by their first bytes.

A header is optional (``log_columns`` knows many), ``#`` starts a comment, further columns (TUM's quaternion) are
ignored. What cannot be used is an error that names the line; what can be used but deserves a look is in the log's
``report``. Large files are read at NumPy's speed, and once more line by line where something is wrong.
"""

import dataclasses
import os
import warnings
from array import array
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np
from jaxtyping import Float

from jaxplan.errors import FileError, InputError
from jaxplan.io.log_columns import WANT, Layout, LogFormat, layout_of
from jaxplan.io.logged import Logged
from jaxplan.io.mcap_log import LARGEST_MCAP, read_mcap
from jaxplan.io.mcap_records import MAGIC as MCAP
from jaxplan.io.ulog import LARGEST_ULOG, read_ulog
from jaxplan.io.ulog import MAGIC as ULOG

_LARGEST_FILE = 256 * 2**20
_MOST_SAMPLES = 10_000_000
_GAP_FACTOR = 5.0
"""A pause longer than this many median sample intervals is a gap (arbitrary)."""
_JUMP_SPEED = 30.0
"""m/s; a step faster than this is a jump: no multirotor this library is for flies it (arbitrary)."""
_LONGEST_INTERVAL = 10.0
"""s; a longer median interval means that the times are not seconds, unless their unit is stated (arbitrary)."""
_SLOW_INTERVAL, _SLOW = 0.99, 0.02
"""s and m/s; so does one that is longer than the first, of a target that is mostly slower than the second (arbitrary):
100 samples a second in milliseconds look like 10 s apart."""


@dataclass(frozen=True)
class Gap:
    """A pause in the recording: it starts at ``time`` [s] and lasts ``duration`` [s]."""

    time: float
    duration: float


@dataclass(frozen=True)
class Jump:
    """A step of ``distance`` [m] right after ``time`` [s] at an implausible ``speed`` [m/s]."""

    time: float
    distance: float
    speed: float


@dataclass(frozen=True)
class LogReport:
    """What a recording is like."""

    samples: int
    rate_hz: float
    """One over the median sample interval."""
    duration: float
    """s"""
    gaps: tuple[Gap, ...]
    jumps: tuple[Jump, ...]
    chosen: str = ""
    """Of a log with many topics, which one was read and how."""

    def warnings(self) -> list[str]:
        """One sentence per kind of irregularity; empty for a clean recording."""
        found = []
        if self.gaps:
            longest = max(self.gaps, key=lambda gap: gap.duration)
            found.append(f"{len(self.gaps)} gaps, the longest {longest.duration:.3f} s at t = {longest.time:.3f} s")
        if self.jumps:
            worst = max(self.jumps, key=lambda jump: jump.speed)
            found.append(f"{len(self.jumps)} jumps, the fastest {worst.speed:.1f} m/s at t = {worst.time:.3f} s")
        return found


@dataclass(frozen=True)
class TargetLog:
    """A recorded flight: strictly increasing ``times`` [s, as in the file] and ``positions`` [m, world, z up]."""

    times: Float[np.ndarray, "n"]
    positions: Float[np.ndarray, "n 3"]
    report: LogReport


def read_target_log(path: str | Path, how: LogFormat | None = None) -> TargetLog:
    """Read a recorded flight.

    Raises:
        FileError: it cannot be used; the line is named. ResourceError: it is a log whose package is not installed.
    """
    path, how = Path(path), how or LogFormat()
    _check_file(path)
    binary = _binary(path)
    _check_size(path, binary.largest if binary else _LARGEST_FILE)
    if binary:
        return _from_binary(path, how, binary)
    with _opened(path) as stream:
        number, first = next(_rows(path, stream), (0, []))
        if not first:
            raise FileError(f"target file {str(path)!r}: have no data, {WANT}")
        header = None if any(_is_number(field) for field in first) else first
        try:
            layout = layout_of(header, how)
        except InputError as error:
            raise FileError(f"target file {str(path)!r}, line {number}: {error}") from error
    skipped = number if header else number - 1
    table = _at_once(path, layout, skipped)
    if table is None:
        table = _line_by_line(path, layout, skipped)
    seconds, metres = table[:, 0] * layout.scales[0], table[:, 1:] * layout.scales[1:]
    if not layout.unit_stated:
        _check_seconds(path, seconds, metres)
    return target_log(seconds, _upwards(metres, how.frame))


class _Binary(NamedTuple):
    """A log with many topics, by its first bytes."""

    magic: bytes
    largest: int
    """Bytes."""
    read: Callable[[Path, LogFormat], Logged]


_BINARIES = (_Binary(ULOG, LARGEST_ULOG, read_ulog), _Binary(MCAP, LARGEST_MCAP, read_mcap))


def _binary(path: Path) -> _Binary | None:
    """How a file is read that is no text; None for others."""
    try:
        with path.open("rb") as stream:
            begin = stream.read(8)
    except OSError as error:
        raise FileError(f"target file {str(path)!r} cannot be read: {error.strerror}") from error
    return next((binary for binary in _BINARIES if begin.startswith(binary.magic)), None)


def _from_binary(path: Path, how: LogFormat, binary: _Binary) -> TargetLog:
    """A flight out of a log with many topics."""
    try:
        found = binary.read(path, how)
    except (InputError, FileError) as error:
        raise FileError(f"target file {str(path)!r}: {error}") from error
    log = target_log(found.times, _upwards(found.positions, found.frame))
    return dataclasses.replace(log, report=dataclasses.replace(log.report, chosen=found.chosen))


def _upwards(metres: Float[np.ndarray, "n 3"], frame: str | None) -> Float[np.ndarray, "n 3"]:
    """Positions with z up, of a frame that has it so or down."""
    return metres[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0]) if frame == "ned" else metres


def target_log(times: Float[np.ndarray, "n"], positions: Float[np.ndarray, "n 3"]) -> TargetLog:
    """A log of checked samples with its report."""
    intervals = np.diff(times)
    distances = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    speeds = distances / intervals
    median = float(np.median(intervals))
    gaps = np.flatnonzero(intervals > _GAP_FACTOR * median)
    jumps = np.flatnonzero(speeds > _JUMP_SPEED)
    report = LogReport(
        samples=len(times),
        rate_hz=1.0 / median,
        duration=float(times[-1] - times[0]),
        gaps=tuple(Gap(float(times[i]), float(intervals[i])) for i in gaps),
        jumps=tuple(Jump(float(times[i]), float(distances[i]), float(speeds[i])) for i in jumps),
    )
    return TargetLog(times=times, positions=positions, report=report)


def resample(log: TargetLog, dt: float) -> TargetLog:
    """The flight at equal intervals ``dt`` [s] from its first sample on, never beyond its last.

    Interpolated by monotone cubics (Fritsch and Carlson 1980): through every sample, with a continuous
    velocity, and without overshoot across a gap. The report stays that of the recording.
    """
    from scipy.interpolate import PchipInterpolator  # a twentieth of all imports, only where it is needed

    duration = float(log.times[-1] - log.times[0])
    if not (np.isfinite(dt) and 0.0 < dt <= duration):
        raise InputError(f"sample interval: have {dt!r} s, want above 0 and at most the flight's {duration:.3f} s")
    count = int(np.floor(duration / dt * (1.0 + 1e-12))) + 1
    if count > _MOST_SAMPLES:
        raise InputError(f"sample interval: have {dt!r} s, which makes {count} samples; use a larger one")
    times = np.minimum(log.times[0] + dt * np.arange(count), log.times[-1])
    positions = PchipInterpolator(log.times, log.positions, axis=0)(times)
    return TargetLog(times=times, positions=positions, report=log.report)


def _check_file(path: Path) -> None:
    if not os.path.exists(path):
        raise FileError(f"target file {str(path)!r} does not exist; give a stored target's name or a file's path")
    if not os.path.isfile(path):
        raise FileError(f"target file {str(path)!r} is not a regular file; {WANT}")


def _check_size(path: Path, largest: int) -> None:
    if path.stat().st_size > largest:
        raise FileError(f"target file {str(path)!r} has more than {largest >> 20} MiB; cut or thin it first")


def _check_seconds(path: Path, seconds: Float[np.ndarray, "n"], metres: Float[np.ndarray, "n 3"]) -> None:
    """Raise for times that are hardly seconds, where nobody says what they are."""
    interval = float(np.median(np.diff(seconds)))
    speed = float(np.median(np.linalg.norm(np.diff(metres, axis=0), axis=1) / np.diff(seconds)))
    if interval > _LONGEST_INTERVAL or (interval > _SLOW_INTERVAL and speed < _SLOW):
        raise FileError(
            f"target file {str(path)!r}: samples are {interval:.9g} s apart and the target flies {speed:.2g} m/s; want "
            "times in seconds, these look like milli-, micro- or nanoseconds; give --time-unit"
        )


def _opened(path: Path) -> TextIO:
    try:
        return path.open(encoding="utf-8-sig", newline=None)
    except OSError as error:
        raise FileError(f"target file {str(path)!r} cannot be read: {error.strerror}") from error


def _rows(path: Path, stream: Iterable[str]) -> Iterator[tuple[int, list[str]]]:
    """Line number (from 1) and fields of every line that holds something."""
    try:
        for number, line in enumerate(stream, start=1):
            if "\0" in line:
                raise FileError(f"target file {str(path)!r} is not text (line {number}); {WANT}")
            content = line.split("#", 1)[0].strip()
            separator = _separator(content)
            fields = [field.strip().strip("\"'") for field in content.split(separator)]
            while fields and not fields[-1]:
                fields.pop()
            if fields:
                yield number, fields
    except UnicodeDecodeError as error:
        raise FileError(f"target file {str(path)!r} is not text (byte {error.start}); {WANT}") from error


def _separator(content: str) -> str | None:
    """What stands between the fields of a line; None for white space."""
    return next((mark for mark in ",;" if mark in content), None)


def _at_once(path: Path, layout: Layout, skipped: int) -> Float[np.ndarray, "n 4"] | None:
    """All numbers by NumPy's reader; None where it stumbles, or where they are not what they should be."""
    try:
        with _opened(path) as stream, warnings.catch_warnings():
            warnings.simplefilter("error")  # that there is nothing
            for _ in range(skipped):
                stream.readline()
            begin = stream.tell()
            separator = _separator(stream.readline())
            stream.seek(begin)
            table = np.loadtxt(stream, float, comments="#", delimiter=separator, usecols=layout.places, ndmin=2)
    except (ValueError, OSError, UserWarning):
        return None
    good = len(table) >= 2 and np.isfinite(table).all() and (np.diff(table[:, 0]) > 0.0).all()
    return table if good else None


def _line_by_line(path: Path, layout: Layout, skipped: int) -> Float[np.ndarray, "n 4"]:
    """The same, slower, with the line named that cannot be used."""
    values, lines = array("d"), array("q")
    with _opened(path) as stream:
        for number, fields in _rows(path, stream):
            if number > skipped:
                values.extend(_numbers(path, number, fields, layout.places))
                lines.append(number)
    table = np.frombuffer(values, float).reshape(-1, 4).copy()
    _check_times(path, table[:, 0], lines, bool(skipped))
    return table


def _numbers(path: Path, number: int, fields: list[str], columns: tuple[int, ...]) -> list[float]:
    place = f"target file {str(path)!r}, line {number}"
    if len(fields) <= max(columns):
        raise FileError(f"{place}: have {len(fields)} columns, want at least {max(columns) + 1}; {WANT}")
    values = []
    for column in columns:
        field = fields[column]
        if not _is_number(field):
            raise FileError(f"{place}, column {column + 1}: have {field[:40]!r}, want a number")
        value = float(field)
        if not np.isfinite(value):
            raise FileError(f"{place}, column {column + 1}: have {field[:40]!r}, want a finite number; remove the line")
        values.append(value)
    return values


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def _check_times(path: Path, times: Float[np.ndarray, "n"], lines: "array[int]", headed: bool) -> None:
    if len(times) == 0 and headed:
        raise FileError(f"target file {str(path)!r}: have a header and no data, {WANT}")
    if len(times) < 2:
        raise FileError(f"target file {str(path)!r}: have {len(times)} sample, want at least 2")
    wrong = np.flatnonzero(~(np.diff(times) > 0.0))
    if len(wrong):
        i = int(wrong[0])
        what = "repeats" if times[i + 1] == times[i] else "goes backwards"
        raise FileError(
            f"target file {str(path)!r}, line {lines[i + 1]}: the time {what}, have {times[i + 1]:.9g} "
            f"after {times[i]:.9g}; sort the file and remove repeated samples"
        )
