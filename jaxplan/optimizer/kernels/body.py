"""What a flat state asks of the body, and its derivatives: ``margins.body_demand`` and ``body_slopes``, compiled.

The rotors' wrench depends on eight numbers: the thrust c, the parts of jerk and snap along the body's axes, and the
upward parts of b_y and b_z. Written out is how it changes with them; how they change with force, jerk and snap follows
from how the axes turn.
"""

import math
from typing import no_type_check

from jaxplan.optimizer.kernels.compiled import inner, within
from jaxplan.tracking.kernels.attitude import axes_along, cross, divided, dot, length, rates_of
from jaxplan.tracking.kernels.step import against_drag, vector

NUMBERS = 13
"""Of ``body_demand``."""


@inner
@no_type_check
def demand(case, state, numbers):
    """Write the numbers of ``body_demand``; ``state`` is position to snap."""
    for drag in range(2):
        force, jerk = _load(case, state, drag)
        _aloft(case, force, jerk, vector(state[4], 0), numbers, 6 * drag)
        if drag:
            numbers[12] = _turning(case, force, jerk)


@inner
@no_type_check
def _load(case, state, drag):
    """Specific force and its rate, without drag or against it."""
    acc, jerk = vector(state[2], 0), vector(state[3], 0)
    if drag:
        acc, jerk = against_drag(case.craft, state)
    return (acc[0], acc[1], acc[2] + case.craft.gravity), jerk


@inner
@no_type_check
def _aloft(case, force, jerk, snap, numbers, begin):
    """Write rotors, thrust and nose for a specific force; how it is flown: thrust, axes, rates and their change."""
    inertia = case.craft.inertia
    thrust, axes = length(force), axes_along(force, case.yaw)
    rates, turning = rates_of(axes, thrust, jerk, snap, 0.0, 0.0)
    bias = cross(rates, (inertia[0] * rates[0], inertia[1] * rates[1], inertia[2] * rates[2]))
    moment = inertia[0] * turning[0] + bias[0], inertia[1] * turning[1] + bias[1], inertia[2] * turning[2] + bias[2]
    _enter(case.mixer, numbers, begin, moment, thrust)
    numbers[begin + 4] = axes[2][2]
    numbers[begin + 5] = math.cos(case.yaw) * axes[0][0] + math.sin(case.yaw) * axes[0][1]
    return thrust, axes, rates, turning


@inner
@no_type_check
def _rotor(mixer, rotor, moment, thrust):
    """Squared speed of a rotor, as a share of the fastest; or its change with theirs."""
    row = mixer[rotor]
    return dot(row, moment) + row[3] * thrust


@inner
@no_type_check
def demand_slopes(case, state, numbers, slopes):
    """The same with its derivatives by velocity to snap (4, 3), a column a number: ``slopes`` is (4, 3, 16)."""
    slopes[:] = 0.0
    for drag in range(2):
        force, jerk = _load(case, state, drag)
        _aloft_slopes(case, force, jerk, vector(state[4], 0), numbers, slopes, 6 * drag)
    _turning_slopes(case, force, jerk, numbers, slopes)
    vel, acc, share = vector(state[1], 0), vector(state[2], 0), case.craft.drag / case.craft.mass
    speed = length(vel)
    scale = divided(1.0, speed)
    along = scale * dot(vel, acc)
    ahead = scale * vel[0], scale * vel[1], scale * vel[2]
    for number in range(6, NUMBERS):
        by_force = slopes[1, 0, number], slopes[1, 1, number], slopes[1, 2, number]
        by_jerk = slopes[2, 0, number], slopes[2, 1, number], slopes[2, 2, number]
        f, g, a = dot(vel, by_force), dot(vel, by_jerk), dot(acc, by_jerk)
        for i in range(3):
            by_rate = ahead[i] * a + along * by_jerk[i] + scale * (acc[i] - along * ahead[i]) * g
            slopes[0, i, number] = share * (speed * by_force[i] + ahead[i] * f + by_rate)
            slopes[1, i, number] += share * (speed * by_jerk[i] + ahead[i] * g)


