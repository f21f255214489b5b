"""Where the next plan begins when the vehicle is not where its reference is."""

from typing import no_type_check

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.replanner.records import Measured
from jaxplan.spline import FlatState
from jaxplan.validation import as_numbers


@no_type_check
def usual_measured(measured: Measured) -> Measured:
    """Arrays of float64. Raises ``InputError`` where they are not three finite numbers each; a unit quaternion."""
    parts = []
    for name, values in zip(Measured._fields, measured, strict=True):
        if name in ("acceleration", "attitude") and values is None:
            parts.append(None)
            continue
        array = as_numbers(f"measured: {name}", values)
        turned = name == "attitude"
        if array.shape != (4 if turned else 3,) or not np.isfinite(array).all() or (turned and not _is_unit(array)):
            wanted = "a unit quaternion w x y z" if turned else "three finite numbers"
            raise InputError(f"measured: {name} is {' '.join(repr(values).split())}, want {wanted}")
        parts.append(array)
    return Measured(*parts)


def _is_unit(quaternion: Float[np.ndarray, "4"]) -> bool:
    """As nearly as estimators keep it: within one percent."""
    return bool(abs(np.linalg.norm(quaternion) - 1.0) <= 0.01)


def carried_on(measured: Measured, now: FlatState, then: FlatState, latency: float) -> FlatState:
    """Where the vehicle will be, so long [s] after it was measured.

    ``now`` and ``then`` are the reference at the two instants: the vehicle is taken to fly it beside it, with the error
    of its acceleration held and that of its velocity and position as these follow. Jerk, snap and yaw are the
    reference's.
    """
    off = np.zeros((3, 3))
    off[0] = measured.position - np.asarray(now.pos)
    off[1] = measured.velocity - np.asarray(now.vel)
    if measured.acceleration is not None:
        off[2] = measured.acceleration - np.asarray(now.acc)
    derivatives = np.array(then.derivatives, dtype=float)
    derivatives[0] += off[0] + latency * off[1] + 0.5 * latency**2 * off[2]
    derivatives[1] += off[1] + latency * off[2]
    derivatives[2] += off[2]
    return FlatState(derivatives=derivatives, yaw=np.asarray(then.yaw))
