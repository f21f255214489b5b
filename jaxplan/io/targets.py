"""Target motions: trajectories stored with a world, and recorded flights, both as functions of time.

A stored trajectory is a list of waypoints and durations; its minimum-snap spline is solved when it is read.
"""

import dataclasses
import json
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.io.log_columns import LogFormat
from jaxplan.io.target_log import read_target_log, resample
from jaxplan.minsnap.single import minimum_snap
from jaxplan.names import require_target, stored_targets
from jaxplan.spline import PiecewisePolynomial

DEFAULT_SPEED = 1.0
"""Maximum speed [m/s] of a stored target when none is asked for."""
_STORED = Path(__file__).parent.parent / "world" / "environments"
_SPEED_SAMPLES = 0.02
"""Interval [s] at which the maximum speed is sampled."""
_LOG_INTERVAL = 0.05
"""Recorded flights are resampled at this interval [s], so that sensor noise does not pass for speed."""


@runtime_checkable
class Motion(Protocol):
    """A motion over time."""

    def __call__(self, times: Float[np.ndarray, "*n"], derivative: int, /) -> Float[np.ndarray, "*n 3"]:
        """The position [m, world] at ``times`` [s], or its first ``derivative`` [m/s]."""
        ...


@dataclasses.dataclass(frozen=True)
class Target:
    """A target's motion over [0, duration]; outside it is held at its ends."""

    name: str
    duration: float
    """Seconds, at the chosen speed."""
    max_speed: float
    """Metres per second, at the chosen speed."""
    warnings: tuple[str, ...]
    """What is odd about the recording."""
    motion: Motion
    """Before it was scaled to the chosen speed."""
    rate: float
    """Seconds of unscaled motion in a second."""
    read_as: str = ""
    """Of a log with many topics, which one was read and how."""

    def position(self, times: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n 3"]:
        """Where the target is at ``times`` [s]: metres, world."""
        return self.motion(np.clip(np.asarray(times) * self.rate, 0.0, self.duration * self.rate), 0)

    def velocity(self, times: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n 3"]:
        """How fast it is at ``times`` [s]: metres per second, world; 0 outside the motion."""
        times = np.asarray(times)
        inside = (times >= 0.0) & (times <= self.duration)
        clipped = np.clip(times * self.rate, 0.0, self.duration * self.rate)
        return self.rate * self.motion(clipped, 1) * inside[..., None]


def load_target(
    name_or_path: str | None, *, world: str, speed: float | None = None, log: LogFormat | None = None
) -> Target:
    """A stored trajectory of ``world`` by name (its first when None), or a recorded flight by path.

    Args:
        speed: maximum speed [m/s] after time-scaling; 1 m/s for stored trajectories and as recorded for flights
            when None.
        log: what a recorded flight's file does not say of itself.

    Raises:
        InputError: the name is unknown, or says all of itself, the speed is not positive, or the target never moves.
        FileError: the file cannot be used.
    """
    names = stored_targets(world)
    if speed is not None and not 0.0 < speed < float("inf"):
        raise InputError(f"target: the speed is {speed} m/s, want a positive number")
    require_target(name_or_path, world)
    if (name_or_path is None or name_or_path in names) and log not in (None, LogFormat()):
        raise InputError("--time-unit, --frame and --columns say how a recorded flight is read; give --target a file")
    if name_or_path is None or name_or_path in names:
        return _stored(world, name_or_path or names[0], DEFAULT_SPEED if speed is None else speed)
    return _recorded(Path(name_or_path), speed, log)


def target_spline(waypoints: Float[np.ndarray, "n 3"], durations: Float[np.ndarray, "m"]) -> PiecewisePolynomial:
    """Minimum snap through n = m + 1 ``waypoints`` [m]: flying towards the second one at the start, at rest at the end.

    ``durations`` [s] are those of the segments between them.
    """
    initial = np.zeros((4, 3))
    initial[0] = (waypoints[1] - waypoints[0]) / durations[0]
    return minimum_snap(waypoints, durations, initial=initial)


def _stored(world: str, name: str, speed: float) -> Target:
    table = json.loads((_STORED / f"{world}_targets.json").read_text())["trajectories"][name]
    spline = target_spline(np.array(table["waypoints"]), np.array(table["durations"]))

    def motion(times: Float[np.ndarray, "*n"], derivative: int) -> Float[np.ndarray, "*n 3"]:
        return np.asarray(spline.evaluate(times, derivative))[..., :3]

    return _scaled(name, float(spline.duration), motion, speed, ())


def _recorded(path: Path, speed: float | None, how: LogFormat | None) -> Target:
    from scipy.interpolate import PchipInterpolator  # a twentieth of all imports, only where it is needed

    log = read_target_log(path, how)
    even = resample(log, min(_LOG_INTERVAL, log.report.duration / 2.0))
    curve = PchipInterpolator(even.times - even.times[0], even.positions, axis=0)
    duration = float(even.times[-1] - even.times[0])
    target = _scaled(
        path.stem, duration, lambda times, derivative: curve(times, derivative), speed, log.report.warnings()
    )
    return dataclasses.replace(target, read_as=log.report.chosen)


def _scaled(
    name: str, duration: float, motion: Motion, speed: float | None, warnings: tuple[str, ...] | list[str]
) -> Target:
    """Stretch time so that the fastest instant has the wanted speed."""
    times = np.linspace(0.0, duration, max(3, int(duration / _SPEED_SAMPLES)))
    fastest = float(np.linalg.norm(motion(times, 1), axis=1).max())
    if speed is not None and fastest <= 0.0:
        raise InputError(f"target {name!r} never moves, so it has no speed to scale; leave --speed out")
    rate = 1.0 if speed is None else speed / fastest
    return Target(name, duration / rate, fastest * rate, tuple(warnings), motion, rate)
