"""Geometric tracking control on SE(3) (Lee, Leok, McClamroch, CDC 2010), in a world with z up and a body FLU.

    f = (-k_x e_x - k_v e_v + m g e_z + m a_ref) . R e_z                                         (their eq. 19)
    M = -k_R e_R - k_W e_W + W x J W - J (W x R^T R_c W_c - R^T R_c dW_c)                        (eq. 20)
    e_R = 1/2 (R_c^T R - R^T R_c)^vee,   e_W = W - R^T R_c W_c                                   (eq. 10, 11)

W_c and dW_c are the reference's own (from flatness), not derivatives of the commanded attitude; the rates are the
filtered gyroscope. It knows neither drag nor disturbances: at speed it lags where INDI does not.
"""

import jax.numpy as jnp
from jaxtyping import Bool, Float

from jaxplan.arrays import AnyArray
from jaxplan.spline import FlatState
from jaxplan.tracking.rotor_commands import rotor_commands
from jaxplan.tracking.sensing import RATES, Sensed
from jaxplan.vehicle.flatness import FlatOutputs, attitude_from, differential_flatness
from jaxplan.vehicle.params import Vehicle


def se3(vehicle: Vehicle, sensed: Sensed, reference: FlatState) -> tuple[Float[AnyArray, "4"], Bool[AnyArray, ""]]:
    """Rotor speeds to command [rad/s], and whether a limit changed them. ``vehicle`` is cast already."""
    gains, dtype = vehicle.se3, sensed.pos.dtype
    specific_force = (
        reference.acc
        + vehicle.gravity * jnp.array([0.0, 0.0, 1.0], dtype)
        + jnp.array(gains.position, dtype) * (reference.pos - sensed.pos)
        + jnp.array(gains.velocity, dtype) * (reference.vel - sensed.vel)
    )
    thrust = vehicle.mass * jnp.maximum(jnp.dot(specific_force, sensed.rotation[:, 2]), 0.0)
    commanded = attitude_from(specific_force, reference.yaw[0])
    flat = differential_flatness(vehicle, reference)
    return rotor_commands(vehicle, _moment(vehicle, sensed, commanded, flat), thrust, sensed.rotor_speeds)


def _moment(
    vehicle: Vehicle, sensed: Sensed, commanded: Float[AnyArray, "3 3"], flat: FlatOutputs
) -> Float[AnyArray, "3"]:
    """Eq. (20) [N m, body], with the gains given per inertia."""
    gains, rates = vehicle.se3, sensed.signals.value[RATES]
    dtype = rates.dtype
    to_commanded = sensed.rotation.T @ commanded  # from the commanded body frame to the true one
    skew = 0.5 * (to_commanded.T - to_commanded)
    attitude_error = jnp.stack([skew[2, 1], skew[0, 2], skew[1, 0]])
    wanted_rates = to_commanded @ flat.body_rates
    angular_acceleration = (
        -jnp.array(gains.attitude, dtype) * attitude_error
        - jnp.array(gains.rates, dtype) * (rates - wanted_rates)
        - jnp.cross(rates, wanted_rates)
        + to_commanded @ flat.angular_acceleration
    )
    return vehicle.inertia * angular_acceleration + jnp.cross(rates, vehicle.inertia * rates)
