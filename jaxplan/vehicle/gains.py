"""Gains of the tracking controllers. They belong to a vehicle: a preset may hold a table for each controller."""

import dataclasses
import math

from jaxplan.errors import InputError

Diagonal = tuple[float, ...]
"""Three numbers, one an axis."""


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
        _check(self, "INDI")
        if self.least_specific_thrust <= 0.0:
            raise InputError("The INDI gain least_specific_thrust is 0: want m/s^2 above 0, as a divisor.")


@dataclasses.dataclass(frozen=True)
class Se3Gains:
    """Diagonal gains, divided by mass and inertia, so that they mean the same on every vehicle.

    Defaults are chosen by hand for rotors with a lag of 20 ms and rates filtered at 30 Hz.
    """

    position: Diagonal = (18.0, 18.0, 18.0)
    """1/s^2, world x y z (k_x / m)."""
    velocity: Diagonal = (7.0, 7.0, 7.0)
    """1/s (k_v / m)."""
    attitude: Diagonal = (150.0, 150.0, 20.0)
    """1/s^2, body x y z (k_R / J)."""
    rates: Diagonal = (18.0, 18.0, 8.0)
    """1/s (k_Omega / J)."""

    def __post_init__(self) -> None:
        _check(self, "SE(3)")


FAST_MOTORS = 0.02
"""s: lag of the motors for which the default gains are."""


def slowness(motor_time_constant: float) -> float:
    """How fast a vehicle whose motors have this lag [s] may be, as a share of one with fast motors."""
    return min(1.0, math.sqrt(FAST_MOTORS / motor_time_constant)) if motor_time_constant > 0.0 else 1.0


def gains_for(motor_time_constant: float) -> dict[str, "IndiGains | Se3Gains"]:
    """Gains for motors with this lag [s]: the defaults, all of them slower by the same factor where the lag is longer.

    The factor is the root of the ratio of the lags, which held best in trial flights of the presets (decision 26).
    """
    factor, powers = slowness(motor_time_constant), {"position": 2, "velocity": 1, "attitude": 2, "rates": 1}

    def slower(gains: IndiGains | Se3Gains) -> IndiGains | Se3Gains:
        scaled = {name: tuple(v * factor**power for v in getattr(gains, name)) for name, power in powers.items()}
        return dataclasses.replace(gains, **scaled)  # type: ignore[arg-type]

    return {"indi": slower(IndiGains()), "se3": slower(Se3Gains())}


def _check(gains: IndiGains | Se3Gains, controller: str) -> None:
    for field in dataclasses.fields(gains):
        value = getattr(gains, field.name)
        numbers = value if isinstance(value, tuple) else (value,)
        size = len(field.default) if isinstance(field.default, tuple) else 1
        if len(numbers) != size or not all(_is_gain(number) for number in numbers):
            raise InputError(f"The {controller} gain {field.name} is {value!r}: want {size} finite number(s) >= 0.")


def _is_gain(number: object) -> bool:
    real = isinstance(number, int | float) and not isinstance(number, bool)
    return real and math.isfinite(number) and number >= 0.0  # type: ignore[arg-type, operator]
