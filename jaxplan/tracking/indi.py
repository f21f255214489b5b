"""Incremental nonlinear dynamic inversion: the tracking controller of Tal & Karaman (IEEE TCST 29(3), 2021).

Rewritten for a world with z up and a body FLU (equation numbers are theirs): thrust is +c b_z, specific thrust
c > 0. Two deviations. The feed-forward of the rates also turns the thrust against the drag's rate, which they leave to
the feedback. They take whichever of yaw and yaw + pi is nearer; here b_x is steered to the yaw itself, with the
attitude rule of ``vehicle.flatness``, so that a vehicle that flies backwards does not count as tracking.
"""

import jax.numpy as jnp
from jaxtyping import Bool, Float

from jaxplan.arrays import AnyArray
from jaxplan.spline import FlatState
from jaxplan.tracking.rotor_commands import rotor_commands
from jaxplan.tracking.sensing import MOMENT, RATES, SPECIFIC_FORCE, THRUST, Sensed
from jaxplan.vehicle.flatness import against_drag, attitude_from, body_rates_from
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.rotations import rotation_vector
from jaxplan.vehicle.vectors import length


def indi(vehicle: Vehicle, sensed: Sensed, reference: FlatState) -> tuple[Float[AnyArray, "4"], Bool[AnyArray, ""]]:
    """Rotor speeds to command [rad/s], and whether a limit changed them. ``vehicle`` is cast already."""
    thrust_vector = _commanded_thrust_vector(vehicle, sensed, reference)
    angular_acceleration = _commanded_angular_acceleration(vehicle, sensed, reference, thrust_vector)
    signals = sensed.signals
    increment = angular_acceleration - signals.rate[RATES]
    moment = signals.value[MOMENT] + vehicle.inertia * increment  # (31)
    thrust = vehicle.mass * length(thrust_vector)  # (21)
    return rotor_commands(vehicle, moment, thrust, sensed.rotor_speeds)


def _commanded_thrust_vector(vehicle: Vehicle, sensed: Sensed, reference: FlatState) -> Float[AnyArray, "3"]:
    """(16), (17), (20): the specific thrust vector [m/s^2, world] that corrects position, velocity and acceleration."""
    force, thrust = sensed.signals.value[SPECIFIC_FORCE], sensed.signals.value[THRUST]
    gains, dtype = vehicle.indi, force.dtype
    acc = force - vehicle.gravity * jnp.array([0.0, 0.0, 1.0], dtype)
    commanded = (
        reference.acc
        + jnp.array(gains.position, dtype) * (reference.pos - sensed.pos)
        + jnp.array(gains.velocity, dtype) * (reference.vel - sensed.vel)
        + jnp.array(gains.acceleration, dtype) * (reference.acc - acc)
    )
    return thrust + commanded - acc


def _commanded_angular_acceleration(
    vehicle: Vehicle, sensed: Sensed, reference: FlatState, thrust_vector: Float[AnyArray, "3"]
) -> Float[AnyArray, "3"]:
    """(22)-(28): feedback on attitude and rates, feed-forward of jerk, snap and yaw [rad/s^2, body]."""
    gains, rotation = vehicle.indi, sensed.rotation
    error = rotation_vector(rotation.T @ attitude_from(thrust_vector, reference.yaw[0]))
    lift = vehicle.thrust_coefficient * jnp.sum(sensed.rotor_speeds**2)
    specific_thrust = jnp.maximum(lift / vehicle.mass, gains.least_specific_thrust)
    rates, feed_forward = body_rates_from(
        rotation,
        specific_thrust,
        against_drag(vehicle, reference).jerk,
        reference.snap,
        reference.yaw[1],
        reference.yaw[2],
    )
    rate_error = rates - sensed.signals.value[RATES]
    dtype = error.dtype
    return jnp.array(gains.attitude, dtype) * error + jnp.array(gains.rates, dtype) * rate_error + feed_forward
