"""Trajectories in the formats that other programs fly, and back (host, NumPy).

What is written is in SI units and starts at time 0, but for TUM. The library's world is z up with yaw counter-clockwise
from x: with x to the east that is ``enu``. ``ned`` is north, east, down with yaw clockwise from north. Crazyflies fly
z up.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.config import FRAMES, Frame
from jaxplan.errors import FileError, InputError
from jaxplan.files import read_limited
from jaxplan.io.files import tum_text
from jaxplan.io.sampled import SETPOINTS, attitudes, north_east_down_quat, sample_times, setpoint_table
from jaxplan.io.septic import SIZE, as_septic
from jaxplan.spline import PiecewisePolynomial
from jaxplan.validation import as_finite, as_number

MEMORY_PIECES = 31
"""Pieces in a Crazyflie's trajectory memory: 4096 bytes of 132 each."""
_PIECE = np.dtype([("coefficients", "<f4", (4, SIZE)), ("duration", "<f4")])
"""``struct poly4d`` of the firmware: ascending coefficients of x, y, z and yaw in seconds, then the duration."""
_LARGEST = 64 * 2**20
"""Bytes of the largest file that is read."""
_AXES = ("x", "y", "z", "yaw")
_SEPTIC_HEADER = ",".join(["duration", *(f"{axis}^{power}" for axis in _AXES for power in range(SIZE))])


class Exported(NamedTuple):
    """A file's content, and what was lost."""

    content: bytes
    pieces: int
    """Polynomials, or samples."""
    error: float
    """Largest distance [m] of what is written from the trajectory."""


class ExportConfig(NamedTuple):
    """Choices that some formats leave."""

    frame: Frame = "enu"
    rate: float = 100.0
    """Samples a second."""
    tolerance: float = 1e-3
    """How far [m] a trajectory of degree 7 may be from one of degree 9."""
    start: float = 0.0
    """What TUM's first time stamp is [s]: the episode's clock, so that it lies over ``flown.csv``."""


class Format(NamedTuple):
    """How one kind of file is written and read."""

    write: Callable[[PiecewisePolynomial, ExportConfig], Exported]
    read: Callable[[bytes], PiecewisePolynomial] | None
    """None where samples are all there is."""
    frames: tuple[Frame, ...]


def export_trajectory(spline: PiecewisePolynomial, name: str, config: ExportConfig | None = None) -> Exported:
    """A trajectory with yaw as the content of a file of the format ``name``, one of ``FORMATS``.

    Raises:
        InputError: an unknown format or frame, a format that has no such frame, a rate or tolerance that is no positive
            number, or a trajectory that does not fit.
    """
    config = config or ExportConfig()
    if name not in FORMATS:
        raise InputError(f"--format: have {name!r}, want one of {', '.join(FORMATS)}")
    if config.frame not in FORMATS[name].frames:
        raise InputError(f"--frame: have {config.frame!r}, want {' or '.join(FORMATS[name].frames)} for {name}")
    rate, tolerance = as_number("--rate", config.rate), as_number("--tolerance", config.tolerance)
    for option, value in (("rate", rate), ("tolerance", tolerance)):
        if not value > 0.0:
            raise InputError(f"--{option}: have {value!r}, want a number above 0")
    given = _whole(spline)
    turned = given if config.frame == "enu" else north_east_down(given)
    start = as_finite("export: start", config.start, ()).item()
    return FORMATS[name].write(turned, ExportConfig(config.frame, rate, tolerance, start))


def _whole(spline: PiecewisePolynomial) -> PiecewisePolynomial:
    """A trajectory of finite numbers, without padding, with a yaw."""
    durations = as_finite("export: durations", spline.durations, (None,))
    position = as_finite("export: position", spline.position, (len(durations), None, 3))
    yaw = np.zeros((len(durations), 1)) if spline.yaw is None else spline.yaw
    turning = as_finite("export: yaw", yaw, (len(durations), None))
    real = durations > 0.0
    if (durations < 0.0).any() or not real.any() or not (position.shape[1] and turning.shape[1]):
        raise InputError("export: have no duration or one below 0, or no coefficient; want a trajectory")
    if max(position.shape[1] - 10, turning.shape[1] - SIZE) > 0:
        raise InputError(f"export: have {position.shape[1]} and {turning.shape[1]} coefficients, want 10 and {SIZE}")
    sized = np.pad(position[real], [(0, 0), (0, 10 - position.shape[1]), (0, 0)])
    return PiecewisePolynomial(durations=durations[real], position=sized, yaw=turning[real])


