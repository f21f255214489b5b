"""The simulated vehicle with the firmware in the place of our controller: a ``tracking.rollout.Plant``.

The physics, its noise and its 400 steps a second are the plant's own. Each step sends the firmware one state packet
with the gyroscope as our controller would have it before its filter, and holds the motor outputs that come back; the
outer loop runs at 200 Hz from true state. Before a flight the vehicle is held at its start, the firmware armed and its
throttle raised; then it is let go. Every reset starts a new process, so a flight depends on nothing before it.
"""

import contextlib
import dataclasses
import shutil
import tempfile
from pathlib import Path
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, PRNGKeyArray

from jaxplan.arrays import AnyArray
from jaxplan.errors import InputError, ResourceError
from jaxplan.precision import float32_island
from jaxplan.spline import FlatState
from jaxplan.tracking.disturbance import Disturbance
from jaxplan.tracking.model import vehicle_body
from jaxplan.tracking.plant import DT, Noise, PlantState, draw_noise, no_noise, physics_step, state_on_reference
from jaxplan.tracking.rates import CONTROL_RATE, PHYSICS_RATE
from jaxplan.tracking.rollout import FlightLog, Plant, log_row
from jaxplan.vehicle.params import Vehicle, hover_speeds
from jaxplan.vehicle.rotations import rotation_from_quat

from . import outer_loop
from .build import Firmware, build
from .link import LOW, MIDDLE, Link, Sensors, Sticks
from .process import running
from .settings import MEMORY, settings_file

