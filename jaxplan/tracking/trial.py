"""Trial flights: whether a vehicle's gains hold it at rest, through an eight and in a steep turn."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxplan.spline import FlatState
from jaxplan.tracking.rates import CONTROL_RATE
from jaxplan.tracking.result import USUAL_RADIUS, held_error
from jaxplan.tracking.rollout import ControllerName, build_plant
from jaxplan.vehicle.limits import most_thrust
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.reach import sideways_acceleration

SECONDS = 8.0
"""How long each is flown (arbitrary)."""
TURN = 2.0
"""Thrust of the turn, in weights; less where the vehicle has not got it."""
SPARED = 0.9
"""Share of its thrust that a vehicle may be asked for there (arbitrary)."""


class Trial(NamedTuple):
    """One flight."""

    name: str
    error: float
    """Largest distance [m] from the reference; infinite where the vehicle was lost."""
    limit: float
    """The largest [m] with which it counts as held."""
    saturated: float
    """Share of the control steps in which a rotor was at its limit."""

    @property
    def held(self) -> bool:
        """Whether the gains hold the vehicle there."""
        return self.error < self.limit


def trial_flights(vehicle: Vehicle, controller: ControllerName = "indi", seed: int = 0) -> list[Trial]:
    """A hover, an eight with what a plan may ask for, and a turn of 2 g, in the plant with its noise (host)."""
    plant, size = build_plant(vehicle, controller=controller), float(vehicle.radius) / USUAL_RADIUS
    limit, found = held_error(vehicle), []
    for name, reference in (
        ("hover", eight(0.0, 1.0)),
        ("eight", eight(sideways_acceleration(vehicle), 2.0 * size)),
        ("turn", circle(turning_acceleration(vehicle), 2.0 * size)),
    ):
        first = FlatState(derivatives=reference.derivatives[0], yaw=reference.yaw[0])
        _, log = plant.fly(plant.reset(first, jax.random.key(seed)), reference)
        error = np.asarray(log.position_error, dtype=float)
        worst = float(error.max()) if np.isfinite(error).all() else np.inf
        found.append(Trial(name, worst, limit, float(np.asarray(log.saturated).mean())))
    return found


def turning_acceleration(vehicle: Vehicle) -> float:
    """Sideways [m/s^2] in a level turn with a thrust of ``TURN`` weights, or with what the vehicle has."""
    ratio = min(TURN, SPARED * float(np.asarray(most_thrust(vehicle)) / np.asarray(vehicle.gravity)))
    return float(vehicle.gravity) * float(np.sqrt(max(ratio**2 - 1.0, 0.0)))


def eight(acceleration: float, size: float) -> FlatState:
    """A lying eight of this half length [m], with an acceleration of at most this [m/s^2]; at 0 it stands still."""
    rate = float(np.sqrt(0.5 * acceleration / size))
    along, across = _waves(rate, size), _waves(2.0 * rate, 0.25 * size)
    return _level(along, across)


def circle(acceleration: float, radius: float) -> FlatState:
    """A level circle of this radius [m] at a speed that takes this acceleration [m/s^2]."""
    rate = float(np.sqrt(acceleration / radius))
    return _level(_waves(rate, radius), _waves(rate, radius, 0.5 * np.pi))


def _waves(rate: float, size: float, phase: float = 0.0) -> Float[np.ndarray, "n 5"]:
    """A sine [m] of this rate [rad/s] and its derivatives at the controller's instants."""
    times = np.arange(round(SECONDS * CONTROL_RATE) + 1) / CONTROL_RATE
    orders = np.arange(5)
    return size * rate**orders * np.sin(rate * times[:, None] + phase + 0.5 * np.pi * orders)


def _level(x: Float[np.ndarray, "n 5"], y: Float[np.ndarray, "n 5"]) -> FlatState:
    """The motion in a level plane with the heading 0."""
    return FlatState(derivatives=np.stack([x, y, np.zeros_like(x)], axis=2), yaw=np.zeros((len(x), 3)))
