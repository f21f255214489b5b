"""A trajectory cut into short pieces, compiled (host): how far each may go, and what it asks of the body in its middle.

Polynomials are expanded about the pieces' middles; the body's rates are how its attitude turns around there.
This is for the last look, so it shares nothing with what flies and checks plans elsewhere, vectors and mixing included
(docs/decisions/0025).
"""

import functools
import math
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxplan.planner.kernels.compiled import entry_point, inner, source_digest
from jaxplan.spline import PiecewisePolynomial
from jaxplan.vehicle.params import Vehicle

INSTANT = 1e-3
"""s; over which an attitude is followed for its rates: their error is of the order of its square."""


class Body(NamedTuple):
    """What the vehicle has to give."""

    numbers: Float[np.ndarray, "7"]
    """Drag per mass [1/m], gravity [m/s^2], mass [kg], moments of inertia [kg m^2], the largest thrust per mass."""
    shares: Float[np.ndarray, "4 4"]
    """From moment [N m] and thrust [N] to squared rotor speeds."""
    squared: Float[np.ndarray, "2"]
    """The least and the most of these [rad^2/s^2]."""


class Pieces(NamedTuple):
    """What is left of a trajectory, piece by piece."""

    middle: Float[np.ndarray, "n 3"]
    """[m, world]"""
    moved: Float[np.ndarray, "n"]
    """How far from there the piece may go [m], at most."""
    speed: Float[np.ndarray, "n"]
    """In the middle [m/s]."""
    slowest: Float[np.ndarray, "n"]
    """A bound of the least speed [m/s]; may be negative."""


class Effort(NamedTuple):
    """What pieces ask of the body."""

    thrust: float
    """The largest against drag, as a share of what there is."""
    least: float
    """The smallest against drag, per mass, as a share of gravity."""
    excess: float
    """How long [s] any rotor is out of its range."""


def body_of(vehicle: Vehicle) -> Body:
    """The vehicle's numbers; squared rotor speeds by the inverse of ``jaxplan.vehicle.mixing``."""
    x, y, _ = np.asarray(vehicle.rotor_positions, float).T
    lift, torque = float(vehicle.thrust_coefficient), float(vehicle.torque_coefficient)
    wrench = np.stack([lift * y, -lift * x, torque * np.asarray(vehicle.rotor_spin, float), np.full(4, lift)])
    mass, squared = float(vehicle.mass), np.array([vehicle.rotor_speed_min, vehicle.rotor_speed_max], float) ** 2
    drag, most = float(vehicle.drag_coefficient) / mass, 4.0 * lift * squared[1] / mass
    numbers = np.array([drag, float(vehicle.gravity), mass, *np.asarray(vehicle.inertia, float), most])
    return Body(numbers, np.linalg.inv(wrench), squared)


def cut(spline: PiecewisePolynomial, count: int, since: float = 0.0, body: Body | None = None) -> tuple[Pieces, Effort]:
    """Each segment in ``count`` pieces; those that end before ``since`` [s] are left out, but never the last one.

    Without a ``body`` nothing is asked of it.
    """
    durations, position = (np.array(part, float, order="C") for part in (spline.durations, spline.position))
    yaw = np.zeros((len(durations), max(3, 0 if spline.yaw is None else spline.yaw.shape[1])))
    if spline.yaw is not None:
        yaw[:, : spline.yaw.shape[1]] = spline.yaw
    rows, powers, attitudes = np.empty((len(durations) * count, 6)), np.empty((position.shape[1], 3)), np.empty((3, 12))
    tables = _taylor(count, position.shape[1]), _taylor(count, yaw.shape[1])
    asked = _NOTHING if body is None else body
    begin = min(float(since), float(durations.sum()) - 1e-9)
    left, thrust, least, excess = _compiled()(
        durations, position, yaw, tables, begin, asked, body is not None, (rows, powers, attitudes)
    )
    rows = rows[:left]
    return Pieces(rows[:, :3], rows[:, 3], rows[:, 4], rows[:, 5]), Effort(thrust, least, excess)


