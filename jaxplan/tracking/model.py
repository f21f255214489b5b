"""The vehicle as a MuJoCo model: one free body, four rotors that pull at sites, and nothing to touch.

Drag, noise and the rotors' own inertia are not in the model: ``plant.py`` applies them as generalised forces.
"""

import contextlib
import io
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from jaxplan.vehicle.params import Vehicle

# mjx 3.17 prints two lines when its optional Warp back end is absent; the standard output belongs to the caller.
with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx

PHYSICS_RATE = 400
"""Physics steps per second, as in the MFRL evaluation."""


Integrator = Literal["Euler", "RK4"]
"""Semi-implicit Euler, first order, is what flights use; RK4 costs 4 times as much (docs/decisions/0008-plant.md)."""


class Body(NamedTuple):
    """The rigid body that MJX steps."""

    model: mjx.Model
    blank: mjx.Data


class Motion(NamedTuple):
    """Position [m, world] and attitude (body to world), velocity [m/s, world] and rates [rad/s, body]."""

    pos: Float[Array, "3"]
    quat_wxyz: Float[Array, "4"]
    vel: Float[Array, "3"]
    body_rates: Float[Array, "3"]


def vehicle_mjcf(vehicle: Vehicle, integrator: Integrator = "Euler") -> str:
    """MJCF text: actuator i takes the thrust [N] of rotor i, and its gear adds the reaction torque about body z.

    A sparse mass matrix is factorised in plain arithmetic, a dense one by LAPACK, lane by lane.
    """
    torque_per_thrust = np.asarray(vehicle.rotor_spin) * vehicle.torque_coefficient / vehicle.thrust_coefficient
    sites = [f'<site name="rotor{i}" pos="{_numbers(pos)}"/>' for i, pos in enumerate(vehicle.rotor_positions)]
    actuators = [
        f'<general name="rotor{i}" site="rotor{i}" gear="0 0 1 0 0 {_numbers(arm)}"/>'
        for i, arm in enumerate(torque_per_thrust)
    ]
    return f"""<mujoco model="vehicle">
  <option timestep="{1.0 / PHYSICS_RATE!r}" gravity="0 0 {-float(vehicle.gravity)!r}" integrator="{integrator}"
    jacobian="sparse">
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


def vehicle_body(vehicle: Vehicle, *, integrator: Integrator = "Euler", float64: bool = False) -> Body:
    """The compiled model and a blank state of it, in float32; in float64 only for comparisons in a 64-bit scope."""
    model = mujoco.MjModel.from_xml_string(vehicle_mjcf(vehicle, integrator))
    with jax.enable_x64(float64):
        return Body(mjx.put_model(model, impl="jax"), mjx.make_data(model, impl="jax"))


def step_body(
    body: Body, motion: Motion, thrusts: Float[Array, "4"], force: Float[Array, "3"], moment: Float[Array, "3"]
) -> Motion:
    """One MJX step of 1/400 s under rotor ``thrusts`` [N], an added ``force`` [N, world] and ``moment`` [N m, body]."""
    data = body.blank.replace(
        qpos=jnp.concatenate([motion.pos, motion.quat_wxyz]),
        qvel=jnp.concatenate([motion.vel, motion.body_rates]),
        ctrl=thrusts,
        qfrc_applied=jnp.concatenate([force, moment]),
    )
    data = mjx.step(body.model, data)
    return Motion(pos=data.qpos[:3], quat_wxyz=data.qpos[3:], vel=data.qvel[:3], body_rates=data.qvel[3:])


def _numbers(values: np.ndarray | float) -> str:
    """Shortest text that reads back as the same float64."""
    return " ".join(repr(float(value)) for value in np.ravel(values))
