"""The last look at a plan before it is committed, and at a committed one in every cycle (host, NumPy).

It shares one thing with the checks that chose the plan, the distance from a point to what is solid, which tests compare
with another code's (``jaxplan.world.clearance``). It evaluates polynomials by Taylor's expansion about the middles of
short pieces, and turns the attitude along the trajectory instead of solving for the body's rates. What both find is
found by two ways.

On a piece whose middle is at p every point is within sum_k |p^(k)| h^k / k! of p, with h half its duration: a clearance
that holds between samples too. Rotors are looked at against drag, at the middles.
"""

import dataclasses
import enum
import functools
from math import comb, factorial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.search.kernels.sight import clearances
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.validation import require_positive, require_within
from jaxplan.vehicle.params import Vehicle

FINER = 4
"""By how much the pieces are cut again where only the bound between samples is too small (arbitrary)."""
ROUNDING = 1e-6
"""By how much positions and derivatives may differ where they should be equal: of their size, at least of 1 SI."""
CLEARANCE_ROUNDING = 1e-4
"""m; distances of two codes, one of them from single-precision grids."""
INSTANT = 1e-3
"""s; over which an attitude is followed for its rates: their error is of the order of its square."""


class Fault(enum.IntFlag):
    """What is wrong with a plan."""

    NONFINITE = 1 << 0
    """A coefficient or duration is not finite, or there is no duration at all."""
    STARTS_ELSEWHERE = 1 << 1
    """Position, velocity, acceleration or jerk do not begin where the plan takes over."""
    NOT_SMOOTH = 1 << 2
    """One of them jumps from one segment to the next."""
    NOT_AT_REST = 1 << 3
    """One of the last three is not 0 at the end."""
    CLEARANCE = 1 << 4
    """Somewhere it is closer to an obstacle or a face of the room than it must be."""
    THRUST = 1 << 5
    """All rotors together cannot give what it asks against gravity and drag."""
    ROTORS = 1 << 6
    """Single rotors are out of their range for too long."""
    SPEED = 1 << 7
    """It is faster than a plan may be."""


@dataclasses.dataclass(frozen=True)
class ValidatorConfig:
    """What a plan must keep, besides clearance and thrust."""

    max_speed: float = 25.0
    """m/s (arbitrary: half as much again as the fastest flight of the preset ``mfrl`` that was seen)."""
    most_excess: float = 1.0
    """Longest time [s] that any rotor may be out of its range against drag, all of a plan added up (343 plans of Table
    I: median 0.20, p99 0.75, most 0.97; all were tracked)."""
    pieces: int = 32
    """Into which each segment is cut."""

    def __post_init__(self) -> None:
        require_positive("validator", self, "max_speed", "most_excess")
        require_within("validator", self, 8, 1024, "pieces")


