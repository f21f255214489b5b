"""Where the next plan begins when the vehicle is not where its reference is."""

import math
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


def heading_near(attitude: Float[np.ndarray, "4"], yaw: float) -> float:
    """Where body x points, seen from above [rad], unwrapped to within half a turn of ``yaw``."""
    east, north, _ = _axes(attitude)[0]
    cos, sin = math.cos(yaw), math.sin(yaw)
    return yaw + math.atan2(cos * north - sin * east, cos * east + sin * north)


def turn_from(attitude: Float[np.ndarray, "4"], yaw: float) -> float:
    """How far an attitude is turned about body z [rad] from that of the same thrust with this yaw [rad]."""
    body_x, body_y, body_z = _axes(attitude)
    cos, sin = math.cos(yaw), math.sin(yaw)
    wanted = cos * body_z[2], sin * body_z[2], -sin * body_z[1] - cos * body_z[0]
    return math.atan2(-_dot(wanted, body_y), _dot(wanted, body_x))


_Vector = tuple[float, float, float]


def _axes(attitude: Float[np.ndarray, "4"]) -> tuple[_Vector, _Vector, _Vector]:
    """Body axes in the world; as plain numbers, of which a cycle wants few."""
    w, x, y, z = attitude.tolist()
    double = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        (1.0 - double * (y * y + z * z), double * (x * y + w * z), double * (x * z - w * y)),
        (double * (x * y - w * z), 1.0 - double * (x * x + z * z), double * (y * z + w * x)),
        (double * (x * z + w * y), double * (y * z - w * x), 1.0 - double * (x * x + y * y)),
    )


def _dot(one: _Vector, other: _Vector) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]
