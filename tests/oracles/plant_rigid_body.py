"""Newton-Euler equations of a quadrotor, integrated by SciPy in continuous time (tests only; no MuJoCo, no MJCF).

Each rotor is a lever arm, an upward pull and a drag torque against its turning direction; attitude by rotation matrix.
"""

import numpy as np
from scipy.integrate import solve_ivp

from jaxplan.vehicle.params import Vehicle


def fly(
    vehicle: Vehicle, initial: dict[str, np.ndarray], command: np.ndarray, duration: float
) -> dict[str, np.ndarray]:
    """State after ``duration`` s of a constant rotor ``command``; keys pos, vel, rotation, rates, speeds."""
    inertia, up = np.diag(vehicle.inertia), np.array([0.0, 0.0, 1.0])

    def derivative(_: float, y: np.ndarray) -> np.ndarray:
        vel, rotation, rates, speeds = y[3:6], y[6:15].reshape(3, 3), y[15:18], y[18:]
        spin_up = (command - speeds) / vehicle.motor_time_constant
        force = vehicle.mass * np.array([0.0, 0.0, -vehicle.gravity])
        force -= vehicle.drag_coefficient * np.linalg.norm(vel) * vel
        moment = -vehicle.aero_moment_coefficient * np.linalg.norm(rates) * rates - np.cross(rates, inertia @ rates)
        for arm, spin, speed, gain in zip(vehicle.rotor_positions, vehicle.rotor_spin, speeds, spin_up, strict=True):
            pull = vehicle.thrust_coefficient * speed**2 * up
            momentum = -spin * vehicle.rotor_inertia * speed * up
            momentum_rate = -spin * vehicle.rotor_inertia * gain * up
            force += rotation @ pull
            moment += np.cross(arm, pull) + spin * vehicle.torque_coefficient * speed**2 * up
            moment -= momentum_rate + np.cross(rates, momentum)
        skew = np.array([[0, -rates[2], rates[1]], [rates[2], 0, -rates[0]], [-rates[1], rates[0], 0]])
        turn = np.linalg.solve(inertia, moment)
        return np.concatenate([vel, force / vehicle.mass, (rotation @ skew).ravel(), turn, spin_up])

    keys = ("pos", "vel", "rotation", "rates", "speeds")
    start = np.concatenate([np.ravel(initial[key]) for key in keys])
    end = solve_ivp(derivative, (0.0, duration), start, rtol=1e-10, atol=1e-10).y[:, -1]
    pos, vel, rotation, rates, speeds = np.split(end, [3, 6, 15, 18])
    return dict(zip(keys, (pos, vel, rotation.reshape(3, 3), rates, speeds), strict=True))