_NOTHING = Body(np.zeros(7), np.zeros((4, 4)), np.zeros(2))


@functools.cache
def _taylor(count: int, size: int) -> Float[np.ndarray, "{count} {size} {size}"]:
    """From ascending coefficients in s to those about the middles of ``count`` pieces of [0, 1]."""
    middles = (np.arange(count) + 0.5) / count
    table = np.zeros((count, size, size))
    for power in range(size):
        for order in range(power + 1):
            table[:, order, power] = math.comb(power, order) * middles ** (power - order)
    return table


@runtime_checkable
class _Cut(Protocol):
    def __call__(
        self,
        durations: np.ndarray,
        position: np.ndarray,
        yaw: np.ndarray,
        tables: tuple,
        since: float,
        body: Body,
        asked: bool,
        scratch: tuple,
    ) -> tuple[int, float, float, float]:
        """Writes rows of ``Pieces``; how many, the largest and the smallest thrust, and the excess."""


@functools.cache
def _compiled() -> _Cut:
    version = source_digest()

    @entry_point
    @no_type_check
    def entry(durations, position, yaw, tables, since, body, asked, scratch):
        _ = version
        rows, powers, attitudes = scratch
        count, left, begin, most, least, excess = len(tables[0]), 0, 0.0, 0.0, math.inf, 0.0
        for i in range(len(durations)):
            duration = durations[i]
            for j in range(count):
                if begin + (j + 0.5 + 0.5) / count * duration < since:
                    continue
                _expand(tables[0][j], position[i], 1.0 / duration, powers)
                half = 0.5 * duration / count
                _bound(powers, half, rows[left])
                left += 1
                if asked:
                    turns = _heading(tables[1][j], yaw[i], 1.0 / duration)
                    thrust, outside = _ask(powers, turns, body, attitudes)
                    most, least = max(most, thrust), min(least, thrust)
                    excess += 2.0 * half if outside else 0.0
            begin += duration
        largest, gravity = body.numbers[6], body.numbers[1]
        return left, most / largest if asked else 0.0, least / gravity if asked else 1.0, excess

    return entry  # type: ignore[no-any-return]


@inner
@no_type_check
def _expand(table, coefficients, rate, powers):
    """p^(k) / k! in a middle [m/s^k]."""
    size, scale = len(powers), 1.0
    for order in range(size):
        x = y = z = 0.0
        for power in range(order, size):
            share = table[order, power]
            x += share * coefficients[power, 0]
            y += share * coefficients[power, 1]
            z += share * coefficients[power, 2]
        powers[order, 0], powers[order, 1], powers[order, 2] = scale * x, scale * y, scale * z
        scale *= rate


@inner
@no_type_check
def _bound(powers, half, row):
    """How far a piece may go from its middle, and how slow it may be at most, by the lengths of all powers."""
    moved = changed = speed = 0.0
    reach = 1.0
    for order in range(1, len(powers)):
        x, y, z = powers[order, 0], powers[order, 1], powers[order, 2]
        length = math.sqrt(x * x + y * y + z * z)
        if order == 1:
            speed = length
        else:
            changed += order * length * reach
        reach *= half
        moved += length * reach
    row[0], row[1], row[2] = powers[0, 0], powers[0, 1], powers[0, 2]
    row[3], row[4], row[5] = moved, speed, speed - changed


@inner
@no_type_check
def _heading(table, coefficients, rate):
    """Yaw and its first two derivatives in a middle [rad, SI]."""
    yaw = turn = turning = 0.0
    for power in range(len(coefficients)):
        yaw += table[0, power] * coefficients[power]
        turn += table[1, power] * coefficients[power]
        turning += table[2, power] * coefficients[power]
    return yaw, turn * rate, 2.0 * turning * rate * rate


