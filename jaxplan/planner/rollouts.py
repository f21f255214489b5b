"""Plans are flown in the model of the vehicle before they are committed.

What a plan asks for says little about a vehicle that is not on its reference: after a hard turn the attitude is behind,
and the next plan, harmless from its own start, is not followed. So the model flies along the reference of the last
second, is put where the vehicle is measured, its thrust turned to where it points, and goes on from there along each
plan (docs/decisions/0036).
"""

import dataclasses
import functools
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxplan.arrays import AnyArray
from jaxplan.batching import fill
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.planner.validator import Room
from jaxplan.precision import float32_island
from jaxplan.records import record, replace
from jaxplan.spline import FlatState
from jaxplan.tracking.plant import PlantState
from jaxplan.tracking.references import padded, references_at
from jaxplan.tracking.rollout import CONTROL_RATE, FlightLog, build_plant
from jaxplan.validation import require_at_least, require_positive
from jaxplan.vehicle.fingerprint import fingerprint
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.rotations import rotation_from_quat
from jaxplan.vehicle.vectors import cross, dot, length

MANY = 64
"""Flights of a call where more than one plan is flown: as many as there are stops, and some more."""
FOUND = (0.3, 1.0, 0.5)
"""m, m/s and rad; the model begins anew, on the reference, where what it came to is farther from what is measured: in
position, in velocity, or in the direction of the thrust (docs/decisions/0036)."""
_MOVING = ("quat_wxyz", "body_rates", "rotor_speeds")
ARM = 0.3
"""m; see ``Rollouts.astray`` (arbitrary)."""
LOOKED_AT = 2
"""Control steps from one flown position that is looked at to the next (1/100 s)."""


@dataclasses.dataclass(frozen=True)
class RolloutConfig:
    """How long plans are flown, and what is then followed."""

    seconds: float = 1.0
    """Before now, along the reference, and from now on, along the plan (docs/decisions/0036)."""
    most_error: float = 0.3
    """Largest distance [m] from the plan at which it counts as followed (arbitrary)."""
    most_twist: float = 0.8
    """Largest turn [rad] about body z from what the plan demands (half of where an episode is lost)."""
    margin: float = 0.05
    """What flown positions keep from obstacles beyond the vehicle's radius [m] (arbitrary)."""

    def __post_init__(self) -> None:
        require_positive("rollouts", self, "seconds", "most_error", "most_twist")
        require_at_least("rollouts", self, 0.0, "margin")

    @property
    def steps(self) -> int:
        """Control steps before and after."""
        return max(round(self.seconds * CONTROL_RATE), 1)


@record
class Rollouts:
    """What became of plans in the model, until ``seconds`` from now."""

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


@runtime_checkable
class _Settle(Protocol):
    def __call__(
        self,
        flown: FlatState,
        position: Float[AnyArray, "3"],
        velocity: Float[AnyArray, "3"],
        acceleration: Float[AnyArray, "3"],
    ) -> PlantState:
        """The model after the references ``flown``, put where the vehicle is measured; acceleration NaN: unknown."""


@runtime_checkable
class _Fly(Protocol):
    def __call__(self, state: PlantState, references: FlatState) -> FlightLog:
        """Flights (k, n) along ``references`` (k, n + 1), all from the same state."""


class Flyer(NamedTuple):
    """The compiled model, without noise."""

    settle: _Settle
    fly: _Fly
    config: RolloutConfig


def compile_rollouts(config: RolloutConfig, vehicle: Vehicle) -> Flyer:
    """The vehicle's model with its controller in still air (host); compiled when it is called first."""
    settle, fly = _programs(_Numbers(fingerprint(vehicle), vehicle))
    return Flyer(settle, fly, config)


@dataclasses.dataclass(frozen=True)
class _Numbers:
    """A vehicle compared by its numbers, so that planners for the same one share what is compiled."""

    fingerprint: str
    vehicle: Vehicle = dataclasses.field(compare=False)


