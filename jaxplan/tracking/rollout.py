"""Flying a reference in simulation: controller at 200 Hz, physics at 400 Hz, the errors logged.

Timing. Control step i lasts from t_i to t_{i+1} = t_i + 1/200 s. ``references`` has n + 1 rows for n steps: row i is
the reference at t_i. The controller reads row i at t_i and holds its command; row i of the log is the plant at t_{i+1},
and its errors are against row i + 1. To go on, the next call's row 0 is this call's row n.
"""

from typing import Literal, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, PRNGKeyArray

from jaxplan.arrays import AnyArray
from jaxplan.errors import InputError
from jaxplan.numerics import wrap_angle
from jaxplan.precision import float32_island
from jaxplan.records import record, replace
from jaxplan.spline import FlatState
from jaxplan.tracking.disturbance import Disturbance
from jaxplan.tracking.indi import indi
from jaxplan.tracking.model import vehicle_body
from jaxplan.tracking.plant import (
    Noise,
    PlantState,
    draw_noise,
    no_noise,
    physics_step,
    sense,
    state_on_reference,
)
from jaxplan.tracking.rates import CONTROL_RATE, PHYSICS_RATE
from jaxplan.tracking.se3 import se3
from jaxplan.tracking.sensing import Controller
from jaxplan.vehicle.flatness import against_drag, demand_of
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.rotations import rotation_from_quat
from jaxplan.vehicle.vectors import dot

ControllerName = Literal["indi", "se3"]
CONTROLLERS: dict[str, Controller] = {"indi": indi, "se3": se3}
"""Incremental dynamic inversion (the default), and geometric control as the second choice. Gains are the vehicle's."""

_SUBSTEPS = PHYSICS_RATE // CONTROL_RATE


@record
class FlightLog:
    """The plant at the end of each control step (leading axis n), and how far it is from the reference of that instant.

    A flight that went wrong shows as errors that are large or not finite: test ``~(error < limit)``.
    """

    pos: Float[AnyArray, "*n 3"]
    """m, world."""
    vel: Float[AnyArray, "*n 3"]
    """m/s, world."""
    quat_wxyz: Float[AnyArray, "*n 4"]
    """Body to world."""
    body_rates: Float[AnyArray, "*n 3"]
    """rad/s, body."""
    rotor_speeds: Float[AnyArray, "*n 4"]
    """rad/s."""
    position_error: Float[AnyArray, "*n"]
    """m, distance from the reference."""
    yaw_error: Float[AnyArray, "*n"]
    """rad in [0, pi], between the heading of body x seen from above and the reference's yaw; not modulo pi. Where body
    x points up or down it says nothing."""
    twist_error: Float[AnyArray, "*n"]
    """rad in [0, pi], how far the vehicle is turned about body z from the attitude that the reference demands against
    the drag of still air."""
    saturated: Bool[AnyArray, "*n"]
    """A rotor limit changed the command of this step."""


@runtime_checkable
class Reset(Protocol):
    """Puts the vehicle on a reference."""

    def __call__(self, reference: FlatState, key: PRNGKeyArray) -> PlantState:
        """The plant on ``reference``, rotors at the speeds it demands, filters settled, with ``key`` for its noise."""


@runtime_checkable
class Fly(Protocol):
    """Flies along references."""

    def __call__(
        self, state: PlantState, references: FlatState, disturbance: Disturbance | None = None
    ) -> tuple[PlantState, FlightLog]:
        """The plant after n control steps along n + 1 ``references``, and the log; one compilation for each n.

        ``disturbance`` adds wind, a gust and thrust losses; None is calm.
        """


class Plant(NamedTuple):
    """A simulated vehicle under control: compiled pure functions of one flight, in float32 whatever the caller's scope.

    For many flights ``vmap`` them; batch axes come first, as ``FlatState`` has them.
    """

    reset: Reset
    fly: Fly


def build_plant(vehicle: Vehicle, *, noise: bool = True, controller: ControllerName | str = "indi") -> Plant:
    """The plant of ``vehicle`` (host); ``noise`` False leaves out process and sensor noise."""
    if controller not in CONTROLLERS:
        raise InputError(f"build_plant: controller is {controller!r}, want one of {', '.join(CONTROLLERS)}")
    body = vehicle_body(vehicle)
    law = CONTROLLERS[controller]
    draws = draw_noise if noise else no_noise
    cast = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), vehicle)

    def reset(reference: FlatState, key: PRNGKeyArray) -> PlantState:
        return state_on_reference(vehicle.astype(jnp.float32), reference, key)

    def control_step(
        state: PlantState, row: tuple[FlatState, FlatState, Noise], disturbance: Disturbance | None
    ) -> tuple[PlantState, FlightLog]:
        reference, target, draw = row
        commands, saturated = law(cast, sense(state), reference)
        time = state.step / CONTROL_RATE  # the same for the substeps: a gust lasts longer than 5 ms

        def substep(state: PlantState, draw: Noise) -> tuple[PlantState, None]:
            return physics_step(cast, body, state, commands, draw, disturbance, time), None

        state, _ = jax.lax.scan(substep, state, draw)
        return replace(state, step=state.step + 1), log_row(cast, state, target, saturated)

    def fly(
        state: PlantState, references: FlatState, disturbance: Disturbance | None = None
    ) -> tuple[PlantState, FlightLog]:
        now = jax.tree.map(lambda rows: rows[:-1], references)
        then = jax.tree.map(lambda rows: rows[1:], references)
        keys = jax.vmap(lambda step: jax.random.fold_in(state.key, step))(state.step + jnp.arange(len(now.yaw)))
        draw = jax.vmap(lambda key: draws(key, _SUBSTEPS))(keys)
        return jax.lax.scan(lambda state, row: control_step(state, row, disturbance), state, (now, then, draw))

    return Plant(reset=float32_island(reset), fly=float32_island(fly))


def log_row(vehicle: Vehicle, state: PlantState, target: FlatState, saturated: Bool[AnyArray, ""]) -> FlightLog:
    """One row of the log, with the errors against ``target``; ``vehicle`` is cast already. NaN stays NaN."""
    rotation = rotation_from_quat(state.quat_wxyz)
    heading = jnp.arctan2(rotation[1, 0], rotation[0, 0])
    (ax, ay, _) = demand_of(vehicle, against_drag(vehicle, target)).axes
    x, y = rotation[:, 0], rotation[:, 1]
    twist = jnp.arctan2(dot(ay, x) - dot(ax, y), dot(ax, x) + dot(ay, y))
    return FlightLog(
        pos=state.pos,
        vel=state.vel,
        quat_wxyz=state.quat_wxyz,
        body_rates=state.body_rates,
        rotor_speeds=state.rotor_speeds,
        position_error=jnp.sqrt(jnp.sum((state.pos - target.pos) ** 2)),
        yaw_error=jnp.abs(wrap_angle(heading - target.yaw[0])),
        twist_error=jnp.abs(twist),
        saturated=saturated,
    )
