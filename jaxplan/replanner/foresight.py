"""Where boxes that are only seen will be: each is an oscillator, of a rate that is not known.

Whatever swings, circles, turns, brakes or flies straight on is for a second the solution of x'' = a - w^2 (x - x0) for
some rate w, straight on where a and w are 0. Given w its place, velocity and acceleration follow from what was seen by
linear regression, with priors on speed and acceleration; how probable each w is follows from the same regression
(Bayesian model averaging; Bishop, Pattern Recognition and Machine Learning, sections 3.3 and 3.4).
"""

from collections import deque
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from jaxplan.errors import InputError
from jaxplan.replanner.passing import Ways
from jaxplan.validation import as_shaped

RATES = np.array([0.0, 0.0, 0.6, 0.9, 1.2, 1.6, 2.0, 2.5, 3.0, 3.6, 4.3, 5.2, 6.2])
"""rad/s; faster ones swing by less than 0.2 m at the prior's acceleration."""
ODDS = np.where(np.arange(len(RATES)) == 0, 0.1, 1.0 / (1.0 + (RATES / 2.0) ** 2))
"""How probable each is beforehand (arbitrary)."""
SPEED = 3.0
"""m/s along each axis that is usual beforehand (arbitrary)."""
ACCELERATIONS = np.where(np.arange(len(RATES)) == 0, 0.1, 6.0)
"""m/s^2 likewise: the first motion is straight on (arbitrary)."""
MEMORY = 0.6
"""s that are looked back: older places say less about a motion that changes."""
AGED = 0.2
"""m/s^2; by half of this times the square of its age a place says less about how the motion goes on."""
REACTION = 0.3
"""s in which a vehicle does something about what it did not foresee: a latency, a cycle, turning the thrust. So long a
box is taken to be able to stray."""
STRAYING = 8.0
"""m/s^2 that boxes are taken to accelerate beside what is foreseen, where nothing else is told (arbitrary)."""
AT_ONCE = 1e-3
"""s within which two sightings are one."""


_PRIOR = np.stack([np.diag([1e-4, SPEED**-2, acceleration**-2]) for acceleration in ACCELERATIONS])


class Foresight:
    """Tracks boxes of known sides and says where they will be when, for ``Replanner.expect``."""

    def __init__(self, half: Annotated[ArrayLike, "b 3"], noise: float = 0.01, straying: float = STRAYING) -> None:
        """Nothing has been seen yet.

        Args:
            half: the boxes' half sides along the room's axes [m].
            noise: standard deviation of the places that will be seen, along each axis [m].
            straying: acceleration beside what is foreseen [m/s^2] that is to be survived: boxes are larger by what it
                leads to within ``REACTION``, and by three standard deviations of the noise.

        Raises ``InputError`` for sides, noise or an acceleration that are none.
        """
        sides = as_shaped("foresight: half", half, (None, 3))
        if not (np.isfinite(sides).all() and (sides > 0.0).all() and 0.0 < noise < np.inf and 0.0 <= straying < np.inf):
            raise InputError("foresight: want finite half sides and noise above 0 m, and straying of 0 m/s^2 or more")
        self._half, self._noise, self._straying = sides, noise, straying
        self._seen = deque[tuple[float, np.ndarray]]()

    def see(self, now: float, centers: Annotated[ArrayLike, "b 3"]) -> None:
        """Where the boxes' centres are [m, world] at ``now`` [s]; NaN for those that are not seen.

        Raises ``InputError`` for other shapes, and where ``now`` is before what has been seen.
        """
        places = as_shaped("foresight: centers", centers, self._half.shape)
        if not np.isfinite(now) or (self._seen and now < self._seen[-1][0]):
            raise InputError(f"foresight: now is {now} s, want a finite time, and none before what was seen last")
        while self._seen and now - self._seen[-1][0] < AT_ONCE:
            self._seen.pop()
        self._seen.append((float(now), places))
        while now - self._seen[0][0] > MEMORY + AT_ONCE:
            self._seen.popleft()

    def ways(self, now: float, ahead: Float[np.ndarray, "n"], keep: float) -> Ways:
        """Where they will be so long [s] after ``now`` [s]; NaN for those that have not been seen within ``MEMORY``.

        Args:
            now: on the clock of what was seen.
            ahead: ascending, from 0 on.
            keep: what plans are to keep from them [m].
        """
        ahead = np.asarray(ahead, dtype=float)
        return Ways(now + ahead, *self._corners(now, ahead), keep)

    def _corners(
        self, now: float, ahead: Float[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "b n 3"], Float[np.ndarray, "b n 3"]]:
        """Lower and upper corners [m, world]; NaN for boxes that have not been seen."""
        if not self._seen:
            nowhere = np.full((len(self._half), len(ahead), 3), np.nan)
            return nowhere, nowhere
        times = np.array([time for time, _ in self._seen]) - now
        places = np.stack([centers for _, centers in self._seen], axis=1)
        seen = np.isfinite(places).all(axis=2) & (times >= -MEMORY - AT_ONCE)
        places = np.where(seen[..., None], places, np.nan)
        newest = places.shape[1] - 1 - np.argmax(seen[:, ::-1], axis=1)
        last = np.take_along_axis(places, newest[:, None, None], axis=1)[:, 0]
        offsets = np.where(seen[..., None], places - last[:, None], 0.0)
        mean, probability = self._fitted(times, offsets, seen)
        each = np.einsum("jni,bjid->bjnd", _basis(ahead), mean)
        way = last[:, None] + np.einsum("bj,bjnd->bnd", probability, each)
        unseen = np.minimum(ahead, REACTION) - times[newest][:, None]
        reach = self._half[:, None] + (3.0 * self._noise + 0.5 * self._straying * unseen**2)[..., None]
        return way - reach, way + reach

    def _fitted(
        self, times: Float[np.ndarray, "m"], offsets: Float[np.ndarray, "b m 3"], seen: Bool[np.ndarray, "b m"]
    ) -> tuple[Float[np.ndarray, "b j 3 3"], Float[np.ndarray, "b j"]]:
        """Each box's place [m], velocity and acceleration at 0 s, by x, y, z, for each rate; how probable that is."""
        basis, weight = _basis(times), seen / (self._noise**2 + (0.5 * AGED * times**2) ** 2)
        precision = np.einsum("jmi,bm,jmk->bjik", basis, weight, basis) + _PRIOR
        moment = np.einsum("jmi,bm,bmd->bjid", basis, weight, offsets)
        mean = np.linalg.solve(precision, moment)
        explained = 0.5 * np.einsum("bjid,bjid->bj", mean, moment)
        log_evidence = explained - 1.5 * (np.linalg.slogdet(precision)[1] - np.linalg.slogdet(_PRIOR)[1])
        log_evidence += np.log(ODDS)
        probability = np.exp(log_evidence - log_evidence.max(axis=1, keepdims=True))
        return mean, probability / probability.sum(axis=1, keepdims=True)


def _basis(times: Float[np.ndarray, "n"]) -> Float[np.ndarray, "j n 3"]:
    """What place, velocity and acceleration at 0 s contribute to the place at each time [s], for each rate."""
    rates = np.maximum(RATES, 1e-6)[:, None]
    angle = rates * times
    return np.stack([np.ones_like(angle), np.sin(angle) / rates, 2.0 * (np.sin(0.5 * angle) / rates) ** 2], axis=-1)
