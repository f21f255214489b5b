"""What a trajectory must keep to, as margins that are positive inside, sampled along all segments.

Rotors: the squared speed of each of the four, as a share of the largest, from its least and from its largest allowed
value; tilt: the upward part of the thrust's direction, and the horizontal part of body x: the nearer it is to the
vertical, the less the vehicle's heading means. All without drag and against the drag of still air. How
fast the thrust turns, against drag. Places: exact distances to the nearest obstacle and to every face of the room.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.arrays import Scalar
from jaxplan.numerics import safe_norm
from jaxplan.optimizer.problem import Task, meeting_time, splines, unflatten
from jaxplan.polynomials import derivative_table
from jaxplan.search.kernels.solids import REACH
from jaxplan.spline import FlatState
from jaxplan.vehicle.flatness import against_drag, demand_of
from jaxplan.vehicle.limits import effort_of
from jaxplan.vehicle.mixing import squared_rotor_speeds
from jaxplan.vehicle.params import Vehicle
from jaxplan.world.clearance import clearance
from jaxplan.world.obstacles import World

SHORTEST, LONGEST = 0.08, 4.0
"""Duration of a segment [s]; shorter ones make the problem ill-conditioned (arbitrary)."""
FARTHEST_STOP = 6.0
"""From the meeting [m] (arbitrary)."""
PER_METRE = 3.0
"""Weight of a metre beside a rotor's whole range: the slack of all margins is the same (arbitrary)."""
_ONCE = np.concatenate([np.eye(4, 6), -np.eye(4, 6), np.eye(2, 6, 4)])
_SIGNS = np.block([[np.kron(np.eye(2), _ONCE), np.zeros((20, 1))], [np.zeros((1, 12)), -np.ones((1, 1))]])
"""From ``body_demand`` to its margins: every rotor has two limits."""


class Linearised(NamedTuple):
    """k problems around k points."""

    objective: Float[Array, "k"]
    gradient: Float[Array, "k v"]
    """Of the objective."""
    curvature: Float[Array, "k v"]
    """Diagonal of the objective's Hessian."""
    margins: Float[Array, "k c"]
    jacobian: Float[Array, "k c v"]


class _Samples(NamedTuple):
    """Of each segment, one behind the other."""

    states: Float[Array, "n 4 3 k"]
    """Velocity to snap [SI, world], flown ``Limits.dilation`` times as fast."""
    places: Float[Array, "p 3 k"]
    """Metres, world."""
    kept: Float[Array, "p k"]
    """Distance from all that is solid that is asked for there [m]."""


def values(task: Task, x: Float[Array, "k v"]) -> tuple[Float[Array, "k"], Float[Array, "k c"]]:
    """Meeting times [s] and margins of k trajectories."""
    found, own = _samples(task, x.T), _bounds(x.T)
    bodies = _each(_of_body(body_demand, task), found.states)
    distances = _each(functools.partial(_free, task.world), found.places)
    margins = _margins(task, bodies, distances - found.kept[:, :, None])
    return meeting_time(unflatten(x.T)), jnp.concatenate([margins, own.T], axis=1)


def linearise(task: Task, x: Float[Array, "k v"]) -> Linearised:
    """The same with derivatives: through the samples, so that each is differentiated by its own 15 numbers only."""
    width, count = x.shape
    directions = jnp.broadcast_to(jnp.eye(count, dtype=x.dtype)[:, :, None], (count, count, width))
    found, pushed = _pushed(functools.partial(_samples, task), x.T, directions)
    by_state, by_place = jnp.transpose(pushed.states, (1, 4, 2, 3, 0)), jnp.transpose(pushed.places, (1, 3, 2, 0))
    bodies, by_body = _each(_of_body(body_slopes, task), found.states)
    distances, slopes = _each(_with_jacobian(functools.partial(_free, task.world)), found.places)
    instants = len(found.states)
    body = by_body.reshape(instants, width, -1, 12) @ by_state.reshape(instants, width, 12, count)
    by_speed = jnp.transpose(pushed.kept, (1, 2, 0))[:, :, None]
    own, pushed_own = _pushed(_bounds, x.T, directions)
    own_slopes = jnp.transpose(pushed_own, (2, 1, 0))
    rows = [_rows(jnp.asarray(_SIGNS, x.dtype) @ body), _rows(PER_METRE * (slopes @ by_place - by_speed)), own_slopes]
    lengthening = _lengthening(x)
    return Linearised(
        objective=meeting_time(unflatten(x.T)),
        gradient=lengthening,
        curvature=lengthening,
        margins=jnp.concatenate([_margins(task, bodies, distances - found.kept[:, :, None]), own.T], axis=1),
        jacobian=jnp.concatenate(rows, axis=1),
    )


