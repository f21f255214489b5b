"""Flying a reference in simulation: controller at 200 Hz, physics at 400 Hz, the errors logged.

Timing. Control step i lasts from t_i to t_{i+1} = t_i + 1/200 s. ``references`` has n + 1 rows for n steps: row i is
the reference at t_i. The controller reads row i at t_i and holds its command; row i of the log is the plant at t_{i+1},
and its errors are against row i + 1. To go on, the next call's row 0 is this call's row n.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxplan.errors import InputError
from jaxplan.numerics import wrap_angle
from jaxplan.records import record, replace
from jaxplan.spline import FlatState
from jaxplan.tracking.disturbance import Disturbance
from jaxplan.tracking.indi import indi
from jaxplan.tracking.model import PHYSICS_RATE, Body, vehicle_body
from jaxplan.tracking.plant import (
    Noise,
    PlantState,
    draw_noise,
    no_noise,
    physics_step,
    sense,
    state_on_reference,
)
from jaxplan.tracking.precision import float32_island
from jaxplan.tracking.se3 import se3
from jaxplan.tracking.sensing import Controller
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.rotations import rotation_from_quat

CONTROL_RATE = 200
"""Control steps per second, as in the MFRL evaluation."""

ControllerName = Literal["indi", "se3"]
CONTROLLERS: dict[ControllerName, Controller] = {"indi": indi, "se3": se3}
"""Incremental dynamic inversion (the default), and geometric control as the second choice. Gains are the vehicle's."""

_SUBSTEPS = PHYSICS_RATE // CONTROL_RATE


@record
class FlightLog:
    """The plant at the end of each control step (leading axis n), and how far it is from the reference of that instant.

    A flight that went wrong shows as errors that are large or not finite: test ``~(error < limit)``.
    """

    pos: Float[Array, "n 3"]
    """m, world."""
    vel: Float[Array, "n 3"]
    """m/s, world."""
    quat_wxyz: Float[Array, "n 4"]
    """Body to world."""
    body_rates: Float[Array, "n 3"]
    """rad/s, body."""
    rotor_speeds: Float[Array, "n 4"]
    """rad/s."""
    position_error: Float[Array, "n"]
    """m, distance from the reference."""
    yaw_error: Float[Array, "n"]
    """rad in [0, pi], between the heading of body x seen from above and the reference's yaw; not modulo pi."""
    saturated: Bool[Array, "n"]
    """A rotor limit changed the command of this step."""


class Plant(NamedTuple):
    """A simulated vehicle under control: compiled pure functions, in float32 whatever the caller's scope."""

    reset: Callable[[FlatState, PRNGKeyArray], PlantState]
    """``reset(reference, key)``: on the reference, rotors at the speeds it demands, filters settled."""
    fly: Callable[..., tuple[PlantState, FlightLog]]
    """``fly(state, references, disturbance=None)``: n control steps along n + 1 references; one compilation for each n.

    A ``Disturbance`` adds wind, a gust and thrust losses; None is calm.
    """


def build_plant(vehicle: Vehicle, *, noise: bool = True, controller: ControllerName = "indi") -> Plant:
    """The plant of ``vehicle`` (host); ``noise`` False leaves out process and sensor noise. ``vmap`` both functions."""
    if controller not in CONTROLLERS:
        raise InputError(f"build_plant: controller is {controller!r}, want one of {', '.join(CONTROLLERS)}")
    body = vehicle_body(vehicle)
    law = CONTROLLERS[controller]
    noise_of = draw_noise if noise else no_noise

    def reset(reference: FlatState, key: PRNGKeyArray) -> PlantState:
        return state_on_reference(vehicle.astype(jnp.float32), reference, key)

    def fly(
        state: PlantState, references: FlatState, disturbance: Disturbance | None = None
    ) -> tuple[PlantState, FlightLog]:
        return _fly(vehicle.astype(jnp.float32), body, law, noise_of, state, references, disturbance)

    return Plant(reset=float32_island(reset), fly=float32_island(fly))


def _fly(
    vehicle: Vehicle,
    body: Body,
    law: Controller,
    noise_of: Callable[[PRNGKeyArray, int], Noise],
    state: PlantState,
    references: FlatState,
    disturbance: Disturbance | None,
) -> tuple[PlantState, FlightLog]:
    now = jax.tree.map(lambda rows: rows[:-1], references)
    then = jax.tree.map(lambda rows: rows[1:], references)

    def control_step(state: PlantState, row: tuple[FlatState, FlatState]) -> tuple[PlantState, FlightLog]:
        reference, target = row
        commands, saturated = law(vehicle, sense(state), reference)
        time = state.step / CONTROL_RATE  # the same for the substeps: a gust lasts longer than 5 ms
        noise = noise_of(jax.random.fold_in(state.key, state.step), _SUBSTEPS)

        def substep(state: PlantState, draw: Noise) -> tuple[PlantState, None]:
            return physics_step(vehicle, body, state, commands, draw, disturbance, time), None

        state, _ = jax.lax.scan(substep, state, noise)
        state = replace(state, step=state.step + 1)
        return state, _log(state, target, saturated)

    return jax.lax.scan(control_step, state, (now, then))


def _log(state: PlantState, target: FlatState, saturated: Bool[Array, ""]) -> FlightLog:
    """One row of the log; plain arithmetic, so that NaN stays NaN."""
    ahead = rotation_from_quat(state.quat_wxyz)[:, 0]
    heading = jnp.arctan2(ahead[1], ahead[0])
    return FlightLog(
        pos=state.pos,
        vel=state.vel,
        quat_wxyz=state.quat_wxyz,
        body_rates=state.body_rates,
        rotor_speeds=state.rotor_speeds,
        position_error=jnp.sqrt(jnp.sum((state.pos - target.pos) ** 2)),
        yaw_error=jnp.abs(wrap_angle(heading - target.yaw[0])),
        saturated=saturated,
    )
