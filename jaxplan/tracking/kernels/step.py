"""One step of the controller and of the vehicle: ``tracking.indi`` and ``tracking.plant`` without noise, compiled.

The state is one row of numbers, by the slices named here; quaternions are w x y z.
"""

import math
from typing import no_type_check

from jaxplan.tracking.filters import CUTOFF_HZ
from jaxplan.tracking.kernels.attitude import axes_along, axes_of, cross, divided, dot, length, rates_of, turn_between
from jaxplan.tracking.kernels.compiled import inner
from jaxplan.tracking.kernels.rotors import command

POS, VEL, QUAT, RATES, SPEEDS, VALUES, SLOPES, SIZE = 0, 3, 6, 10, 13, 17, 29, 41
"""Where position [m], velocity [m/s], attitude, body rates [rad/s], rotor speeds [rad/s], filtered signals (the rows of
``sensing``) and their rates begin in a state, and how long it is."""
FORCE, THRUST, GYRO, MOMENT = VALUES, VALUES + 3, VALUES + 6, VALUES + 9
"""Where each of the filtered signals begins."""
_OMEGA = 2.0 * math.pi * CUTOFF_HZ


@inner
@no_type_check
def vector(row, begin):
    """Three numbers of a row."""
    return row[begin], row[begin + 1], row[begin + 2]


@inner
@no_type_check
def against_drag(craft, derivatives):
    """Acceleration and jerk that a state asks of the rotors in still air (``flatness.against_drag``)."""
    vel, acc, jerk = vector(derivatives[1], 0), vector(derivatives[2], 0), vector(derivatives[3], 0)
    speed, share = length(vel), craft.drag / craft.mass
    along = divided(dot(vel, acc), speed)
    return (
        (acc[0] + share * speed * vel[0], acc[1] + share * speed * vel[1], acc[2] + share * speed * vel[2]),
        (
            jerk[0] + share * (speed * acc[0] + along * vel[0]),
            jerk[1] + share * (speed * acc[1] + along * vel[1]),
            jerk[2] + share * (speed * acc[2] + along * vel[2]),
        ),
    )


@inner
@no_type_check
def steer(craft, state, derivatives, yaw, work, commands):
    """Write the rotor speeds that the controller commands towards a reference; ``work`` is room for four numbers."""
    gains = craft.gains
    thrust = (
        _wanted(craft, state, derivatives, 0),
        _wanted(craft, state, derivatives, 1),
        _wanted(craft, state, derivatives, 2),
    )
    axes = axes_of(state[QUAT], state[QUAT + 1], state[QUAT + 2], state[QUAT + 3])
    error = turn_between(axes, axes_along(thrust, yaw[0]))
    speeds = state[SPEEDS : SPEEDS + 4]
    lift = craft.thrust_coefficient * (speeds[0] ** 2 + speeds[1] ** 2 + speeds[2] ** 2 + speeds[3] ** 2)
    specific = max(lift / craft.mass, craft.least_thrust)
    _, jerk = against_drag(craft, derivatives)
    rates, ahead = rates_of(axes, specific, jerk, vector(derivatives[4], 0), yaw[1], yaw[2])
    moment = (
        _moment(craft, state, gains[3, 0] * error[0] + gains[4, 0] * (rates[0] - state[GYRO]) + ahead[0], 0),
        _moment(craft, state, gains[3, 1] * error[1] + gains[4, 1] * (rates[1] - state[GYRO + 1]) + ahead[1], 1),
        _moment(craft, state, gains[3, 2] * error[2] + gains[4, 2] * (rates[2] - state[GYRO + 2]) + ahead[2], 2),
    )
    command(craft, moment, craft.mass * length(thrust), speeds, work, commands)


@inner
@no_type_check
def _wanted(craft, state, derivatives, i):
    """One entry of the specific thrust that corrects position, velocity and acceleration."""
    gains = craft.gains
    acc = state[FORCE + i] - (craft.gravity if i == 2 else 0.0)
    return (
        state[THRUST + i]
        + derivatives[2, i]
        + gains[0, i] * (derivatives[0, i] - state[POS + i])
        + gains[1, i] * (derivatives[1, i] - state[VEL + i])
        + gains[2, i] * (derivatives[2, i] - acc)
        - acc
    )


@inner
@no_type_check
def _moment(craft, state, angular_acceleration, i):
    """One entry of the moment that changes the angular acceleration to what is wanted."""
    return state[MOMENT + i] + craft.inertia[i] * (angular_acceleration - state[SLOPES + 6 + i])


