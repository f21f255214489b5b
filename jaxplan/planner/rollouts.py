"""Plans are flown in the model of the vehicle before they are committed.

What a plan asks for says little about a vehicle that is not on its reference: after a hard turn the attitude is behind,
and the next plan, harmless from its own start, is not followed. So the model flies along the reference since the last
cycle, is put where the vehicle is measured, and turned as it is, and goes on from there along each plan
(docs/decisions/0036).
"""

import dataclasses
import math
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Float

from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.planner.validator import Room
from jaxplan.records import record
from jaxplan.spline import FlatState, PiecewisePolynomial
from jaxplan.tracking.kernels.craft import Craft, craft_of
from jaxplan.tracking.kernels.flight import fly, on_reference, reference_of
from jaxplan.tracking.kernels.sampling import references
from jaxplan.tracking.kernels.step import POS, QUAT, VEL
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.result import held_error
from jaxplan.validation import require_at_least, require_positive
from jaxplan.vehicle.heading import body_axes
from jaxplan.vehicle.params import Vehicle

FOUND = (0.3, 1.0, 0.5)
"""m, m/s and rad; the model begins anew, on the reference, where what it came to is farther from what is measured: in
position, in velocity, or in the direction of the thrust (docs/decisions/0036)."""
ARM = 0.3
"""m; see ``Rollouts.astray`` (arbitrary)."""
LOOKED_AT = 2
"""Control steps from one flown position that is looked at to the next (1/100 s)."""
NOWHERE = 1e6
"""m; where a flight counts as that is not finite any more."""


@dataclasses.dataclass(frozen=True)
class RolloutConfig:
    """How long plans are flown, and what is then followed."""

    seconds: float = 1.0
    """Before now, along the reference, where the model was not put to where the vehicle was since
    (docs/decisions/0036)."""
    ahead: float = 1.5
    """From now on, along the plan [s] (docs/decisions/0050)."""
    most_error: float = 0.3
    """Largest distance [m] from the plan at which it counts as followed (arbitrary)."""
    most_twist: float = 0.6
    """Largest turn [rad] about body z from what the plan demands (three quarters of where an episode is lost)."""
    whole_share: float = 0.8
    """Largest distance [m] from a refined plan, flown from its own start to its end, as a share of the error with which
    a flight of such a vehicle counts as held (docs/decisions/0050)."""
    whole_twist: float = 0.4
    """And the largest turn [rad] about body z there: half of ``most_twist``, since the vehicle begins on the plan."""
    margin: float = 0.05
    """What flown positions keep from obstacles beyond the vehicle's radius [m] (arbitrary)."""

    def __post_init__(self) -> None:
        require_positive("rollouts", self, "seconds", "ahead", "most_error", "most_twist", "whole_share", "whole_twist")
        require_at_least("rollouts", self, 0.0, "margin")

    @property
    def steps(self) -> int:
        """Control steps before now."""
        return max(round(self.seconds * CONTROL_RATE), 1)

    @property
    def steps_ahead(self) -> int:
        """And from now on."""
        return max(round(self.ahead * CONTROL_RATE), 1)


@record
class Rollouts:
    """What became of plans in the model, until ``RolloutConfig.ahead`` from now."""

    positions: Float[np.ndarray, "k m 3"]
    """Where the model is [m, world], ``LOOKED_AT`` control steps after one another; the first so long from now."""
    clearance: Float[np.ndarray, "k"]
    """The least free distance of the flown positions [m]."""
    error: Float[np.ndarray, "k"]
    """The largest distance from the plan [m]."""
    twist: Float[np.ndarray, "k"]
    """The largest turn about body z from what the plan demands [rad]."""
    clear: Bool[np.ndarray, "k"]
    """Whether the flown positions keep their distance."""
    followed: Bool[np.ndarray, "k"]
    """Whether both errors stay below their limits."""

    @property
    def astray(self) -> Float[np.ndarray, "k"]:
        """How badly each is followed [m]: the turn about body z counts with an arm of ``ARM``."""
        return self.error + ARM * self.twist


