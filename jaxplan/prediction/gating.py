"""Which samples belong to the target's track: one sample after the other, in the order of their times.

A sample passes the gate if it lies within reach of where the last one, at its velocity, would be by then. One that does
not, or that follows better from the last that did not, is a rival; the track moves over to rivals once ``relock`` of
them in a row are consistent with each other. So a single outlier is never followed, and a target that really moved is
found again.
"""

import dataclasses
import math
from typing import NamedTuple

from jaxplan.validation import require_at_least, require_positive

_BLUR = 0.05
"""Time constant [s] of the track's velocity, so that noise at high rates does not pass for speed (arbitrary)."""

Velocity = tuple[float, float, float]
"""Metres per second, world."""


@dataclasses.dataclass(frozen=True)
class GateConfig:
    """What a plausible target is."""

    max_speed: float = 12.0
    """Largest speed [m/s] that the second sample may imply; above every target here (arbitrary)."""
    max_acceleration: float = 25.0
    """Largest change of velocity [m/s^2] that a track follows; quadrotors with a thrust-to-weight of 2.7 reach it."""
    slack: float = 0.3
    """Distance [m] that noise may add."""
    relock: int = 3
    """Consistent rivals in a row that become the track."""

    def __post_init__(self) -> None:
        require_at_least("gate", self, 1, "relock")
        require_positive("gate", self, "max_speed", "max_acceleration", "slack")


class Sample(NamedTuple):
    """Where the target was seen: seconds and metres, world."""

    time: float
    x: float
    y: float
    z: float


class TrackStep(NamedTuple):
    """A sample, and the track after it."""

    sample: Sample
    newest: Sample
    """The newest sample of the track."""
    velocity: Velocity | None
    """Of the track; None after its first sample."""
    rivals: tuple[Sample, ...]
    """The newest samples in a row that do not belong to the track but to each other."""
    joined: tuple[Sample, ...]
    """What this sample adds to the track: itself, nothing, or, where the track begins anew, the rivals too."""
    anew: bool
    """Whether the track begins with ``joined``."""


def advance(before: TrackStep | None, sample: Sample, config: GateConfig) -> TrackStep:
    """Whether ``sample`` continues the track, and what the track is then; ``before`` is None for the first sample."""
    if before is None:
        return TrackStep(sample, sample, None, (), (sample,), True)
    deviation, rivals = _deviation(before, sample, config), before.rivals
    from_rivals = _step(rivals[-1], sample, config) if rivals else math.inf
    if deviation <= min(1.0, from_rivals):
        return TrackStep(sample, sample, _velocity(before, sample), (), (sample,), False)
    rivals = (*rivals, sample) if from_rivals <= 1.0 else (sample,)
    if len(rivals) < config.relock:
        return TrackStep(sample, before.newest, before.velocity, rivals, (), False)
    velocity = _difference(rivals[-2], rivals[-1]) if len(rivals) > 1 else None
    return TrackStep(sample, sample, velocity, (), rivals, True)


def _deviation(track: TrackStep, sample: Sample, config: GateConfig) -> float:
    """How far the sample is from where the track leads, as a share of the gate's radius."""
    if track.velocity is None:
        return _step(track.newest, sample, config)
    elapsed = sample.time - track.newest.time
    expected = [a + elapsed * v for a, v in zip(track.newest[1:], track.velocity, strict=True)]
    radius = config.slack + config.max_acceleration * elapsed * (elapsed + _BLUR)
    return math.dist(expected, sample[1:]) / radius


def _step(first: Sample, second: Sample, config: GateConfig) -> float:
    """The distance of two samples as a share of the gate's radius around the first, whose velocity is unknown."""
    radius = config.slack + config.max_speed * (second.time - first.time)
    return math.dist(first[1:], second[1:]) / radius


def _velocity(before: TrackStep, sample: Sample) -> Velocity:
    """Of the track with ``sample``, smoothed."""
    newest = _difference(before.newest, sample)
    if before.velocity is None:
        return newest
    share = 1.0 - math.exp(-(sample.time - before.newest.time) / _BLUR)
    x, y, z = (old + share * (new - old) for old, new in zip(before.velocity, newest, strict=True))
    return x, y, z


def _difference(first: Sample, second: Sample) -> Velocity:
    elapsed = second.time - first.time
    x, y, z = ((b - a) / elapsed for a, b in zip(first[1:], second[1:], strict=True))
    return x, y, z
