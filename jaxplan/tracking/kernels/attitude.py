"""Vectors, attitudes and the rates that turn them: ``vehicle.rotations`` and ``vehicle.flatness``, compiled.

An attitude is its three body axes in the world: the columns of the rotation.
"""

import math
from typing import no_type_check

from jaxplan.tracking.kernels.compiled import inner

TINY = 1e-6
"""Sine of half an angle below which the angle is taken for twice it, as in ``rotation_vector``."""


@inner
@no_type_check
def dot(u, v):
    """u . v."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@inner
@no_type_check
def cross(u, v):
    """u x v."""
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@inner
@no_type_check
def length(v):
    """Euclidean norm."""
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@inner
@no_type_check
def divided(a, b):
    """a / b, and 0 where b is 0."""
    return a / b if b != 0.0 else 0.0


@inner
@no_type_check
def axes_of(w, x, y, z):
    """Body axes of a unit quaternion."""
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        (2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


@inner
@no_type_check
def axes_along(force, yaw):
    """Body axes with z along ``force`` and x in the vertical plane of ``yaw`` (``flatness.attitude_from``)."""
    c, s = math.cos(yaw), math.sin(yaw)
    size = length(force)
    b_z = (force[0] / size, force[1] / size, force[2] / size) if size != 0.0 else (0.0, 0.0, 1.0)
    ahead = cross((-s, c, 0.0), b_z)
    size = length(ahead)
    b_x = (ahead[0] / size, ahead[1] / size, ahead[2] / size) if size != 0.0 else (c, s, 0.0)
    return b_x, cross(b_z, b_x), b_z


@inner
@no_type_check
def rates_of(axes, thrust, jerk, snap, yaw_rate, yaw_acceleration):
    """Body rates and angular acceleration at a specific thrust (``flatness.body_rates_from``)."""
    b_x3, b_y3, b_z3 = axes[0][2], axes[1][2], axes[2][2]
    jerk_x, jerk_y, thrust_rate = dot(axes[0], jerk), dot(axes[1], jerk), dot(axes[2], jerk)
    snap_x, snap_y = dot(axes[0], snap), dot(axes[1], snap)
    heading = 1.0 - b_x3 * b_x3
    rate_x = -divided(jerk_y, thrust)
    rate_y = divided(jerk_x, thrust)
    rate_z = divided(heading * yaw_rate - b_y3 * rate_y, b_z3)
    acc_x = -divided(snap_y + 2.0 * thrust_rate * rate_x, thrust) + rate_y * rate_z
    acc_y = divided(snap_x - 2.0 * thrust_rate * rate_y, thrust) - rate_x * rate_z
    heading_rate = -2.0 * b_x3 * (rate_z * b_y3 - rate_y * b_z3)
    drift = rate_x * (rate_y * b_z3 - rate_z * b_y3)
    acc_z = divided(heading * yaw_acceleration + heading_rate * yaw_rate - drift - b_y3 * acc_y, b_z3)
    return (rate_x, rate_y, rate_z), (acc_x, acc_y, acc_z)


@inner
@no_type_check
def quaternion_of(axes):
    """Unit quaternion (w x y z, w >= 0) of body axes, by the largest of its components (Shepperd 1978)."""
    (a, d, g), (b, e, h), (c, f, i) = axes
    squares = (1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i)  # four times the components'
    largest, square = 0, squares[0]
    for other in range(1, 4):
        if squares[other] > square:
            largest, square = other, squares[other]
    if largest == 0:
        q = (square, h - f, c - g, d - b)
    elif largest == 1:
        q = (h - f, square, b + d, c + g)
    elif largest == 2:
        q = (c - g, b + d, square, f + h)
    else:
        q = (d - b, c + g, f + h, square)
    scale = 0.5 / math.sqrt(square)
    if q[0] < 0.0:
        scale = -scale
    return q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale


@inner
@no_type_check
def turn_between(axes, wanted):
    """Axis times angle [rad, body] of the turn from one attitude to another (``rotation_vector`` of R^T wanted)."""
    columns = (
        (dot(axes[0], wanted[0]), dot(axes[1], wanted[0]), dot(axes[2], wanted[0])),
        (dot(axes[0], wanted[1]), dot(axes[1], wanted[1]), dot(axes[2], wanted[1])),
        (dot(axes[0], wanted[2]), dot(axes[1], wanted[2]), dot(axes[2], wanted[2])),
    )
    w, x, y, z = quaternion_of(columns)
    sine = length((x, y, z))
    factor = 2.0 if sine < TINY else 2.0 * math.atan2(sine, w) / sine
    return factor * x, factor * y, factor * z
