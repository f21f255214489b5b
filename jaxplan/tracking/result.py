"""What a batch of flights came to, and the labels that follow from thresholds on the tracking errors."""

import dataclasses
import enum
import math

import numpy as np
from jaxtyping import Bool, Float, UInt32

from jaxplan.errors import InputError
from jaxplan.records import record
from jaxplan.validation import require_positive
from jaxplan.vehicle.params import Vehicle


@dataclasses.dataclass(frozen=True)
class Thresholds:
    """A flight is feasible while both errors stay below these, at every control step. Defaults: MFRL's labels."""

    position: float = 0.20
    """m."""
    yaw: float = math.radians(15.0)
    """rad, at most pi."""

    def __post_init__(self) -> None:
        require_positive("thresholds", self, "position")
        if not 0.0 < self.yaw <= math.pi:
            raise InputError(f"thresholds: yaw is {self.yaw} rad, want a number above 0 and at most pi")


TRAINING = Thresholds()
"""Labels and rewards of MFRL: 0.20 m and 15 degrees."""
SUCCESS = Thresholds(position=0.40, yaw=math.radians(45.0))
"""Success of an interception (paper, Sec. IV): 0.40 m and 45 degrees."""

USUAL_RADIUS = 0.18
"""m, of the preset mfrl."""


def held_error(vehicle: Vehicle) -> float:
    """Largest error [m] of a flight that counts as held, less for vehicles smaller than mfrl: with their radius."""
    return TRAINING.position * min(1.0, float(vehicle.radius) / USUAL_RADIUS)


class Flaw(enum.IntFlag):
    """Why a trajectory is labelled infeasible; bits are append-only."""

    NONFINITE = 1 << 0
    """A coefficient or a duration of the spline is NaN or infinite, or a duration is negative."""
    DURATION = 1 << 1
    """It takes no time, or longer than is simulated."""
    DIVERGED = 1 << 2
    """The simulated state stopped being finite."""
    POSITION = 1 << 3
    """The position error reached its threshold."""
    YAW = 1 << 4
    """The yaw error reached its threshold."""
    ROTORS = 1 << 5
    """Low fidelity: the trajectory itself demands a rotor speed outside the limits."""


@record
class TrackingResult:
    """One entry a flight, in the order given; NumPy arrays. A flight that was not flown or diverged has errors inf."""

    max_position_error: Float[np.ndarray, "k"]
    """m, largest distance from the reference at any control step."""
    max_yaw_error: Float[np.ndarray, "k"]
    """rad in [0, pi], not modulo pi; inf where it diverged."""
    time_of_first_violation: Float[np.ndarray, "k"]
    """s from the start, of the first control step at a threshold; inf where there is none, 0 where it was not flown."""
    peak_rotor_speed: Float[np.ndarray, "k"]
    """rad/s, of the fastest rotor; NaN where it was not flown."""
    saturation_share: Float[np.ndarray, "k"]
    """Share of the control steps whose command a rotor limit changed."""
    duration: Float[np.ndarray, "k"]
    """s; NaN where the spline is not finite."""
    feasible: Bool[np.ndarray, "k"]
    """No reason against it."""
    reasons: UInt32[np.ndarray, "k"]
    """Bits of ``Flaw``."""

    def labels(self, thresholds: Thresholds) -> Bool[np.ndarray, "k"]:
        """Feasible for other thresholds, without flying again; monotone in each of them."""
        position = self.max_position_error < thresholds.position
        return position & (self.max_yaw_error < thresholds.yaw)

    def count_reasons(self) -> dict[str, int]:
        """How many flights carry each bit; names in lower case, only those that occur."""
        counts = {flaw.name.lower(): int(np.count_nonzero(self.reasons & int(flaw))) for flaw in Flaw if flaw.name}
        return {name: count for name, count in counts.items() if count}
