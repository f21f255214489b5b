"""What comes into the planner from outside, as the compiled stations take it: NumPy, float64, of the right shapes.

A compiled station that meets another type or shape would be traced anew, in flight, for half a minute. So everything is
cast here, and what cannot be is refused in one line.
"""

from typing import Any, no_type_check

import numpy as np

from jaxplan.errors import InputError
from jaxplan.prediction.candidates import Candidates
from jaxplan.records import replace
from jaxplan.spline import FlatState
from jaxplan.validation import as_numbers


@no_type_check
def usual_state(state: FlatState) -> FlatState:
    """The start of a plan: one state, finite. Raises ``InputError`` otherwise."""
    derivatives = _array("state: derivatives", state.derivatives, np.float64, (5, 3))
    yaw = _array("state: yaw", state.yaw, np.float64, (3,))
    for name, values in (("derivatives", derivatives), ("yaw", yaw)):
        if not np.isfinite(values).all():
            raise InputError(f"state: {name} hold {values[~np.isfinite(values)][0]}, want finite numbers")
    return FlatState(derivatives=derivatives, yaw=yaw)


@no_type_check
def usual_candidates(candidates: Candidates) -> Candidates:
    """Goals with times, likelihoods and reasons of the same number; single ones may be unusable. As ``usual_state``."""
    goals = _array("candidates: goals", candidates.goals, np.float64, (None, 3))
    count = len(goals)
    return replace(
        candidates,
        goals=goals,
        arrival_times=_array("candidates: arrival_times", candidates.arrival_times, np.float64, (count,)),
        likelihood=_array("candidates: likelihood", candidates.likelihood, np.float64, (count,)),
        reasons=_array("candidates: reasons", candidates.reasons, np.uint32, (count,)),
        target=_array("candidates: target", candidates.target, np.float64, (3,)),
    )


def _array(name: str, values: Any, dtype: type, shape: tuple[int | None, ...]) -> Any:
    """The values as an array of this type and shape, None for any length."""
    array: Any = as_numbers(name, values, dtype)
    wanted = ", ".join("K" if length is None else str(length) for length in shape)
    fits = len(array.shape) == len(shape) and all(b is None or a == b for a, b in zip(array.shape, shape, strict=True))
    if not fits:
        raise InputError(f"{name}: have shape {array.shape}, want ({wanted}{',' if len(shape) == 1 else ''})")
    return array
