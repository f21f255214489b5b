"""A baseline that plans with a point mass: model predictive control by quadratic programs (OSQP, extra ``peers``).

In each cycle the squared distances to the predicted target and the squared accelerations over the coming second are
minimised, axis by axis, within limits of acceleration, velocity, and the faces of the room. It knows no obstacles. The
first acceleration is commanded.
"""

import importlib.util
from typing import Any

import numpy as np
import scipy.sparse
from jaxtyping import Float

from jaxplan.prediction.observations import Observations
from jaxplan.prediction.protocol import Predictor
from jaxplan.world.obstacles import World

from .guidance import MOST_ACCELERATION, MOST_SPEED

STEPS, STEP = 10, 0.1
"""Of the horizon, and s."""
EFFORT = 1e-3
"""m^2 that an acceleration of 1 m/s^2 is worth (arbitrary)."""
FROM_WALLS = 0.4
"""m"""


def has_solver() -> bool:
    """Whether OSQP is installed."""
    return importlib.util.find_spec("osqp") is not None


class PointMassMpc:
    """A ``guidance.Law``: the first acceleration of a plan for the coming second."""

    def __init__(self, world: World, predictor: Predictor) -> None:
        """``predictor`` proposes where the target will be; of several goals at a time the first counts."""
        self._predictor, self._cycles = predictor, 0
        self._bounds = np.asarray(world.bounds, dtype=float) + FROM_WALLS * np.array([[1.0], [-1.0]])
        lags = np.arange(1, STEPS + 1)[:, None] - np.arange(STEPS)[None]
        self._velocity = np.where(lags > 0, STEP, 0.0)
        self._position = np.where(lags > 0, STEP**2 * (lags - 0.5), 0.0)
        self._axes = [self._program() for _ in range(3)]

    def __call__(self, state: Float[np.ndarray, "5 3"], observations: Observations) -> Float[np.ndarray, "3"]:
        """As ``guidance.Law``."""
        expected = self._expected(observations)
        self._cycles += 1
        wanted = np.array([self._solved(axis, state[:2, axis], expected[:, axis]) for axis in range(3)])
        return wanted * min(1.0, MOST_ACCELERATION / max(float(np.linalg.norm(wanted)), 1e-9))

    def _expected(self, observations: Observations) -> Float[np.ndarray, "s 3"]:
        """Where the target will be at the steps of the horizon [m]."""
        candidates = self._predictor(observations, self._cycles)
        times, first = np.unique(np.asarray(candidates.arrival_times), return_index=True)
        goals = np.asarray(candidates.goals)[first]
        known_times, known = np.r_[0.0, times], np.concatenate([observations.positions[-1:], goals])
        wanted = STEP * np.arange(1, STEPS + 1)
        return np.stack([np.interp(wanted, known_times, known[:, axis]) for axis in range(3)], axis=1)

    def _program(self) -> Any:
        """The quadratic program of one axis; bounds and the linear term change from cycle to cycle."""
        import osqp

        hessian = 2.0 * (self._position.T @ self._position + EFFORT * np.eye(STEPS))
        rows = np.concatenate([np.eye(STEPS), self._velocity, self._position])
        program = osqp.OSQP()
        wide = np.full(len(rows), 1e6)
        program.setup(
            scipy.sparse.csc_matrix(np.triu(hessian)),
            np.zeros(STEPS),
            scipy.sparse.csc_matrix(rows),
            -wide,
            wide,
            verbose=False,
            eps_abs=1e-5,
            eps_rel=1e-5,
        )
        return program

    def _solved(self, axis: int, state: Float[np.ndarray, "2"], expected: Float[np.ndarray, "s"]) -> float:
        """The acceleration to begin with [m/s^2]; that of a stop where there is none within the limits."""
        position, velocity = state
        times = STEP * np.arange(1, STEPS + 1)
        free = position + velocity * times
        lower, upper = self._bounds[:, axis]
        speed = max(MOST_SPEED, abs(velocity))
        most = np.full(STEPS, MOST_ACCELERATION)
        program = self._axes[axis]
        program.update(
            q=2.0 * self._position.T @ (free - expected),
            l=np.concatenate([-most, np.full(STEPS, -speed - velocity), min(lower, position) - free]),
            u=np.concatenate([most, np.full(STEPS, speed - velocity), max(upper, position) - free]),
        )
        found = program.solve()
        if found.info.status_val != 1 or not np.isfinite(found.x).all():
            return float(np.clip(-velocity / STEP, -MOST_ACCELERATION, MOST_ACCELERATION))
        return float(found.x[0])
