"""Flights of the compiled vehicle along references: where it is, and how far from where it should be (host)."""

import functools
import math
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxplan.tracking.kernels.attitude import axes_along, axes_of, cross, dot, length, quaternion_of, rates_of
from jaxplan.tracking.kernels.compiled import entry_point, inner, source_digest
from jaxplan.tracking.kernels.craft import Craft
from jaxplan.tracking.kernels.step import (
    FORCE,
    GYRO,
    MOMENT,
    POS,
    QUAT,
    RATES,
    SIZE,
    SLOPES,
    SPEEDS,
    THRUST,
    VEL,
    advance,
    against_drag,
    steer,
    vector,
)
from jaxplan.tracking.rates import CONTROL_RATE, PHYSICS_RATE
from jaxplan.vehicle.heading import body_axes, heading_near

_SUBSTEPS = PHYSICS_RATE // CONTROL_RATE
_DT = 1.0 / PHYSICS_RATE


class Flown(NamedTuple):
    """What became of k flights; what is not finite counts as infinitely far."""

    state: Float[np.ndarray, "k s"]
    """At the end (``step``)."""
    position: Float[np.ndarray, "k n 3"]
    """At the end of every step [m, world]."""
    error: Float[np.ndarray, "k"]
    """Largest distance from the reference [m]."""
    twist: Float[np.ndarray, "k"]
    """Largest turn about body z from the attitude that the reference demands [rad]."""


def on_reference(craft: Craft, derivatives: Float[np.ndarray, "5 3"], yaw: Float[np.ndarray, "3"]) -> np.ndarray:
    """The state as if the vehicle had always flown so (``plant.state_on_reference``)."""
    state = np.empty(SIZE)
    _compiled_reset()(craft, np.ascontiguousarray(derivatives, float), np.ascontiguousarray(yaw, float), state)
    return state


def reference_of(
    craft: Craft, state: Float[np.ndarray, "s"], yaw: float
) -> tuple[Float[np.ndarray, "5 3"], Float[np.ndarray, "3"]]:
    """The reference that a vehicle is on: derivatives to jerk, and its heading, unwrapped to near ``yaw`` [rad].

    The rotors are taken to keep their thrust, and nothing is said of the snap and of how the heading turns: all 0.
    """
    velocity, quat, rates = state[VEL : VEL + 3], state[QUAT : QUAT + 4], state[RATES : RATES + 3]
    up, speed = body_axes(quat)[2], float(np.linalg.norm(velocity))
    lift = craft.thrust_coefficient * float(np.sum(state[SPEEDS : SPEEDS + 4] ** 2)) / craft.mass
    share = craft.drag / craft.mass
    acceleration = lift * up - share * speed * velocity - [0.0, 0.0, craft.gravity]
    swing = lift * np.cross(rates @ body_axes(quat), up)
    along = float(velocity @ acceleration) / speed if speed > 0.0 else 0.0
    jerk = swing - share * (speed * acceleration + along * velocity)
    derivatives = np.stack([state[POS : POS + 3], velocity, acceleration, jerk, np.zeros(3)])
    return derivatives, np.array([heading_near(quat, yaw), 0.0, 0.0])


def fly(
    craft: Craft,
    state: Float[np.ndarray, "s"],
    derivatives: Float[np.ndarray, "k n 5 3"],
    yaw: Float[np.ndarray, "k n 3"],
    since: int = 0,
) -> Flown:
    """Fly along n - 1 control steps of each of k references, all from one state; errors count after ``since`` steps."""
    count, rows = yaw.shape[:2]
    found = Flown(np.empty((count, SIZE)), np.empty((count, rows - 1, 3)), np.zeros(count), np.zeros(count))
    derivatives, yaw = np.ascontiguousarray(derivatives, float), np.ascontiguousarray(yaw, float)
    _compiled_fly()(craft, np.ascontiguousarray(state, float), derivatives, yaw, min(since, rows - 2), found)
    return found


@runtime_checkable
class _Reset(Protocol):
    def __call__(self, craft: Craft, derivatives: np.ndarray, yaw: np.ndarray, state: np.ndarray) -> None:
        """Writes the state."""


