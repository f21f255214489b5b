"""Recorded flights of a target: ``t,x,y,z`` or ``timestamp tx ty tz``, comma, semicolon or space separated.

A header is optional, ``#`` starts a comment, further columns (TUM's quaternion) are ignored. What cannot be
used is an error that names the line; what can be used but deserves a look is in the log's ``report``.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator

from jaxplan.errors import FileError, InputError

_NAMES = {
    "time": ("t", "time", "timestamp", "stamp", "sec", "seconds"),
    "x": ("x", "tx", "px", "p_x", "pos_x"),
    "y": ("y", "ty", "py", "p_y", "pos_y"),
    "z": ("z", "tz", "pz", "p_z", "pos_z"),
}
_WANT = "want t,x,y,z or timestamp tx ty tz in seconds and metres"
_LARGEST_FILE = 256 * 2**20
_MOST_SAMPLES = 10_000_000
_GAP_FACTOR = 5.0
"""A pause longer than this many median sample intervals is a gap (arbitrary)."""
_JUMP_SPEED = 30.0
"""m/s; a step faster than this is a jump: no multirotor this library is for flies it (arbitrary)."""
_LONGEST_INTERVAL = 10.0
"""s; a median interval above it means that the times are not seconds (arbitrary)."""


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


def read_target_log(path: str | Path) -> TargetLog:
    """Read a recorded flight; raises ``FileError`` naming the line where it cannot be used."""
    path = Path(path)
    rows = list(_rows(_text(path)))
    if not rows:
        raise FileError(f"target file {str(path)!r}: have no data, {_WANT}")
    columns, rows = _columns(path, rows)
    table = np.array([_numbers(path, number, fields, columns) for number, fields in rows], dtype=float)
    _check_times(path, table.reshape(-1, 4)[:, 0], [number for number, _ in rows])
    return target_log(table[:, 0], table[:, 1:])


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
    duration = float(log.times[-1] - log.times[0])
    if not (np.isfinite(dt) and 0.0 < dt <= duration):
        raise InputError(f"sample interval: have {dt!r} s, want above 0 and at most the flight's {duration:.3f} s")
    count = int(np.floor(duration / dt * (1.0 + 1e-12))) + 1
    if count > _MOST_SAMPLES:
        raise InputError(f"sample interval: have {dt!r} s, which makes {count} samples; use a larger one")
    times = np.minimum(log.times[0] + dt * np.arange(count), log.times[-1])
    positions = PchipInterpolator(log.times, log.positions, axis=0)(times)
    return TargetLog(times=times, positions=positions, report=log.report)


def _text(path: Path) -> str:
    if not os.path.exists(path):
        raise FileError(f"target file {str(path)!r} does not exist; give a stored target's name or a file's path")
    if not os.path.isfile(path):
        raise FileError(f"target file {str(path)!r} is not a regular file; {_WANT}")
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise FileError(f"target file {str(path)!r} has more than {_LARGEST_FILE >> 20} MiB; cut or thin it first")
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(f"target file {str(path)!r} is not text (byte {error.start}); {_WANT}") from error
    except OSError as error:
        raise FileError(f"target file {str(path)!r} cannot be read: {error.strerror}") from error
    if "\0" in text:
        raise FileError(f"target file {str(path)!r} is not text (byte {text.index(chr(0))}); {_WANT}")
    return text


def _rows(text: str) -> Iterator[tuple[int, list[str]]]:
    """Line number (from 1) and fields of every line that holds something."""
    for number, line in enumerate(text.splitlines(), start=1):
        content = line.split("#", 1)[0].strip()
        separator = next((mark for mark in ",;" if mark in content), None)
        fields = [field.strip().strip("\"'") for field in content.split(separator)]
        while fields and not fields[-1]:
            fields.pop()
        if fields:
            yield number, fields


def _columns(path: Path, rows: list[tuple[int, list[str]]]) -> tuple[list[int], list[tuple[int, list[str]]]]:
    """Where time, x, y and z are, and the rows without the header."""
    number, first = rows[0]
    if any(_is_number(field) for field in first):
        return [0, 1, 2, 3], rows
    names = [field.split("[")[0].split("(")[0].strip().lower() for field in first]
    found = {wanted: [i for i, name in enumerate(names) if name in known] for wanted, known in _NAMES.items()}
    missing = [wanted for wanted, places in found.items() if not places]
    if missing:
        have = ", ".join(first)[:80]
        raise FileError(
            f"target file {str(path)!r}, line {number}: no column for {', '.join(missing)}; have {have!r}, {_WANT}"
        )
    if len(rows) == 1:
        raise FileError(f"target file {str(path)!r}: have a header and no data, {_WANT}")
    return [places[0] for places in found.values()], rows[1:]


def _numbers(path: Path, number: int, fields: list[str], columns: list[int]) -> list[float]:
    place = f"target file {str(path)!r}, line {number}"
    if len(fields) <= max(columns):
        raise FileError(f"{place}: have {len(fields)} columns, want at least {max(columns) + 1}; {_WANT}")
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


def _check_times(path: Path, times: Float[np.ndarray, "n"], lines: list[int]) -> None:
    if len(times) < 2:
        raise FileError(f"target file {str(path)!r}: have {len(times)} sample, want at least 2")
    wrong = np.flatnonzero(~(np.diff(times) > 0.0))
    if len(wrong):
        i = int(wrong[0])
        what = "repeats" if times[i + 1] == times[i] else "goes backwards"
        raise FileError(
            f"target file {str(path)!r}, line {lines[i + 1]}: the time {what}, have {times[i + 1]:.9g} s "
            f"after {times[i]:.9g} s; sort the file and remove repeated samples"
        )
    if np.median(np.diff(times)) > _LONGEST_INTERVAL:
        raise FileError(
            f"target file {str(path)!r}: samples are {np.median(np.diff(times)):.9g} s apart; "
            "want times in seconds, these look like milliseconds or nanoseconds"
        )
