"""The plant again, with C MuJoCo in float64 and rotors written out one by one in NumPy (tests only)."""

import math

import mujoco
import numpy as np

from jaxplan.vehicle.params import Vehicle


def fly_open_loop(
    vehicle: Vehicle, mjcf: str, qpos: np.ndarray, qvel: np.ndarray, speeds: np.ndarray, commands: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 7) and velocities (n, 6) after each step under rotor ``commands`` (n, 4), without noise."""
    model = mujoco.MjModel.from_xml_string(mjcf)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    speeds = np.array(speeds, dtype=np.float64)
    dt = model.opt.timestep
    positions, velocities = [], []
    for command in commands:
        new = [c + (w - c) * math.exp(-dt / vehicle.motor_time_constant) for w, c in zip(speeds, command, strict=True)]
        angular_momentum, spin_up = 0.0, 0.0
        for i in range(4):
            mean = (speeds[i] + new[i]) / 2.0
            data.ctrl[i] = vehicle.thrust_coefficient * mean**2
            angular_momentum -= vehicle.rotor_spin[i] * vehicle.rotor_inertia * mean
            spin_up += vehicle.rotor_spin[i] * vehicle.rotor_inertia * (new[i] - speeds[i]) / dt
        vel, rates = data.qvel[:3], data.qvel[3:]
        gyroscopic = -np.cross(rates, [0.0, 0.0, angular_momentum])
        damping = -vehicle.aero_moment_coefficient * np.linalg.norm(rates) * rates
        data.qfrc_applied[:3] = -vehicle.drag_coefficient * np.linalg.norm(vel) * vel
        data.qfrc_applied[3:] = gyroscopic + damping + [0.0, 0.0, spin_up]
        mujoco.mj_step(model, data)
        speeds = np.array(new)
        positions.append(data.qpos.copy())
        velocities.append(data.qvel.copy())
    return np.array(positions), np.array(velocities)
