"""What decides whether the vehicle can follow a trajectory.

A trajectory (waypoints, initial state and times give it) is looked at at instants evenly spread over its duration. What
is taken there does not change when it is moved or turned about the vertical: thrust, tilt, and how fast thrust, speed
and heading change. Beside these stands the low fidelity, how far the rotors are from their limits, and how
long beyond.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplan.arrays import AnyArray
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.vehicle.limits import thrust_limit_margin
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.thrust import LEAST_THRUST, log_thrust
from jaxplan.vehicle.vectors import dot, length

INSTANTS = 20
MOTION_FEATURES = 12
YAWING = slice(8, 10)
"""Which of them are yaw rate and yaw acceleration,"""
DURATION = 10
"""the duration,"""
MARGIN = 11
"""and the margin, of which the low fidelity is made."""
LOW_FIDELITIES = 2
"""Numbers of ``low_fidelity``."""
SCARCE = 0.2
"""Compressed margin below which a rotor has little left,"""
SHORT = 0.04
"""and the time [s] times margin that counts as none: both arbitrary."""


def motion_features(splines: SplineBatch, vehicle: Vehicle) -> Float[Array, "f p k"]:
    """Features of ``INSTANTS`` instants of each of k trajectories, compressed to the order of 1 (traced; float32).

    Args:
        splines: the trajectories [m, rad, s; world].
        vehicle: its gravity and rotor limits; any precision.
    """
    states = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), splines).states(INSTANTS)
    _, velocity, acceleration, jerk, snap = states.derivatives  # (3, p, k)
    _, yaw_rate, yaw_acceleration = states.yaw
    gravity = jnp.asarray(vehicle.gravity, velocity.dtype)
    force = (acceleration[0], acceleration[1], acceleration[2] + gravity)
    thrust = length(force)
    share = 1.0 / jnp.maximum(thrust, LEAST_THRUST)
    up = [share * entry for entry in force]
    climb, along, along_snap = (dot(vector, up) for vector in (velocity, jerk, snap))
    turning = share * length([jerk[axis] - along * up[axis] for axis in range(3)])
    twisting = share * length([snap[axis] - along_snap * up[axis] for axis in range(3)])
    total = jnp.sum(splines.durations, axis=0).astype(jnp.float32)
    features = [
        log_thrust(thrust),
        up[2],
        _compressed(0.5 * length(velocity)),
        _compressed(0.5 * climb),
        _compressed(0.1 * along),
        _compressed(turning),
        _compressed(0.1 * twisting),
        _compressed(0.02 * along_snap),
        _compressed(yaw_rate),
        _compressed(0.3 * yaw_acceleration),
        jnp.log(jnp.maximum(total, 1e-3))[None] * jnp.ones_like(thrust),
        _compressed(5.0 * thrust_limit_margin(vehicle, states)),
    ]
    return jnp.stack(features)


def low_fidelity(motion: Float[AnyArray, "f p k"]) -> Float[Array, "l k"]:
    """How far the rotors of each trajectory are from their limits, and how far and long beyond, on a logarithmic scale.

    The first is negative where a rotor would have to exceed its limits, which it may for an instant.
    """
    duration = jnp.exp(motion[DURATION, 0])
    lacking = jnp.mean(jnp.maximum(SCARCE - motion[MARGIN], 0.0), axis=0)
    return jnp.stack([jnp.min(motion[MARGIN], axis=0), jnp.log(duration * lacking + SHORT)])


def summarise(motion: Float[AnyArray, "f p k"]) -> Float[Array, "s k"]:
    """What each trajectory comes to: the largest, the least and the mean of every feature, and its duration.

    Turning left counts as turning right. The low fidelity is left out.
    """
    turning = jnp.abs(motion[YAWING])
    seen = jnp.concatenate([motion[: YAWING.start], turning])
    return jnp.concatenate([jnp.max(seen, axis=1), jnp.min(seen, axis=1), jnp.mean(seen, axis=1), motion[DURATION, :1]])


def _compressed(x: Float[AnyArray, "*shape"]) -> Float[AnyArray, "*shape"]:
    """x where it is small, of the order of its fourth root where it is large; cheaper than a logarithm."""
    root = jnp.sqrt(1.0 + jnp.abs(x))
    return x / (root * jnp.sqrt(root))
