"""Rotor speeds for a commanded moment and thrust, with the rotors' own inertia and within their limits.

Tal & Karaman 2021 eq. (33): [moment; thrust] = G1 w_c^2 + G2 (w_c - w) / tau, where G2 is the reaction to the
rotors' acceleration and acts on yaw alone. With z the part of the yaw moment that G1 must make, every speed is known:
w_c,i = sqrt(base_i + s_i h z), and z solves one increasing scalar equation. Where limits bind, yaw gives way first,
then thrust (eq. 34-35), and last each rotor is clipped by itself, at the cost of roll and pitch.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplan.vehicle.allocation import inverse_allocation_matrix
from jaxplan.vehicle.params import Vehicle

_NEWTON_STEPS = 8
"""The yaw moment is then met to 2e-4 N m at worst, over 2000 random pairs of present and wanted speeds; with all rotors
wanted above 200 rad/s to 1e-6 N m."""


def rotor_commands(
    vehicle: Vehicle, moment: Float[Array, "3"], thrust: Float[Array, ""], rotor_speeds: Float[Array, "4"]
) -> tuple[Float[Array, "4"], Bool[Array, ""]]:
    """Speeds [rad/s] to command for ``moment`` [N m, body] and ``thrust`` [N] at the current ``rotor_speeds`` [rad/s].

    Also tells whether any limit changed them. ``vehicle`` is cast already.
    """
    inverse = inverse_allocation_matrix(vehicle)
    lowest, highest = vehicle.rotor_speed_min**2, vehicle.rotor_speed_max**2
    tilt = inverse[:, 0] * moment[0] + inverse[:, 1] * moment[1]
    spin, yaw_gain = vehicle.rotor_spin, jnp.abs(inverse[0, 2])
    wanted = inverse[0, 3] * thrust
    lift = _nearest_lift(tilt, spin, wanted, lowest, highest)
    base = tilt + lift
    room_up = jnp.where(spin > 0.0, highest - base, base - lowest)
    room_down = jnp.where(spin > 0.0, lowest - base, base - highest)
    low, high = jnp.max(room_down) / yaw_gain, jnp.min(room_up) / yaw_gain

    reaction = vehicle.rotor_inertia / vehicle.motor_time_constant
    present = vehicle.torque_coefficient * jnp.sum(spin * rotor_speeds**2)

    def excess(z: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        speeds = jnp.sqrt(jnp.maximum(base + spin * yaw_gain * z, 0.0))
        slope = 1.0 + reaction * jnp.sum(0.5 * yaw_gain / jnp.maximum(speeds, 1.0))
        return z + reaction * jnp.sum(spin * (speeds - rotor_speeds)) - moment[2], slope

    def newton(_: int, z: Float[Array, ""]) -> Float[Array, ""]:
        value, slope = excess(z)
        return jnp.clip(z - value / slope, low, high)

    z = jax.lax.fori_loop(0, _NEWTON_STEPS, newton, jnp.clip(present, low, high))
    squares = base + spin * yaw_gain * z
    unclipped = (lowest <= squares) & (squares <= highest)
    yaw_kept = (excess(low)[0] <= 0.0) & (excess(high)[0] >= 0.0)
    saturated = ~(yaw_kept & (lift == wanted) & jnp.all(unclipped | _nearly(squares, lowest, highest)))
    return jnp.sqrt(jnp.clip(squares, lowest, highest)), saturated


def _nearest_lift(
    tilt: Float[Array, "4"],
    spin: Float[Array, "4"],
    wanted: Float[Array, ""],
    lowest: Float[Array, ""],
    highest: Float[Array, ""],
) -> Float[Array, ""]:
    """The lift (squared speed that all rotors share) nearest to ``wanted`` that some yaw moment makes feasible.

    Rotors of spin +1 run at lift + yaw + tilt_i, those of spin -1 at lift - yaw + tilt_i: each pair bounds its own sum,
    and the lift is the mean of the two. Where a pair has no room at all, the middle of its bounds is taken.
    """

    def bounds(pair: Bool[Array, "4"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        low = lowest - jnp.min(jnp.where(pair, tilt, jnp.inf))
        high = highest - jnp.max(jnp.where(pair, tilt, -jnp.inf))
        middle = 0.5 * (low + high)
        return jnp.where(low > high, middle, low), jnp.where(low > high, middle, high)

    low_ahead, high_ahead = bounds(spin > 0.0)
    low_back, high_back = bounds(spin < 0.0)
    return jnp.clip(wanted, 0.5 * (low_ahead + low_back), 0.5 * (high_ahead + high_back))


def _nearly(squares: Float[Array, "4"], lowest: Float[Array, ""], highest: Float[Array, ""]) -> Bool[Array, "4"]:
    """Outside the limits by rounding only."""
    slack = 1e-5 * highest
    return (squares >= lowest - slack) & (squares <= highest + slack)
