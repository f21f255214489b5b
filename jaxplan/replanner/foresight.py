"""Where boxes that are only seen will be: each is an oscillator, of a rate that is not known.

Whatever swings, circles, turns, brakes or flies straight on is for a second the solution of x'' = a - w^2 (x - x0) for
some rate w, straight on where a and w are 0. Given w its place, velocity and acceleration follow from what was seen by
linear regression, with priors on speed and acceleration; how probable each w is follows from the same regression
(Bayesian model averaging; Bishop, Pattern Recognition and Machine Learning, sections 3.3 and 3.4).
"""

from collections import deque
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Float
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
AT_ONCE = 1e-3
"""s within which two sightings are one."""


_PRIOR = np.stack([np.diag([1e-4, SPEED**-2, acceleration**-2]) for acceleration in ACCELERATIONS])


class _Fit(NamedTuple):
    """Each box's place, velocity and acceleration, for each rate."""

    mean: Float[np.ndarray, "b j 3 3"]
    """Place relative to where it was seen last [m], velocity, acceleration; each with x, y, z."""
    covariance: Float[np.ndarray, "b j 3 3"]
    """Of the three, the same along each axis."""
    probability: Float[np.ndarray, "b j"]


class Foresight:
    """Tracks boxes of known sides and says where they will be when, for ``Replanner.expect``."""

    def __init__(self, half: Annotated[ArrayLike, "b 3"], noise: float = 0.01, straying: float = 8.0) -> None:
        """Nothing has been seen yet.

        Args:
            half: the boxes' half sides along the room's axes [m].
            noise: standard deviation of the places that will be seen, along each axis [m].
            straying: acceleration beside what is foreseen [m/s^2] that is to be survived: boxes are larger by what it
                leads to within ``REACTION``, and by three standard deviations of the noise.

        Raises ``InputError`` for sides, noise or an acceleration that are none.
        """
        half = as_shaped("foresight: half", half, (None, 3))
        if not (np.isfinite(half).all() and (half > 0.0).all() and 0.0 < noise < np.inf and 0.0 <= straying < np.inf):
            raise InputError("foresight: want finite half sides and noise above 0 m, and straying of 0 m/s^2 or more")
        self._half, self._noise, self._straying = half, noise, straying
        self._seen = deque[tuple[float, np.ndarray]]()

    def see(self, now: float, centers: Annotated[ArrayLike, "b 3"]) -> None:
        """Where the boxes' centres are [m, world] at ``now`` [s]; NaN for those that are not seen.

        Raises ``InputError`` for other shapes, and where ``now`` is before what has been seen.
        """
        centers = as_shaped("foresight: centers", centers, self._half.shape)
        if not np.isfinite(now) or (self._seen and now < self._seen[-1][0]):
            raise InputError(f"foresight: now is {now} s, want a finite time, and none before what was seen last")
        while self._seen and now - self._seen[-1][0] < AT_ONCE:
            self._seen.pop()
        self._seen.append((float(now), centers))
        while now - self._seen[0][0] > MEMORY + AT_ONCE:
            self._seen.popleft()

    def ways(self, now: float, ahead: Float[np.ndarray, "n"], keep: float) -> Ways:
        """Where all that have been seen within ``MEMORY`` will be so long [s] after ``now`` [s].

        Args:
            now: on the clock of what was seen.
            ahead: ascending, from 0 on.
            keep: what plans are to keep from them [m].
        """
        lower, upper = self.corners(now, ahead)
        known = np.isfinite(lower).all(axis=(1, 2))
        return Ways(now + ahead, lower[known], upper[known], keep)

    def corners(
        self, now: float, ahead: Float[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "b n 3"], Float[np.ndarray, "b n 3"]]:
        """Lower and upper corners [m, world]; NaN for boxes that have not been seen."""
        if not self._seen:
            nowhere = np.full((len(self._half), len(ahead), 3), np.nan)
            return nowhere, nowhere
        times = np.array([time for time, _ in self._seen]) - now
        places = np.stack([centers for _, centers in self._seen], axis=1)
        last, fit = self._fitted(times, places)
        basis = _basis(np.asarray(ahead, dtype=float))
        each = np.einsum("jni,bjid->bjnd", basis, fit.mean)
        way = last[:, None] + np.einsum("bj,bjnd->bnd", fit.probability, each)
        strayed = 3.0 * self._noise + 0.5 * self._straying * np.minimum(ahead, REACTION) ** 2
        reach = self._half[:, None] + strayed[:, None]
        return way - reach, way + reach

    def _fitted(
        self, times: Float[np.ndarray, "m"], places: Float[np.ndarray, "b m 3"]
    ) -> tuple[Float[np.ndarray, "b 3"], _Fit]:
        """Where each box was seen last [m], and its motions."""
        seen = np.isfinite(places).all(axis=2)
        newest = places.shape[1] - 1 - np.argmax(seen[:, ::-1], axis=1)
        last = np.take_along_axis(places, newest[:, None, None], axis=1)[:, 0]
        basis, weight = _basis(times), seen / (self._noise**2 + (0.5 * AGED * times**2) ** 2)
        offsets = np.where(seen[..., None], places - last[:, None], 0.0)
        precision = np.einsum("jmi,bm,jmk->bjik", basis, weight, basis) + _PRIOR
        covariance = np.linalg.inv(precision)
        moment = np.einsum("jmi,bm,bmd->bjid", basis, weight, offsets)
        mean = covariance @ moment
        explained = 0.5 * np.einsum("bjid,bjid->bj", mean, moment)
        log_evidence = explained - 1.5 * (np.linalg.slogdet(precision)[1] - np.linalg.slogdet(_PRIOR)[1])
        log_evidence += np.log(ODDS)
        probability = np.exp(log_evidence - log_evidence.max(axis=1, keepdims=True))
        return last, _Fit(mean, covariance, probability / probability.sum(axis=1, keepdims=True))


def _basis(times: Float[np.ndarray, "n"]) -> Float[np.ndarray, "j n 3"]:
    """What place, velocity and acceleration at 0 s contribute to the place at each time [s], for each rate."""
    rates = np.maximum(RATES, 1e-6)[:, None]
    angle = rates * times
    return np.stack([np.ones_like(angle), np.sin(angle) / rates, 2.0 * (np.sin(0.5 * angle) / rates) ** 2], axis=-1)
