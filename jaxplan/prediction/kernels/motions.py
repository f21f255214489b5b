"""How a target moves in each mode of the filters, compiled (host): ``jaxplan.prediction.imm_motions``.

What a target does is a plain tuple of the numbers of ``MotionConfig``, in the order of ``Motion``.
"""

import math
from typing import NamedTuple, no_type_check

from jaxplan.prediction.imm_motions import FADING, NODES, SHARES, STANDING, STRAIGHT, TURN, MotionConfig
from jaxplan.prediction.kernels.compiled import inner

INSTANTS, WEIGHTS = tuple(NODES.tolist()), tuple(SHARES.tolist())


class Motion(NamedTuple):
    """The numbers of a ``MotionConfig``. Compiled code takes them as a plain tuple."""

    turn_radius: float
    persistence: float
    least_acceleration: float
    max_acceleration: float
    least_fading: float
    most_fading: float
    straight: float
    turning: float
    sojourn: float
    max_rate: float
    speed: float


def motion_of(config: MotionConfig) -> Motion:
    """What a plausible target is, for compiled code."""
    return Motion(
        turn_radius=float(config.turn_radius),
        persistence=float(config.persistence),
        least_acceleration=float(config.least_acceleration),
        max_acceleration=float(config.max_acceleration),
        least_fading=float(config.fading[0]),
        most_fading=float(config.fading[1]),
        straight=float(config.straight),
        turning=float(config.turning),
        sojourn=float(config.sojourn),
        max_rate=float(config.max_rate),
        speed=float(config.speed),
    )


@inner
@no_type_check
def move_on(motion, time, speed, rate, means, covariances):
    """Carry each mode's state on over ``time`` [s], and add what may happen meanwhile."""
    acceleration, fading = expected_acceleration(motion, speed), expected_fading(motion, speed)
    jerk = acceleration * math.sqrt(2.0 / fading)
    even = motion[6] * acceleration * math.sqrt(fading)
    for m in range(3):
        a, b, c, d, e = _motion(m, time, fading, rate)
        for axis in range(3):
            x, y, z = means[m, 0, axis], means[m, 1, axis], means[m, 2, axis]
            means[m, 0, axis] = x + a * y + b * z
            means[m, 1, axis] = c * y + a * z if m == TURN else y + d * z
            means[m, 2, axis] = d * y + e * z if m == TURN else e * z
        _carry(m, covariances[m], a, b, c, d, e)
        for n in range(len(INSTANTS)):
            instant, weight = 0.5 * time * (1.0 + INSTANTS[n]), 0.5 * time * WEIGHTS[n]
            a, b, c, d, e = _motion(m, instant, fading, rate)
            if m == STRAIGHT:
                x, y, z = even * instant, even, 0.0
            elif m == FADING:
                x, y, z = jerk * b, jerk * d, jerk * e
            else:
                x, y, z = motion[7] * jerk * b, motion[7] * jerk * a, motion[7] * jerk * c
            _add(covariances[m], weight, x, y, z)
        if m == STRAIGHT:
            covariances[m, 2, 2] += acceleration * acceleration


@inner
@no_type_check
def _motion(mode, time, fading, rate):
    """The entries of a mode's transition (``imm_motions``) that are not 0 or 1.

    The first row is 1, a, b; the others 0, c, a and 0, d, e in a turn, else 0, 1, d and 0, 0, e.
    """
    if mode == STRAIGHT:
        return time, 0.0, 1.0, 0.0, 0.0
    if mode == FADING:
        gone = -math.expm1(-time / fading)
        return time, fading * (time - fading * gone), 1.0, fading * gone, 1.0 - gone
    along, across, cosine, sine = turn_motion(time, rate)
    return along, across, cosine, -rate * sine, cosine


@inner
@no_type_check
def turn_motion(time, rate):
    """Of a turn at ``rate`` [rad/s]: the ways of velocity and acceleration, and the angle's cosine and sine."""
    angle = rate * time
    along = time * _sinc(angle)
    half = time * _sinc(0.5 * angle)
    return along, 0.5 * half * half, math.cos(angle), math.sin(angle)


@inner
@no_type_check
def _sinc(angle):
    return math.sin(angle) / angle if angle != 0.0 else 1.0


@inner
@no_type_check
def _carry(mode, covariance, a, b, c, d, e):
    """A covariance between the mode's transition and its transpose."""
    for column in range(3):  # M P
        x, y, z = covariance[0, column], covariance[1, column], covariance[2, column]
        covariance[0, column] = x + a * y + b * z
        covariance[1, column] = c * y + a * z if mode == TURN else y + d * z
        covariance[2, column] = d * y + e * z if mode == TURN else e * z
    for row in range(3):  # (M P) M^T
        x, y, z = covariance[row, 0], covariance[row, 1], covariance[row, 2]
        covariance[row, 0] = x + a * y + b * z
        covariance[row, 1] = c * y + a * z if mode == TURN else y + d * z
        covariance[row, 2] = d * y + e * z if mode == TURN else e * z


@inner
@no_type_check
def _add(covariance, weight, x, y, z):
    """Add what white noise has done to position, velocity and acceleration."""
    covariance[0, 0] += weight * x * x
    covariance[1, 1] += weight * y * y
    covariance[2, 2] += weight * z * z
    covariance[0, 1] += weight * x * y
    covariance[1, 0] += weight * x * y
    covariance[0, 2] += weight * x * z
    covariance[2, 0] += weight * x * z
    covariance[1, 2] += weight * y * z
    covariance[2, 1] += weight * y * z


@inner
@no_type_check
def expected_acceleration(motion, speed):
    """Deviation of each coordinate [m/s^2] of the acceleration at a speed [m/s]."""
    return min(motion[2] + speed * speed / motion[0], motion[3])


@inner
@no_type_check
def expected_fading(motion, speed):
    """Time constant [s] of the acceleration at a speed [m/s]."""
    return min(max(motion[1] / max(speed, 1e-3), motion[4]), motion[5])


@inner
@no_type_check
def turn_rate(motion, velocity, acceleration):
    """omega [rad/s] of a turn with this velocity and acceleration."""
    a = velocity[1] * acceleration[2] - velocity[2] * acceleration[1]
    b = velocity[2] * acceleration[0] - velocity[0] * acceleration[2]
    c = velocity[0] * acceleration[1] - velocity[1] * acceleration[0]
    speed = velocity[0] * velocity[0] + velocity[1] * velocity[1] + velocity[2] * velocity[2]
    return min(math.sqrt(a * a + b * b + c * c) / (speed + STANDING), motion[9])