@inner
@no_type_check
def _turning(case, force, jerk):
    """Squared rate at which the thrust turns, as a share of the fastest."""
    across, square = cross(force, jerk), dot(force, force)
    return divided(dot(across, across), square * square) / (case.turning * case.turning)


@inner
@no_type_check
def _turning_slopes(case, force, jerk, numbers, slopes):
    """The squared rate at which the thrust turns, and its derivatives by force and jerk."""
    numbers[12] = _turning(case, force, jerk)
    across, square = cross(force, jerk), dot(force, force)
    scale = divided(1.0, square * square) / (case.turning * case.turning)
    by_force, by_jerk = cross(jerk, across), cross(across, force)
    shrinks = 2.0 * divided(dot(across, across), square)
    for i in range(3):
        slopes[1, i, 12] = 2.0 * scale * (by_force[i] - shrinks * force[i])
        slopes[2, i, 12] = 2.0 * scale * by_jerk[i]


@within
@no_type_check
def _aloft_slopes(case, force, jerk, snap, numbers, slopes, begin):
    """Of ``_aloft``, by force, jerk and snap, one entry of them after another."""
    thrust, axes, rates, turning = _aloft(case, force, jerk, snap, numbers, begin)
    x, y, z = axes
    heading = math.cos(case.yaw), math.sin(case.yaw), 0.0
    left = -heading[1], heading[0], 0.0
    stretch, slant = divided(1.0, thrust), divided(1.0, length(cross(left, z)))
    per, thrust_rate = (stretch, divided(1.0, z[2])), dot(z, jerk)
    for entry in range(9):
        i = entry % 3
        dx = dy = dz = 0.0, 0.0, 0.0
        dc, jerks, snaps = 0.0, (0.0, 0.0, 0.0), (x[i], y[i])
        if entry < 3:
            dz = (
                stretch * ((i == 0) - z[i] * z[0]),
                stretch * ((i == 1) - z[i] * z[1]),
                stretch * ((i == 2) - z[i] * z[2]),
            )
            turned = cross(left, dz)
            part = dot(x, turned)
            dx = slant * (turned[0] - part * x[0]), slant * (turned[1] - part * x[1]), slant * (turned[2] - part * x[2])
            one, other = cross(dz, x), cross(z, dx)
            dy = one[0] + other[0], one[1] + other[1], one[2] + other[2]
            dc, jerks, snaps = z[i], (dot(dx, jerk), dot(dy, jerk), dot(dz, jerk)), (dot(dx, snap), dot(dy, snap))
        elif entry < 6:
            jerks, snaps = (x[i], y[i], z[i]), (0.0, 0.0)
        moment = _moment_change(
            case.craft.inertia, axes, per, rates, turning, thrust_rate, dc, jerks, snaps, dy[2], dz[2]
        )
        row = slopes[1 + entry // 3, i]
        _enter(case.mixer, row, begin, moment, dc)
        row[begin + 4], row[begin + 5] = dz[2], dot(heading, dx)


@inner
@no_type_check
def _enter(mixer, row, begin, moment, thrust):
    """The four rotors' part of a row."""
    for rotor in range(4):
        row[begin + rotor] = _rotor(mixer, rotor, moment, thrust)


@inner
@no_type_check
def _moment_change(inertia, axes, per, rates, turning, thrust_rate, dc, jerks, snaps, dy3, dz3):
    """Change of the moment with thrust, parts of jerk and snap along the axes, and upward parts of b_y and b_z.

    The derivative of ``attitude.rates_of`` with a held heading, term by term. ``per``: 1 over thrust and z of b_z.
    """
    y3, z3 = axes[1][2], axes[2][2]
    p, q, r = rates
    per_thrust, per_up = per
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