@runtime_checkable
class _Fly(Protocol):
    def __call__(
        self, craft: Craft, state: np.ndarray, derivatives: np.ndarray, yaw: np.ndarray, since: int, found: Flown
    ) -> None:
        """Writes what became of all flights."""


@functools.cache
def _compiled_reset() -> _Reset:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(craft, derivatives, yaw, state):
        _ = version
        _reset(craft, derivatives, yaw, state)

    return entry  # type: ignore[no-any-return]


@functools.cache
def _compiled_fly() -> _Fly:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(craft, state, derivatives, yaw, since, found):
        _ = version
        work, commands = np.empty(4), np.empty(8)
        for k in range(len(yaw)):
            now = found.state[k]
            for n in range(SIZE):  # assigning arrays compiles the message for other sizes: two seconds
                now[n] = state[n]
            found.error[k], found.twist[k] = _fly_one(
                craft, now, derivatives[k], yaw[k], since, work, commands, found.position[k]
            )

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _fly_one(craft, now, derivatives, yaw, since, work, commands, position):
    """The largest errors of one flight; where something is not finite, the rest of it is infinitely far."""
    error, twist = 0.0, 0.0
    for i in range(len(position)):
        steer(craft, now, derivatives[i], yaw[i], work, commands)
        for _ in range(_SUBSTEPS):
            advance(craft, now, commands, _DT)
        place, wanted = vector(now, POS), derivatives[i + 1, 0]
        off = length((place[0] - wanted[0], place[1] - wanted[1], place[2] - wanted[2]))
        turned = _twist(craft, now, derivatives[i + 1], yaw[i + 1])
        if not (math.isfinite(off) and math.isfinite(turned)):
            for rest in range(i, len(position)):
                position[rest, 0] = position[rest, 1] = position[rest, 2] = math.inf
            return math.inf, math.inf
        position[i, 0], position[i, 1], position[i, 2] = place
        if i >= since:
            error, twist = max(error, off), max(twist, turned)
    return error, twist


@inner
@no_type_check
def _twist(craft, now, derivatives, yaw):
    """Turn about body z from what a reference demands against drag [rad]."""
    acc, _ = against_drag(craft, derivatives)
    ax, ay, _ = axes_along((acc[0], acc[1], acc[2] + craft.gravity), yaw[0])
    x, y, _ = axes_of(now[QUAT], now[QUAT + 1], now[QUAT + 2], now[QUAT + 3])
    return abs(math.atan2(dot(ay, x) - dot(ax, y), dot(ax, x) + dot(ay, y)))


@inner
@no_type_check
def _reset(craft, derivatives, yaw, state):
    """Attitude, rates, rotors and settled filters of a reference."""
    acc, jerk = against_drag(craft, derivatives)
    snap = vector(derivatives[4], 0)
    force = acc[0], acc[1], acc[2] + craft.gravity
    thrust, axes = length(force), axes_along(force, yaw[0])
    rates, turning = rates_of(axes, thrust, jerk, snap, yaw[1], yaw[2])
    inertia = craft.inertia
    bias = cross(rates, (inertia[0] * rates[0], inertia[1] * rates[1], inertia[2] * rates[2]))
    quat = quaternion_of(axes)
    for i in range(4):
        state[QUAT + i] = quat[i]
    for i in range(3):
        moment = inertia[i] * turning[i] + bias[i]
        up = craft.gravity if i == 2 else 0.0
        state[POS + i], state[VEL + i], state[RATES + i] = derivatives[0, i], derivatives[1, i], rates[i]
        state[FORCE + i], state[THRUST + i] = derivatives[2, i] + up, thrust * axes[2][i]
        state[GYRO + i], state[MOMENT + i] = rates[i], moment
        state[SLOPES + i] = state[SLOPES + 3 + i] = derivatives[3, i]
        state[SLOPES + 6 + i], state[SLOPES + 9 + i] = turning[i], 0.0
    for i in range(4):
        square = craft.mixer[i, 3] * craft.mass * thrust
        for j in range(3):
            square += craft.mixer[i, j] * state[MOMENT + j]
        speed = math.sqrt(abs(square)) if square > 0.0 else -math.sqrt(abs(square))
        state[SPEEDS + i] = min(max(speed, craft.slowest), craft.fastest)
