"""Rotation matrices (body to world) and unit quaternions (w x y z), for one rotation each.

NaN goes through: nothing here hides a bad attitude.
"""

import jax.numpy as jnp
from jaxtyping import Float

from jaxplan.arrays import AnyArray
from jaxplan.vehicle.vectors import length


def rotation_from_quat(quat_wxyz: Float[AnyArray, "4"]) -> Float[AnyArray, "3 3"]:
    """The matrix that turns body vectors into world vectors."""
    w, x, y, z = quat_wxyz
    return jnp.stack(
        [
            jnp.stack([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)]),
            jnp.stack([2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)]),
            jnp.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)]),
        ]
    )


def quat_from_rotation(rotation: Float[AnyArray, "3 3"]) -> Float[AnyArray, "4"]:
    """The quaternion (w >= 0) of a rotation matrix, by the largest of its four components (Shepperd 1978)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    outer = jnp.stack(  # 4 q q^T
        [
            jnp.stack([1.0 + a + e + i, h - f, c - g, d - b]),
            jnp.stack([h - f, 1.0 + a - e - i, b + d, c + g]),
            jnp.stack([c - g, b + d, 1.0 - a + e - i, f + h]),
            jnp.stack([d - b, c + g, f + h, 1.0 - a - e + i]),
        ]
    )
    row, square = outer[0], outer[0, 0]
    for other in range(1, 4):  # selected, not indexed: indices that depend on data cost every lane of a batch a gather
        larger = outer[other, other] > square
        row, square = jnp.where(larger, outer[other], row), jnp.where(larger, outer[other, other], square)
    quat = row / (2.0 * jnp.sqrt(square))
    return jnp.where(quat[0] < 0.0, -quat, quat)


def rotation_vector(rotation: Float[AnyArray, "3 3"]) -> Float[AnyArray, "3"]:
    """Axis times angle [rad, at most pi] of a rotation matrix; 2 v for tiny angles."""
    quat = quat_from_rotation(rotation)
    vector = quat[1:]
    sine = length(vector)
    tiny = sine < 1e-6
    return jnp.where(tiny, 2.0, 2.0 * jnp.arctan2(sine, quat[0]) / jnp.where(tiny, 1.0, sine)) * vector
