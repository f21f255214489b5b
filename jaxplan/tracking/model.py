"""The vehicle as a MuJoCo model: one free body, four rotors that pull at sites, and nothing to touch.

Drag, noise and the rotors' own inertia are not in the model: ``plant.py`` applies them as generalised forces.

MuJoCo gives a free joint a velocity in the world and rates in the body. About the centre of mass, in principal axes,
its equations of motion then do not depend on the pose:

    diag(m, m, m, J) [dv; dW] = forces - bias(v, W),        bias = [0, 0, m g; W x J W]

So the stages of MJX that depend on the pose alone run once, for the level body at the origin, and a step is what is
left: the body's velocities, the bias by recursive Newton-Euler, the integrator. A batch of flights takes half the time
that it takes with ``mjx.step`` and differs by rounding (docs/decisions/0016-free-body.md); ``complete_body`` is that
step, with which the tests compare.

MJX is imported when a step is traced: where traces are kept (``jaxplan.kept``) none is, and it takes a quarter of the
time of all imports.
"""

import contextlib
import functools
import io
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxplan.arrays import AnyArray, Scalar
from jaxplan.tracking.rates import PHYSICS_RATE
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.rotations import rotation_from_quat

Integrator = Literal["Euler", "RK4"]
"""Semi-implicit Euler, first order, is what flights use; RK4 costs 4 times as much (docs/decisions/0008-plant.md)."""


class Motion(NamedTuple):
    """Position [m, world] and attitude (body to world), velocity [m/s, world] and rates [rad/s, body]."""

    pos: Float[AnyArray, "3"]
    quat_wxyz: Float[AnyArray, "4"]
    vel: Float[AnyArray, "3"]
    body_rates: Float[AnyArray, "3"]


@runtime_checkable
class Body(Protocol):
    """A rigid body that can be stepped."""

    def __call__(
        self, motion: Motion, thrusts: Float[AnyArray, "4"], force: Float[AnyArray, "3"], moment: Float[AnyArray, "3"]
    ) -> Motion:
        """The motion 1/400 s later under rotor ``thrusts`` [N], ``force`` [N, world] and ``moment`` [N m, body]."""


def vehicle_mjcf(vehicle: Vehicle, integrator: Integrator = "Euler") -> str:
    """MJCF text: actuator i takes the thrust [N] of rotor i, and its gear adds the reaction torque about body z.

    A sparse mass matrix is factorised in plain arithmetic, a dense one by LAPACK, flight by flight.
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


def vehicle_body(vehicle: Vehicle, *, float64: bool = False) -> Body:
    """The body of ``vehicle`` under Euler's step, in float32; in float64 only for comparisons in a 64-bit scope (host).

    The function that comes back is pure; ``vmap`` it over flights.
    """
    text, dtype = vehicle_mjcf(vehicle), np.float64 if float64 else np.float32
    inertia = np.concatenate([np.full(3, vehicle.mass), vehicle.inertia]).astype(dtype)
    arms = _moment_arms(vehicle).astype(dtype)

    def step(
        motion: Motion, thrusts: Float[AnyArray, "4"], force: Float[AnyArray, "3"], moment: Float[AnyArray, "3"]
    ) -> Motion:
        mjx, model, level = _level(text, float64)
        up = rotation_from_quat(motion.quat_wxyz)[:, 2]
        lift = thrusts[0] + thrusts[1] + thrusts[2] + thrusts[3]
        turning = jnp.sum(arms * thrusts[None, :], axis=1)
        applied = jnp.concatenate([force + up * lift, moment + turning])
        data = mjx.rne(model, mjx.com_vel(model, _moved(level, motion)))
        return _motion(mjx.euler(model, data.replace(qacc=(applied - data.qfrc_bias) / inertia)))

    return step


def complete_body(vehicle: Vehicle, *, integrator: Integrator = "Euler", float64: bool = False) -> Body:
    """The body of ``vehicle`` under all of ``mjx.step``, its rotors MuJoCo's actuators; for comparisons (host)."""
    text = vehicle_mjcf(vehicle, integrator)

    def step(
        motion: Motion, thrusts: Float[AnyArray, "4"], force: Float[AnyArray, "3"], moment: Float[AnyArray, "3"]
    ) -> Motion:
        mjx, model, level = _level(text, float64)
        data = _moved(level, motion).replace(ctrl=thrusts, qfrc_applied=jnp.concatenate([force, moment]))
        return _motion(mjx.step(model, data))

    return step


@functools.cache
def _level(text: str, float64: bool) -> tuple[Any, Any, Any]:
    """MJX, the model of an MJCF text, and its data at the origin, level; C MuJoCo fills in what follows from that."""
    import mujoco

    # mjx 3.17 prints two lines when its optional Warp back end is absent; the standard output belongs to the caller.
    with contextlib.redirect_stdout(io.StringIO()):
        from mujoco import mjx

    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    with jax.ensure_compile_time_eval(), jax.enable_x64(float64):
        return mjx, mjx.put_model(model, impl="jax"), mjx.put_data(model, data, impl="jax")


def _moment_arms(vehicle: Vehicle) -> Float[np.ndarray, "3 4"]:
    """Moment [N m, body] of each rotor per newton of its thrust."""
    x, y = np.asarray(vehicle.rotor_positions)[:, :2].T
    torque = np.asarray(vehicle.rotor_spin) * vehicle.torque_coefficient / vehicle.thrust_coefficient
    return np.stack([y, -x, torque])


def _moved(data: Any, motion: Motion) -> Any:
    return data.replace(
        qpos=jnp.concatenate([motion.pos, motion.quat_wxyz]), qvel=jnp.concatenate([motion.vel, motion.body_rates])
    )


def _motion(data: Any) -> Motion:
    return Motion(pos=data.qpos[:3], quat_wxyz=data.qpos[3:], vel=data.qvel[:3], body_rates=data.qvel[3:])


def _numbers(values: Float[AnyArray, "..."] | Scalar) -> str:
    """Shortest text that reads back as the same float64."""
    return " ".join(repr(float(value)) for value in np.ravel(np.asarray(values)))
