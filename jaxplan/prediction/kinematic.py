"""Constant velocity and constant acceleration: what is known without a model of targets."""

import numpy as np
from jaxtyping import Float

from jaxplan.prediction.mixture import Prediction
from jaxplan.prediction.observations import Observations

VELOCITY_FROM = 3
"""Newest observations through which the constant velocity is fitted; with two it is a little better where there is no
noise, with more it lags behind turns (docs/prediction.md)."""
ACCELERATION_FROM = 4
"""The same for the constant acceleration."""
TURN_RADIUS = 4.0
"""Metres: a target at speed v is expected to accelerate by v^2 over this (arbitrary, the size of rooms)."""
LEAST_ACCELERATION = 0.1
"""m/s^2 that a target may have at any speed (arbitrary)."""
POSITION_NOISE = 0.01
"""Standard deviation [m] of an observation (arbitrary, motion capture and better)."""


def constant_velocity(observations: Observations, offsets: Float[np.ndarray, "s"]) -> Prediction:
    """Straight on from the newest position; its variance grows as if an unknown acceleration lasted."""
    velocity = newest_velocity(observations)
    means = observations.positions[-1] + offsets[:, None] * velocity
    return _isotropic(means, offsets, float(np.linalg.norm(velocity)))


def constant_acceleration(observations: Observations, offsets: Float[np.ndarray, "s"]) -> Prediction:
    """The parabola through the newest positions, continued from the newest one."""
    velocity, acceleration = _derivatives(observations, ACCELERATION_FROM, degree=2)
    means = observations.positions[-1] + offsets[:, None] * velocity + 0.5 * offsets[:, None] ** 2 * acceleration
    return _isotropic(means, offsets, float(np.linalg.norm(velocity)))


def newest_velocity(observations: Observations) -> Float[np.ndarray, "3"]:
    """Of the target now [m/s, world]; 0 where it was seen once."""
    velocity: Float[np.ndarray, "3"] = _derivatives(observations, VELOCITY_FROM, degree=1)[0]
    return velocity


def expected_acceleration(speed: float) -> float:
    """Deviation [m/s^2] of each coordinate of an unknown acceleration, at this speed [m/s]."""
    return LEAST_ACCELERATION + speed**2 / TURN_RADIUS


def _isotropic(means: Float[np.ndarray, "s 3"], offsets: Float[np.ndarray, "s"], speed: float) -> Prediction:
    """One isotropic normal distribution for each offset, as wide as turns of the usual radius allow."""
    deviations = np.sqrt(POSITION_NOISE**2 + (0.5 * expected_acceleration(speed) * offsets**2) ** 2)
    return Prediction(
        offsets=offsets,
        log_weights=np.zeros(1),
        means=means[:, :, None],
        factors=deviations[:, None, None, None] * np.eye(3)[:, :, None],
    )


def _derivatives(observations: Observations, newest: int, degree: int) -> Float[np.ndarray, "d 3"]:
    """Velocity (and acceleration) now, of the least-squares polynomial through the newest positions; 0 if unknown."""
    times = observations.times[-newest:] - observations.times[-1]
    known = min(degree, len(times) - 1)
    found = np.zeros((degree, 3))
    if known:
        powers = times[:, None] ** np.arange(known + 1)
        fitted = np.linalg.lstsq(powers, observations.positions[-newest:], rcond=None)[0]
        found[:known] = fitted[1:] * np.array([1.0, 2.0])[:known, None]
    return found
