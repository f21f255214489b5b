"""From rotor speeds to the wrench on the body and back.

    [moment_x, moment_y, moment_z, thrust] = G1 speed^2        (Tal & Karaman 2021, G1 of eq. 6, here in FLU with z up)

``Vehicle`` admits only layouts in which the rows of G1 are orthogonal, so G1^-1 = G1^T diag(1 / |row|^2).
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplan.vehicle.params import Vehicle


def allocation_matrix(vehicle: Vehicle) -> Float[Array, "4 4"]:
    """G1 [N m, N m, N m, N per (rad/s)^2]; column i belongs to rotor i. ``vehicle`` is cast already."""
    x, y = vehicle.rotor_positions[:, 0], vehicle.rotor_positions[:, 1]
    lift = vehicle.thrust_coefficient
    return jnp.stack([lift * y, -lift * x, vehicle.torque_coefficient * vehicle.rotor_spin, lift * jnp.ones_like(x)])


def inverse_allocation_matrix(vehicle: Vehicle) -> Float[Array, "4 4"]:
    """G1^-1; row i belongs to rotor i. ``vehicle`` is cast already."""
    matrix = allocation_matrix(vehicle)
    squares = jnp.sum(matrix * matrix, axis=1, keepdims=True)
    return (matrix / jnp.broadcast_to(squares, matrix.shape)).T


def squared_rotor_speeds(vehicle: Vehicle, moment: Float[Array, "3"], thrust: Float[Array, ""]) -> Float[Array, "4"]:
    """Squares [(rad/s)^2] of the rotor speeds that make ``moment`` [N m, body] and ``thrust`` [N]; < 0 if none do."""
    return inverse_allocation_matrix(vehicle) @ jnp.concatenate([moment, thrust[None]])


def signed_sqrt(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """sign(x) sqrt(|x|), with gradient 0 instead of infinity at 0; NaN stays NaN."""
    zero = x == 0.0
    return jnp.where(zero, 0.0, jnp.sign(x) * jnp.sqrt(jnp.where(zero, 1.0, jnp.abs(x))))