@inner
@no_type_check
def _ask(powers, turns, body, attitudes):
    """Thrust in the middle per mass [m/s^2], and whether any rotor is out of its range."""
    mass, inertia_x, inertia_y, inertia_z = body.numbers[2:6]
    _attitude(powers, turns, body.numbers, -INSTANT, attitudes[0])
    thrust = _attitude(powers, turns, body.numbers, 0.0, attitudes[1])
    _attitude(powers, turns, body.numbers, INSTANT, attitudes[2])
    first, second = _turned(attitudes[0], attitudes[1]), _turned(attitudes[1], attitudes[2])
    rate, width = 0.5 / INSTANT, 1.0 / INSTANT**2
    p, q, r = rate * (first[0] + second[0]), rate * (first[1] + second[1]), rate * (first[2] + second[2])
    x = inertia_x * width * (second[0] - first[0]) + (inertia_z - inertia_y) * q * r
    y = inertia_y * width * (second[1] - first[1]) + (inertia_x - inertia_z) * r * p
    z = inertia_z * width * (second[2] - first[2]) + (inertia_y - inertia_x) * p * q
    outside = False
    for rotor in range(4):
        share = body.shares[rotor]
        squared = share[0] * x + share[1] * y + share[2] * z + share[3] * mass * thrust
        outside = outside or squared < body.squared[0] or squared > body.squared[1]
    return thrust, outside


@inner
@no_type_check
def _attitude(powers, turns, numbers, time, attitude):
    """Write the axes of the body, forward, left and up, so long [s] after a middle; the thrust per mass [m/s^2]."""
    speed = 0.0
    for axis in range(3):
        acceleration, jerk = 2.0 * powers[2, axis], 6.0 * powers[3, axis]
        moved = powers[1, axis] + time * acceleration + 0.5 * time * time * jerk
        attitude[axis], speed = moved, speed + moved * moved
    drag = numbers[0] * math.sqrt(speed)
    for axis in range(3):
        acceleration, jerk, snap = 2.0 * powers[2, axis], 6.0 * powers[3, axis], 24.0 * powers[4, axis]
        force = acceleration + time * jerk + 0.5 * time * time * snap + drag * attitude[axis]
        attitude[6 + axis] = force + (numbers[1] if axis == 2 else 0.0)
    thrust = _normalised(attitude, 6)
    yaw = turns[0] + time * turns[1] + 0.5 * time * time * turns[2]
    aside_x, aside_y = -math.sin(yaw), math.cos(yaw)
    x, y, z = attitude[6], attitude[7], attitude[8]
    attitude[0], attitude[1], attitude[2] = aside_y * z, -aside_x * z, aside_x * y - aside_y * x
    _normalised(attitude, 0)
    u, v, w = attitude[0], attitude[1], attitude[2]
    attitude[3], attitude[4], attitude[5] = y * w - z * v, z * u - x * w, x * v - y * u
    return thrust


@inner
@no_type_check
def _normalised(attitude, first):
    """Make three numbers a direction; how long they were."""
    x, y, z = attitude[first], attitude[first + 1], attitude[first + 2]
    length = math.sqrt(x * x + y * y + z * z)
    scale = 1.0 / max(length, 1e-12)
    attitude[first], attitude[first + 1], attitude[first + 2] = scale * x, scale * y, scale * z
    return length


@inner
@no_type_check
def _turned(one, other):
    """The small rotation [rad, body] from one attitude to the next."""
    return (
        0.5 * (_dot(one, 6, other, 3) - _dot(one, 3, other, 6)),
        0.5 * (_dot(one, 0, other, 6) - _dot(one, 6, other, 0)),
        0.5 * (_dot(one, 3, other, 0) - _dot(one, 0, other, 3)),
    )


@inner
@no_type_check
def _dot(one, i, other, j):
    return one[i] * other[j] + one[i + 1] * other[j + 1] + one[i + 2] * other[j + 2]
