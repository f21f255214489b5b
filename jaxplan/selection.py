"""Checks on planned trajectories as reason bits, and the paper's choice among those that pass (eq. 9)."""

import dataclasses
import functools
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from jaxplan.arrays import AnyArray, Scalar, namespace
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.numerics import safe_norm
from jaxplan.polynomials import control_point_table
from jaxplan.records import record, replace
from jaxplan.status import Reason, bit
from jaxplan.validation import require_at_least, require_positive, require_within
from jaxplan.vehicle.limits import effort_of, least_rotor_margin, most_thrust
from jaxplan.vehicle.params import Vehicle
from jaxplan.world.clearance import DistanceIn, free_distance
from jaxplan.world.obstacles import World


@dataclasses.dataclass(frozen=True)
class CheckConfig:
    """What a trajectory must satisfy to be committed."""

    max_deviation: float = 0.5
    """delta_max [m]: largest distance from the searched path (paper, Sec. IV)."""
    tracking_margin: float = 0.1
    """Clearance [m] beyond the vehicle's own radius, for the tracking error, at rest and in slow flight."""
    slow: float = 2.0
    """Speed [m/s] from which more is kept (docs/decisions/0025)."""
    margin_per_speed: float = 0.025
    """How much more [m per m/s]."""
    most_margin: float = 0.25
    """The most [m] that is kept beyond the radius."""
    samples_per_segment: int = 16
    """Pieces into which the clearance check cuts a segment; more pieces give a tighter bound."""
    instants: int = 128
    """Instants of a trajectory, evenly spaced over its duration, at which the rotors are looked at."""
    max_body_rate: float = 10.0
    """Fastest turn of the thrust [rad/s], against drag, that a trajectory may ask for (docs/decisions/0022)."""
    least_probability: float = 0.75
    """Probability of being tracked that a trajectory needs where a classifier decides instead of the rotor limits."""

    def __post_init__(self) -> None:
        require_positive("checks", self, "max_deviation", "max_body_rate")
        require_at_least("checks", self, 0, "tracking_margin", "slow", "margin_per_speed")
        require_at_least("checks", self, self.tracking_margin, "most_margin")
        require_within("checks", self, 0, 1, "least_probability")
        require_within("checks", self, 2, 256, "samples_per_segment")
        require_within("checks", self, 2, 4096, "instants")

    def margin_at(self, speed: Float[AnyArray, "*n"]) -> Float[AnyArray, "*n"]:
        """Clearance [m] beyond the radius that a trajectory keeps where it is so fast [m/s]."""
        grown = self.tracking_margin + self.margin_per_speed * (speed - self.slow)
        return namespace(speed).clip(grown, self.tracking_margin, self.most_margin)


@record
class Margins:
    """How far each trajectory is from what it must not exceed; one lane per candidate."""

    deviation: Float[AnyArray, "k"]
    """Largest distance [m] from the searched path, at equal shares of arc length."""
    clearance: Float[AnyArray, "k"]
    """Lower bound [m] of the distance to obstacles and to the room's faces, anywhere on the trajectory."""
    rotor_speed: Float[AnyArray, "k"]
    """Distance [rad/s] of the worst rotor from its nearest limit, over the samples; NaN where a classifier decides."""
    probability: Float[AnyArray, "k"]
    """Of being tracked, by the classifier; NaN without one."""
    reasons: UInt32[AnyArray, "k"]
    """``Reason`` bits; 0 is a trajectory that passes."""


def check(
    splines: SplineBatch,
    paths: Float[Array, "p 3 k"],
    world: World,
    vehicle: Vehicle,
    config: CheckConfig,
    probability: Float[Array, "k"] | None = None,
) -> Margins:
    """Deviation, feasibility and clearance of every spline.

    Args:
        paths: the searched paths, resampled at uniform arc length.
        probability: of being tracked; where given, it decides feasibility instead of the rotor limits, which flights
            may exceed for an instant without harm.
    """
    flown = check_flight(splines, paths, vehicle, config, probability)
    return check_clearance(flown, splines, world, vehicle, config)


def check_flight(
    splines: SplineBatch,
    paths: Float[Array, "p 3 k"],
    vehicle: Vehicle,
    config: CheckConfig,
    probability: Float[Array, "k"] | None = None,
    least_probability: Scalar | None = None,
) -> Margins:
    """``check`` without obstacles: the clearance is NaN. ``least_probability``: instead of the configuration's."""
    samples = splines.derivatives(_middles(config))
    deviation = _deviation(samples[:, :, 0], paths)
    finite = jnp.isfinite(splines.position).all(axis=(0, 1, 2)) & jnp.isfinite(splines.yaw).all(axis=(0, 1, 2))
    unknown = jnp.full_like(deviation, jnp.nan)
    vel, acc, jerk = (jnp.moveaxis(samples[:, :, order], 2, 0) for order in (1, 2, 3))
    thrust, tilting = (jnp.max(most, axis=(0, 1)) for most in effort_of(vehicle, vel, acc, jerk))
    if probability is None:
        rotors, probability = least_rotor_margin(vehicle, splines.states(config.instants)), unknown
        feasible, doubted = rotors >= 0.0, Reason.LIMITS
    else:
        rotors = unknown
        least = config.least_probability if least_probability is None else least_probability
        feasible, doubted = probability >= least, Reason.UNTRACKABLE
    reasons = (
        bit(~finite, Reason.NONFINITE)
        | bit(~(deviation < config.max_deviation), Reason.DEVIATION)
        | bit(~feasible, doubted)
        | bit(~(thrust <= most_thrust(vehicle)), Reason.LIMITS)
        | bit(~(tilting <= config.max_body_rate), Reason.BODY_RATE)
    )
    return Margins(deviation=deviation, clearance=unknown, rotor_speed=rotors, probability=probability, reasons=reasons)


