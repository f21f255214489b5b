"""Incremental nonlinear dynamic inversion: the tracking controller of Tal & Karaman (IEEE TCST 29(3), 2021).

Rewritten for a world with z up and a body FLU (equation numbers are theirs): thrust is +c b_z, specific thrust
c > 0. One deviation: they take whichever of yaw and yaw + pi is nearer; here b_x is steered to the yaw itself, with the
attitude rule of ``vehicle.flatness``, so that a vehicle that flies backwards does not count as tracking.
"""

import dataclasses
import math

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplan.errors import InputError
from jaxplan.records import record
from jaxplan.spline import FlatState
from jaxplan.tracking.filters import FilterState
from jaxplan.tracking.rotor_commands import rotor_commands
from jaxplan.vehicle.flatness import attitude_from, body_rates_from
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.rotations import length, rotation_vector

Diagonal = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class IndiGains:
    """Diagonal gains. Defaults: the simulation gains of MFRL (``controller: NDI``), for 200 Hz and 30 Hz filters."""

    position: Diagonal = (18.0, 18.0, 13.5)
    """1/s^2, world x y z (eq. 17, Kx)."""
    velocity: Diagonal = (7.8, 7.8, 5.85)
    """1/s (Kv)."""
    acceleration: Diagonal = (0.5, 0.5, 0.3)
    """Dimensionless (Ka)."""
    attitude: Diagonal = (90.0, 90.0, 16.41)
    """1/s^2, body x y z (eq. 28, K_xi)."""
    rates: Diagonal = (10.0, 10.0, 14.0)
    """1/s (K_Omega)."""
    least_specific_thrust: float = 1.0
    """m/s^2: the feed-forward of the rates divides by no less; arbitrary, a tenth of hover."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            numbers = value if isinstance(value, tuple) else (value,)
            size = 3 if field.name != "least_specific_thrust" else 1
            if len(numbers) != size or not all(math.isfinite(number) and number >= 0.0 for number in numbers):
                raise InputError(f"The INDI gain {field.name} is {value!r}: want {size} finite number(s) >= 0.")
        if self.least_specific_thrust <= 0.0:
            raise InputError("The INDI gain least_specific_thrust is 0: want m/s^2 above 0, as a divisor.")


@record
class Sensed:
    """What the controller reads: true position, velocity, attitude and rotor speeds, and four filtered signals."""

    pos: Float[Array, "3"]
    """m, world."""
    vel: Float[Array, "3"]
    """m/s, world."""
    rotation: Float[Array, "3 3"]
    """Body to world."""
    rotor_speeds: Float[Array, "4"]
    """rad/s."""
    signals: FilterState
    """(4, 3): rows ``SPECIFIC_FORCE``, ``THRUST``, ``RATES``, ``MOMENT``."""


SPECIFIC_FORCE, THRUST, RATES, MOMENT = range(4)
"""Rows of the filtered signals: accelerometer turned into the world [m/s^2], specific thrust vector in the world
[m/s^2], gyroscope [rad/s, body], moment that the rotors make, their reaction included [N m, body]."""


def indi(
    vehicle: Vehicle, gains: IndiGains, sensed: Sensed, reference: FlatState
) -> tuple[Float[Array, "4"], Bool[Array, ""]]:
    """Rotor speeds to command [rad/s], and whether a limit changed them. ``vehicle`` is cast already."""
    thrust_vector = _commanded_thrust_vector(vehicle, gains, sensed, reference)
    angular_acceleration = _commanded_angular_acceleration(vehicle, gains, sensed, reference, thrust_vector)
    signals = sensed.signals
    increment = angular_acceleration - signals.rate[RATES]
    moment = signals.value[MOMENT] + vehicle.inertia * increment  # (31)
    thrust = vehicle.mass * length(thrust_vector)  # (21)
    return rotor_commands(vehicle, moment, thrust, sensed.rotor_speeds)


def _commanded_thrust_vector(
    vehicle: Vehicle, gains: IndiGains, sensed: Sensed, reference: FlatState
) -> Float[Array, "3"]:
    """(16), (17), (20): the specific thrust vector [m/s^2, world] that corrects position, velocity and acceleration."""
    force, thrust = sensed.signals.value[SPECIFIC_FORCE], sensed.signals.value[THRUST]
    dtype = force.dtype
    acc = force - vehicle.gravity * jnp.array([0.0, 0.0, 1.0], dtype)
    commanded = (
        reference.acc
        + jnp.array(gains.position, dtype) * (reference.pos - sensed.pos)
        + jnp.array(gains.velocity, dtype) * (reference.vel - sensed.vel)
        + jnp.array(gains.acceleration, dtype) * (reference.acc - acc)
    )
    return thrust + commanded - acc


def _commanded_angular_acceleration(
    vehicle: Vehicle, gains: IndiGains, sensed: Sensed, reference: FlatState, thrust_vector: Float[Array, "3"]
) -> Float[Array, "3"]:
    """(22)-(28): feedback on attitude and rates, feed-forward of jerk, snap and yaw [rad/s^2, body]."""
    rotation = sensed.rotation
    error = rotation_vector(rotation.T @ attitude_from(thrust_vector, reference.yaw[0]))
    lift = vehicle.thrust_coefficient * jnp.sum(sensed.rotor_speeds**2)
    specific_thrust = jnp.maximum(lift / vehicle.mass, gains.least_specific_thrust)
    rates, feed_forward = body_rates_from(
        rotation, specific_thrust, reference.jerk, reference.snap, reference.yaw[1], reference.yaw[2]
    )
    rate_error = rates - sensed.signals.value[RATES]
    dtype = error.dtype
    return jnp.array(gains.attitude, dtype) * error + jnp.array(gains.rates, dtype) * rate_error + feed_forward
