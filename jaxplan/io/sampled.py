"""A trajectory as samples at an even rate: tables of setpoints, and poses (host, NumPy)."""

import jax
import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.spline import PiecewisePolynomial
from jaxplan.vehicle.flatness import attitude_from
from jaxplan.vehicle.rotations import quat_from_rotation
from jaxplan.vehicle.thrust import STANDARD_GRAVITY

SETPOINTS = ("t", "x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az", "jx", "jy", "jz", "yaw", "yaw_rate")
"""Columns of sampled setpoints: s, m to m/s^3, rad, rad/s."""
MOST_SAMPLES = 1_000_000
"""In a file."""


def sample_times(spline: PiecewisePolynomial, rate: float, name: str) -> Float[np.ndarray, "n"]:
    """Instants [s] at an even rate [Hz] from 0 on, and the end. ``InputError`` for more than ``MOST_SAMPLES``."""
    duration = float(spline.duration)
    if not duration * rate <= MOST_SAMPLES:
        raise InputError(
            f"{name}: have {duration:g} s at {rate:g} a second, want at most {MOST_SAMPLES} samples; give a smaller "
            "--rate"
        )
    return np.append(np.arange(int(np.ceil(duration * rate - 1e-9))) / rate, duration)


def setpoint_table(spline: PiecewisePolynomial, times: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n 15"]:
    """The columns ``SETPOINTS`` at ``times`` [s]."""
    values = [np.asarray(spline.evaluate(times, derivative)) for derivative in range(4)]
    return np.hstack([times[:, None], *(value[:, :3] for value in values), values[0][:, 3:], values[1][:, 3:]])


def attitudes(spline: PiecewisePolynomial, times: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n 4"]:
    """The attitude (FLU to world, wxyz) that flatness demands along a z-up trajectory, without drag."""
    with jax.enable_x64(True):
        force = np.asarray(spline.evaluate(times, 2))[:, :3] + np.array([0.0, 0.0, STANDARD_GRAVITY])
        rotation = jax.vmap(attitude_from)(force, np.asarray(spline.evaluate(times))[:, 3])
        return np.asarray(jax.vmap(quat_from_rotation)(rotation))


def north_east_down_quat(quat_wxyz: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 4"]:
    """FLU to ENU attitudes as FRD to NED ones; w stays above 0 or becomes so."""
    w, x, y, z = np.asarray(quat_wxyz, dtype=float).T
    # Half a turn about east-north's diagonal on the left, about forward on the right.
    turned = np.stack([w + z, x + y, x - y, w - z], axis=1) / np.sqrt(2.0)
    return np.where(turned[:, :1] < 0.0, -turned, turned)