@functools.lru_cache(maxsize=8)
def _programs(numbers: _Numbers) -> tuple[_Settle, _Fly]:
    """Of one vehicle."""
    plant = build_plant(numbers.vehicle, noise=False)

    own = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), numbers.vehicle)

    def settle(
        flown: FlatState,
        position: Float[AnyArray, "3"],
        velocity: Float[AnyArray, "3"],
        acceleration: Float[AnyArray, "3"],
    ) -> PlantState:
        drag = own.drag_coefficient / own.mass * length(velocity) * velocity
        thrust = acceleration + drag + own.gravity * jnp.array([0.0, 0.0, 1.0], acceleration.dtype)
        up = thrust / length(thrust)
        first, now = (jax.tree.map(lambda rows, row=row: rows[row], flown) for row in (0, -1))
        key = jax.random.key(0)
        state = fresh = plant.reset(now, key)
        if len(flown.yaw) > 1:
            state, _ = plant.fly(plant.reset(first, key), flown)
            here = jnp.stack([length(state.pos - position), length(state.vel - velocity), _apart(state.quat_wxyz, up)])
            found = jnp.all(~(here > jnp.array(FOUND, here.dtype)))
            state = replace(
                state, **{name: jnp.where(found, getattr(state, name), getattr(fresh, name)) for name in _MOVING}
            )
            state = replace(
                state, signals=jax.tree.map(lambda *both: jnp.where(found, *both), state.signals, fresh.signals)
            )
        attitude = _tilted(state.quat_wxyz, up)
        known = jnp.isfinite(attitude).all()
        return replace(state, pos=position, vel=velocity, quat_wxyz=jnp.where(known, attitude, state.quat_wxyz))

    def fly(state: PlantState, references: FlatState) -> FlightLog:
        return jax.vmap(lambda rows: plant.fly(state, rows)[1])(references)

    return float32_island(settle), float32_island(fly)


def _apart(quat_wxyz: Float[AnyArray, "4"], up: Float[AnyArray, "3"]) -> Float[AnyArray, ""]:
    """Angle [rad] between body z and ``up`` (unit, world)."""
    return jnp.arccos(jnp.clip(dot(rotation_from_quat(quat_wxyz)[:, 2], up), -1.0, 1.0))


def _tilted(quat_wxyz: Float[AnyArray, "4"], up: Float[AnyArray, "3"]) -> Float[AnyArray, "4"]:
    """The attitude turned the shortest way to where body z is ``up`` (unit, world); NaN where that is opposite."""
    before = rotation_from_quat(quat_wxyz)[:, 2]
    w, v = 1.0 + dot(before, up), cross(before, up)
    size = jnp.sqrt(w * w + dot(v, v))
    (a, b), (c, d) = (w / size, jnp.stack(v) / size), (quat_wxyz[0], quat_wxyz[1:])
    return jnp.concatenate([(a * c - dot(b, d))[None], a * d + c * b + jnp.stack(cross(b, d))])


def sampled(splines: SplineBatch, times: Float[np.ndarray, "n"]) -> FlatState:
    """References (k, n) along splines at ``times`` [s of their own]; the first of them before, at rest behind."""
    count, times = splines.durations.shape[-1], np.maximum(times, 0.0)
    parts = []
    for at in range(0, count, MANY):
        some = np.arange(at, min(at + MANY, count))
        states = references_at(padded(splines, fill(some, MANY)), times)
        parts.append(jax.tree.map(np.asarray, states))
    return jax.tree.map(lambda *rows: np.concatenate(rows)[:count], *parts)


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
    ) -> None:
        """``flown``: references until now, ``steps`` + 1 of them, or only now's, where those before are not known.

        The ``acceleration`` [m/s^2], where it is known, tells where the thrust points.
        """
        self._flyer, self._room, self._radius = flyer, room, radius
        self._state = flyer.settle(
            flown, position, velocity, np.full(3, np.nan) if acceleration is None else acceleration
        )

    @property
    def config(self) -> RolloutConfig:
        """What it was made with."""
        return self._flyer.config

    def along(self, references: FlatState, since: int = 0) -> Rollouts:
        """Fly ``references`` (k, steps + 1), whose first rows are those of now; compiles nothing.

        Errors count after ``since`` control steps, when the plans take over: a plan need not go on where another led.
        """
        count = len(references.yaw)
        width = 1 if count == 1 else MANY
        starts = range(0, count, width)
        parts = [self._fly(references, np.arange(at, min(at + width, count)), width, since) for at in starts]
        positions, error, twist = (np.concatenate(rows) for rows in zip(*parts, strict=True))
        clearance = self._room.free_distance(positions.astype(float)).min(axis=1)
        config = self.config
        followed = (error <= config.most_error) & (twist <= config.most_twist)
        return Rollouts(
            clearance=clearance,
            error=error,
            twist=twist,
            clear=clearance >= self._radius + config.margin,
            followed=followed,
        )

    def _fly(
        self, references: FlatState, some: np.ndarray, width: int, since: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, and the largest errors, of some of them; what is not finite is infinitely far."""
        rows = fill(some, width)
        chosen = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32)[rows], references)
        log = self._flyer.fly(self._state, chosen)
        count = len(some)
        position, error, twist = (np.asarray(rows)[:count] for rows in (log.pos, log.position_error, log.twist_error))
        position = np.where(np.isfinite(position), position, 1e6)[:, LOOKED_AT - 1 :: LOOKED_AT]
        counted = (values[:, min(since, values.shape[1] - 1) :] for values in (error, twist))
        largest = (np.where(np.isfinite(values), values, np.inf).max(axis=1) for values in counted)
        return (position, *largest)
