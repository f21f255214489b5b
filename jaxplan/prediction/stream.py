"""From samples of the target as they arrive to the observations that a predictor wants.

Samples may come late, twice, with gaps, from the future or from nowhere near the target. Whatever the order of their
arrival, the track is that of the sorted samples without repetitions: every sample is held against the track once all
earlier ones are (``jaxplan.prediction.gating``), and once more when an earlier one arrives after all.
"""

import bisect
import dataclasses
import math
from typing import Annotated, no_type_check

import numpy as np
from numpy.typing import ArrayLike

from jaxplan.prediction.gating import GateConfig, Sample, TrackStep, advance
from jaxplan.prediction.interpolation import interpolate
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.protocol import SPACING, PredictionConfig
from jaxplan.validation import as_number, as_shaped, require_at_least, require_positive

_CAPACITY = 4096
"""Most samples remembered."""
_SAME_INSTANT = 1e-9
"""Seconds; a grid time this far outside the samples counts as inside: rounding, no sensor is that exact."""


@dataclasses.dataclass(frozen=True)
class StreamConfig:
    """Which samples are taken, and the spacing of what is handed on."""

    observations: int = 19
    """Most positions handed on: of these every second are the paper's N_obs in a large room."""
    dt: float = SPACING
    """Seconds between them."""
    gate: GateConfig = GateConfig()
    """Which samples belong to the track."""
    longest_gap: float = 0.5
    """Seconds without a sample over which positions are still interpolated (arbitrary)."""
    future: float = 0.01
    """Seconds by which a sample's time may be ahead of the clock."""

    def __post_init__(self) -> None:
        require_at_least("observation stream", self, 1, "observations")
        require_positive("observation stream", self, "dt", "longest_gap")
        require_at_least("observation stream", self, 0.0, "future")

    @classmethod
    def for_prediction(cls, prediction: PredictionConfig) -> "StreamConfig":
        """As many as predictors look at, ``SPACING`` apart or less, even where predictions are farther apart."""
        between = math.ceil(prediction.dt / SPACING - _SAME_INSTANT)
        return cls(observations=(prediction.observations - 1) * between + 1, dt=prediction.dt / between)

    @property
    def memory(self) -> float:
        """Seconds before the newest sample from which samples are still taken."""
        return self.dt * self.observations + self.longest_gap


class ObservationStream:
    """Takes samples as they come; ``observe`` gives the track at even intervals up to its newest sample."""

    def __init__(self, config: StreamConfig = StreamConfig()) -> None:
        self.config = config
        self.refused = {"not_finite": 0, "future": 0, "late": 0, "repeated": 0}
        """Samples that were not taken, by reason."""
        self._times: list[float] = []
        self._steps: list[TrackStep] = []

    @property
    def outliers(self) -> int:
        """Remembered samples that are not on the track."""
        return len(self._steps) - sum(len(step.joined) for step in self._steps)

    @no_type_check
    def add(self, time: float, position: Annotated[ArrayLike, "3"], now: float) -> None:
        """Take a sample; one that cannot be used is counted in ``refused``.

        Args:
            time: when the target was seen [s].
            position: where [m, world].
            now: when the sample arrives [s, the same clock].

        Raises:
            InputError: the position does not have three coordinates, or a time is no number.
        """
        where = as_shaped("observation stream: position", position, (3,))
        sample = Sample(as_number("observation stream: time", time), *where.tolist())
        now = as_number("observation stream: now", now)
        if not all(map(math.isfinite, sample)):
            self.refused["not_finite"] += 1
        elif sample.time > now + self.config.future:
            self.refused["future"] += 1
        elif self._times and sample.time < self._times[-1] - self.config.memory:
            self.refused["late"] += 1
        else:
            self._insert(sample)

    def observe(self, now: float) -> Observations | None:
        """The newest positions of the track, ``dt`` apart; fewer after a start, a gap or a jump.

        None while there is no sample at all. ``age`` tells how long the target has been silent at ``now`` [s].
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
            sample = min(sample, self._steps[place].sample)
            if sample == self._steps[place].sample:
                return
            later = self._steps[place + 1 :]
        else:
            self._times.insert(place, sample.time)
            later = self._steps[place:]
        del self._steps[place:]
        for following in (sample, *(step.sample for step in later)):
            before = self._steps[-1] if self._steps else None
            self._steps.append(advance(before, following, self.config.gate))
        self._forget()

    def _forget(self) -> None:
        """Drop what is older than any sample still taken, except the last, from which the next step goes on."""
        oldest = bisect.bisect_left(self._times, self._times[-1] - self.config.memory)
        drop = max(oldest - 1, len(self._times) - _CAPACITY, 0)
        del self._times[:drop], self._steps[:drop]

    def _track(self) -> list[Sample]:
        """The samples of the track since its last long gap, oldest first."""
        track: list[Sample] = []
        for step in reversed(self._steps):
            for sample in reversed(step.joined):
                if track and track[-1].time - sample.time > self.config.longest_gap:
                    return track[::-1]
                track.append(sample)
            if step.anew:
                break
        return track[::-1]
