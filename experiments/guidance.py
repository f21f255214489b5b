"""Baselines that plan nothing: pure pursuit and proportional navigation, straight at the target or around obstacles.

They see what a planner sees of the target and nothing of the room. The acceleration that is commanded every cycle is
reached at the end of the cycle, so that the reference is continuous up to its acceleration.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxplan.prediction.kinematic import constant_velocity
from jaxplan.prediction.observations import Observations
from jaxplan.replanner import CommittedPlan, Measured, ReplannerConfig
from jaxplan.spline import FlatState

from .routing import Aim

LAWS = ("pursuit", "navigation")
FAST = "fast-navigation"
"""Fast response proportional navigation (Pliska, Vrba, Baca, Saska, Towards Safe Mid-Air Drone Interception, IEEE RA-L
2024, eq. 19, arXiv 2405.13542): linear proportional navigation, blended with a pull towards the target that grows with
the distance, so that it does not hesitate where the relative velocity is small."""
FAST_GAIN, FAST_PULL = 19.7, 0.051
"""Its gain, and the weight of the pull [1/s^2 beside 1/s^2 of the navigation]: the paper's."""
NAVIGATION_CONSTANT = 3.0
"""N of proportional navigation; 3 to 5 is usual (Zarchan, Tactical and Strategic Missile Guidance)."""
RESPONSE = 0.4
"""Seconds in which an error of the velocity would be made up for (arbitrary)."""
ADVANTAGE, LEAST_SPEED, MOST_SPEED = 1.5, 3.0, 8.0
"""Closing speed: this many times the target's speed, within these limits [m/s] (arbitrary)."""
FASTEST = 12.0
"""m/s from which fast navigation asks for no more speed (arbitrary: the rotors fight drag from there on; the paper's
vehicle has limits of its own)."""
MOST_ACCELERATION = 8.0
"""m/s^2, which leaves the rotors a reserve (arbitrary)."""


class Leg(NamedTuple):
    """From ``start`` the acceleration changes at a constant rate for one cycle, and then no more."""

    start: float
    state: Float[np.ndarray, "3 3"]
    """Position, velocity and acceleration [SI, world] at the start."""
    jerk: Float[np.ndarray, "3"]


@runtime_checkable
class Law(Protocol):
    """Decides from cycle to cycle how to accelerate."""

    def __call__(self, state: Float[np.ndarray, "5 3"], observations: Observations, /) -> Float[np.ndarray, "3"]:
        """The acceleration to be reached within a cycle [m/s^2] from a state of position to snap [SI]."""


def law_named(name: str, aim: Aim | None = None) -> Law:
    """Pursuit or a kind of navigation; ``aim`` says where to fly first instead of straight at the target."""

    def law(state: Float[np.ndarray, "5 3"], observations: Observations) -> Float[np.ndarray, "3"]:
        target = observations.positions[-1]
        velocity = np.asarray(constant_velocity(observations, np.ones(1)).means)[0, :, 0] - target
        corner = None if aim is None else aim(state[0], target)
        if corner is not None:
            return command("pursuit", corner - state[0], -state[1], state[1], np.zeros(3))
        return command(name, target - state[0], velocity - state[1], state[1], velocity)

    return law


class Guidance:
    """Stands where a ``Replanner`` stands in an episode."""

    def __init__(self, law: Law, start: FlatState) -> None:
        self.config, self._law, self._yaw = ReplannerConfig(), law, np.asarray(start.yaw)
        at_rest = np.stack([np.asarray(start.pos), np.zeros(3), np.zeros(3)])
        self._legs = [Leg(-np.inf, at_rest, np.zeros(3))]

    @property
    def plans(self) -> tuple[CommittedPlan, ...]:
        """None: nothing is planned."""
        return ()

    @property
    def ever_planned(self) -> bool:
        """Whether anything but the initial hover was commanded."""
        return len(self._legs) > 1

    def reference(self, times: Float[np.ndarray, "n"]) -> FlatState:
        """The commanded flat state at ``times`` [s]."""
        starts = np.array([leg.start for leg in self._legs])
        active = np.searchsorted(starts, np.asarray(times) + 1e-9, side="right") - 1
        rows = np.stack([self._state(self._legs[leg], time) for leg, time in zip(active, times, strict=True)])
        yaw = np.broadcast_to(self._yaw, (len(rows), 3))
        return FlatState(derivatives=rows, yaw=yaw)

    def step(self, now: float, observations: Observations, measured: Measured | None = None) -> None:
        """Command an acceleration for the coming cycle."""
        state = self._state(self._legs[-1], now)
        wanted = self._law(state, observations)
        self._legs.append(Leg(now, state[:3], (wanted - state[2]) / self.config.period))

    def _state(self, leg: Leg, time: float) -> Float[np.ndarray, "5 3"]:
        if not np.isfinite(leg.start):
            return np.concatenate([leg.state, np.zeros((2, 3))])
        turning = min(max(time - leg.start, 0.0), self.config.period)
        even = max(time - leg.start - self.config.period, 0.0)
        position, velocity, acceleration = _advanced(leg.state, leg.jerk, turning)
        position, velocity, acceleration = _advanced(np.stack([position, velocity, acceleration]), np.zeros(3), even)
        jerk = leg.jerk if even == 0.0 else np.zeros(3)
        return np.stack([position, velocity, acceleration, jerk, np.zeros(3)])


def command(
    law: str,
    apart: Float[np.ndarray, "3"],
    relative: Float[np.ndarray, "3"],
    own: Float[np.ndarray, "3"],
    target: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "3"]:
    """The acceleration [m/s^2] that a law asks for.

    Args:
        law: one of ``LAWS``, or ``FAST``.
        apart: from the defender to the target [m].
        relative: the target's velocity less the defender's [m/s]; ``own`` and ``target`` are the two.
    """
    distance = max(float(np.linalg.norm(apart)), 1e-3)
    sight = apart / distance
    speed = float(np.clip(ADVANTAGE * np.linalg.norm(target), LEAST_SPEED, MOST_SPEED))
    if law == "pursuit":
        wanted = (speed * sight - own) / RESPONSE
    elif law == FAST:
        wanted = _fast(apart, relative, own)
    else:
        closing = -float(relative @ sight)
        turning = np.cross(apart, relative) / distance**2
        wanted = NAVIGATION_CONSTANT * max(closing, 0.0) * np.cross(turning, sight)
        wanted += (speed - closing) / RESPONSE * sight
    size = float(np.linalg.norm(wanted))
    return wanted * min(1.0, MOST_ACCELERATION / max(size, 1e-9))


def _fast(
    apart: Float[np.ndarray, "3"], relative: Float[np.ndarray, "3"], own: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """What fast response proportional navigation asks for [m/s^2], before it is limited; arguments as ``command``."""
    left = max(float(np.linalg.norm(apart)), 1e-3) / max(float(np.linalg.norm(relative)), 1e-3)
    wanted = FAST_GAIN * ((1.0 - FAST_PULL) * (apart + relative * left) / left**2 + FAST_PULL * apart)
    speed = float(np.linalg.norm(own))
    if speed >= FASTEST:
        wanted = wanted - max(float(wanted @ own), 0.0) / speed**2 * own
    return np.asarray(wanted)


def _advanced(
    state: Float[np.ndarray, "3 3"], jerk: Float[np.ndarray, "3"], time: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration after ``time`` [s] at a constant jerk."""
    position, velocity, acceleration = state
    return (
        position + time * velocity + time**2 / 2.0 * acceleration + time**3 / 6.0 * jerk,
        velocity + time * acceleration + time**2 / 2.0 * jerk,
        acceleration + time * jerk,
    )