def read_trajectory(path: Path, name: str) -> PiecewisePolynomial:
    """The trajectory in a file that was written as ``name``, in the frame in which it was written.

    Raises:
        InputError: samples, or an unknown format. FileError: the file holds something else.
    """
    read = FORMATS[name].read if name in FORMATS else None
    if read is None:
        known = [key for key, form in FORMATS.items() if form.read is not None]
        raise InputError(f"read_trajectory: have {name!r}, want one of {', '.join(known)}")
    content = read_limited(path, _LARGEST, f"a trajectory as {name}")
    try:
        spline = read(content)
        durations, numbers = np.asarray(spline.durations), np.asarray(spline.position)
        known = np.isfinite(numbers).all() and np.isfinite(durations).all()
        if not (len(durations) and known and (durations > 0.0).all()):
            raise ValueError("no piece, a number that is not finite, or a duration that is not above 0")
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise FileError(f"{path}: is no trajectory as {name} ({error}); give another file") from error
    return spline


def north_east_down(spline: PiecewisePolynomial) -> PiecewisePolynomial:
    """From east, north, up to north, east, down and back: yaw is pi / 2 less the other."""
    position = np.asarray(spline.position)[..., [1, 0, 2]] * np.array([1.0, 1.0, -1.0])
    yaw = -np.asarray(spline.yaw)
    yaw[:, 0] += 0.5 * np.pi
    return PiecewisePolynomial(durations=spline.durations, position=position, yaw=yaw)


def _in_seconds(spline: PiecewisePolynomial, size: int) -> Float[np.ndarray, "m 4 {size}"]:
    """Ascending coefficients of x, y, z and yaw in the time since each piece's start."""
    both = np.zeros((len(spline.durations), 4, size))
    both[:, :3, : spline.position.shape[1]] = np.moveaxis(np.asarray(spline.position), 1, 2)
    turning = np.asarray(spline.yaw)
    both[:, 3, : turning.shape[1]] = turning
    with np.errstate(all="ignore"):
        return _finite(both / (np.asarray(spline.durations)[:, None] ** np.arange(size))[:, None])


