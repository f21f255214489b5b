"""What is minimised: the time to meet a target whose motion is known, from rest, as one minimum-snap spline.

    min   T = T_1 + ... + T_(m-1)                                  the meeting knot is the last but one
    over  log T_1 .. log T_m, the inner waypoints p_1 .. p_(m-2), an offset u and the stop vector b
    with  p_(m-1) = target(T) + r u, |u| <= 1,   p_m = p_(m-1) + b, where the vehicle is at rest
    and   every margin of ``margins.py`` at or above 0 at samples of every segment

The path between is minimum snap through these waypoints with these durations (``minsnap.single.interpolate``), so all
of it depends smoothly on the variables. Layout: **the batch is the last axis**, as in ``minsnap``.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplan.arrays import AnyArray
from jaxplan.minsnap.single import POSITION_ORDER, interpolate
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.records import record
from jaxplan.vehicle.params import Vehicle
from jaxplan.world.obstacles import World


@record
class Limits:
    """What each of k trajectories must keep to."""

    clearance: Float[AnyArray, "k"]
    """Metres from the vehicle's centre to the nearest obstacle or face of the room, at every sample."""
    meet_radius: Float[AnyArray, "k"]
    """Metres from the target at the meeting."""
    dilation: Float[AnyArray, "k"]
    """The body must be able to fly the trajectory so many times as fast as it is flown."""


@record
class TargetTable:
    """A target's motion from the plan's start on, at even intervals; cubic between them, at rest at its end behind."""

    interval: Float[AnyArray, ""]
    """Seconds."""
    position: Float[AnyArray, "n 3"]
    """Metres, world."""
    velocity: Float[AnyArray, "n 3"]
    """Metres per second, world."""

    def at(self, times: Float[Array, "k"]) -> Float[Array, "3 k"]:
        """Where the target is ``times`` [s] after the plan's start [m, world]."""
        steps = jnp.clip(times / self.interval, 0.0, len(self.position) - 1.0)
        index = jnp.clip(jnp.floor(steps).astype(jnp.int32), 0, len(self.position) - 2)
        s = (steps - index.astype(steps.dtype))[None]
        left, right = jnp.asarray(self.position)[index].T, jnp.asarray(self.position)[index + 1].T
        slope, next_slope = (self.interval * jnp.asarray(self.velocity)[i].T for i in (index, index + 1))
        step = right - left
        return left + s * (
            slope + s * ((3.0 * step - 2.0 * slope - next_slope) + s * (slope + next_slope - 2.0 * step))
        )


@record
class Task:
    """One interception, to be optimised from k starts."""

    start: Float[AnyArray, "3"]
    """Where the vehicle hovers [m, world]."""
    target: TargetTable
    world: World
    vehicle: Vehicle
    limits: Limits


class Variables(NamedTuple):
    """What is optimised, for each of k starts."""

    log_durations: Float[AnyArray, "m k"]
    """Of seconds; the last segment leads from the meeting to the stop."""
    inner: Float[AnyArray, "i 3 k"]
    """The i = m - 2 waypoints between start and meeting [m, world]."""
    offset: Float[AnyArray, "3 k"]
    """Of the meeting point from the target, in units of the meeting radius."""
    stop: Float[AnyArray, "3 k"]
    """From the meeting point to where the vehicle comes to rest [m, world]."""


def flatten(variables: Variables) -> Float[Array, "v k"]:
    """All variables of a start in one column."""
    width = variables.offset.shape[-1]
    return jnp.concatenate([jnp.reshape(part, (-1, width)) for part in variables])


def unflatten(flat: Float[Array, "v k"]) -> Variables:
    """The inverse of ``flatten``: v = 4 m."""
    m, width = flat.shape[0] // 4, flat.shape[1]
    return Variables(
        log_durations=flat[:m],
        inner=flat[m : 4 * m - 6].reshape(m - 2, 3, width),
        offset=flat[4 * m - 6 : 4 * m - 3],
        stop=flat[4 * m - 3 :],
    )


def meeting_time(variables: Variables) -> Float[Array, "k"]:
    """Seconds from the plan's start to the meeting."""
    return jnp.sum(jnp.exp(variables.log_durations[:-1]), axis=0)


def waypoints(task: Task, variables: Variables) -> Float[Array, "n 3 k"]:
    """The n = m + 1 waypoints, start and stop included [m, world]."""
    meet = task.target.at(meeting_time(variables)) + jnp.asarray(task.limits.meet_radius)[None] * variables.offset
    start = jnp.broadcast_to(jnp.asarray(task.start)[:, None], meet.shape)
    return jnp.concatenate([start[None], variables.inner, meet[None], (meet + variables.stop)[None]])


def splines(task: Task, variables: Variables) -> SplineBatch:
    """The minimum-snap trajectories, with the heading held at 0."""
    durations, points = jnp.exp(variables.log_durations), waypoints(task, variables)
    width = points.shape[-1]
    position, _ = interpolate(durations, points, jnp.zeros((POSITION_ORDER, 3, width), points.dtype))
    yaw = jnp.zeros((len(durations), 6, 1, width), points.dtype)
    return SplineBatch(durations=durations, position=position, yaw=yaw)