def check_clearance(
    margins: Margins,
    splines: SplineBatch,
    world: World,
    vehicle: Vehicle,
    config: CheckConfig,
    free: DistanceIn = free_distance,
) -> Margins:
    """The margins with the clearance of every spline in this world, whose distances ``free`` knows."""
    samples = splines.derivatives(_middles(config))
    clear = _clearance_bounds(samples, splines, config.samples_per_segment, functools.partial(free, world))
    spare = clear - config.margin_at(safe_norm(samples[:, :, 1], axis=2))
    hit = bit(~(jnp.min(spare, axis=(0, 1)) >= vehicle.radius), Reason.CLEARANCE)
    return replace(margins, clearance=jnp.min(clear, axis=(0, 1)), reasons=margins.reasons | hit)


def select(score: Float[np.ndarray, "k"], reasons: UInt32[np.ndarray, "k"]) -> int:
    """Index of the best usable candidate, -1 when there is none; a NaN score never wins (host)."""
    usable = (np.asarray(reasons) == 0) & np.isfinite(score)
    return int(np.argmax(np.where(usable, score, -np.inf))) if usable.any() else -1


def _middles(config: CheckConfig) -> Float[np.ndarray, "s"]:
    """Normalised times of the middles of a segment's pieces."""
    return (np.arange(config.samples_per_segment) + 0.5) / config.samples_per_segment


def _deviation(positions: Float[Array, "m s 3 k"], paths: Float[Array, "p 3 k"]) -> Float[Array, "k"]:
    """Largest distance between points at the same share of arc length on the spline and on its path."""
    points = positions.reshape(-1, *positions.shape[2:])
    steps = safe_norm(jnp.diff(points, axis=0, prepend=paths[:1]), axis=1)
    travelled = _running_sums(steps.reshape(*positions.shape[:2], -1)).reshape(steps.shape)
    share = travelled / jnp.maximum(travelled[-1:], 1e-9)
    place = share * (paths.shape[0] - 1)
    low = jnp.clip(jnp.nan_to_num(jnp.floor(place)), 0, paths.shape[0] - 2).astype(jnp.int32)[:, None]
    weight = place[:, None] - low.astype(place.dtype)
    before, after = jnp.take_along_axis(paths, low, axis=0), jnp.take_along_axis(paths, low + 1, axis=0)
    return jnp.max(safe_norm(points - before * (1.0 - weight) - after * weight, axis=1), axis=0)


def _running_sums(steps: Float[Array, "m s k"]) -> Float[Array, "m s k"]:
    """Sums of all steps up to each, along both axes: a third of what XLA's scan takes on a CPU, which is quadratic."""
    within = [steps[:, 0]]
    for piece in range(1, steps.shape[1]):
        within.append(within[-1] + steps[:, piece])
    before = [jnp.zeros_like(within[-1][0])]
    for segment in range(len(steps) - 1):
        before.append(before[-1] + within[-1][segment])
    return jnp.stack(within, axis=1) + jnp.stack(before)[:, None]


def _clearance_bounds(
    samples: Float[Array, "m s 5 3 k"], splines: SplineBatch, pieces: int, free_at: Callable[[Array], Array]
) -> Float[Array, "m s k"]:
    """Least clearance on each piece of each trajectory, from below; infinite on padding.

    Within half a piece h of its middle the position moves at most |v| h + a h^2 / 2, where a bounds the
    acceleration on the segment; distance to obstacles changes no faster than position (Lipschitz).
    """
    points = jnp.moveaxis(samples[:, :, 0], 2, -1)
    free = free_at(points)
    half = 0.5 * splines.durations / pieces
    speed = safe_norm(samples[:, :, 1], axis=2)
    reach = speed * half[:, None] + (0.5 * _acceleration_bound(splines) * half**2)[:, None]
    return jnp.where((splines.durations > 0.0)[:, None], free - reach, jnp.inf)


def _acceleration_bound(splines: SplineBatch) -> Float[Array, "m k"]:
    """An upper bound [m/s^2] of the acceleration on each segment: it lies in the hull of its control points."""
    table = control_point_table(splines.position.shape[1], derivative=2, pieces=1)
    points = jnp.einsum("cn,mndk->mcdk", jnp.asarray(table, splines.position.dtype), splines.position)
    return jnp.max(safe_norm(points, axis=2), axis=1) * splines.rate() ** 2