def body_demand(
    vehicle: Vehicle, yaw: Scalar, max_body_rate: Scalar, derivatives: Float[Array, "4 3"]
) -> Float[Array, "13"]:
    """Squared rotor speeds as shares of the largest, the thrust's upward part and the nose's part along the heading.

    Without drag, then against it. At last the squared rate at which the thrust turns, as a share of the largest.
    ``derivatives``: velocity to snap [SI, world]; the heading is held.
    """
    aloft = jax.vmap(lambda drag: _aloft(vehicle, yaw, drag, derivatives))(jnp.arange(2.0, dtype=derivatives.dtype))
    return jnp.append(aloft, _turning(vehicle, max_body_rate, derivatives))


def body_slopes(
    vehicle: Vehicle, yaw: Scalar, max_body_rate: Scalar, derivatives: Float[Array, "4 3"]
) -> tuple[Float[Array, "13"], Float[Array, "13 4 3"]]:
    """``body_demand`` and its derivatives, backwards: measured, a quarter of the time of forwards."""

    def aloft(drag: Scalar) -> tuple[Float[Array, "6"], Float[Array, "6 4 3"]]:
        value, back = jax.vjp(functools.partial(_aloft, vehicle, yaw, drag), derivatives)
        return value, jax.vmap(back)(jnp.eye(len(value), dtype=value.dtype))[0]

    values, slopes = jax.vmap(aloft)(jnp.arange(2.0, dtype=derivatives.dtype))
    turning, slope = jax.value_and_grad(functools.partial(_turning, vehicle, max_body_rate))(derivatives)
    return jnp.append(values, turning), jnp.concatenate([slopes.reshape(-1, 4, 3), slope[None]])


def _aloft(vehicle: Vehicle, yaw: Scalar, drag: Scalar, derivatives: Float[Array, "4 3"]) -> Float[Array, "6"]:
    """Of the rotors, the thrust and the nose, against a share ``drag`` of the drag."""
    rows = jnp.concatenate([jnp.zeros_like(derivatives[:1]), derivatives])
    state = FlatState(derivatives=rows, yaw=jnp.zeros_like(rows[0]).at[0].set(yaw))
    against = jnp.asarray(against_drag(vehicle, state).derivatives)
    demand = demand_of(vehicle, FlatState(derivatives=rows + drag * (against - rows), yaw=state.yaw))
    squared = jnp.stack(squared_rotor_speeds(vehicle, demand.moment, vehicle.mass * demand.specific_thrust))
    upwards, nose = demand.axes[2][2], jnp.cos(yaw) * demand.axes[0][0] + jnp.sin(yaw) * demand.axes[0][1]
    return jnp.concatenate([squared / vehicle.rotor_speed_max**2, jnp.stack([upwards, nose])])


def _turning(vehicle: Vehicle, max_body_rate: Scalar, derivatives: Float[Array, "4 3"]) -> Float[Array, ""]:
    """Squared, as a share."""
    return jnp.asarray(effort_of(vehicle, *(tuple(row) for row in derivatives[:3])).tilting / max_body_rate) ** 2


