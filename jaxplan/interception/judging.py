"""What was flown, row by row, beside reference, target and obstacles, and what decides an episode."""

import numpy as np
from jaxtyping import Float

from jaxplan.interception.records import Flight
from jaxplan.replanner import Measured
from jaxplan.scenario import Scenario
from jaxplan.tracking.plant import PlantState
from jaxplan.tracking.rollout import FlightLog
from jaxplan.vehicle.params import Vehicle

INTERCEPTION_RADIUS = 0.4
"""Distance [m] that counts as an interception (paper, Sec. IV)."""


def measured_state(state: PlantState, vehicle: Vehicle) -> Measured:
    """The vehicle as its estimator sees it: where it is, and the acceleration of its thrust in still air."""
    velocity, (w, x, y, z) = np.asarray(state.vel, dtype=float), np.asarray(state.quat_wxyz, dtype=float)
    up = np.array([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)])
    mass, lift = float(vehicle.mass), float(vehicle.thrust_coefficient)
    thrust = lift * float((np.asarray(state.rotor_speeds, dtype=float) ** 2).sum())
    drag = float(vehicle.drag_coefficient) * float(np.linalg.norm(velocity)) * velocity
    acceleration = (thrust * up - drag) / mass - np.array([0.0, 0.0, float(vehicle.gravity)])
    return Measured(np.asarray(state.pos, dtype=float), velocity, acceleration, np.array([w, x, y, z]))


def flight_rows(
    ends: Float[np.ndarray, "n"], log: FlightLog, reference: Float[np.ndarray, "n 3"], scenario: Scenario
) -> Flight:
    """Rows of a flight: what the plant logged, beside reference [m] and target at the same instants [s]."""
    position = np.asarray(log.pos, dtype=float)
    return Flight(
        times=ends,
        position=position,
        velocity=np.asarray(log.vel, dtype=float),
        quat_wxyz=np.asarray(log.quat_wxyz, dtype=float),
        reference=reference,
        target=scenario.target.position(ends),
        target_velocity=scenario.target.velocity(ends),
        position_error=np.asarray(log.position_error, dtype=float),
        yaw_error=np.asarray(log.yaw_error, dtype=float),
        twist_error=np.asarray(log.twist_error, dtype=float),
        clearance=scenario.clearance(position),
    )


def until_decided(flight: Flight, scenario: Scenario) -> tuple[Flight, str | None]:
    """The rows up to what decided the episode, and its outcome, if anything did. Failure comes before success."""
    apart = np.linalg.norm(flight.position - flight.target, axis=1)
    turned = flight.yaw_error if scenario.judged_by_heading else flight.twist_error
    tracked = (flight.position_error < scenario.lost_beyond.position) & (turned < scenario.lost_beyond.yaw)
    free = flight.clearance >= np.asarray(scenario.vehicle.radius).item()
    met = (apart < INTERCEPTION_RADIUS) & (flight.times >= scenario.departure)
    decided = ~tracked | ~free | met
    if not decided.any():
        return flight, None
    row = int(np.argmax(decided))
    outcome = "collision" if not free[row] else "intercepted" if tracked[row] else "tracking_lost"
    return Flight(*(values[: row + 1] for values in flight)), outcome