BOOT = 3.0
"""s of the firmware's clock before its first packet."""
ARMED_AT, RAISED_AT, LET_GO_AT = 5.5, 6.5, 8.0
"""s after the boot, at which the switch is thrown, the throttle raised, and the vehicle let go; the firmware refuses to
arm in its first 5 s."""
RAISED = 0.02
"""Motor output within which the firmware must be of what hovers before the vehicle is let go (arbitrary)."""
SUBSTEPS = PHYSICS_RATE // CONTROL_RATE
CORNERS = ("front right", "rear left", "front left", "rear right")
"""The firmware's motors, as its packets have them."""
_SIDES = np.array([[1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [-1.0, -1.0]])
"""Signs of x and y of those corners."""
_SPINS = np.array([-1.0, -1.0, 1.0, 1.0])
"""Signs of their reaction torques about body z up, where the firmware's motors are not reversed."""


class Advance(Protocol):
    """One physics step."""

    def __call__(
        self, state: PlantState, outputs: Float[np.ndarray, "4"], noise: Noise, disturbance: Disturbance | None, /
    ) -> tuple[PlantState, Float[AnyArray, "16"]]:
        """The state 1/400 s later under held motor outputs [0 to 1, as the rotors are numbered], and the sensors."""


class Draw(Protocol):
    """Noise of steps to come."""

    def __call__(self, state: PlantState, steps: Int[np.ndarray, "n"], /) -> Noise:
        """Of each of these control steps from ``state``: leading axes n and the physics steps within it."""


def motor_of_rotor(vehicle: Vehicle) -> Int[np.ndarray, "4"]:
    """Which entry of a motor packet each rotor of a vehicle is.

    Raises:
        InputError: the vehicle is not the X that the firmware's mixer flies.
    """
    sides = np.sign(np.asarray(vehicle.rotor_positions)[:, :2])
    motors = np.array([np.flatnonzero((side == _SIDES).all(axis=1)).sum() for side in sides])
    if sorted(motors.tolist()) != [0, 1, 2, 3] or (sides == 0.0).any():
        raise InputError(f"firmware: rotors of vehicle {vehicle.name!r} are not one at each of {', '.join(CORNERS)}")
    if (_SPINS[motors] != np.asarray(vehicle.rotor_spin)).any():
        raise InputError(
            f"firmware: rotors of vehicle {vehicle.name!r} turn the other way round than Betaflight's; it flies only "
            "vehicles whose front left rotor turns clockwise from above"
        )
    return motors


class FirmwarePlant:
    """Flies one vehicle, one flight at a time; use it in a ``with`` block, which ends the firmware.

    ``reset`` and ``fly`` are those of a ``Plant``, with one difference: the firmware remembers, so a flight goes on
    from where it was and from no other state.
    """

    def __init__(self, vehicle: Vehicle, firmware: Firmware | None = None, *, noise: bool = True) -> None:
        """Build the firmware where none is given; ``noise`` False leaves out process and sensor noise."""
        self._vehicle, self._motors = vehicle, motor_of_rotor(vehicle)
        self._firmware = firmware or build()
        self._settings = settings_file(self._firmware)
        self._cast = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), vehicle)
        self._advance, self._draw = _physics(vehicle), _draws(noise)
        self._running = contextlib.ExitStack()
        self._link: Link | None = None
        self._exchanges, self._step = 0, 0
        self._sensors = np.zeros(16)

    def __enter__(self) -> Plant:
        return Plant(reset=self.reset, fly=self.fly)

    def __exit__(self, *_: object) -> None:
        self._running.close()
        self._link = None

    def reset(self, reference: FlatState, key: PRNGKeyArray) -> PlantState:
        """The plant on ``reference``, with a firmware that was started anew, armed, and throttled to hover.

        Raises:
            ResourceError: the firmware cannot be started, does not answer, or does not arm.
        """
        self._running.close()
        self._link = None
        state = _start(self._cast, reference, key)
        self._sensors = np.asarray(_at_rest(self._cast, state), dtype=float)
        self._step = 0
        with contextlib.ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="jaxplan-firmware-")))
            shutil.copyfile(self._settings, folder / MEMORY)
            self._link = Link(stack.enter_context(running(self._firmware, folder, BOOT)))
            self._take_off(self._link)
            self._running = stack.pop_all()
        return state

    def fly(
        self, state: PlantState, references: FlatState, disturbance: Disturbance | None = None
    ) -> tuple[PlantState, FlightLog]:
        """As ``tracking.rollout.Fly``; the log counts a motor at either end of its range as saturated.

        Raises:
            InputError: ``state`` is not where the firmware is.
            ResourceError: the firmware does not answer.
        """
        if self._link is None or int(state.step) != self._step:
            raise InputError(
                f"firmware: a flight from step {int(state.step)}, but it is at step {self._step}: it cannot go back; "
                "reset the plant first"
            )
        count = len(references.yaw) - 1
        asked, noise = _demands(self._cast, references), jax.tree.map(np.asarray, self._draw(state, np.arange(count)))
        rows, states, saturated = (jax.tree.map(np.asarray, references), asked), [], []
        for step in range(count):
            reference, demand = jax.tree.map(lambda leaf, step=step: leaf[step], rows)
            output, *rates = np.asarray(_commands(self._cast, state, reference, demand), dtype=float)
            sticks = outer_loop.sticks(output, np.array(rates))
            for part in range(SUBSTEPS):
                motors = self._exchange(self._link, sticks)
                draw = jax.tree.map(lambda leaf, row=(step, part): leaf[row], noise)
                state, sensors = self._advance(state, motors[self._motors], draw, disturbance)
                self._sensors = np.asarray(sensors, dtype=float)
            state = dataclasses.replace(state, step=state.step + 1)
            states.append(state)
            saturated.append(bool((motors <= outer_loop.IDLE).any() or (motors >= 1.0).any()))
        self._step += count
        flown = jax.tree.map(lambda *leaves: np.stack(leaves), *[_without_key(state) for state in states])
        targets = jax.tree.map(lambda leaf: leaf[1:], rows[0])
        return state, _log(self._cast, flown, targets, np.array(saturated))

    def _exchange(self, link: Link, sticks: Sticks) -> Float[np.ndarray, "4"]:
        """One step of the firmware's clock."""
        self._exchanges += 1
        ends = np.split(self._sensors, (3, 6, 10, 13))
        return link.step(BOOT + self._exchanges * DT, Sensors(*ends), sticks)

    def _take_off(self, link: Link) -> None:
        """Hold the vehicle in the air until the firmware turns its motors as in hover."""
        wanted = float(hover_speeds(self._vehicle).mean() / self._vehicle.rotor_speed_max)
        raised = outer_loop.sticks(wanted, np.zeros(3))
        low = Sticks(MIDDLE, MIDDLE, LOW, MIDDLE, armed=False)
        self._exchanges, motors = 0, np.zeros(4)
        for step in range(round(LET_GO_AT * PHYSICS_RATE)):
            now = step / PHYSICS_RATE
            held = raised if now >= RAISED_AT else low._replace(armed=now >= ARMED_AT)
            motors = self._exchange(link, held)
        if not (np.abs(motors - wanted) < RAISED).all():
            raise ResourceError(
                f"firmware: {LET_GO_AT:g} s after its boot its motors are at {np.round(motors, 3).tolist()}, want "
                f"{wanted:.3f} each, which hovers: did it arm? Its settings are in {self._settings}"
            )