class Flyer(NamedTuple):
    """The model, without noise and in still air."""

    craft: Craft
    config: RolloutConfig
    held_error: float
    """With which a flight counts as held [m]."""

    def follows(self, spline: PiecewisePolynomial) -> bool:
        """Whether the model, on its reference where a plan begins, stays near it until its end."""
        count = max(math.ceil(float(spline.duration) * CONTROL_RATE), 1)
        wanted = sampled(spline, np.arange(count + 1) / CONTROL_RATE)
        rows, yaw = np.asarray(wanted.derivatives), np.asarray(wanted.yaw)
        flown = fly(self.craft, on_reference(self.craft, rows[0, 0], yaw[0, 0]), rows, yaw)
        near = float(flown.error[0]) <= self.config.whole_share * self.held_error
        return near and float(flown.twist[0]) <= self.config.whole_twist


def build_flyer(config: RolloutConfig, vehicle: Vehicle) -> Flyer:
    """The vehicle's model with its controller (host); compiled when it flies first, once for all vehicles."""
    return Flyer(craft_of(vehicle), config, held_error(vehicle))


def sampled(splines: SplineBatch | PiecewisePolynomial, times: Float[np.ndarray, "n"]) -> FlatState:
    """References (k, n) along splines at ``times`` [s of their own]; the first of them before, at rest behind."""
    if isinstance(splines, PiecewisePolynomial):
        turning = np.zeros((len(splines.durations), 1)) if splines.yaw is None else splines.yaw
        durations, position, yaw = (np.asarray(leaf)[None] for leaf in (splines.durations, splines.position, turning))
        return references(durations, position, yaw, times)
    parts = splines.durations, splines.position, splines.yaw[:, :, 0]
    durations, position, yaw = (np.moveaxis(np.asarray(leaf), -1, 0) for leaf in parts)
    return references(durations, position, yaw, times)


class Rollout:
    """The model in the state of the vehicle, from which plans are flown."""

    def __init__(
        self,
        flyer: Flyer,
        room: Room,
        radius: float,
        flown: FlatState,
        position: Float[np.ndarray, "3"],
        velocity: Float[np.ndarray, "3"],
        acceleration: Float[np.ndarray, "3"] | None = None,
        attitude: Float[np.ndarray, "4"] | None = None,
        before: "Rollout | None" = None,
    ) -> None:
        """``flown``: references until now, or only now's, where those before are not known.

        The ``attitude`` (w x y z), or else the ``acceleration`` [m/s^2], tells where the thrust points. ``before`` is
        the model as it was at the first of the references; without it, it is on that.
        """
        self._flyer, self._room, self._radius = flyer, room, radius
        up = _up(flyer.craft, velocity, acceleration, attitude)
        state = _come_there(flyer.craft, flown, None if before is None else before._state, position, velocity, up)
        state[POS : POS + 3], state[VEL : VEL + 3] = position, velocity
        if attitude is not None:
            state[QUAT : QUAT + 4] = attitude
        elif up is not None:
            state[QUAT : QUAT + 4] = _tilted(state[QUAT : QUAT + 4], up)
        self._state: Float[np.ndarray, "s"] = state

    @property
    def config(self) -> RolloutConfig:
        """What it was made with."""
        return self._flyer.config

    def along(self, references: FlatState, since: int = 0) -> Rollouts:
        """Fly ``references`` (k, n), whose first rows are those of now.

        Errors count after ``since`` control steps, when the plans take over: a plan need not go on where another led.
        """
        rows, yaw = np.asarray(references.derivatives), np.asarray(references.yaw)
        flown = fly(self._flyer.craft, self._state, rows, yaw, since)
        positions = np.where(np.isfinite(flown.position), flown.position, NOWHERE)[:, LOOKED_AT - 1 :: LOOKED_AT]
        clearance = self._room.free_distance(positions).min(axis=1)
        config = self.config
        return Rollouts(
            positions=positions,
            clearance=clearance,
            error=flown.error,
            twist=flown.twist,
            clear=clearance >= self._radius + config.margin,
            followed=(flown.error <= config.most_error) & (flown.twist <= config.most_twist),
        )

    def after(self, references: FlatState) -> FlatState:
        """As what the vehicle flies [world] at the end of ``references`` (n), the first of them now's."""
        rows, yaw = np.asarray(references.derivatives), np.asarray(references.yaw)
        state = fly(self._flyer.craft, self._state, rows[None], yaw[None]).state[0]
        derivatives, turning = reference_of(self._flyer.craft, state, float(yaw[-1, 0]))
        return FlatState(derivatives=derivatives, yaw=turning)


