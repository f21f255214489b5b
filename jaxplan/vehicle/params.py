"""What a quadrotor is: its parameters, and what they must fulfil."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike, Float

from jaxplan.arrays import AnyArray, Scalar
from jaxplan.errors import InputError
from jaxplan.records import record, static
from jaxplan.vehicle.gains import IndiGains, Se3Gains

SHAPES: dict[str, tuple[int, ...]] = {"inertia": (3,), "rotor_positions": (4, 3), "rotor_spin": (4,)}
"""Of the fields that are not single numbers."""
_NON_NEGATIVE = (
    "rotor_inertia",
    "rotor_speed_min",
    "drag_coefficient",
    "aero_moment_coefficient",
    "force_noise_psd",
    "moment_noise_psd",
    "accelerometer_variance",
    "gyroscope_variance",
)
_POSITIVE = (
    "mass",
    "inertia",
    "thrust_coefficient",
    "torque_coefficient",
    "motor_time_constant",
    "rotor_speed_max",
    "gravity",
    "radius",
)


_LEAST_AUTHORITY = 1e-4
"""Least singular value of the mixer with rows of unit length; below, float32 would not tell the axes apart (arbitrary;
an X layout has 1)."""
_HEAVIEST = 50.0
"""kg (arbitrary: ten times the heaviest vehicle that this library is for)."""
_WIDEST = 3.0
"""m (arbitrary)."""
_STRONGEST = 20.0
"""Times the weight (arbitrary: racing quadrotors have 10)."""
_LEAST_HOVER = 0.01
"""Of the fastest rotor's speed at hover: less is a rotor that carries nothing (arbitrary)."""


@record
class Vehicle:
    """A quadrotor with four upright rotors. Body frame FLU, SI units.

    Python floats and float64 NumPy arrays at the host; cast with ``astype`` where arithmetic begins. Raises InputError
    for values that are no quadrotor, for a mixer without full rank, and where a rotor's limits exclude hovering.
    """

    name: str = static()
    mass: Scalar
    """kg."""
    inertia: Float[AnyArray, "3"]
    """kg m^2, principal moments about body x, y, z."""
    rotor_positions: Float[AnyArray, "4 3"]
    """m, from the centre of mass, body frame."""
    rotor_spin: Float[AnyArray, "4"]
    """+1 or -1: sign of the reaction torque on the body about +z (so the rotor itself turns about -spin z)."""
    thrust_coefficient: Scalar
    """N / (rad/s)^2: thrust = coefficient * speed^2, along body +z."""
    torque_coefficient: Scalar
    """N m / (rad/s)^2: torque about body z = spin * coefficient * speed^2."""
    rotor_inertia: Scalar
    """kg m^2, one rotor about its axis."""
    motor_time_constant: Scalar
    """s, first order lag from commanded to actual rotor speed."""
    rotor_speed_min: Scalar
    """rad/s."""
    rotor_speed_max: Scalar
    """rad/s."""
    drag_coefficient: Scalar
    """N / (m/s)^2: force = -coefficient |v| v, world frame."""
    aero_moment_coefficient: Scalar
    """N m / (rad/s)^2: moment = -coefficient |w| w, body frame."""
    force_noise_psd: Scalar
    """N^2 s, white force on each world axis."""
    moment_noise_psd: Scalar
    """(N m)^2 s, white moment on each body axis."""
    accelerometer_variance: Scalar
    """(m/s^2)^2 per sample and axis."""
    gyroscope_variance: Scalar
    """(rad/s)^2 per sample and axis."""
    gravity: Scalar
    """m/s^2, along world -z."""
    radius: Scalar
    """m, of the sphere about the centre of mass that stands for the vehicle in collision checks."""
    indi: IndiGains = static(default=IndiGains())
    """Gains of the default controller."""
    se3: Se3Gains = static(default=Se3Gains())
    """Gains of the geometric controller."""

    def __post_init__(self) -> None:
        for name in _POSITIVE:
            _require(self, name, "> 0", lambda value: value > 0.0)
        for name in _NON_NEGATIVE:
            _require(self, name, ">= 0", lambda value: value >= 0.0)
        _require(self, "rotor_spin", "+1 or -1", lambda value: np.abs(value) == 1.0)
        _require(self, "rotor_speed_max", "> rotor_speed_min", lambda value: value > self.rotor_speed_min)
        _check_layout(self)
        _check_hover(self)

    def astype(self, dtype: DTypeLike) -> "Vehicle":
        """The same vehicle with JAX arrays of ``dtype``, for arithmetic under strict type promotion."""
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), self)


