"""Targets that may do one of a few things, and predictors that say so."""

import numpy as np

from jaxplan.prediction.candidates import Candidates, candidates_from, later
from jaxplan.prediction.futures import Futures
from jaxplan.records import replace

TIMES = 0.1 * np.arange(1, 21)


def predicted(
    *velocities: tuple[float, float, float], place: tuple[float, float, float] = (-4.2, 0.0, 1.0)
) -> Candidates:
    """A target at a place that goes on at one of some velocities, all as likely; its goals are those of all of them."""
    motions = np.array(place) + np.r_[0.0, TIMES][:, None] * np.array(velocities)[:, None]
    count = len(velocities)
    goals = np.moveaxis(motions[:, 1:], 0, 1).reshape(-1, 3)
    found = candidates_from(np.array(place), goals, np.repeat(TIMES, count), np.zeros(len(goals)))
    futures = Futures(times=np.r_[0.0, TIMES], positions=motions, weights=np.full(count, 1.0 / count))
    return replace(found, futures=futures)


class Always:
    """A predictor that always says the same of what comes from now on, or one thing after another."""

    def __init__(self, *answers: Candidates) -> None:
        self.answers = answers

    def __call__(self, observations: object, cycle: int) -> Candidates:
        return self.answers[cycle % len(self.answers)]


class Passing:
    """One motion of the target, as time passes."""

    def __init__(self, whole: Candidates, spread: float) -> None:
        self.whole, self.spread, self.rng = whole, spread, np.random.default_rng(0)

    def __call__(self, observations: object, cycle: int) -> Candidates:
        """Told anew in each cycle, with noise on whole motions."""
        whole = later(self.whole, 0.1 * cycle)
        futures = whole.futures
        assert futures is not None
        moved = futures.positions + self.spread * self.rng.normal(size=(len(futures.positions), 1, 3))
        goals = np.moveaxis(moved[:, 1:], 0, 1).reshape(-1, 3)
        return replace(whole, goals=goals, futures=replace(futures, positions=moved))
