"""What the vehicle would do along plans that might take over, by its model."""

import jax
import numpy as np

from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.planner import Planner, Rollout, Rollouts, sampled
from jaxplan.replanner.committed import CommittedPlans
from jaxplan.replanner.records import Measured
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.tracking.rates import CONTROL_RATE

COMMITTED_TWIST = 1.2
"""How much more the model may be turned about body z, where a plan is committed already (docs/decisions/0060)."""


class Ahead:
    """The model where the vehicle is now, and the references that lead from there to a takeover."""

    def __init__(self, model: Rollout, committed: CommittedPlans, now: float) -> None:
        self.model, self.now = model, now
        self._times = now + np.arange(model.config.steps_ahead + 1) / CONTROL_RATE
        self._kept = committed.reference(self._times)
        self.committed = model.along(jax.tree.map(lambda rows: rows[None], self._kept))
        """Of the plans that are committed already."""

    @property
    def most_twist(self) -> float:
        """Largest turn [rad] about body z with which a committed plan is kept."""
        return COMMITTED_TWIST * self.model.config.most_twist

    def along(self, splines: SplineBatch | PiecewisePolynomial, takeover: float) -> Rollouts:
        """One plan or many, which take over at ``takeover`` [s]."""
        return self._fly(sampled(splines, self._times - takeover), takeover)

    def at(self, takeover: float) -> FlatState:
        """The vehicle at ``takeover`` [s], as the model has it."""
        rows = self._times <= takeover + 1e-9
        return self.model.after(jax.tree.map(lambda leaf: leaf[rows], self._kept))

    def _fly(self, plans: FlatState, takeover: float) -> Rollouts:
        """Along what is committed until the takeover, then along the plans."""
        before = self._times < takeover - 1e-9

        def spliced(kept: np.ndarray, rows: np.ndarray) -> np.ndarray:
            return np.where(before.reshape(-1, *(1,) * (kept.ndim - 1)), kept, rows)

        return self.model.along(jax.tree.map(spliced, self._kept, plans), int(before.sum()))


def look_ahead(
    planner: Planner, committed: CommittedPlans, now: float, measured: Measured | None, last: Ahead | None = None
) -> Ahead | None:
    """None where the vehicle is not measured, or the planner has no model to fly plans in.

    The model goes on from the ``last`` cycle's, where that is not too long ago.
    """
    settings = planner.config.rollouts
    if measured is None or settings is None:
        return None
    steps = settings.steps + 1 if last is None else round((now - last.now) * CONTROL_RATE)
    before = None if last is None or steps > settings.steps else last.model
    times = now + np.arange(-min(steps, settings.steps), 1) / CONTROL_RATE
    known = before is not None or committed.plans[0].start_time <= times[0]
    model = planner.roll_out(committed.reference(times if known else times[-1:]), *measured, before)
    return None if model is None else Ahead(model, committed, now)
