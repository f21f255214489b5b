"""Reference trajectories with exact derivatives, in NumPy float64 (tests only)."""

import math

import numpy as np

from jaxplan.spline import FlatState


def sine_derivatives(amplitude: float, rate: float, t: np.ndarray, phase: float = 0.0) -> np.ndarray:
    """amplitude * sin(rate t + phase) and its first four derivatives, shape (len(t), 5)."""
    orders = np.arange(5)
    return amplitude * rate**orders * np.sin(rate * t[:, None] + phase + orders * np.pi / 2)


def figure_eight(t: np.ndarray, top_speed: float, size: float = 2.0, along_heading: bool = False) -> FlatState:
    """A lemniscate x = size sin(w t), y = size/2 sin(2 w t), z = 1 + 0.2 sin(w t) whose top speed is ``top_speed`` m/s.

    The top speed is that of the centre: |v|^2 = w^2 size^2 (1 + 1 + 0.01) there.
    """
    rate = top_speed / (size * math.sqrt(2.0 + (0.2 / size) ** 2))
    x, y = sine_derivatives(size, rate, t), sine_derivatives(size / 2, 2 * rate, t)
    z = sine_derivatives(0.2, rate, t)
    z[:, 0] += 1.0
    yaw = heading(x, y) if along_heading else np.tile([0.3, 0.0, 0.0], (len(t), 1))
    return FlatState(derivatives=np.stack([x, y, z], axis=-1), yaw=yaw)


def heading(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Direction of the horizontal velocity, unwrapped, with two derivatives, from (n, 5) derivative tables."""
    speed2 = x[:, 1] ** 2 + y[:, 1] ** 2
    turn = x[:, 1] * y[:, 2] - y[:, 1] * x[:, 2]
    turn_rate = x[:, 1] * y[:, 3] - y[:, 1] * x[:, 3]
    speed2_rate = 2.0 * (x[:, 1] * x[:, 2] + y[:, 1] * y[:, 2])
    angle = np.unwrap(np.arctan2(y[:, 1], x[:, 1]))
    return np.stack([angle, turn / speed2, turn_rate / speed2 - turn * speed2_rate / speed2**2], axis=1)


def hop(t: np.ndarray, distance: float, duration: float) -> FlatState:
    """Rest to rest along x: the minimum-snap polynomial 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7; at rest afterwards."""
    polynomial = np.polynomial.Polynomial([0, 0, 0, 0, 35.0, -84.0, 70.0, -20.0])
    s = np.minimum(t / duration, 1.0)
    derivatives = np.zeros((len(t), 5, 3))
    for order in range(5):
        value = polynomial.deriv(order)(s) if order else polynomial(s)
        inside = (t <= duration) | (order == 0)
        derivatives[:, order, 0] = np.where(inside, distance * value / duration**order, 0.0)
    return FlatState(derivatives=derivatives, yaw=np.zeros((len(t), 3)))


def sagging(t: np.ndarray, thrust: float, hold: float, ramp: float = 0.25) -> FlatState:
    """A climb braked by gravity: the thrust [m/s^2, without drag] is taken back to so much, held and given back.

    Each takes ``ramp`` s, by 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7; the climb is as fast at first as the fall at the end.
    """
    polynomial = np.polynomial.Polynomial([0, 0, 0, 0, 35.0, -84.0, 70.0, -20.0])
    derivatives, lacking = np.zeros((len(t), 5, 3)), 9.81 - thrust
    derivatives[:, 0, 2] = derivatives[:, 1, 2] = 0.5 * lacking * (ramp + hold)
    derivatives[:, 0, 2] *= t
    for begin, sign in ((0.0, -1.0), (ramp + hold, 1.0)):
        since = t - begin
        s, over = np.clip(since / ramp, 0.0, 1.0), np.maximum(since - ramp, 0.0)
        for order in range(5):
            within = polynomial.deriv(order - 2) if order > 2 else polynomial.integ(2 - order)
            part = ramp ** (2 - order) * within(s)
            if order == 0:
                part = part + ramp * polynomial.integ(1)(1.0) * over + 0.5 * over**2
            elif order == 1:
                part = part + over
            derivatives[:, order, 2] += sign * lacking * part
    return FlatState(derivatives=derivatives, yaw=np.zeros((len(t), 3)))


def helix(t: np.ndarray, radius: float, rate: float, climb: float, yaw_rate: float) -> FlatState:
    """A circle of ``radius`` m at ``rate`` rad/s, climbing, while the yaw sways: 0.5 + sin(yaw_rate t)."""
    x, y = sine_derivatives(radius, rate, t, np.pi / 2), sine_derivatives(radius, rate, t)
    z = np.zeros_like(x)
    z[:, 0], z[:, 1] = climb * t, climb
    yaw = sine_derivatives(1.0, yaw_rate, t)[:, :3]
    yaw[:, 0] += 0.5
    return FlatState(derivatives=np.stack([x, y, z], axis=-1), yaw=yaw)
