"""The last look at a plan before it is committed, and at a committed one in every cycle (host).

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
from math import factorial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.planner.kernels.pieces import Body, Pieces, cut
from jaxplan.search.kernels.sight import clearances
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.validation import require_positive, require_within

FINER = 4
"""By how much the pieces are cut again where only the bound between samples is too small (arbitrary)."""
ROUNDING = 1e-6
"""By how much positions and derivatives may differ where they should be equal: of their size, at least of 1 SI."""
CLEARANCE_ROUNDING = 1e-4
"""m; distances of two codes, one of them from single-precision grids."""


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
    FALLING = 1 << 8
    """It asks for so little thrust that the rotors have nothing left to turn the vehicle with."""


@dataclasses.dataclass(frozen=True)
class ValidatorConfig:
    """What a plan must keep, besides clearance and thrust."""

    max_speed: float = 25.0
    """m/s (arbitrary: half as much again as the fastest flight of the preset ``mfrl`` that was seen)."""
    most_excess: float = 1.0
    """Longest time [s] that any rotor may be out of its range against drag, all of a plan added up (343 plans of Table
    I: median 0.20, p99 0.75, most 0.97; all were tracked)."""
    least_thrust: float = 0.33
    """Smallest thrust against drag, as a share of gravity: from rotors that hardly turn nothing can be taken away, and
    the attitude is lost (docs/decisions/0067)."""
    pieces: int = 32
    """Into which each segment is cut."""

    def __post_init__(self) -> None:
        require_positive("validator", self, "max_speed", "most_excess")
        require_within("validator", self, 0, 1, "least_thrust")
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


def validate(
    spline: PiecewisePolynomial,
    room: Room,
    body: Body,
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
        body: of the vehicle that flies it.
        keep: its distance from obstacles and faces.
        config: the other limits.
        since: what it has flown already [s of its own time].
        start: where it takes over, if that is to be looked at.
    """
    numbers = (spline.durations, spline.position, np.zeros(0) if spline.yaw is None else spline.yaw)
    if not all(np.isfinite(part).all() for part in numbers) or not (np.asarray(spline.durations) > 0.0).all():
        return Verdict(Fault.NONFINITE, -np.inf, np.inf)
    pieces, effort = cut(spline, config.pieces, since, body)
    clearance, spare, seen = _clearance(pieces, room, keep)
    if spare < 0.0 <= seen:
        clearance, spare, _ = _clearance(cut(spline, FINER * config.pieces, since)[0], room, keep)
    faults = _joints(spline, start)
    for bad, fault in (
        (spare < -CLEARANCE_ROUNDING, Fault.CLEARANCE),
        (effort.thrust > 1.0 + ROUNDING, Fault.THRUST),
        (effort.least < config.least_thrust, Fault.FALLING),
        (effort.excess > config.most_excess, Fault.ROTORS),
        (pieces.speed.max() > config.max_speed, Fault.SPEED),
    ):
        faults |= fault if bad else Fault(0)
    return Verdict(faults, clearance, effort.excess)


def _clearance(pieces: Pieces, room: Room, keep: Keep) -> tuple[float, float, float]:
    """Lower bound of the free distance [m] on all pieces, the same less what is kept, and the latter in the middles.

    What is kept goes by the least speed that a piece may have: no piece is refused for a speed that it may not have.
    """
    free, kept = room.free_distance(pieces.middle), keep.at(pieces.slowest)
    sure = free - pieces.moved
    return float(sure.min()), float((sure - kept).min()), float((free - kept).min())


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
