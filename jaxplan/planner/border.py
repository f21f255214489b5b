"""What comes into the planner from outside, as the compiled stations take it: NumPy, float64, of the right shapes.

A compiled station that meets another type or shape would be traced anew, in flight, for half a minute. So everything is
cast here, and what cannot be is refused in one line.
"""

from typing import no_type_check

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.prediction.candidates import Candidates
from jaxplan.prediction.futures import Futures
from jaxplan.records import replace
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.validation import as_finite, as_shaped


@no_type_check
def usual_state(state: FlatState) -> FlatState:
    """The start of a plan: one state, finite. Raises ``InputError`` otherwise."""
    derivatives = as_finite("state: derivatives", state.derivatives, (5, 3))
    return FlatState(derivatives=derivatives, yaw=as_finite("state: yaw", state.yaw, (3,)))


@no_type_check
def usual_candidates(candidates: Candidates) -> Candidates:
    """Goals with times, likelihoods and reasons of the same number; single ones may be unusable. As ``usual_state``."""
    goals = as_shaped("candidates: goals", candidates.goals, (None, 3))
    count = len(goals)
    return replace(
        candidates,
        goals=goals,
        arrival_times=as_shaped("candidates: arrival_times", candidates.arrival_times, (count,)),
        likelihood=as_shaped("candidates: likelihood", candidates.likelihood, (count,)),
        reasons=as_shaped("candidates: reasons", candidates.reasons, (count,), np.uint32),
        target=as_shaped("candidates: target", candidates.target, (3,)),
    )


@no_type_check
def usual_futures(futures: Futures) -> Futures | None:
    """Motions with times and weights of the same numbers; None where these mean nothing. As ``usual_state``."""
    times, weights = (as_shaped(f"futures: {name}", getattr(futures, name), (None,)) for name in ("times", "weights"))
    positions = as_shaped("futures: positions", futures.positions, (len(weights), len(times), 3))
    finite = np.isfinite(positions).all() and np.isfinite(times).all() and np.isfinite(weights).all()
    rising = len(times) > 0 and (np.diff(times) > 0.0).all()
    if not (finite and rising and (weights >= 0.0).all() and weights.sum() > 0.0):
        return None
    return Futures(times=times, positions=positions, weights=weights / weights.sum())


@no_type_check
def usual_spline(spline: PiecewisePolynomial) -> PiecewisePolynomial:
    """A trajectory of three coordinates, and a heading or none; its numbers may be any. As ``usual_state``."""
    durations = as_shaped("spline: durations", spline.durations, (None,))
    position = as_shaped("spline: position", spline.position, (len(durations), None, 3))
    yaw = None if spline.yaw is None else as_shaped("spline: yaw", spline.yaw, (len(durations), None))
    if not len(durations) or not position.shape[1] or (yaw is not None and not yaw.shape[1]):
        raise InputError("spline: have no segment or no coefficient, want one or more of each")
    return PiecewisePolynomial(
        durations=durations, position=_with_terms(position, 5), yaw=None if yaw is None else _with_terms(yaw, 3)
    )


def _with_terms(coefficients: Float[np.ndarray, "m n ..."], least: int) -> Float[np.ndarray, "m k ..."]:
    """The same polynomials with at least so many ascending coefficients."""
    more = least - coefficients.shape[1]
    return coefficients if more <= 0 else np.pad(coefficients, [(0, 0), (0, more), *[(0, 0)] * (coefficients.ndim - 2)])
