"""How a target moves in each mode of the filter: matrices that carry position, velocity and acceleration over a time.

- straight: white acceleration (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation,
  2001, Sec. 6.2); the acceleration afterwards is unknown, with the deviation of any.
- fading: an acceleration that fades with a time constant (Singer, IEEE Transactions on Aerospace and Electronic Systems
  6(4), 1970).
- turn: jerk -omega^2 v with omega = |v x a| / |v|^2, a coordinated turn in whatever plane (Li and Jilkov, Survey of
  maneuvering target tracking, part I, ibid. 39(4), 2003, Sec. V).

None couples the axes or prefers a direction, so one 3 x 3 matrix serves all three. How far a target accelerates, and
for how long, follows from its speed and from lengths: a flight twice as fast is the same flight in half the time.
"""

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.arrays import AnyArray
from jaxplan.numerics import safe_norm
from jaxplan.validation import require_at_least, require_positive, require_range, require_within

STRAIGHT, FADING, TURN = range(3)
MODES = 3
NODES, SHARES = np.polynomial.legendre.leggauss(5)
STANDING = 0.05
"""m^2/s^2 that keep the rate of a turn finite where nothing moves (arbitrary)."""


@dataclasses.dataclass(frozen=True)
class MotionConfig:
    """What a plausible target is: found by random search on stored, fast and recorded flights, exact and noisy."""

    turn_radius: float = 3.5
    """R [m]: at speed v a coordinate of the acceleration has the deviation v^2 / R."""
    persistence: float = 1.4
    """Way [m] along which an acceleration lasts."""
    least_acceleration: float = 0.5
    """m/s^2 at any speed."""
    max_acceleration: float = 7.5
    """m/s^2: deviation of each coordinate at high speed."""
    fading: tuple[float, float] = (0.1, 3.0)
    """Least and largest time constant [s] of an acceleration."""
    straight: float = 0.8
    """White acceleration of the straight mode, as a share of what the acceleration could do while it lasts."""
    turning: float = 0.3
    """Jerk noise of a turn, as a share of that of a fading acceleration."""
    sojourn: float = 0.5
    """Seconds in a mode."""
    max_rate: float = 4.0
    """rad/s of a turn."""
    speed: float = 3.0
    """Deviation [m/s] of each coordinate of the velocity before anything is known of it."""

    def __post_init__(self) -> None:
        """Raises InputError for what is not positive; shares may be 0."""
        names = ("turn_radius", "persistence", "least_acceleration", "max_acceleration", "max_rate", "speed")
        require_positive("motion", self, *names)
        require_range("motion", self, "fading")
        require_at_least("motion", self, 0.0, "straight", "turning")
        require_within("motion", self, 1e-3, np.inf, "sojourn")


USUAL_MOTION = MotionConfig()
"""Of targets of which nothing else is known."""


class Liveliness(NamedTuple):
    """What is expected of targets at some speeds."""

    acceleration: Float[Array, "*n"]
    """Deviation of each coordinate [m/s^2]."""
    fading: Float[Array, "*n"]
    """Time constant [s]."""

    def noises(self, config: MotionConfig) -> tuple[Float[Array, "*n"], Float[Array, "*n"], Float[Array, "*n"]]:
        """Roots of the intensities of each mode's white noise: of acceleration [m/s^1.5], jerk, jerk [m/s^2.5]."""
        jerk = self.acceleration * jnp.sqrt(2.0 / self.fading)
        return config.straight * self.acceleration * jnp.sqrt(self.fading), jerk, config.turning * jerk


def liveliness(config: MotionConfig, speed: Float[AnyArray, "*n"]) -> Liveliness:
    """What is expected at ``speed`` [m/s]."""
    acceleration = jnp.minimum(config.least_acceleration + speed**2 / config.turn_radius, config.max_acceleration)
    return Liveliness(acceleration, jnp.clip(config.persistence / jnp.maximum(speed, 1e-3), *config.fading))


def turn_rate(
    config: MotionConfig, velocity: Float[AnyArray, "*n 3"], acceleration: Float[AnyArray, "*n 3"]
) -> Float[Array, "*n"]:
    """omega [rad/s] of a turn with this velocity and acceleration."""
    across = safe_norm(jnp.cross(velocity, acceleration))
    return jnp.minimum(across / ((velocity * velocity).sum(axis=-1) + STANDING), config.max_rate)


def straight_motion(time: Float[AnyArray, "*n"]) -> Float[Array, "*n 3 3"]:
    """Transition of the straight mode over ``time`` [s]; nothing is left of the acceleration."""
    time = jnp.asarray(time)
    one, zero = jnp.ones_like(time), jnp.zeros_like(time)
    return _matrix((one, time, zero), (zero, one, zero), (zero, zero, zero))


def fading_motion(time: Float[AnyArray, "*#n"], fading: Float[AnyArray, "*#n"]) -> Float[Array, "... 3 3"]:
    """Transition of the fading mode over ``time`` [s]."""
    time, fading = jnp.broadcast_arrays(time, fading)
    gone = -jnp.expm1(-time / fading)
    one, zero = jnp.ones_like(time), jnp.zeros_like(time)
    return _matrix((one, time, fading * (time - fading * gone)), (zero, one, fading * gone), (zero, zero, 1.0 - gone))


def turn_motion(time: Float[AnyArray, "*#n"], rate: Float[AnyArray, "*#n"]) -> Float[Array, "... 3 3"]:
    """Transition of a turn at ``rate`` [rad/s] over ``time`` [s]."""
    time, rate = jnp.broadcast_arrays(time, rate)
    angle = rate * time
    along = time * jnp.sinc(angle / jnp.pi)
    across = 0.5 * (time * jnp.sinc(0.5 * angle / jnp.pi)) ** 2
    one, zero = jnp.ones_like(time), jnp.zeros_like(time)
    return _matrix((one, along, across), (zero, jnp.cos(angle), along), (zero, -rate * jnp.sin(angle), jnp.cos(angle)))


def transition(
    config: MotionConfig, time: Float[AnyArray, ""], speed: Float[AnyArray, "l"], rate: Float[AnyArray, "l"]
) -> tuple[Float[Array, "l m 3 3"], Float[Array, "l m 3 3"]]:
    """The m modes' transitions over ``time`` [s], and the covariances of what happens meanwhile, of each axis.

    Args:
        speed: of the target [m/s].
        rate: of the turn [rad/s].
    """
    expected = liveliness(config, speed)
    instants, shares = 0.5 * time * (1.0 + NODES), 0.5 * time * SHARES  # Gauss-Legendre: no closed form is short
    straight, fading, turn = (noise[:, None, None] for noise in expected.noises(config))
    responses = jnp.stack(
        [
            straight * straight_motion(instants)[None, :, :, 1],
            fading * fading_motion(instants[None], expected.fading[:, None])[..., 2],
            turn * turn_motion(instants[None], rate[:, None])[..., 2],
        ],
        axis=1,
    )
    happens = (shares[None, None, :, None, None] * responses[..., :, None] * responses[..., None, :]).sum(axis=2)
    times = jnp.broadcast_to(jnp.asarray(time), speed.shape)
    motions = [straight_motion(times), fading_motion(times, expected.fading), turn_motion(times, rate)]
    return jnp.stack(motions, axis=1), happens.at[:, STRAIGHT, 2, 2].add(expected.acceleration**2)


def _matrix(*rows: tuple[Float[Array, "*n"], ...]) -> Float[Array, "*n 3 3"]:
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)