class RollOut(Protocol):
    """The model of the vehicle in the state that the vehicle is in now, to fly plans with before they are committed."""

    def __call__(
        self,
        flown: FlatState,
        position: Float[np.ndarray, "3"],
        velocity: Float[np.ndarray, "3"],
        acceleration: Float[np.ndarray, "3"] | None = None,
        attitude: Float[np.ndarray, "4"] | None = None,
        before: Rollout | None = None,
    ) -> Rollout | None:
        """None where the configuration has no rollouts; compiles nothing.

        ``flown`` are the references at ``CONTROL_RATE``, both ends included, since ``before``, the model as it was
        then, or of the last ``RolloutConfig.seconds``, or now's alone; ``position`` [m], ``velocity`` [m/s] and, where
        they are known, ``acceleration`` [m/s^2] and ``attitude`` (w x y z) are measured.
        """


def _come_there(
    craft: Craft,
    flown: FlatState,
    before: Float[np.ndarray, "s"] | None,
    position: Float[np.ndarray, "3"],
    velocity: Float[np.ndarray, "3"],
    up: Float[np.ndarray, "3"] | None,
) -> Float[np.ndarray, "s"]:
    """The model after the references ``flown``; on the last of them where what it came to is not what is measured."""
    rows, yaw = np.asarray(flown.derivatives), np.asarray(flown.yaw)
    if before is not None or len(yaw) > 1:
        begun = on_reference(craft, rows[0], yaw[0]) if before is None else before
        state = fly(craft, begun, rows[None], yaw[None]).state[0]
        off = np.linalg.norm(state[POS : POS + 3] - position), np.linalg.norm(state[VEL : VEL + 3] - velocity)
        apart = 0.0 if up is None else np.arccos(np.clip(body_axes(state[QUAT : QUAT + 4])[2] @ up, -1.0, 1.0))
        if np.isfinite(state).all() and (np.array([*off, apart]) <= FOUND).all():
            return state
    return on_reference(craft, rows[-1], yaw[-1])


def _up(
    craft: Craft,
    velocity: Float[np.ndarray, "3"],
    acceleration: Float[np.ndarray, "3"] | None,
    attitude: Float[np.ndarray, "4"] | None,
) -> Float[np.ndarray, "3"] | None:
    """Where the thrust points (unit, world), as far as it is known."""
    if attitude is not None:
        return body_axes(attitude)[2]
    return None if acceleration is None else _thrust_direction(craft, velocity, acceleration)


def _thrust_direction(
    craft: Craft, velocity: Float[np.ndarray, "3"], acceleration: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"] | None:
    """Where the thrust of a vehicle points that moves so (unit, world); None in free fall."""
    drag = craft.drag / craft.mass * np.linalg.norm(velocity) * velocity
    thrust = acceleration + drag + [0.0, 0.0, craft.gravity]
    size = np.linalg.norm(thrust)
    return thrust / size if size > 0.0 else None


def _tilted(quat_wxyz: Float[np.ndarray, "4"], up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4"]:
    """The attitude turned the shortest way to where body z is ``up`` (unit, world); as it is where that is opposite."""
    before = body_axes(quat_wxyz)[2]
    turn = np.array([1.0 + before @ up, *np.cross(before, up)])
    size = np.linalg.norm(turn)
    if size == 0.0:
        return quat_wxyz
    (a, *b), (c, *d) = turn / size, quat_wxyz
    return np.array([a * c - np.dot(b, d), *(a * np.array(d) + c * np.array(b) + np.cross(b, d))])
