"""How soon a plan captures the target, when only its possible futures are known.

What a plan is worth is not where one future will be, but how soon it captures whichever comes true. Plans are corrected
as they are flown: what passes a metre beside a future in a second captures it all the same, since by then it is known.
So a future counts as captured as soon as the plan is within the capture radius and what a correction can reach, which
begins after a reaction and grows as a constant acceleration's way does. The expected time until then is what plans,
the committed one among them, are compared by: it does not jump from one sample to the next, and falls by the time that
passes while what was expected happens.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.planner.kernels.captures import spline_times, straight_times
from jaxplan.prediction.candidates import Candidates, candidates_from
from jaxplan.prediction.futures import Futures
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.validation import require_at_least, require_positive

MOTIONS = 64
"""Futures that are looked at: more are thinned out, so that one program serves all predictors (arbitrary)."""
STEP = 0.05
"""Seconds between the instants that are looked at (arbitrary: a correction reaches farther than is flown in it)."""
RETURN_SPEED = 5.0
"""m/s at which what is missed by the horizon is counted (arbitrary)."""


@dataclasses.dataclass(frozen=True)
class CaptureConfig:
    """What counts as captured, and by how much a plan can be corrected (docs/decisions/0034)."""

    radius: float = 0.3
    """m; within which a target is captured: less than the judge's, for tracking errors."""
    reaction: float = 0.2
    """Seconds until a correction shows: a latency, a cycle, and turning the thrust."""
    correction: float = 3.0
    """m/s^2; how much a plan can be corrected sideways, on average: a fraction of what the vehicle has, since what is
    to come is learned little by little."""
    horizon: float = 2.0
    """Seconds that are looked ahead at least,"""
    farthest: float = 4.0
    """and at most, where the target is predicted for so long, as in large rooms (docs/decisions/0056)."""
    gain: float = 0.05
    """By how much sooner another plan must be expected to capture [s] to replace the committed one."""

    def __post_init__(self) -> None:
        require_positive("capture", self, "radius")
        require_at_least("capture", self, 2.0 * STEP, "horizon")
        require_at_least("capture", self, self.horizon, "farthest")
        require_at_least("capture", self, 0.0, "reaction", "correction", "gain")

    def times(self, known: float) -> Float[np.ndarray, "u"]:
        """The instants that are looked at [s from a plan's start] where the target is predicted until ``known`` [s]."""
        until = min(max(known, self.horizon), self.farthest)
        return STEP * np.arange(round(until / STEP) + 1)

    def reach(self, times: Float[np.ndarray, "u"]) -> Float[np.ndarray, "u"]:
        """How far from a plan [m] the target is captured at each of some instants [s]."""
        since = np.maximum(times - self.reaction, 0.0)
        return np.asarray(self.radius + 0.5 * self.correction * since**2)


class Prospect(NamedTuple):
    """The futures at the instants that are looked at, from the start of the plans on."""

    times: Float[np.ndarray, "u"]
    """[s]"""
    motions: Float[np.ndarray, "u n 3"]
    """[m, world]"""
    weights: Float[np.ndarray, "n"]
    reach: Float[np.ndarray, "u"]
    """As ``CaptureConfig.reach`` has it."""

    def thinned(self) -> "Prospect":
        """Every second future at every second instant, to compare many at little cost."""
        weights = self.weights[::2]
        motions = self.motions[::2, ::2]
        return Prospect(self.times[::2], motions, weights / max(float(weights.sum()), 1e-12), self.reach[::2])

    @property
    def mean(self) -> Float[np.ndarray, "u 3"]:
        """Where the target is expected [m, world]."""
        return np.asarray(np.matmul(self.weights, self.motions))

    def mean_at(self, time: float) -> Float[np.ndarray, "3"]:
        """Where it is expected [m, world] at one instant [s]."""
        mean = self.mean
        return np.array([np.interp(time, self.times, mean[:, axis]) for axis in range(3)])


def prospect_of(futures: Futures, config: CaptureConfig) -> Prospect:
    """The futures, their times counted from the start of the plans, on the grid (host)."""
    chosen = np.flatnonzero(np.asarray(futures.weights) > 0.0)
    if len(chosen) > MOTIONS:
        chosen = chosen[np.linspace(0, len(chosen) - 1, MOTIONS).round().astype(int)]
    weights = np.asarray(futures.weights, dtype=np.float64)[chosen]
    few = Futures(times=futures.times, positions=np.asarray(futures.positions)[chosen], weights=weights)
    times = config.times(float(np.asarray(futures.times)[-1]))
    motions, missing = np.moveaxis(few.at(times), 0, 1), MOTIONS - len(chosen)
    return Prospect(
        times=times,
        motions=np.concatenate([motions, np.repeat(motions[:, :1], missing, axis=1)], axis=1),
        weights=np.pad(weights / weights.sum(), (0, missing)),
        reach=config.reach(times),
    )


def expected_goals(prospect: Prospect, target: Float[np.ndarray, "3"], times: Sequence[float]) -> Candidates:
    """Where the target is expected [m, world] at some times [s from the start], as candidates (host)."""
    goals = np.stack([prospect.mean_at(time) for time in times])
    return candidates_from(target, goals, np.array(times), np.zeros(len(times)))


def capture_times(
    prospect: Prospect, splines: SplineBatch, some: Int[np.ndarray, "n"] | None = None
) -> Float[np.ndarray, "k"]:
    """Expected seconds until each trajectory captures the target, at rest where it ends (host).

    NaN for all but ``some``: each takes its time, and what does not pass is not compared.
    """
    times = np.full(splines.durations.shape[1], np.nan)
    some = np.arange(len(times)) if some is None else some
    if len(some):
        durations, position = np.asarray(splines.durations)[:, some], np.asarray(splines.position)[..., some]
        times[some] = spline_times(*prospect, durations.T, np.moveaxis(position, -1, 0), 0.0, RETURN_SPEED)
    return times


def capture_time(prospect: Prospect, spline: PiecewisePolynomial, since: float = 0.0) -> float:
    """The same for what is left of one trajectory ``since`` [s of its own time]."""
    durations, position = np.asarray(spline.durations)[None], np.asarray(spline.position)[None]
    return float(spline_times(*prospect, durations, position, since, RETURN_SPEED)[0])


def straight_capture_times(
    prospect: Prospect, state: FlatState, goals: Float[np.ndarray, "k 3"], times: Float[np.ndarray, "k"]
) -> Float[np.ndarray, "k"]:
    """The same before there are trajectories: at a constant acceleration to each goal [m], to be there at its time [s].

    They stop soon behind their goals.
    """
    start = np.asarray(state.derivatives, float)[:2]
    return straight_times(*prospect, start, goals, np.maximum(times, STEP), 2.0 * STEP, RETURN_SPEED)