class Keep(NamedTuple):
    """What a plan keeps from obstacles and faces [m], more where it is fast."""

    least: float
    """[m]"""
    slow: float = 0.0
    """Speed [m/s] from which it is more."""
    per_speed: float = 0.0
    """How much more [m per m/s]."""
    most: float = np.inf
    """[m]"""

    def at(self, speed: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """At these speeds [m/s]."""
        return np.clip(self.least + self.per_speed * (speed - self.slow), self.least, self.most)

    def wider(self, by: float) -> "Keep":
        """So much [m] more at all speeds."""
        return self._replace(least=self.least + by, most=self.most + by)


class Verdict(NamedTuple):
    """What the last look has found."""

    faults: Fault
    clearance: float
    """Lower bound [m] along the whole trajectory, what is flown already left out; ``solids.REACH`` at most."""
    excess: float
    """Seconds during which any rotor is out of its range."""


class Room(NamedTuple):
    """What is solid, for the distances."""

    solids: tuple
    bounds: Float[np.ndarray, "2 3"]
    """Corners [m]."""

    def free_distance(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
        """To the nearest obstacle or face of the room [m]."""
        to_wall = np.minimum(points - self.bounds[0], self.bounds[1] - points).min(axis=-1)
        inside = np.clip(points, *self.bounds).reshape(-1, 3)
        return np.minimum(clearances(self.solids, inside).reshape(to_wall.shape), to_wall)


class _Pieces(NamedTuple):
    """Taylor coefficients about the middles of all pieces, what is flown already left out."""

    powers: Float[np.ndarray, "n 10 3"]
    """p^(k) / k! [m/s^k]."""
    half: Float[np.ndarray, "n"]
    """Seconds from the middle to the ends."""
    yaw: Float[np.ndarray, "n 3"]
    """Yaw and its first two derivatives [rad, SI]."""

    def derivative(self, order: int) -> Float[np.ndarray, "n 3"]:
        """In the middles [SI]."""
        return factorial(order) * self.powers[:, order]


def validate(
    spline: PiecewisePolynomial,
    room: Room,
    vehicle: Vehicle,
    keep: Keep,
    config: ValidatorConfig,
    *,
    since: float = 0.0,
    start: FlatState | None = None,
) -> Verdict:
    """Look at a plan as it is flown.

    Args:
        spline: the plan, without padding, in NumPy.
        room: where it is flown.
        vehicle: what flies it.
        keep: its distance from obstacles and faces.
        config: the other limits.
        since: what it has flown already [s of its own time].
        start: where it takes over, if that is to be looked at.
    """
    numbers = (spline.durations, spline.position, np.zeros(0) if spline.yaw is None else spline.yaw)
    if not all(np.isfinite(part).all() for part in numbers) or not (np.asarray(spline.durations) > 0.0).all():
        return Verdict(Fault.NONFINITE, -np.inf, np.inf)
    pieces = _cut(spline, config.pieces, since)
    clearance, spare, seen = _clearance(pieces, room, keep)
    if spare < 0.0 <= seen:
        clearance, spare, _ = _clearance(_cut(spline, FINER * config.pieces, since), room, keep)
    thrust, excess = _effort(pieces, vehicle)
    faults = _joints(spline, start)
    for bad, fault in (
        (spare < -CLEARANCE_ROUNDING, Fault.CLEARANCE),
        (thrust > 1.0 + ROUNDING, Fault.THRUST),
        (excess > config.most_excess, Fault.ROTORS),
        (np.linalg.norm(pieces.derivative(1), axis=1).max() > config.max_speed, Fault.SPEED),
    ):
        faults |= fault if bad else Fault(0)
    return Verdict(faults, clearance, excess)


def _cut(spline: PiecewisePolynomial, count: int, since: float) -> _Pieces:
    """Each segment in ``count`` pieces; those that end before ``since`` [s] are left out, but never the last one."""
    durations = np.asarray(spline.durations)
    middles = (np.arange(count) + 0.5) / count
    rates = (1.0 / durations)[:, None, None, None]
    position = _expanded(np.asarray(spline.position), count)
    position *= rates ** np.arange(position.shape[2])[None, None, :, None]
    yaw = np.zeros((len(durations), count, 3))
    if spline.yaw is not None:
        turns = _expanded(np.asarray(spline.yaw)[..., None], count)[:, :, :3, 0]
        yaw = turns * rates[..., 0] ** np.arange(3) * np.array([1.0, 1.0, 2.0])
    ends = (np.cumsum(durations) - durations)[:, None] + (middles + 0.5 / count) * durations[:, None]
    left = ends.ravel() >= min(since, float(durations.sum()) - 1e-9)
    half = np.repeat(0.5 * durations / count, count)
    return _Pieces(position.reshape(-1, *position.shape[2:])[left], half[left], yaw.reshape(-1, 3)[left])


def _expanded(coefficients: Float[np.ndarray, "m n d"], count: int) -> Float[np.ndarray, "m {count} n d"]:
    """Ascending coefficients about the middles of ``count`` pieces of each segment, in normalised time."""
    segments, size, axes = coefficients.shape
    found = _taylor(count, size).reshape(count * size, size) @ coefficients
    return found.reshape(segments, count, size, axes)


@functools.cache
def _taylor(count: int, size: int) -> Float[np.ndarray, "{count} {size} {size}"]:
    """From ascending coefficients in s to those about the middles of ``count`` pieces of [0, 1]."""
    middles = (np.arange(count) + 0.5) / count
    table = np.zeros((count, size, size))
    for power in range(size):
        for order in range(power + 1):
            table[:, order, power] = comb(power, order) * middles ** (power - order)
    return table


def _clearance(pieces: _Pieces, room: Room, keep: Keep) -> tuple[float, float, float]:
    """Lower bound of the free distance [m] on all pieces, the same less what is kept, and the latter in the middles.

    What is kept goes by the least speed that a piece may have: no piece is refused for a speed that it may not have.
    """
    lengths = np.linalg.norm(pieces.powers[:, 1:], axis=2)
    moved = (lengths * pieces.half[:, None] ** np.arange(1, lengths.shape[1] + 1)).sum(axis=1)
    orders = np.arange(2, lengths.shape[1] + 1)
    changed = (orders * lengths[:, 1:] * pieces.half[:, None] ** (orders - 1)).sum(axis=1)
    free = room.free_distance(pieces.powers[:, 0])
    kept = keep.at(lengths[:, 0] - changed)
    return float((free - moved).min()), float((free - moved - kept).min()), float((free - kept).min())


def _effort(pieces: _Pieces, vehicle: Vehicle) -> tuple[float, float]:
    """The largest thrust against drag, as a share of what there is, and for how long [s] any rotor is out of range."""
    mass, inertia = float(vehicle.mass), np.asarray(vehicle.inertia, float)
    attitudes, thrusts = _attitude(pieces, vehicle, np.array([-INSTANT, 0.0, INSTANT]))
    first, second = _turned(attitudes[:-1], attitudes[1:])
    rates, turning = (first + second) / (2.0 * INSTANT), (second - first) / INSTANT**2
    moment, thrust = inertia * turning + _cross(rates, inertia * rates), thrusts[1]
    wrench = np.concatenate([moment, mass * thrust[:, None]], axis=1)
    squared = np.linalg.solve(_allocation(vehicle), wrench.T).T
    least, most = float(vehicle.rotor_speed_min) ** 2, float(vehicle.rotor_speed_max) ** 2
    outside = np.any((squared < least) | (squared > most), axis=1)
    whole = 4.0 * float(vehicle.thrust_coefficient) * most / mass
    return float(thrust.max() / whole), float(2.0 * pieces.half[outside].sum())


def _allocation(vehicle: Vehicle) -> Float[np.ndarray, "4 4"]:
    """From squared rotor speeds to moment and thrust (``jaxplan.vehicle.mixing``)."""
    x, y, _ = np.asarray(vehicle.rotor_positions, float).T
    lift, torque = float(vehicle.thrust_coefficient), float(vehicle.torque_coefficient)
    return np.stack([lift * y, -lift * x, torque * np.asarray(vehicle.rotor_spin, float), np.full(4, lift)])


def _attitude(
    pieces: _Pieces, vehicle: Vehicle, times: Float[np.ndarray, "t"]
) -> tuple[Float[np.ndarray, "t n 3 3"], Float[np.ndarray, "t n"]]:
    """Body to world, and thrust per mass [m/s^2], so long [s] after the middles: b_z along it, b_x over the yaw."""
    vel, acc, jerk, snap = (pieces.derivative(order) for order in (1, 2, 3, 4))
    time = times[:, None, None]
    moved = vel + time * acc + 0.5 * time**2 * jerk
    drag = float(vehicle.drag_coefficient) / float(vehicle.mass) * np.linalg.norm(moved, axis=-1, keepdims=True) * moved
    force = acc + time * jerk + 0.5 * time**2 * snap + drag
    force[..., 2] += float(vehicle.gravity)
    thrust = np.linalg.norm(force, axis=-1)
    up = force / np.maximum(thrust, 1e-12)[..., None]
    yaw = (pieces.yaw @ [np.ones_like(times), times, 0.5 * times**2]).T
    aside = np.stack([-np.sin(yaw), np.cos(yaw), np.zeros_like(yaw)], axis=-1)
    forward = _cross(aside, up)
    forward /= np.maximum(np.linalg.norm(forward, axis=-1), 1e-12)[..., None]
    return np.stack([forward, _cross(up, forward), up], axis=-1), thrust


def _cross(one: Float[np.ndarray, "*n 3"], other: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """As ``numpy.cross``, which takes three times as long."""
    return one[..., [1, 2, 0]] * other[..., [2, 0, 1]] - one[..., [2, 0, 1]] * other[..., [1, 2, 0]]


def _turned(first: Float[np.ndarray, "*n 3 3"], second: Float[np.ndarray, "*n 3 3"]) -> Float[np.ndarray, "*n 3"]:
    """The small rotation [rad, body] from one attitude to the next."""
    turn = np.swapaxes(first, -1, -2) @ second
    skew = 0.5 * (turn - np.swapaxes(turn, -1, -2))
    return np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)


def _joints(spline: PiecewisePolynomial, start: FlatState | None) -> Fault:
    """What does not fit where the plan begins, where its segments meet, and at its end."""
    position, durations = np.asarray(spline.position), np.asarray(spline.durations)
    size, orders = position.shape[1], np.arange(4)
    rates = (1.0 / durations)[:, None] ** orders
    begins = position[:, :4] * (np.array([factorial(k) for k in orders]) * rates)[..., None]
    ends = _at_the_end(size) @ position * rates[..., None]
    faults = Fault(0)
    if start is not None and _differ(begins[0], np.asarray(start.derivatives)[:4]):
        faults |= Fault.STARTS_ELSEWHERE
    if _differ(begins[1:], ends[:-1]):
        faults |= Fault.NOT_SMOOTH
    scale = np.maximum(np.abs(begins[:, 1:]).max(axis=(0, 2)), 1.0)
    if (np.abs(ends[-1, 1:]).max(axis=1) > ROUNDING * scale).any():
        faults |= Fault.NOT_AT_REST
    return faults


@functools.cache
def _at_the_end(size: int) -> Float[np.ndarray, "4 {size}"]:
    """From ascending coefficients in s to the value and three derivatives at s = 1."""
    return np.array([[np.prod(np.arange(n, n - k, -1.0)) for n in range(size)] for k in range(4)])


def _differ(one: Float[np.ndarray, "... 3"], other: Float[np.ndarray, "... 3"]) -> bool:
    """Whether derivatives differ by more than rounding."""
    return bool((np.abs(one - other) > ROUNDING * np.maximum(np.abs(other), 1.0)).any())
