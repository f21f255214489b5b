"""Rotor speeds for a commanded moment and thrust, with the rotors' own inertia and within their limits.

Tal & Karaman 2021 eq. (33): [moment; thrust] = G1 w_c^2 + G2 (w_c - w) / tau, where G2 is the reaction to the
rotors' acceleration and acts on yaw alone. With z the part of the yaw moment that G1 must make, every speed is known:
w_c,i = sqrt(base_i + y_i z) with y the yaw column of G1^-1, and z solves one increasing scalar equation. Where limits
bind, yaw gives way first, then thrust (eq. 34-35), and last each rotor is clipped by itself, at the cost of roll and
pitch.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from jaxplan.arrays import AnyArray, Scalar
from jaxplan.vehicle.mixing import inverse_allocation_matrix
from jaxplan.vehicle.params import Vehicle

_NEWTON_STEPS = 8
"""The yaw moment is then met to 2e-4 N m at worst, over 2000 random pairs of present and wanted speeds; with all rotors
wanted above 200 rad/s to 1e-6 N m."""
_NO_PART = 0.01
"""Of the largest yaw gain: a rotor with less does not bound the yaw moment (arbitrary)."""
_STEEP = 0.1
"""Of the steepest conceivable: a pair of rotors that depends less on thrust does not bound it, since giving thrust up
would buy next to nothing (arbitrary)."""


class _Mixer(NamedTuple):
    """Squared rotor speeds as straight lines of thrust and yaw moment: tilt + lift * thrust + yaw * z."""

    tilt: Float[AnyArray, "4"]
    lift: Float[AnyArray, "4"]
    yaw: Float[AnyArray, "4"]
    lowest: Scalar
    highest: Scalar


def rotor_commands(
    vehicle: Vehicle, moment: Float[AnyArray, "3"], thrust: Float[AnyArray, ""], rotor_speeds: Float[AnyArray, "4"]
) -> tuple[Float[AnyArray, "4"], Bool[AnyArray, ""]]:
    """Speeds [rad/s] to command for ``moment`` [N m, body] and ``thrust`` [N] at the current ``rotor_speeds`` [rad/s].

    Also tells whether any limit changed them. ``vehicle`` is cast already.
    """
    inverse = inverse_allocation_matrix(vehicle)
    lowest, highest = vehicle.rotor_speed_min**2, vehicle.rotor_speed_max**2
    tilt = inverse[:, 0] * moment[0] + inverse[:, 1] * moment[1]
    spin, yaw = vehicle.rotor_spin, inverse[:, 2]
    mixer = _Mixer(tilt=tilt, lift=inverse[:, 3], yaw=yaw, lowest=lowest, highest=highest)
    given = _nearest_thrust(mixer, thrust)
    base = tilt + mixer.lift * given
    low, high = _yaw_room(mixer, base)

    # Where yaw speeds a rotor up whose torque opposes it, the reaction comes with the wrong sign and the equation need
    # not be increasing: such layouts answer with the torques alone.
    alike = jnp.all(spin * yaw >= -_NO_PART * jnp.max(jnp.abs(yaw)))
    reaction = jnp.where(alike, vehicle.rotor_inertia / vehicle.motor_time_constant, 0.0)
    present = vehicle.torque_coefficient * jnp.sum(spin * rotor_speeds**2)

    def excess(z: Float[AnyArray, ""]) -> tuple[Float[AnyArray, ""], Float[AnyArray, ""]]:
        speeds = jnp.sqrt(jnp.maximum(base + yaw * z, 0.0))
        slope = 1.0 + reaction * jnp.sum(0.5 * spin * yaw / jnp.maximum(speeds, 1.0))
        return z + reaction * jnp.sum(spin * (speeds - rotor_speeds)) - moment[2], slope

    def newton(_: Int[AnyArray, ""] | int, z: Float[AnyArray, ""]) -> Float[AnyArray, ""]:
        value, slope = excess(z)
        return jnp.clip(z - value / slope, low, high)

    z = jax.lax.fori_loop(0, _NEWTON_STEPS, newton, jnp.clip(present, low, high))
    squares = base + yaw * z
    unclipped = (lowest <= squares) & (squares <= highest)
    yaw_kept = (excess(low)[0] <= 0.0) & (excess(high)[0] >= 0.0)
    saturated = ~(yaw_kept & (given == thrust) & jnp.all(unclipped | _nearly(squares, lowest, highest)))
    return jnp.sqrt(jnp.clip(squares, lowest, highest)), saturated


def _yaw_room(mixer: _Mixer, base: Float[AnyArray, "4"]) -> tuple[Float[AnyArray, ""], Float[AnyArray, ""]]:
    """The yaw moments z [N m] that keep all rotors within limits at ``base`` + yaw z; low > high if none does."""
    size = jnp.abs(mixer.yaw)
    part = size > _NO_PART * jnp.max(size)
    divisor = jnp.where(part, mixer.yaw, 1.0)
    ends = (mixer.lowest - base) / divisor, (mixer.highest - base) / divisor
    low = jnp.max(jnp.where(part, jnp.minimum(*ends), -jnp.inf))
    return low, jnp.min(jnp.where(part, jnp.maximum(*ends), jnp.inf))


def _nearest_thrust(mixer: _Mixer, wanted: Float[AnyArray, ""]) -> Float[AnyArray, ""]:
    """The thrust [N] nearest to ``wanted`` that some yaw moment makes feasible.

    Two rotors with the yaw moment eliminated (Fourier-Motzkin) bound the thrust from both sides: with y_i, y_j of
    opposite sign, |y_j| square_i + |y_i| square_j does not depend on yaw. Such pairs have the last word; pairs of equal
    sign bound the thrust only in layouts without symmetry. The middle is taken where the bounds contradict each other:
    then roll and pitch alone ask too much.
    """
    for opposite in (False, True):
        low, high = _bounds(mixer, opposite)
        middle = 0.5 * (low + high)
        contradict = low > high
        wanted = jnp.clip(wanted, jnp.where(contradict, middle, low), jnp.where(contradict, middle, high))
    return wanted


def _bounds(mixer: _Mixer, opposite: bool) -> tuple[Float[AnyArray, ""], Float[AnyArray, ""]]:
    """The thrusts that all pairs allow whose rotors yaw in opposite (or else in equal) directions."""
    yaw, lift, tilt = (_pairs(values) for values in (mixer.yaw, mixer.lift, mixer.tilt))
    one, other = yaw[1], -yaw[0]  # weights that cancel yaw
    slope = one * lift[0] + other * lift[1]
    offset = one * tilt[0] + other * tilt[1]
    least = jnp.where(one > 0.0, one * mixer.lowest, one * mixer.highest)
    least += jnp.where(other > 0.0, other * mixer.lowest, other * mixer.highest)
    most = one * (mixer.lowest + mixer.highest) + other * (mixer.lowest + mixer.highest) - least
    steep = jnp.abs(slope) > _STEEP * jnp.max(jnp.abs(mixer.yaw)) * jnp.max(mixer.lift)
    counts = steep & ((one * other > 0.0) == opposite)
    divisor = jnp.where(counts, slope, 1.0)
    ends = (least - offset) / divisor, (most - offset) / divisor
    all_alike = 4.0 / jnp.sum(mixer.lift)  # N per (rad/s)^2 of all rotors; bounds everything: no bound is infinite
    low = jnp.max(jnp.where(counts, jnp.minimum(*ends), mixer.lowest * all_alike))
    return low, jnp.min(jnp.where(counts, jnp.maximum(*ends), mixer.highest * all_alike))


def _pairs(values: Float[AnyArray, "4"]) -> tuple[Float[AnyArray, "8"], Float[AnyArray, "8"]]:
    """Each rotor beside the next and the one after that: every pair, those across twice."""
    following = [jnp.roll(values, -1), jnp.roll(values, -2)]
    return jnp.concatenate([values, values]), jnp.concatenate(following)


def _nearly(squares: Float[AnyArray, "4"], lowest: Scalar, highest: Scalar) -> Bool[AnyArray, "4"]:
    """Outside the limits by rounding only."""
    slack = 1e-5 * highest
    return (squares >= lowest - slack) & (squares <= highest + slack)
