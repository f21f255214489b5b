"""From samples of the target as they arrive to the observations that a predictor wants.

Samples may come late, twice, with gaps, from the future or from nowhere near the target. Whatever the order of their
arrival, the track is that of the sorted samples without repetitions: every sample is judged once all earlier ones are,
and judged again when an earlier one arrives after all.

A sample belongs to the track if it lies within reach of where the last one, at its velocity, would be by then. One
that does not, or that follows better from the last that did not, is a rival; the track moves over to rivals once
``relock`` of them in a row are consistent with each other. So a single outlier is never followed, and a target that
really moved is found again.
"""

import bisect
import dataclasses
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.prediction.observations import Observations

_BLUR = 0.05
"""Time constant [s] of the track's velocity, so that noise at high rates does not pass for speed (arbitrary)."""
_CAPACITY = 4096
"""Most samples remembered."""
_SAME_INSTANT = 1e-9
"""Seconds; a grid time this far outside the samples counts as inside: rounding, no sensor is that exact."""


@dataclasses.dataclass(frozen=True)
class StreamConfig:
    """What a plausible target is, and the spacing of what is handed on."""

    observations: int = 10
    """N_obs, most positions handed on."""
    dt: float = 0.1
    """Seconds between them."""
    max_speed: float = 12.0
    """Largest speed [m/s] that the second sample may imply; above every target here (arbitrary)."""
    max_acceleration: float = 25.0
    """Largest change of velocity [m/s^2] that a track follows; quadrotors with a thrust-to-weight of 2.7 reach it."""
    slack: float = 0.3
    """Distance [m] that noise may add."""
    relock: int = 3
    """Consistent rivals in a row that become the track."""
    longest_gap: float = 0.5
    """Seconds without a sample over which positions are still interpolated (arbitrary)."""
    future: float = 0.01
    """Seconds by which a sample's time may be ahead of the clock."""

    def __post_init__(self) -> None:
        for name in ("observations", "relock"):
            if getattr(self, name) < 1:
                raise InputError(f"observation stream: {name} is {getattr(self, name)}, want at least 1")
        for name in ("dt", "max_speed", "max_acceleration", "slack", "longest_gap"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise InputError(f"observation stream: {name} is {getattr(self, name)}, want a positive number")

    @property
    def memory(self) -> float:
        """Seconds before the newest sample from which samples are still taken."""
        return self.dt * self.observations + self.longest_gap


class Sample(NamedTuple):
    """Where the target was seen: seconds and metres, world."""

    time: float
    x: float
    y: float
    z: float


class _Verdict(NamedTuple):
    """A sample, and the track after it."""

    sample: Sample
    last: Sample
    """The newest sample of the track."""
    velocity: tuple[float, float, float] | None
    """Of the track [m/s]; None after its first sample."""
    rivals: tuple[Sample, ...]
    """The newest samples in a row that do not belong to the track but to each other."""
    joined: tuple[Sample, ...]
    """What this sample adds to the track: itself, nothing, or, where the track begins anew, the rivals too."""
    anew: bool


class ObservationStream:
    """Takes samples as they come; ``observe`` gives the track at even intervals up to its newest sample."""

    def __init__(self, config: StreamConfig = StreamConfig()) -> None:
        self.config = config
        self.refused = {"not_finite": 0, "future": 0, "late": 0, "repeated": 0}
        """Samples that were not taken, by reason."""
        self._times: list[float] = []
        self._verdicts: list[_Verdict] = []

    @property
    def outliers(self) -> int:
        """Remembered samples that are not on the track."""
        return len(self._verdicts) - sum(len(verdict.joined) for verdict in self._verdicts)

    def add(self, time: float, position: Float[np.ndarray, "3"], now: float) -> None:
        """Take the sample seen at ``time`` [s] that arrives at ``now`` [s, the same clock]; bad ones are counted."""
        sample = Sample(float(time), *(float(value) for value in position))
        if not all(map(math.isfinite, sample)):
            self.refused["not_finite"] += 1
        elif sample.time > now + self.config.future:
            self.refused["future"] += 1
        elif self._times and sample.time < self._times[-1] - self.config.memory:
            self.refused["late"] += 1
        else:
            self._insert(sample)

    def observe(self, now: float) -> Observations | None:
        """The newest positions of the track, ``dt`` apart; fewer than N_obs after a start, a gap or a jump.

        None while there is no sample at all. ``age`` tells how long the target has been silent.
        """
        track = self._track()
        if not track:
            return None
        samples = np.array(track)
        times = samples[-1, 0] - self.config.dt * np.arange(self.config.observations - 1, -1, -1)
        times = times[times >= samples[0, 0] - _SAME_INSTANT]
        positions = interpolate(samples[:, 0], samples[:, 1:], times)
        return Observations(times=times, positions=positions, age=max(0.0, now - samples[-1, 0]))

    def _insert(self, sample: Sample) -> None:
        place = bisect.bisect_left(self._times, sample.time)
        if place < len(self._times) and self._times[place] == sample.time:
            self.refused["repeated"] += 1
            # Of two different positions for one instant the lesser stays: arbitrary, but whatever the order.
            sample = min(sample, self._verdicts[place].sample)
            if sample == self._verdicts[place].sample:
                return
            later = self._verdicts[place + 1 :]
        else:
            self._times.insert(place, sample.time)
            later = self._verdicts[place:]
        del self._verdicts[place:]
        for following in (sample, *(verdict.sample for verdict in later)):
            before = self._verdicts[-1] if self._verdicts else None
            self._verdicts.append(_judge(before, following, self.config))
        self._forget()

    def _forget(self) -> None:
        """Drop what is older than any sample still taken, except the last, on which the next verdict rests."""
        oldest = bisect.bisect_left(self._times, self._times[-1] - self.config.memory)
        drop = max(oldest - 1, len(self._times) - _CAPACITY, 0)
        del self._times[:drop], self._verdicts[:drop]

    def _track(self) -> list[Sample]:
        """The samples of the track since its last long gap, oldest first."""
        track: list[Sample] = []
        for verdict in reversed(self._verdicts):
            for sample in reversed(verdict.joined):
                if track and track[-1].time - sample.time > self.config.longest_gap:
                    return track[::-1]
                track.append(sample)
            if verdict.anew:
                break
        return track[::-1]


def _judge(before: _Verdict | None, sample: Sample, config: StreamConfig) -> _Verdict:
    """Whether ``sample`` continues the track, and what the track is then."""
    if before is None:
        return _Verdict(sample, sample, None, (), (sample,), True)
    stretch, rivals = _stretch(before, sample, config), before.rivals
    rival_stretch = _step_stretch(rivals[-1], sample, config) if rivals else math.inf
    if stretch <= min(1.0, rival_stretch):
        return _Verdict(sample, sample, _velocity(before, sample), (), (sample,), False)
    rivals = (*rivals, sample) if rival_stretch <= 1.0 else (sample,)
    if len(rivals) < config.relock:
        return _Verdict(sample, before.last, before.velocity, rivals, (), False)
    velocity = _difference(rivals[-2], rivals[-1]) if len(rivals) > 1 else None
    return _Verdict(sample, sample, velocity, (), rivals, True)


def _stretch(track: _Verdict, sample: Sample, config: StreamConfig) -> float:
    """How far the sample is from where the track leads, as a share of what the target could have strayed."""
    if track.velocity is None:
        return _step_stretch(track.last, sample, config)
    elapsed = sample.time - track.last.time
    expected = [a + elapsed * v for a, v in zip(track.last[1:], track.velocity, strict=True)]
    reach = config.slack + config.max_acceleration * elapsed * (elapsed + _BLUR)
    return math.dist(expected, sample[1:]) / reach


def _step_stretch(first: Sample, second: Sample, config: StreamConfig) -> float:
    """The distance of two samples as a share of what a target of unknown velocity could have flown between them."""
    reach = config.slack + config.max_speed * (second.time - first.time)
    return math.dist(first[1:], second[1:]) / reach


def _velocity(before: _Verdict, sample: Sample) -> tuple[float, float, float]:
    newest = _difference(before.last, sample)
    if before.velocity is None:
        return newest
    share = 1.0 - math.exp(-(sample.time - before.last.time) / _BLUR)
    x, y, z = (old + share * (new - old) for old, new in zip(before.velocity, newest, strict=True))
    return x, y, z


def _difference(first: Sample, second: Sample) -> tuple[float, float, float]:
    elapsed = second.time - first.time
    x, y, z = ((b - a) / elapsed for a, b in zip(first[1:], second[1:], strict=True))
    return x, y, z


def interpolate(
    times: Float[np.ndarray, "n"], values: Float[np.ndarray, "n c"], at: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "m c"]:
    """Piecewise cubics through all samples, with the slopes of parabolas through three neighbours; held at the ends.

    Exact for parabolas; its error is of third order in the interval, of fourth where samples are even.
    """
    if len(times) == 1:
        return np.repeat(values, len(at), axis=0)
    interval = np.diff(times)[:, None]
    chord = np.diff(values, axis=0) / interval
    slopes = np.concatenate([chord[:1], chord])
    if len(times) > 2:
        before, after = interval[:-1], interval[1:]
        slopes[1:-1] = (after * chord[:-1] + before * chord[1:]) / (before + after)
        slopes[0], slopes[-1] = 2.0 * chord[0] - slopes[1], 2.0 * chord[-1] - slopes[-2]
    piece = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(interval) - 1)
    h = interval[piece]
    s = np.clip((at - times[piece])[:, None] / h, 0.0, 1.0)
    first, second = values[piece], values[piece + 1]
    bend = (
        s
        * (1.0 - s)
        * ((1.0 - s) * (h * slopes[piece] - (second - first)) - s * (h * slopes[piece + 1] - (second - first)))
    )
    return first + s * (second - first) + bend
