"""One flight of our vehicle in rotorpy: its vehicle model and its SE(3) controller (extra ``peers``).

rotorpy knows neither rotor inertia nor aerodynamic moments, integrates adaptively, and senses without noise or filters.
"""

from typing import Any

import numpy as np

from jaxplan.spline import PiecewisePolynomial
from jaxplan.vehicle.params import Vehicle

ORDERS = ("x", "x_dot", "x_ddot", "x_dddot", "x_ddddot")


def parameters(vehicle: Vehicle) -> dict[str, Any]:
    """rotorpy's dictionary for a vehicle of ours."""
    positions = {f"r{i + 1}": np.asarray(position) for i, position in enumerate(np.asarray(vehicle.rotor_positions))}
    inertia = dict(zip(("Ixx", "Iyy", "Izz"), np.asarray(vehicle.inertia), strict=True))
    drag = dict.fromkeys(("c_Dx", "c_Dy", "c_Dz"), vehicle.drag_coefficient)
    zeros = dict.fromkeys(("Ixy", "Iyz", "Ixz", "k_d", "k_z", "k_h", "k_flap", "motor_noise_std"), 0.0)
    return {
        "mass": vehicle.mass,
        "num_rotors": 4,
        "rotor_pos": positions,
        "rotor_directions": np.asarray(vehicle.rotor_spin),
        "rI": np.zeros(3),
        "k_eta": vehicle.thrust_coefficient,
        "k_m": vehicle.torque_coefficient,
        "tau_m": vehicle.motor_time_constant,
        "rotor_speed_min": vehicle.rotor_speed_min,
        "rotor_speed_max": vehicle.rotor_speed_max,
        "k_w": 1.0,
        "k_v": 10.0,
        # rotorpy's 310 and 57 are for every axis; yaw has little authority here, and without feed-forward of the rates
        # the attitude lags by kd / kp, so it has to be stiff. Chosen by hand.
        "kp_att": np.array([600.0, 600.0, 15.0]),
        "kd_att": np.array([35.0, 35.0, 7.0]),
        **inertia,
        **drag,
        **zeros,
    }


def fly(vehicle: Vehicle, spline: PiecewisePolynomial, rate: int = 200) -> float:
    """Largest position error [m] along a rest-to-rest ``spline``, controlled at ``rate`` Hz."""
    from rotorpy.controllers.quadrotor_control import SE3Control
    from rotorpy.vehicles.multirotor import Multirotor

    values = parameters(vehicle)
    plant, controller = Multirotor(values), SE3Control(values)
    controller.kp_pos, controller.kd_pos = np.full(3, 18.0), np.full(3, 7.0)
    times = np.arange(int(float(spline.duration) * rate) + 1) / rate
    rows = spline.state(times)
    hover = np.sqrt(vehicle.mass * vehicle.gravity / (4 * vehicle.thrust_coefficient))
    half = 0.5 * rows.yaw[0, 0]
    state = {
        "x": rows.pos[0],
        "v": rows.vel[0],
        "q": np.array([0.0, 0.0, np.sin(half), np.cos(half)]),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": np.full(4, hover),
    }
    worst = 0.0
    for i, time in enumerate(times[:-1]):
        flat = dict(zip(ORDERS, rows.derivatives[i], strict=True))
        flat |= {"yaw": rows.yaw[i, 0], "yaw_dot": rows.yaw[i, 1], "yaw_ddot": rows.yaw[i, 2]}
        state = plant.step(state, controller.update(time, state, flat), 1.0 / rate)
        worst = max(worst, float(np.linalg.norm(state["x"] - rows.pos[i + 1])))
    return worst
