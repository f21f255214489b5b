"""What a flat state asks of the body, and its derivatives: ``margins.body_demand`` and ``body_slopes``, compiled.

The rotors' wrench depends on eight numbers: the thrust c, the parts of jerk and snap along the body's axes, and the
upward parts of b_y and b_z. Written out is how it changes with them; how they change with force, jerk and snap follows
from how the axes turn.
"""

import math
from typing import no_type_check

from jaxplan.optimizer.kernels.compiled import inner
from jaxplan.tracking.kernels.attitude import axes_along, cross, divided, dot, length, rates_of
from jaxplan.tracking.kernels.step import against_drag, vector

NUMBERS = 13
"""Of ``body_demand``."""


@inner
@no_type_check
def demand(case, state, numbers):
    """Write the numbers of ``body_demand``; ``state`` is position to snap."""
    craft, jerk, snap = case.craft, vector(state[3], 0), vector(state[4], 0)
    force = state[2, 0], state[2, 1], state[2, 2] + craft.gravity
    _aloft(case, force, jerk, snap, numbers, 0)
    acc, jerk = against_drag(craft, state)
    force = acc[0], acc[1], acc[2] + craft.gravity
    _aloft(case, force, jerk, snap, numbers, 6)
    across, square = cross(force, jerk), dot(force, force)
    numbers[12] = divided(dot(across, across), square * square) / (case.turning * case.turning)


@inner
@no_type_check
def _aloft(case, force, jerk, snap, numbers, begin):
    """Rotors, thrust and nose for a specific force."""
    craft, inertia = case.craft, case.craft.inertia
    thrust, axes = length(force), axes_along(force, case.yaw)
    rates, turning = rates_of(axes, thrust, jerk, snap, 0.0, 0.0)
    bias = cross(rates, (inertia[0] * rates[0], inertia[1] * rates[1], inertia[2] * rates[2]))
    moment = inertia[0] * turning[0] + bias[0], inertia[1] * turning[1] + bias[1], inertia[2] * turning[2] + bias[2]
    for rotor in range(4):
        numbers[begin + rotor] = _rotor(craft, rotor, moment, thrust)
    numbers[begin + 4] = axes[2][2]
    numbers[begin + 5] = math.cos(case.yaw) * axes[0][0] + math.sin(case.yaw) * axes[0][1]


@inner
@no_type_check
def _rotor(craft, rotor, moment, thrust):
    """Squared speed of a rotor, as a share of the fastest; or its change with theirs."""
    row = craft.mixer[rotor]
    return (dot(row, moment) + row[3] * craft.mass * thrust) / (craft.fastest * craft.fastest)


@inner
@no_type_check
def demand_slopes(case, state, slopes):
    """Write the derivatives of ``demand`` by velocity to snap (4, 3), a column a number: ``slopes`` is (4, 3, 16)."""
    craft, vel, acc, snap = case.craft, vector(state[1], 0), vector(state[2], 0), vector(state[4], 0)
    force = acc[0], acc[1], acc[2] + craft.gravity
    slopes[:] = 0.0
    _aloft_slopes(case, force, vector(state[3], 0), snap, slopes, 0)
    bare, jerk = against_drag(craft, state)
    force = bare[0], bare[1], bare[2] + craft.gravity
    _aloft_slopes(case, force, jerk, snap, slopes, 6)
    _turning_slopes(case, force, jerk, slopes)
    speed, share = length(vel), craft.drag / craft.mass
    scale = divided(1.0, speed)
    along = scale * dot(vel, acc)
    ahead = scale * vel[0], scale * vel[1], scale * vel[2]
    for number in range(6, NUMBERS):
        by_force = slopes[1, 0, number], slopes[1, 1, number], slopes[1, 2, number]
        by_jerk = slopes[2, 0, number], slopes[2, 1, number], slopes[2, 2, number]
        f, g, a = dot(vel, by_force), dot(vel, by_jerk), dot(acc, by_jerk)
        for i in range(3):
            bend = scale * (acc[i] - along * ahead[i]) * g
            by_rate = ahead[i] * a + along * by_jerk[i] + bend
            slopes[0, i, number] = share * (speed * by_force[i] + ahead[i] * f + by_rate)
            slopes[1, i, number] += share * (speed * by_jerk[i] + ahead[i] * g)