def suspicions(values: Mapping[str, Any]) -> list[str]:
    """What looks like numbers of other units than kg, m, rad/s, a line each; empty where nothing does."""
    found = []
    mass, thrust = float(values["mass"]), float(values["thrust_coefficient"]) * float(values["rotor_speed_max"]) ** 2
    weight = mass * float(values["gravity"])
    if mass > _HEAVIEST:
        found.append(f"mass is {mass:g} kg, want less than {_HEAVIEST:g}; are these grams?")
    if float(np.abs(values["rotor_positions"]).max()) > _WIDEST:
        found.append(
            f"rotor_positions are up to {np.abs(values['rotor_positions']).max():g} m; are these inches or mm?"
        )
    if not found and weight > 0.0 and 4.0 * thrust > _STRONGEST * weight:
        found.append(
            f"thrust_coefficient and rotor_speed_max make {4.0 * thrust / weight:.0f} times the weight, want at most "
            f"{_STRONGEST:g}; are these rev/min instead of rad/s?"
        )
    return found


def _require(vehicle: Vehicle, name: str, want: str, good: Callable[[np.ndarray], np.ndarray | np.bool_]) -> None:
    value = np.asarray(getattr(vehicle, name), dtype=np.float64)
    shape = SHAPES.get(name, ())
    if value.shape != shape or not np.all(np.isfinite(value)) or not np.all(good(value)):
        raise InputError(
            f"{name} of vehicle {vehicle.name!r} is {value.tolist()}: want finite numbers {want} of shape {shape}."
        )


def hover_speeds(vehicle: Vehicle) -> Float[np.ndarray, "4"]:
    """rad/s of each rotor at rest (host); negative where the rotor would have to pull downwards."""
    x, y = np.asarray(vehicle.rotor_positions, dtype=np.float64)[:, :2].T
    rows = np.stack([y, -x, np.asarray(vehicle.rotor_spin, dtype=np.float64), np.ones(4)])
    lift = vehicle.mass * vehicle.gravity / vehicle.thrust_coefficient
    squares = np.linalg.solve(rows, [0.0, 0.0, 0.0, float(lift)])
    return np.sign(squares) * np.sqrt(np.abs(squares))


def _check_layout(vehicle: Vehicle) -> None:
    """Roll, pitch, yaw and thrust must be independent in the four rotors."""
    _require(vehicle, "rotor_positions", "(any sign)", np.isfinite)
    positions = np.asarray(vehicle.rotor_positions, dtype=np.float64)
    rows = np.stack([positions[:, 1], -positions[:, 0], np.asarray(vehicle.rotor_spin), np.ones(4)])
    lengths = np.linalg.norm(rows, axis=1, keepdims=True)
    rank = int(np.linalg.matrix_rank(rows / np.where(lengths == 0.0, 1.0, lengths), tol=_LEAST_AUTHORITY))
    if rank < 4:
        raise InputError(
            f"The mixer of vehicle {vehicle.name!r} has rank {rank} (positions {positions.tolist()}, spins "
            f"{np.asarray(vehicle.rotor_spin).tolist()}): want 4, so that roll, pitch, yaw and thrust are independent."
        )


def _check_hover(vehicle: Vehicle) -> None:
    speeds = hover_speeds(vehicle)
    if not np.all(speeds < vehicle.rotor_speed_max):
        raise InputError(
            f"rotor_speed_max of vehicle {vehicle.name!r} is {float(vehicle.rotor_speed_max):.0f} rad/s, but hovering "
            f"takes {np.max(speeds):.0f} rad/s: want more than that."
        )
    if not np.all(speeds > max(float(vehicle.rotor_speed_min), _LEAST_HOVER * np.max(speeds))):
        raise InputError(
            f"Hovering takes the rotors of vehicle {vehicle.name!r} to {np.round(speeds).tolist()} rad/s (below 0: "
            f"pulling down): want each above rotor_speed_min, {float(vehicle.rotor_speed_min):.0f} rad/s, and above "
            "1 % of the fastest; the centre of mass must lie between the rotors."
        )
