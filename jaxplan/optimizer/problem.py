"""What is minimised: the time to meet a target whose motion is known, as one minimum-snap spline from a flat state.

    min   T = T_1 + ... + T_(m-1)                                  the meeting knot is the last but one
    over  log T_1 .. log T_m, the inner waypoints p_1 .. p_(m-2), an offset u and the stop vector b
    with  p_(m-1) = target(T) + r u, |u| <= 1,   p_m = p_(m-1) + b, where the vehicle is at rest
    and   every margin of ``margins.py`` at or above 0 at samples of every segment

The path between is minimum snap through these waypoints with these durations (``minsnap.single.interpolate``), so all
of it depends smoothly on the variables. Layout: **the batch is the last axis**, as in ``minsnap``.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.arrays import AnyArray
from jaxplan.minsnap.single import interpolate
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.records import record, static
from jaxplan.spline import FlatState
from jaxplan.vehicle.params import Vehicle
from jaxplan.world.obstacles import World


@record
class Limits:
    """What each of k trajectories must keep to."""

    clearance: Float[AnyArray, "k"]
    """Metres from the vehicle's centre to the nearest obstacle or face of the room, at every sample."""
    slow: Float[AnyArray, "k"]
    """Speed [m/s] from which it is more."""
    per_speed: Float[AnyArray, "k"]
    """How much more [m per m/s]."""
    most: Float[AnyArray, "k"]
    """The most that it is more [m]."""
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
    offset: Float[AnyArray, "3 k"]
    """Where each of k targets flies, beside the one that the table shows [m]."""

    def at(self, times: Float[Array, "k"]) -> Float[Array, "3 k"]:
        """Where the targets are ``times`` [s] after the plan's start [m, world]."""
        steps = jnp.clip(times / self.interval, 0.0, len(self.position) - 1.0)
        index = jnp.clip(jnp.floor(steps).astype(jnp.int32), 0, len(self.position) - 2)
        s = (steps - index.astype(steps.dtype))[None]
        left, right = jnp.asarray(self.position)[index].T, jnp.asarray(self.position)[index + 1].T
        slope, next_slope = (self.interval * jnp.asarray(self.velocity)[i].T for i in (index, index + 1))
        step = right - left
        return (
            jnp.asarray(self.offset)
            + left
            + s * (slope + s * ((3.0 * step - 2.0 * slope - next_slope) + s * (slope + next_slope - 2.0 * step)))
        )


@record
class Task:
    """One interception, to be optimised from k starts."""

    start: FlatState
    """Where the plan begins; its heading is held."""
    target: TargetTable
    world: World
    vehicle: Vehicle
    limits: Limits
    max_tilt: Float[AnyArray, ""]
    """Of the thrust from the vertical [rad]; far beyond 1.4 plans flip over and are not tracked."""
    max_pitch: Float[AnyArray, ""]
    """Of body x from the horizontal [rad]."""
    max_body_rate: Float[AnyArray, ""]
    """Fastest turn of the thrust [rad/s], against drag; may be infinite."""
    body_samples: int = static(default=12)
    """Instants of a segment at which the body is looked at."""
    place_samples: int = static(default=36)
    """Instants of a segment at which the distance to obstacles is: at 17 m/s and 0.3 s they are 0.14 m apart. With 12
    vehicles cut the corners of walls."""


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


def flatten(variables: Variables) -> Float[np.ndarray, "v k"]:
    """All variables of a start in one column (host)."""
    width = variables.offset.shape[-1]
    return np.concatenate([np.reshape(part, (-1, width)) for part in variables])


def unflatten(flat: Float[Array, "v k"]) -> Variables:
    """The inverse of ``flatten``: v = 4 m."""
    m, width = flat.shape[0] // 4, flat.shape[1]
    return Variables(
        log_durations=flat[:m],
        inner=flat[m : 4 * m - 6].reshape(m - 2, 3, width),
        offset=flat[4 * m - 6 : 4 * m - 3],
        stop=flat[4 * m - 3 :],
    )


def slowed(flat: Float[np.ndarray, "v"], factor: float) -> Float[np.ndarray, "v"]:
    """The variables of one start with all durations so many times as long (host)."""
    longer = np.zeros(len(flat))
    longer[: len(flat) // 4] = np.log(factor)
    return flat + longer


def meeting_time(variables: Variables) -> Float[Array, "k"]:
    """Seconds from the plan's start to the meeting."""
    return jnp.sum(jnp.exp(variables.log_durations[:-1]), axis=0)


def waypoints(task: Task, variables: Variables) -> Float[Array, "n 3 k"]:
    """The n = m + 1 waypoints, start and stop included [m, world]."""
    meet = task.target.at(meeting_time(variables)) + jnp.asarray(task.limits.meet_radius)[None] * variables.offset
    start = jnp.broadcast_to(jnp.asarray(task.start.pos)[:, None], meet.shape)
    return jnp.concatenate([start[None], variables.inner, meet[None], (meet + variables.stop)[None]])


def splines(task: Task, variables: Variables) -> SplineBatch:
    """The minimum-snap trajectories, with the heading held."""
    durations, points = jnp.exp(variables.log_durations), waypoints(task, variables)
    width = points.shape[-1]
    begin = task.start.repeated(width)
    position, _ = interpolate(durations, points, jnp.asarray(begin.derivatives)[1:])
    yaw = jnp.zeros((len(durations), 6, 1, width), points.dtype).at[:, 0, 0].set(jnp.asarray(begin.yaw)[0])
    return SplineBatch(durations=durations, position=position, yaw=yaw)