def _physics(vehicle: Vehicle) -> Advance:
    """The compiled step of a vehicle: its state 1/400 s later, and what its sensors say then."""
    body, fastest = vehicle_body(vehicle), float(vehicle.rotor_speed_max)
    cast = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), vehicle)

    def advance(
        state: PlantState, outputs: Float[AnyArray, "4"], noise: Noise, disturbance: Disturbance | None
    ) -> tuple[PlantState, Float[AnyArray, "16"]]:
        speeds = jnp.maximum(outputs * fastest, cast.rotor_speed_min)
        after = physics_step(cast, body, state, speeds, noise, disturbance, state.step / CONTROL_RATE)
        acceleration = (after.vel - state.vel) / DT
        rates = after.body_rates + jnp.sqrt(cast.gyroscope_variance) * noise.gyroscope
        return after, _sensed(
            cast, after, rates, acceleration, jnp.sqrt(cast.accelerometer_variance) * noise.accelerometer
        )

    return float32_island(advance)


def _draws(noise: bool) -> Draw:
    """The noise of the control steps that follow, as the plant of our controller draws it."""
    one = draw_noise if noise else no_noise

    def draw(state: PlantState, steps: Int[AnyArray, "n"]) -> Noise:
        keys = jax.vmap(lambda step: jax.random.fold_in(state.key, state.step + step))(steps)
        return jax.vmap(lambda key: one(key, SUBSTEPS))(keys)

    return float32_island(draw)


def _sensed(
    vehicle: Vehicle,
    state: PlantState,
    rates: Float[AnyArray, "3"],
    acceleration: Float[AnyArray, "3"],
    noise: Float[AnyArray, "3"],
) -> Float[AnyArray, "16"]:
    """``Sensors`` as one array."""
    up = jnp.array([0.0, 0.0, 1.0], state.pos.dtype)
    force = rotation_from_quat(state.quat_wxyz).T @ (acceleration + vehicle.gravity * up) + noise
    return jnp.concatenate([state.pos, state.vel, state.quat_wxyz, rates, force])


@float32_island
def _at_rest(vehicle: Vehicle, state: PlantState) -> Float[AnyArray, "16"]:
    """What the sensors of a vehicle say that is held: no rates, its weight, no noise."""
    nothing = jnp.zeros_like(state.pos)
    return _sensed(vehicle, state, nothing, nothing, nothing)


_start = float32_island(state_on_reference)
_demands = float32_island(outer_loop.demands)
_commands = float32_island(outer_loop.commands)


@float32_island
def _log(vehicle: Vehicle, states: PlantState, targets: FlatState, saturated: Bool[AnyArray, "n"]) -> FlightLog:
    return jax.vmap(log_row, in_axes=(None, 0, 0, 0))(vehicle, states, targets, saturated)


def _without_key(state: PlantState) -> PlantState:
    """A state that can be stacked in NumPy."""
    return dataclasses.replace(state, key=np.zeros(2, np.uint32))
