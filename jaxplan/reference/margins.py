"""What a trajectory must keep to, as margins that are positive inside, sampled along all segments.

Rotors: the squared speed of each of the four, as a share of the largest, from its least and from its largest allowed
value; tilt: the upward part of the thrust's direction. Both without drag and against the drag of still air. Places:
exact distances to the nearest obstacle and to every face of the room.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.polynomials import derivative_table
from jaxplan.reference.problem import Task, meeting_time, splines, unflatten
from jaxplan.spline import FlatState
from jaxplan.vehicle.flatness import against_drag, demand_of
from jaxplan.vehicle.mixing import squared_rotor_speeds
from jaxplan.vehicle.params import Vehicle
from jaxplan.world.clearance import clearance

BODY_SAMPLES, PLACE_SAMPLES = 12, 36
"""Instants of a segment at which the body and the distance to obstacles are looked at: at 17 m/s and 0.3 s places are
0.14 m apart. With 12 places vehicles cut the corners of walls."""
MAX_TILT = math.radians(78.5)
"""Of the thrust from the vertical [rad]; beyond, plans flip over and are not tracked."""
SHORTEST, LONGEST = 0.08, 4.0
"""Duration of a segment [s]; shorter ones make the problem ill-conditioned (arbitrary)."""
FARTHEST_STOP = 6.0
"""From the meeting [m] (arbitrary)."""
PER_METRE = 3.0
"""Weight of a metre beside a rotor's whole range: the slack of all margins is the same (arbitrary)."""
_ONCE = np.concatenate([np.eye(4, 5), -np.eye(4, 5), np.eye(1, 5, 4)])
_SIGNS = np.kron(np.eye(2), _ONCE)
"""From ``body_demand`` to its margins: every rotor has two limits."""


class Linearised(NamedTuple):
    """k problems around k points."""

    gradient: Float[Array, "k v"]
    """Of the objective."""
    curvature: Float[Array, "k v"]
    """Diagonal of the objective's Hessian."""
    margins: Float[Array, "k c"]
    jacobian: Float[Array, "k c v"]


class _Samples(NamedTuple):
    """Of each segment, one behind the other."""

    states: Float[Array, "n 5 3 k"]
    """Position to snap [SI, world], flown ``Limits.dilation`` times as fast."""
    places: Float[Array, "p 3 k"]
    """Metres, world."""


def values(task: Task, x: Float[Array, "k v"]) -> tuple[Float[Array, "k"], Float[Array, "k c"]]:
    """Meeting times [s] and margins of k trajectories."""
    found, own = _samples(task, x.T), _bounds(x.T)
    bodies = _each(functools.partial(body_demand, task.vehicle), found.states[:, 1:])
    distances = _each(lambda place: clearance(task.world, place), found.places)
    margins = _margins(task, bodies, distances, found.states[:, 0])
    return meeting_time(unflatten(x.T)), jnp.concatenate([margins, own.T], axis=1)


def linearise(task: Task, x: Float[Array, "k v"]) -> Linearised:
    """The same with derivatives: through the samples, so that each is differentiated by its own 15 numbers only."""
    width, count = x.shape
    directions = jnp.broadcast_to(jnp.eye(count, dtype=x.dtype)[:, :, None], (count, count, width))
    found, push = jax.linearize(functools.partial(_samples, task), x.T)
    pushed = jax.vmap(push)(directions)
    by_state, by_place = jnp.transpose(pushed.states, (1, 4, 2, 3, 0)), jnp.transpose(pushed.places, (1, 3, 2, 0))
    bodies, by_body = _each(_with_jacobian(functools.partial(body_demand, task.vehicle)), found.states[:, 1:])
    distances, slopes = _each(_with_jacobian(lambda place: clearance(task.world, place)), found.places)
    instants, places = len(found.states), len(found.places)
    body = by_body.reshape(instants, width, -1, 12) @ by_state[:, :, 1:].reshape(instants, width, 12, count)
    distance = PER_METRE * (slopes.reshape(places, width, 1, 3) @ by_place)
    walls = PER_METRE * jnp.concatenate([by_state[:, :, 0], -by_state[:, :, 0]], axis=2)
    own, push_own = jax.linearize(_bounds, x.T)
    own_slopes = jnp.transpose(jax.vmap(push_own)(directions), (2, 1, 0))
    rows = [_rows(jnp.asarray(_SIGNS, x.dtype) @ body), _rows(distance), _rows(walls), own_slopes]
    lengthening = _lengthening(x)
    return Linearised(
        gradient=lengthening,
        curvature=lengthening,
        margins=jnp.concatenate([_margins(task, bodies, distances, found.states[:, 0]), own.T], axis=1),
        jacobian=jnp.concatenate(rows, axis=1),
    )