@inner
@no_type_check
def _turning_slopes(case, force, jerk, slopes):
    """Of the squared rate at which the thrust turns, by force and jerk."""
    across, square = cross(force, jerk), dot(force, force)
    scale = divided(1.0, square * square) / (case.turning * case.turning)
    by_force, by_jerk = cross(jerk, across), cross(across, force)
    shrinks = 2.0 * divided(dot(across, across), square)
    for i in range(3):
        slopes[1, i, 12] = 2.0 * scale * (by_force[i] - shrinks * force[i])
        slopes[2, i, 12] = 2.0 * scale * by_jerk[i]


@inner
@no_type_check
def _aloft_slopes(case, force, jerk, snap, slopes, begin):
    """Of ``_aloft``, by force, jerk and snap."""
    thrust, axes = length(force), axes_along(force, case.yaw)
    x, y, z = axes
    rates, turning = rates_of(axes, thrust, jerk, snap, 0.0, 0.0)
    heading = math.cos(case.yaw), math.sin(case.yaw), 0.0
    left = -heading[1], heading[0], 0.0
    stretch, slant = divided(1.0, thrust), divided(1.0, length(cross(left, z)))
    for i in range(3):
        e = (1.0 if i == 0 else 0.0), (1.0 if i == 1 else 0.0), (1.0 if i == 2 else 0.0)
        dz = stretch * (e[0] - z[i] * z[0]), stretch * (e[1] - z[i] * z[1]), stretch * (e[2] - z[i] * z[2])
        turned = cross(left, dz)
        part = dot(x, turned)
        dx = slant * (turned[0] - part * x[0]), slant * (turned[1] - part * x[1]), slant * (turned[2] - part * x[2])
        one, other = cross(dz, x), cross(z, dx)
        dy = one[0] + other[0], one[1] + other[1], one[2] + other[2]
        jerks, snaps = (dot(dx, jerk), dot(dy, jerk), dot(dz, jerk)), (dot(dx, snap), dot(dy, snap))
        moment = _moment_change(case.craft, axes, thrust, rates, turning, dot(z, jerk), z[i], jerks, snaps, dy[2], dz[2])
        _enter(case.craft, slopes[1, i], begin, moment, z[i])
        slopes[1, i, begin + 4], slopes[1, i, begin + 5] = dz[2], dot(heading, dx)
        jerks = x[i], y[i], z[i]
        moment = _moment_change(case.craft, axes, thrust, rates, turning, dot(z, jerk), 0.0, jerks, (0.0, 0.0), 0.0, 0.0)
        _enter(case.craft, slopes[2, i], begin, moment, 0.0)
        inertia, first, second = case.craft.inertia, -stretch * y[i], stretch * x[i]
        moment = inertia[0] * first, inertia[1] * second, -inertia[2] * divided(y[2] * second, z[2])
        _enter(case.craft, slopes[3, i], begin, moment, 0.0)


@inner
@no_type_check
def _enter(craft, row, begin, moment, thrust):
    """The four rotors' part of a row."""
    for rotor in range(4):
        row[begin + rotor] = _rotor(craft, rotor, moment, thrust)


@inner
@no_type_check
def _moment_change(craft, axes, thrust, rates, turning, thrust_rate, dc, jerks, snaps, dy3, dz3):
    """Change of the moment with thrust, parts of jerk and snap along the axes, and upward parts of b_y and b_z.

    The derivative of ``attitude.rates_of`` with a held heading, term by term.
    """
    y3, z3, inertia = axes[1][2], axes[2][2], craft.inertia
    p, q, r = rates
    per_thrust, per_up = divided(1.0, thrust), divided(1.0, z3)
    dp = -per_thrust * (jerks[1] + p * dc)
    dq = per_thrust * (jerks[0] - q * dc)
    dr = -per_up * (dy3 * q + y3 * dq + r * dz3)
    first = turning[0] - q * r
    da = -per_thrust * (snaps[1] + 2.0 * (jerks[2] * p + thrust_rate * dp) + first * dc) + dq * r + q * dr
    first = turning[1] + p * r
    db = per_thrust * (snaps[0] - 2.0 * (jerks[2] * q + thrust_rate * dq) - first * dc) - dp * r - p * dr
    drift = dp * (q * z3 - r * y3) + p * (dq * z3 + q * dz3 - dr * y3 - r * dy3)
    dg = -per_up * (drift + dy3 * turning[1] + y3 * db + turning[2] * dz3)
    return (
        inertia[0] * da + (inertia[2] - inertia[1]) * (dq * r + q * dr),
        inertia[1] * db + (inertia[0] - inertia[2]) * (dp * r + p * dr),
        inertia[2] * dg + (inertia[1] - inertia[0]) * (dp * q + p * dq),
    )
