"""The vehicle as a MuJoCo model: one free body, four rotors that pull at sites, and nothing to touch.

Drag, noise and the rotors' own inertia are not in the model: ``plant.py`` applies them as generalised forces.
"""

import jax
import mujoco
import numpy as np
from mujoco import mjx

from jaxplan.vehicle.params import Vehicle

PHYSICS_RATE = 400
"""Physics steps per second, as in the MFRL evaluation."""


def vehicle_mjcf(vehicle: Vehicle) -> str:
    """MJCF text: actuator i takes the thrust [N] of rotor i, and its gear adds the reaction torque about body z."""
    torque_per_thrust = np.asarray(vehicle.rotor_spin) * vehicle.torque_coefficient / vehicle.thrust_coefficient
    sites = [f'<site name="rotor{i}" pos="{_numbers(pos)}"/>' for i, pos in enumerate(vehicle.rotor_positions)]
    actuators = [
        f'<general name="rotor{i}" site="rotor{i}" gear="0 0 1 0 0 {_numbers(arm)}"/>'
        for i, arm in enumerate(torque_per_thrust)
    ]
    return f"""<mujoco model="vehicle">
  <option timestep="{1.0 / PHYSICS_RATE!r}" gravity="0 0 {-float(vehicle.gravity)!r}" integrator="Euler">
    <flag contact="disable" constraint="disable" eulerdamp="disable"/>
  </option>
  <worldbody>
    <body name="vehicle">
      <freejoint/>
      <inertial pos="0 0 0" mass="{_numbers(vehicle.mass)}" diaginertia="{_numbers(vehicle.inertia)}"/>
      {" ".join(sites)}
    </body>
  </worldbody>
  <actuator>{" ".join(actuators)}</actuator>
</mujoco>
"""


def vehicle_model(vehicle: Vehicle) -> tuple[mjx.Model, mjx.Data]:
    """The compiled model and a blank state of it, in float32."""
    model = mujoco.MjModel.from_xml_string(vehicle_mjcf(vehicle))
    with jax.enable_x64(False):
        return mjx.put_model(model, impl="jax"), mjx.make_data(model, impl="jax")


def _numbers(values: np.ndarray | float) -> str:
    """Shortest text that reads back as the same float64."""
    return " ".join(repr(float(value)) for value in np.ravel(values))