@inner
@no_type_check
def advance(craft, state, commands, dt):
    """The vehicle ``dt`` [s] later under held ``commands``, in place."""
    w, x, y, z = state[QUAT], state[QUAT + 1], state[QUAT + 2], state[QUAT + 3]
    up = axes_of(w, x, y, z)[2]
    lift, momentum, change = _turn_rotors(craft, state, commands, dt)
    moment = _rotor_moment(craft, commands)
    reaction = craft.rotor_inertia * change / dt
    vel, turn = vector(state, VEL), vector(state, RATES)
    speed, spinning = length(vel), length(turn)
    bias = cross(turn, (craft.inertia[0] * turn[0], craft.inertia[1] * turn[1], craft.inertia[2] * turn[2]))
    inertial = (momentum * turn[1], -momentum * turn[0], reaction)
    for i in range(3):
        up_again = craft.gravity if i == 2 else 0.0
        pull = up[i] * lift / craft.mass
        acc = pull - craft.drag / craft.mass * speed * vel[i] - up_again
        state[VEL + i] = vel[i] + dt * acc
        state[POS + i] += dt * state[VEL + i]
        torque = moment[i] + inertial[i] - craft.damping * spinning * turn[i] - bias[i]
        state[RATES + i] = turn[i] + dt * torque / craft.inertia[i]
        _filter(state, i, acc + up_again, dt)
        _filter(state, 3 + i, pull, dt)
        _filter(state, 6 + i, state[RATES + i], dt)
        _filter(state, 9 + i, moment[i] + (reaction if i == 2 else 0.0), dt)
    _turn(state, dt)


@inner
@no_type_check
def _turn_rotors(craft, state, commands, dt):
    """The rotors' lag: new speeds in the state, squares of the mean ones in ``commands[4:]``.

    Comes back with the lift [N], and the sums of spin times mean speed (times the rotors' inertia) and of its change.
    """
    held, lift, momentum, change = math.exp(-dt / craft.lag), 0.0, 0.0, 0.0
    for i in range(4):
        before = state[SPEEDS + i]
        after = commands[i] + (before - commands[i]) * held
        mean = 0.5 * (before + after)
        state[SPEEDS + i], commands[4 + i] = after, mean * mean
        lift += craft.arms[3, i] * mean * mean
        momentum += craft.rotor_inertia * craft.spin[i] * mean
        change += craft.spin[i] * (after - before)
    return lift, momentum, change


@inner
@no_type_check
def _rotor_moment(craft, commands):
    """Moment [N m, body] of the squared speeds in ``commands[4:]``."""
    arms = craft.arms
    return (
        arms[0, 0] * commands[4] + arms[0, 1] * commands[5] + arms[0, 2] * commands[6] + arms[0, 3] * commands[7],
        arms[1, 0] * commands[4] + arms[1, 1] * commands[5] + arms[1, 2] * commands[6] + arms[1, 3] * commands[7],
        arms[2, 0] * commands[4] + arms[2, 1] * commands[5] + arms[2, 2] * commands[6] + arms[2, 3] * commands[7],
    )


@inner
@no_type_check
def _filter(state, i, signal, dt):
    """One filtered number after ``dt`` [s] (``tracking.filters``)."""
    gain = dt * _OMEGA**2
    slope = (state[SLOPES + i] + gain * (signal - state[VALUES + i])) / (1.0 + dt * (math.sqrt(2.0) * _OMEGA + gain))
    state[SLOPES + i] = slope
    state[VALUES + i] += dt * slope


@inner
@no_type_check
def _turn(state, dt):
    """The attitude after ``dt`` [s] of its rates."""
    p, q, r = state[RATES], state[RATES + 1], state[RATES + 2]
    rate = length((p, q, r))
    half = 0.5 * dt * rate
    c, s = math.cos(half), divided(math.sin(half), rate)
    w, x, y, z = state[QUAT], state[QUAT + 1], state[QUAT + 2], state[QUAT + 3]
    a, b, d, e = c, s * p, s * q, s * r
    nw, nx = w * a - x * b - y * d - z * e, w * b + x * a + y * e - z * d
    ny, nz = w * d - x * e + y * a + z * b, w * e + x * d - y * b + z * a
    size = math.sqrt(nw * nw + nx * nx + ny * ny + nz * nz)
    state[QUAT], state[QUAT + 1], state[QUAT + 2], state[QUAT + 3] = nw / size, nx / size, ny / size, nz / size