def _finite(numbers: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    if not np.isfinite(numbers).all():
        raise InputError("export: have numbers beyond the format's precision, want segments that last longer")
    return numbers


def _from_seconds(durations: Float[np.ndarray, "m"], coefficients: Float[np.ndarray, "m 4 n"]) -> PiecewisePolynomial:
    scaled = coefficients * (durations[:, None] ** np.arange(coefficients.shape[2]))[:, None]
    return PiecewisePolynomial(durations=durations, position=np.moveaxis(scaled[:, :3], 1, 2), yaw=scaled[:, 3])


def _write_crazyswarm(spline: PiecewisePolynomial, config: ExportConfig) -> Exported:
    """CSV of uav_trajectories and Crazyswarm: a duration and 4 x 8 coefficients a line."""
    septic, error = as_septic(spline, config.tolerance)
    table = np.column_stack([septic.durations, _in_seconds(septic, SIZE).reshape(len(septic.durations), -1)])
    lines = [_SEPTIC_HEADER, *(",".join(f"{value:.12g}" for value in row) for row in table)]
    return Exported(("\n".join(lines) + "\n").encode(), len(table), error)


def _read_crazyswarm(content: bytes) -> PiecewisePolynomial:
    """Lines may end in a comma, as Crazyswarm's own do."""
    lines = [line.rstrip(", \r") for line in content.decode().split("\n")]
    table = np.array([[float(value) for value in line.split(",")] for line in lines[1:] if line])
    if table.ndim != 2 or table.shape[1] != 1 + 4 * SIZE:
        raise ValueError(f"lines of {1 + 4 * SIZE} numbers are wanted")
    return _from_seconds(table[:, 0], table[:, 1:].reshape(-1, 4, SIZE))


def _write_poly4d(spline: PiecewisePolynomial, config: ExportConfig) -> Exported:
    """A Crazyflie's trajectory memory, to be uploaded as it is."""
    septic, error = as_septic(spline, config.tolerance)
    if len(septic.durations) > MEMORY_PIECES:
        raise InputError(
            f"poly4d: have {len(septic.durations)} pieces at a tolerance of {config.tolerance:g} m, want at most "
            f"{MEMORY_PIECES}; give a larger --tolerance, or a single --plan"
        )
    pieces = np.zeros(len(septic.durations), _PIECE)
    with np.errstate(over="ignore"):
        pieces["duration"], pieces["coefficients"] = septic.durations, _in_seconds(septic, SIZE)
    _finite(pieces["coefficients"])
    rounded = _read_poly4d(pieces.tobytes())
    shares = np.linspace(0.0, 1.0, 65)
    off = [
        np.linalg.norm((np.asarray(a) - np.asarray(b)).T @ shares ** np.arange(SIZE)[:, None], axis=0).max()
        for a, b in zip(rounded.position, septic.position, strict=True)
    ]
    return Exported(pieces.tobytes(), len(pieces), error + float(max(off)))


def _read_poly4d(content: bytes) -> PiecewisePolynomial:
    pieces = np.frombuffer(content, _PIECE)
    return _from_seconds(pieces["duration"].astype(float), pieces["coefficients"].astype(float))


def _write_mav_trajectory_generation(spline: PiecewisePolynomial, config: ExportConfig) -> Exported:
    """YAML of mav_trajectory_generation, in its flow style, which is JSON; knots are rounded to nanoseconds."""
    size = spline.position.shape[1]
    knots = np.concatenate([[0], np.round(1e9 * np.cumsum(spline.durations)).astype(np.int64)])
    nanoseconds = np.diff(knots)
    if (nanoseconds <= 0).any():
        raise InputError("mav-trajectory-generation: have a segment below 1 ns, want longer ones; give another --plan")
    timed = PiecewisePolynomial(durations=1e-9 * nanoseconds, position=spline.position, yaw=spline.yaw)
    segments = [
        {"N": size, "D": 4, "time": int(time), "coefficients": rows.tolist()}
        for time, rows in zip(nanoseconds, _in_seconds(timed, size), strict=True)
    ]
    late = np.abs(knots[1:] * 1e-9 - np.cumsum(spline.durations)).max() * float(np.max(spline.bound(1)))
    lines = ",\n".join(json.dumps(segment) for segment in segments)
    return Exported(f'{{"segments": [\n{lines}\n]}}\n'.encode(), len(segments), float(late))


def _read_mav_trajectory_generation(content: bytes) -> PiecewisePolynomial:
    segments = json.loads(content)["segments"]
    durations = np.array([1e-9 * int(segment["time"]) for segment in segments])
    coefficients = np.array([segment["coefficients"] for segment in segments], float)
    if coefficients.ndim != 3 or coefficients.shape[1] != 4:
        raise ValueError("segments of four polynomials of one degree are wanted")
    return _from_seconds(durations, coefficients)


def _write_setpoints(spline: PiecewisePolynomial, config: ExportConfig) -> Exported:
    """CSV of samples at an even rate, the end included."""
    times = sample_times(spline, config.rate, "setpoints")
    table = _finite(setpoint_table(spline, times))
    lines = [",".join(SETPOINTS), *(",".join(f"{value:.9f}" for value in row) for row in table)]
    return Exported(("\n".join(lines) + "\n").encode(), len(times), 0.0)


def _write_tum(spline: PiecewisePolynomial, config: ExportConfig) -> Exported:
    """TUM's poses at an even rate, the end included: body FLU in east, north, up, or FRD in north, east, down."""
    times = sample_times(spline, config.rate, "tum")
    if config.frame == "enu":
        quat_wxyz = attitudes(spline, times)
    else:
        quat_wxyz = north_east_down_quat(attitudes(north_east_down(spline), times))
    position = np.asarray(spline.evaluate(times))[:, :3]
    text = tum_text(config.start + times, _finite(position), _finite(quat_wxyz))
    return Exported(text.encode(), len(times), 0.0)


FORMATS = {
    "crazyswarm": Format(_write_crazyswarm, _read_crazyswarm, ("enu",)),
    "poly4d": Format(_write_poly4d, _read_poly4d, ("enu",)),
    "mav-trajectory-generation": Format(_write_mav_trajectory_generation, _read_mav_trajectory_generation, FRAMES),
    "setpoints": Format(_write_setpoints, None, FRAMES),
    "tum": Format(_write_tum, None, FRAMES),
}
"""By the names under which they are asked for."""