def body_demand(vehicle: Vehicle, derivatives: Float[Array, "4 3"]) -> Float[Array, "10"]:
    """Squared rotor speeds as shares of the largest, and the thrust's upward part; without drag, then against it.

    ``derivatives``: velocity to snap [SI, world], with the heading held at 0.
    """
    rows = jnp.concatenate([jnp.zeros_like(derivatives[:1]), derivatives])
    state = FlatState(derivatives=rows, yaw=jnp.zeros_like(rows[0]))
    found: list[Array] = []
    for reference in (state, against_drag(vehicle, state)):
        demand = demand_of(vehicle, reference)
        squared = jnp.stack(squared_rotor_speeds(vehicle, demand.moment, vehicle.mass * demand.specific_thrust))
        found += [squared / vehicle.rotor_speed_max**2, jnp.asarray(demand.axes[2][2])[None]]
    return jnp.concatenate(found)


def _margins(
    task: Task,
    bodies: Float[Array, "n k 10"],
    distances: Float[Array, "p k"],
    places: Float[Array, "n 3 k"],
) -> Float[Array, "k c"]:
    """Margins in the order of the rows of ``linearise``, but for the variables' own bounds."""
    vehicle, limits = task.vehicle, task.limits
    least = vehicle.rotor_speed_min**2 / vehicle.rotor_speed_max**2
    offsets = jnp.stack([*[-least] * 4, *[jnp.ones_like(least)] * 4, jnp.full_like(least, -math.cos(MAX_TILT))] * 2)
    body = bodies @ jnp.asarray(_SIGNS.T, bodies.dtype) + offsets[None, None]
    lower, upper = jnp.asarray(task.world.bounds, places.dtype)[:, None, :, None]
    walls = jnp.concatenate([places - lower, upper - places], axis=1) - jnp.asarray(limits.clearance)[None, None]
    distance = distances - limits.clearance[None]
    rows = [_rows(body), PER_METRE * distance.T, PER_METRE * _rows(jnp.swapaxes(walls, 1, 2))]
    return jnp.concatenate(rows, axis=1)


def _samples(task: Task, x: Float[Array, "v k"]) -> _Samples:
    """Along the k trajectories."""
    batch = splines(task, unflatten(x))
    segments, count, axes, width = batch.position.shape
    table = jnp.asarray(derivative_table(count, _middles(PLACE_SAMPLES), 0), x.dtype)
    places = jnp.matmul(table, batch.position.reshape(segments, count, axes * width))
    faster = jnp.asarray(task.limits.dilation)[None] ** jnp.arange(5, dtype=x.dtype)[:, None]
    states = batch.derivatives(_middles(BODY_SAMPLES)) * faster[None, None, :, None]
    return _Samples(states.reshape(-1, 5, axes, width), places.reshape(-1, axes, width))


def _bounds(x: Float[Array, "v k"]) -> Float[Array, "c k"]:
    """Margins of the variables themselves: durations, the meeting ball and the stop."""
    found = unflatten(x)
    ball = 1.0 - jnp.sum(found.offset**2, axis=0, keepdims=True)
    stop = 1.0 - jnp.sum(found.stop**2, axis=0, keepdims=True) / FARTHEST_STOP**2
    low, high = found.log_durations - math.log(SHORTEST), math.log(LONGEST) - found.log_durations
    return jnp.concatenate([low, high, ball, stop])


def _lengthening(x: Float[Array, "k v"]) -> Float[Array, "k v"]:
    """First and second derivatives of the meeting times by each variable."""
    logs = unflatten(x.T).log_durations.T
    last = jnp.arange(logs.shape[1])[None] == logs.shape[1] - 1
    return jnp.zeros_like(x).at[:, : logs.shape[1]].set(jnp.where(last, 0.0, jnp.exp(logs)))


def _middles(count: int) -> Float[np.ndarray, "{count}"]:
    return (np.arange(count) + 0.5) / count


def _each(function: Callable[[Array], Any], rows: Float[Array, "n ... k"]) -> Any:
    """``function`` of each of n rows of each of k problems; results have the axes (n, k) first."""
    return jax.vmap(jax.vmap(function, in_axes=-1, out_axes=0))(rows)


def _with_jacobian(function: Callable[[Array], Array]) -> Callable[[Array], tuple[Array, Array]]:
    return lambda row: (function(row), jax.jacfwd(function)(row))


def _rows(values: Float[Array, "n k c ..."]) -> Float[Array, "k n*c ..."]:
    """All rows of a problem in one axis."""
    moved = jnp.moveaxis(values, 1, 0)
    return moved.reshape(moved.shape[0], -1, *moved.shape[3:])
