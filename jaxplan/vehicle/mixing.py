"""From rotor speeds to the wrench on the body and back.

    [moment_x, moment_y, moment_z, thrust] = G1 speed^2        (Tal & Karaman 2021, G1 of eq. 6, here in FLU with z up)

``Vehicle`` admits every layout whose G1 has rank 4. The inverse is the adjugate over the determinant: plain arithmetic,
where a linear solve would call LAPACK lane by lane.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxplan.arrays import AnyArray
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.vectors import Entry, Vector, dot

_SIGNS = np.array([[1.0, -1.0, 1.0, -1.0], [-1.0, 1.0, -1.0, 1.0], [1.0, -1.0, 1.0, -1.0], [-1.0, 1.0, -1.0, 1.0]])
"""Of the cofactors."""


def allocation_matrix(vehicle: Vehicle) -> Float[AnyArray, "4 4"]:
    """G1 [N m, N m, N m, N per (rad/s)^2]; column i belongs to rotor i. ``vehicle`` is cast already."""
    return _units(vehicle)[:, None] * _layout(vehicle)


def inverse_allocation_matrix(vehicle: Vehicle) -> Float[AnyArray, "4 4"]:
    """G1^-1; row i belongs to rotor i. ``vehicle`` is cast already."""
    rows = _layout(vehicle)
    # the minors of an entry, cyclically: an even permutation of the three rows and columns that are left
    a, b, c = ([jnp.roll(rows, (-down, -along), (0, 1)) for along in (1, 2, 3)] for down in (1, 2, 3))
    minors = (
        a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
    cofactors = minors * _SIGNS.astype(minors.dtype)
    determinant = jnp.sum(rows[0] * cofactors[0])
    return cofactors.T / (determinant * _units(vehicle))[None, :]


def _layout(vehicle: Vehicle) -> Float[AnyArray, "4 4"]:
    """G1 without its coefficients: y, -x [m], spin, 1."""
    x, y = vehicle.rotor_positions[:, 0], vehicle.rotor_positions[:, 1]
    return jnp.stack([y, -x, vehicle.rotor_spin, jnp.ones_like(x)])


def _units(vehicle: Vehicle) -> Float[AnyArray, "4"]:
    """The coefficient of each row of G1."""
    lift = vehicle.thrust_coefficient
    return jnp.stack([lift, lift, vehicle.torque_coefficient, lift])


def squared_rotor_speeds(vehicle: Vehicle, moment: Vector, thrust: Entry) -> list[Entry]:
    """Squares [(rad/s)^2] of the rotor speeds that make ``moment`` [N m, body] and ``thrust`` [N]; < 0 if none do."""
    inverse = inverse_allocation_matrix(vehicle)
    return [dot(inverse[rotor, :3], moment) + inverse[rotor, 3] * thrust for rotor in range(4)]


def signed_sqrt(x: Float[AnyArray, "..."]) -> Float[AnyArray, "..."]:
    """sign(x) sqrt(|x|), with gradient 0 instead of infinity at 0; NaN stays NaN."""
    zero = x == 0.0
    return jnp.where(zero, 0.0, jnp.sign(x) * jnp.sqrt(jnp.where(zero, 1.0, jnp.abs(x))))
