"""Which way a vehicle is turned that has any attitude (host)."""

import numpy as np
from jaxtyping import Float


def body_axes(quat_wxyz: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """Body x, y and z in the world, one a row, of a quaternion of any size but 0."""
    w, x, y, z = (quat_wxyz / np.linalg.norm(quat_wxyz)).tolist()
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
            [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
            [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def heading_near(attitude: Float[np.ndarray, "4"], yaw: float) -> float:
    """Where body x points, seen from above [rad], unwrapped to within half a turn of ``yaw``."""
    east, north, _ = body_axes(attitude)[0]
    cos, sin = np.cos(yaw), np.sin(yaw)
    return yaw + float(np.arctan2(cos * north - sin * east, cos * east + sin * north))


def turn_from(attitude: Float[np.ndarray, "4"], yaw: float) -> float:
    """How far an attitude is turned about body z [rad] from that of the same thrust with this yaw [rad]."""
    body_x, body_y, body_z = body_axes(attitude)
    wanted = np.cross([-np.sin(yaw), np.cos(yaw), 0.0], body_z)
    return float(np.arctan2(-(wanted @ body_y), wanted @ body_x))
