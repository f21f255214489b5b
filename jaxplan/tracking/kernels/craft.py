"""A vehicle as plain numbers for compiled code (host)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.vehicle.params import Vehicle

_NO_PART, _STEEP = 0.01, 0.1
"""As in ``tracking.rotor_commands``: which rotors bound the yaw moment, and which pairs of them the thrust."""


class Craft(NamedTuple):
    """What a step of the flight needs; SI units, body FLU."""

    mass: float
    gravity: float
    thrust_coefficient: float
    torque_coefficient: float
    lag: float
    """s, of the motors."""
    rotor_inertia: float
    drag: float
    """Coefficient [N / (m/s)^2]."""
    damping: float
    """Coefficient of the aerodynamic moment [N m / (rad/s)^2]."""
    slowest: float
    """rad/s."""
    fastest: float
    least_thrust: float
    """m/s^2; see ``IndiGains.least_specific_thrust``."""
    reaction: float
    """Rotor inertia over lag where a rotor's reaction helps its torque, 0 in other layouts."""
    inertia: Float[np.ndarray, "3"]
    gains: Float[np.ndarray, "5 3"]
    """Position, velocity, acceleration, attitude, rates."""
    arms: Float[np.ndarray, "4 4"]
    """Wrench [N m, N m, N m, N] of each rotor for each (rad/s)^2; a column a rotor."""
    spin: Float[np.ndarray, "4"]
    mixer: Float[np.ndarray, "4 4"]
    """The inverse of ``arms``; a row a rotor."""
    turns: Float[np.ndarray, "4"]
    """The yaw column of the mixer where a rotor bounds the yaw moment, 0 where not."""
    pairs: Float[np.ndarray, "n 8"]
    """Pairs of rotors that bound the thrust: whether they yaw in opposite directions, their numbers, the weights that
    cancel yaw, least and most of what is weighted, and how it grows with thrust."""


def craft_of(vehicle: Vehicle) -> Craft:
    """The numbers of a vehicle."""
    x, y = np.asarray(vehicle.rotor_positions, dtype=float)[:, :2].T
    lift, torque = float(vehicle.thrust_coefficient), float(vehicle.torque_coefficient)
    spin, gains = np.asarray(vehicle.rotor_spin, dtype=float), vehicle.indi
    arms = np.stack([lift * y, -lift * x, torque * spin, np.full(4, lift)])
    mixer = np.linalg.inv(arms)
    yaw = mixer[:, 2]
    part = np.abs(yaw) > _NO_PART * np.abs(yaw).max()
    alike = bool((spin * yaw >= -_NO_PART * np.abs(yaw).max()).all())
    slowest, fastest = float(vehicle.rotor_speed_min), float(vehicle.rotor_speed_max)
    return Craft(
        mass=float(vehicle.mass),
        gravity=float(vehicle.gravity),
        thrust_coefficient=lift,
        torque_coefficient=torque,
        lag=float(vehicle.motor_time_constant),
        rotor_inertia=float(vehicle.rotor_inertia),
        drag=float(vehicle.drag_coefficient),
        damping=float(vehicle.aero_moment_coefficient),
        slowest=slowest,
        fastest=fastest,
        least_thrust=float(gains.least_specific_thrust),
        reaction=float(vehicle.rotor_inertia) / float(vehicle.motor_time_constant) if alike else 0.0,
        inertia=np.array(vehicle.inertia, dtype=float),
        gains=np.array([gains.position, gains.velocity, gains.acceleration, gains.attitude, gains.rates], dtype=float),
        arms=arms,
        spin=spin,
        mixer=mixer,
        turns=np.where(part, yaw, 0.0),
        pairs=_pairs(yaw, mixer[:, 3], slowest**2, fastest**2),
    )


def _pairs(
    yaw: Float[np.ndarray, "4"], lift: Float[np.ndarray, "4"], lowest: float, highest: float
) -> Float[np.ndarray, "n 8"]:
    """Each pair of rotors of which the sum that yaw does not change grows with thrust; those that yaw alike first."""
    rows = []
    for opposite in (0.0, 1.0):
        for first in range(4):
            for second in range(first + 1, 4):
                one, other = yaw[second], -yaw[first]
                slope = one * lift[first] + other * lift[second]
                steep = abs(slope) > _STEEP * np.abs(yaw).max() * lift.max()
                if not steep or (one * other > 0.0) != bool(opposite):
                    continue
                ends = sorted((one * lowest, one * highest)), sorted((other * lowest, other * highest))
                least, most = ends[0][0] + ends[1][0], ends[0][1] + ends[1][1]
                rows.append([opposite, first, second, one, other, least, most, slope])
    return np.array(rows, dtype=float).reshape(-1, 8)