def body_margins(
    vehicle: Vehicle, max_tilt: Scalar, max_pitch: Scalar, bodies: Float[Array, "*n 13"]
) -> Float[Array, "*n 21"]:
    """From ``body_demand`` to margins that are positive inside."""
    least = vehicle.rotor_speed_min**2 / vehicle.rotor_speed_max**2
    once = [*[-least] * 4, *[jnp.ones_like(least)] * 4, -jnp.cos(max_tilt), -jnp.cos(max_pitch)]
    offsets = jnp.stack([*once, *once, jnp.ones_like(least)])
    return bodies @ jnp.asarray(_SIGNS.T, bodies.dtype) + jnp.expand_dims(offsets, tuple(range(bodies.ndim - 1)))


def _of_body(function: Callable[..., Any], task: Task) -> Callable[[Float[Array, "4 3"]], Any]:
    """``body_demand`` or ``body_slopes`` at one instant of a task."""
    return functools.partial(function, task.vehicle, jnp.asarray(task.start.yaw)[0], task.max_body_rate)


def _margins(
    task: Task,
    bodies: Float[Array, "n k 13"],
    spare: Float[Array, "p k 4"],
) -> Float[Array, "k c"]:
    """Margins in the order of the rows of ``linearise``, but for the variables' own bounds."""
    body = body_margins(task.vehicle, task.max_tilt, task.max_pitch, bodies)
    return jnp.concatenate([_rows(body), PER_METRE * _rows(spare)], axis=1)


def _free(world: World, place: Float[Array, "3"]) -> Float[Array, "4"]:
    """Metres from a place to the nearest obstacle, and to the nearer face of the room along each axis.

    An obstacle beyond ``REACH`` counts as that far.
    """
    lower, upper = jnp.asarray(world.bounds, place.dtype)
    faces = 0.5 * (upper - lower) - jnp.abs(place - 0.5 * (lower + upper))
    nearest = jnp.minimum(clearance(world, place), REACH)
    return jnp.concatenate([nearest[None], faces])


def _samples(task: Task, x: Float[Array, "v k"]) -> _Samples:
    """Along the k trajectories."""
    batch, limits = splines(task, unflatten(x)), task.limits
    segments, count, axes, width = batch.position.shape
    middles, flat = _middles(task.place_samples), batch.position.reshape(segments, count, axes * width)
    places, moving = (
        jnp.matmul(jnp.asarray(derivative_table(count, middles, order), x.dtype), flat).reshape(-1, axes, width)
        for order in (0, 1)
    )
    rate = jnp.repeat(batch.rate(), len(middles), axis=0)
    grown = limits.per_speed[None] * (rate * safe_norm(moving, axis=1) - limits.slow[None])
    faster = jnp.asarray(limits.dilation)[None] ** jnp.arange(1, 5, dtype=x.dtype)[:, None]
    states = batch.derivatives(_middles(task.body_samples))[:, :, 1:] * faster[None, None, :, None]
    kept = jnp.asarray(limits.clearance)[None] + jnp.clip(grown, 0.0, limits.most[None])
    return _Samples(states.reshape(-1, 4, axes, width), places, kept)


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
    """``function`` and its derivatives by each of its numbers, traced once for both."""

    def both(row: Array) -> tuple[Array, Array]:
        directions = jnp.eye(row.size, dtype=row.dtype).reshape(row.size, *row.shape)
        value, slopes = _pushed(function, row, directions)
        return value, jnp.moveaxis(slopes, 0, -1).reshape(*value.shape, *row.shape)

    return both


def _pushed(function: Callable[[Array], Any], x: Float[Array, "*n"], directions: Float[Array, "d *n"]) -> Any:
    """``function`` and its derivatives along each of d directions."""

    def push(direction: Float[Array, "*n"]) -> Any:
        return jax.jvp(function, (x,), (direction,))

    return jax.vmap(push, out_axes=(None, 0))(directions)


def _rows(values: Float[Array, "n k c ..."]) -> Float[Array, "k n*c ..."]:
    """All rows of a problem in one axis."""
    moved = jnp.moveaxis(values, 1, 0)
    return moved.reshape(moved.shape[0], -1, *moved.shape[3:])
