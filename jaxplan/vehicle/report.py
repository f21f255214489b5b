"""What matters about a vehicle, in numbers that a pilot knows, and what speaks against it."""

from typing import NamedTuple

import numpy as np

from jaxplan.vehicle.limits import most_thrust
from jaxplan.vehicle.mixing import allocation_matrix
from jaxplan.vehicle.params import Vehicle, hover_speeds
from jaxplan.vehicle.reach import sideways_acceleration

MASSES = (0.03, 5.0)
"""kg, of the vehicles that plans are made for (arbitrary)."""
RATIOS = (1.6, 8.0)
"""Their thrust-to-weight ratios."""
LAGS = (0.015, 0.05)
"""Of their motors [s]."""
_ARM = (0.113, 0.771)
"""m and kg of the preset mfrl."""
LEAST_RATIO = 1.2
"""Below, nothing is left for flying."""


def usual_arm(mass: float) -> float:
    """Arm [m] of a vehicle of so many kg: it grows with the cube root of the mass."""
    return _ARM[0] * (mass / _ARM[1]) ** (1.0 / 3.0)


class Line(NamedTuple):
    """One number."""

    name: str
    value: str
    unit: str


def thrust_to_weight(vehicle: Vehicle) -> float:
    """Of all rotors at full speed."""
    return float(np.asarray(most_thrust(vehicle)) / np.asarray(vehicle.gravity))


def vehicle_lines(vehicle: Vehicle) -> list[Line]:
    """Mass, thrust, speeds of the rotors, what it can turn and push (host)."""
    ratio, hover = thrust_to_weight(vehicle), hover_speeds(vehicle)
    fastest = float(vehicle.rotor_speed_max)
    tilt = float(np.degrees(np.arccos(min(1.0 / ratio, 1.0))))
    drag = float(vehicle.drag_coefficient)
    full = float(vehicle.mass) * float(vehicle.gravity) * float(np.sqrt(max(ratio**2 - 1.0, 0.0)))
    turns = angular_accelerations(vehicle)
    return [
        Line("mass", f"{float(vehicle.mass):.4g}", "kg"),
        Line("radius", f"{float(vehicle.radius):.3g}", "m"),
        Line("thrust to weight", f"{ratio:.2f}", ""),
        Line("rotors at hover", f"{hover.mean():.0f}", f"rad/s, {100.0 * hover.max() / fastest:.0f} % of the fastest"),
        Line("steepest level tilt", f"{tilt:.0f}", "deg"),
        Line("fastest level flight", f"{np.sqrt(full / drag):.1f}" if drag > 0.0 else "-", "m/s"),
        Line("roll, pitch, yaw", ", ".join(f"{turn:.0f}" for turn in turns), "rad/s^2 from hover"),
        Line("lag of the motors", f"{1e3 * float(vehicle.motor_time_constant):.0f}", "ms"),
        Line("a plan may ask for", f"{sideways_acceleration(vehicle):.1f}", "m/s^2 sideways"),
    ]


def angular_accelerations(vehicle: Vehicle) -> list[float]:
    """The largest [rad/s^2] about body x, y and z at the thrust of hover: what rotors have to spare either way."""
    hover = hover_speeds(vehicle)
    matrix = np.asarray(allocation_matrix(vehicle.astype(np.float32)), dtype=float)
    room = np.minimum(float(vehicle.rotor_speed_max) ** 2 - hover**2, hover**2 - float(vehicle.rotor_speed_min) ** 2)
    moments = np.abs(matrix[:3]) @ np.maximum(room, 0.0)
    return (moments / np.asarray(vehicle.inertia, dtype=float)).tolist()


def vehicle_warnings(vehicle: Vehicle) -> list[str]:
    """A line for everything in which it is unlike the vehicles that plans are made for."""
    mass, ratio = float(vehicle.mass), thrust_to_weight(vehicle)
    found = []
    if ratio <= LEAST_RATIO:
        found.append(f"thrust to weight is {ratio:.2f}, want more than {LEAST_RATIO}: it hovers, and no more")
    elif not RATIOS[0] <= ratio <= RATIOS[1]:
        found.append(f"thrust to weight is {ratio:.2f}; plans were tried from {RATIOS[0]} to {RATIOS[1]}")
    if not MASSES[0] <= mass <= MASSES[1]:
        found.append(f"mass is {mass:g} kg; plans were tried from {MASSES[0]} to {MASSES[1]:g} kg")
    return found
