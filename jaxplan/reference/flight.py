"""Proof by flight: a trajectory flown in the plant, judged as an episode is, and to its very end (host)."""

import dataclasses
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Float

from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.result import SUCCESS
from jaxplan.tracking.rollout import Plant

BLOCK = 20
"""Control steps of one call of the plant: 0.1 s, as in an episode, so that both share the compiled program."""


@runtime_checkable
class Distance(Protocol):
    """Distance to the nearest obstacle or face of the room."""

    def __call__(self, points: Float[np.ndarray, "n 3"], /) -> Float[np.ndarray, "n"]:
        """Metres from each point [m, world]."""


class Flown(NamedTuple):
    """One flight: a row per control step, at its end, from time 0 to the trajectory's end or a little later."""

    times: Float[np.ndarray, "n"]
    """Seconds on the episode's clock."""
    position: Float[np.ndarray, "n 3"]
    """Metres, world."""
    velocity: Float[np.ndarray, "n 3"]
    """Metres per second, world."""
    position_error: Float[np.ndarray, "n"]
    """Metres from the trajectory."""
    yaw_error: Float[np.ndarray, "n"]
    """Radians between the heading of body x and 0."""
    twist_error: Float[np.ndarray, "n"]
    """Radians about body z from the attitude that the trajectory demands."""


class Verdict(NamedTuple):
    """What a flight came to."""

    met: float
    """When the vehicle is first near enough to the target [s on the episode's clock]; inf if never."""
    tracked: bool
    """Whether it is in control: until the meeting as Table I judges, by the heading of body x; then by its turn about
    body z, as nothing depends on the heading any more."""
    shortfall: float
    """By how much it comes closer to an obstacle or a wall than its radius [m]; 0 where it does not."""
    miss: float
    """By how much it passes too far from the target [m]; 0 where it meets it."""

    @property
    def accepted(self) -> bool:
        """Whether it met the target, in control throughout and clear of everything."""
        return bool(np.isfinite(self.met)) and self.tracked and self.shortfall <= 0.0


@dataclasses.dataclass(frozen=True)
class Judge:
    """Who says whether a flight is good."""

    clearance: Distance
    radius: float
    """Of the vehicle [m]."""
    near: float
    """Distance from the target that counts as meeting it [m]."""
    until: float
    """When the target's motion ends [s on the episode's clock]."""

    def verdict(self, flight: Flown, target: Float[np.ndarray, "n 3"], departure: float) -> Verdict:
        """Of a flight, with the target at the same instants [m, world]; it counts from ``departure`` [s] on."""
        apart = np.where(flight.times < departure, np.inf, np.linalg.norm(flight.position - target, axis=1))
        apart[flight.times > self.until] = np.inf
        near = apart < self.near
        met = float(flight.times[np.argmax(near)]) if near.any() else np.inf
        turned = np.where(flight.times <= met, flight.yaw_error, flight.twist_error)
        kept = (flight.position_error < SUCCESS.position) & (turned < SUCCESS.yaw)
        distance = self.clearance(flight.position)
        return Verdict(
            met=met,
            tracked=bool(kept.all()),
            shortfall=float(np.fmax(self.radius - distance, 0.0).max()) if np.isfinite(distance).all() else np.inf,
            miss=max(float(apart.min()) - self.near, 0.0) if not near.any() else 0.0,
        )


def fly(plant: Plant, hover: FlatState, spline: PiecewisePolynomial, begin: float, seed: int) -> Flown:
    """Hover until ``begin`` [s], then fly ``spline`` to its end.

    Args:
        plant: what flies.
        hover: the reference until ``begin``.
        spline: begins where the vehicle hovers.
        begin: seconds on the episode's clock, whose noise ``seed`` decides.
    """
    state = plant.reset(hover, jax.random.key(seed))
    period = BLOCK / CONTROL_RATE
    blocks = []
    for index in range(int(np.ceil((begin + float(spline.duration)) / period))):
        times = index * period + np.arange(BLOCK + 1) / CONTROL_RATE
        state, log = plant.fly(state, spline.state(times - begin))
        rows = (log.pos, log.vel, log.position_error, log.yaw_error, log.twist_error)
        blocks.append((times[1:], *(np.asarray(row, dtype=float) for row in rows)))
    return Flown(*(np.concatenate(rows) for rows in zip(*blocks, strict=True)))
