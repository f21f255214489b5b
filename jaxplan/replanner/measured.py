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


def heading_near(attitude: Float[np.ndarray, "4"], yaw: float) -> float:
    """Where body x points, seen from above [rad], unwrapped to within half a turn of ``yaw``."""
    east, north, _ = _axes(attitude)[0]
    cos, sin = np.cos(yaw), np.sin(yaw)
    return yaw + float(np.arctan2(cos * north - sin * east, cos * east + sin * north))


def turn_from(attitude: Float[np.ndarray, "4"], yaw: float) -> float:
    """How far an attitude is turned about body z [rad] from that of the same thrust with this yaw [rad]."""
    body_x, body_y, body_z = _axes(attitude)
    wanted = np.cross([-np.sin(yaw), np.cos(yaw), 0.0], body_z)
    return float(np.arctan2(-(wanted @ body_y), wanted @ body_x))


def _axes(attitude: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """Body axes in the world, one a row."""
    w, x, y, z = (attitude / np.linalg.norm(attitude)).tolist()
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
            [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
            [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
