"""What the placing policy is asked in training: courses from hover, then what is left of its own flights.

A flight in progress is what a planner begins from nine times in ten, and its states are those that the policy itself
leads to. So each batch is flown on with the weights of the moment: from a random instant of each plan what is left of
it is a course of its own, to a goal that has moved, and whose points may have strayed.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxplan.arrays import AnyArray
from jaxplan.knots import resample
from jaxplan.minsnap.single import interpolate
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.numerics import safe_divide
from jaxplan.policy.placing import SEGMENTS, Courses, Distance, Placed, look_around
from jaxplan.spline import FlatStateBatch
from jaxplan.training.placing.vehicles import Fleet
from jaxplan.world.clearance import clearance
from jaxplan.world.obstacles import World

INSTANTS = 96
"""Of a flight at which it is known where the vehicle is."""
LEFT = 25
"""Points of what is left of a flight before it is cut evenly."""
CUT = (0.03, 0.9)
"""Shares of the time to the meeting between which a flight is cut."""
MOVED = np.array([0.02, 0.1, 0.3, 0.8])
"""Standard deviations by which goals move, for each second until they are met [m/s]."""
LEVEL = np.array([1.0, 1.0, 0.4])
"""How much of that along x, y and z."""
STRAYED, STRAY = 0.3, 0.15
"""Share of the courses whose points are moved at random, and by how much [m]."""
SLOWED, SLOWEST = 0.25, 0.6
"""Share of the states that are slowed down, as arrivals are matched, and to which share of their speed at most."""
CERTAIN, RADII = 0.6, (0.02, 0.3)
"""Share of the meetings of the largest radius, and the range of the others [m]."""


class Problems(NamedTuple):
    """k of them, batch axis last."""

    courses: Courses
    initial: FlatStateBatch
    good: Bool[AnyArray, "k"]
    """Whether start and meeting are free: others do not count."""


def distance_in(worlds: World, rooms: int) -> Distance:
    """Distance [m] to obstacles and faces, where lanes lie room by room: as many in each of ``worlds``."""

    def within(world: World, points: Float[Array, "n s 3"]) -> Float[Array, "n s"]:
        lower, upper = jnp.asarray(world.bounds, points.dtype)
        faces = jnp.min(jnp.minimum(points - lower[None, None], upper[None, None] - points), axis=-1)
        return jnp.minimum(clearance(world, points), faces)

    def distance(points: Float[AnyArray, "*n 3 k"]) -> Float[Array, "*n k"]:
        last = jnp.moveaxis(jnp.asarray(points), -2, -1)
        apart = jnp.moveaxis(last.reshape(-1, rooms, last.shape[-2] // rooms, 3), 1, 0)
        found = jax.vmap(within)(worlds, apart)
        return jnp.moveaxis(found, 0, 1).reshape(last.shape[:-1])

    return distance


def from_hover(
    points: Float[Array, "7 3 k"], fleet: Fleet, keep: Float[Array, "k"], distance: Distance, key: PRNGKeyArray
) -> Problems:
    """Courses flown from rest with any heading, ``keep`` [m] away from all that is solid at their ends."""
    heading_key, radius_key = jax.random.split(key)
    width = points.shape[-1]
    heading = jax.random.uniform(heading_key, (width,), points.dtype, -np.pi, np.pi)
    derivatives = jnp.zeros((5, 3, width), points.dtype).at[0].set(points[0])
    initial = FlatStateBatch(derivatives=derivatives, yaw=jnp.zeros((3, width), points.dtype).at[0].set(heading))
    return _problems(points, initial, fleet, keep, distance, radius_key)


def in_flight(
    flown: SplineBatch,
    meeting: Float[Array, "k"],
    fleet: Fleet,
    keep: Float[Array, "k"],
    distance: Distance,
    key: PRNGKeyArray,
) -> Problems:
    """What is left of flights that meet after so many seconds, from a random instant of each, to goals that moved."""
    keys = jax.random.split(key, 8)
    width, dtype = meeting.shape[0], meeting.dtype
    states, whole = flown.states(INSTANTS), jnp.sum(flown.durations, axis=0)
    places = jnp.asarray(states.derivatives)[0]
    share = jax.random.uniform(keys[0], (width,), dtype, *CUT) * meeting / whole
    index = jnp.clip(jnp.round(share * (INSTANTS - 1)), 0, INSTANTS - 6).astype(jnp.int32)
    derivatives = jnp.take_along_axis(states.derivatives, index[None, None, None], axis=2)[:, :, 0]
    yaw = jnp.take_along_axis(states.yaw, index[None, None], axis=1)[:, 0]
    begin = index.astype(dtype) / (INSTANTS - 1)
    at = begin[None] + (meeting / whole - begin)[None] * jnp.linspace(0.0, 1.0, LEFT, dtype=dtype)[:, None]
    even = jax.vmap(lambda path: resample(path, SEGMENTS), in_axes=-1, out_axes=-1)(_along(places, at))
    size = meeting - share * whole
    size *= jnp.asarray(MOVED, dtype)[jax.random.randint(keys[1], (width,), 0, len(MOVED))]
    move = size[None] * jax.random.normal(keys[2], (3, width), dtype) * jnp.asarray(LEVEL, dtype)[:, None]
    move = jnp.where((distance((even[-1] + move)[None])[0] > keep)[None], move, 0.0)
    ramp = jnp.linspace(0.0, 1.0, SEGMENTS, dtype=dtype)
    ramp = ramp[:, None] ** jnp.where(jax.random.bernoulli(keys[3], 0.5, (width,)), 2.0, 1.0)[None]
    strayed = STRAY * jax.random.normal(keys[4], (SEGMENTS - 2, 3, width), dtype)
    strayed *= jax.random.bernoulli(keys[5], STRAYED, (width,)).astype(dtype)[None, None]
    even = (even + ramp[:, None] * move[None]).at[1:-1].add(strayed)
    stop = places[:, -1] + move
    stop = jnp.where((distance(stop[None])[0] > keep)[None], stop, even[-1])
    slowed = jax.random.uniform(keys[6], (width,), dtype, SLOWEST, 1.0)
    alpha = jnp.where(jax.random.bernoulli(keys[7], SLOWED, (width,)), slowed, 1.0)
    initial = FlatStateBatch(
        derivatives=derivatives * (alpha[None] ** jnp.arange(5, dtype=dtype)[:, None])[:, None], yaw=yaw
    )
    return _problems(jnp.concatenate([even, stop[None]]), initial, fleet, keep, distance, jax.random.fold_in(key, 1))


def solved(initial: FlatStateBatch, placed: Placed) -> SplineBatch:
    """The plans: minimum snap in float64, the heading held; in float32."""
    whole = (placed.durations, placed.points, jnp.asarray(initial.derivatives)[1:])
    times, points, rows = (jnp.asarray(leaf, jnp.float64) for leaf in whole)
    position, _ = interpolate(times, points, rows)
    durations, yaw = placed.durations, jnp.asarray(initial.yaw, placed.durations.dtype)
    held = jnp.zeros((SEGMENTS, 6, 1, durations.shape[1]), durations.dtype).at[:, 0, 0].set(yaw[0])
    return SplineBatch(durations=durations, position=position.astype(durations.dtype), yaw=held)


def _problems(
    points: Float[Array, "7 3 k"],
    initial: FlatStateBatch,
    fleet: Fleet,
    keep: Float[Array, "k"],
    distance: Distance,
    key: PRNGKeyArray,
) -> Problems:
    certain_key, radius_key = jax.random.split(key)
    radius = jax.random.uniform(radius_key, keep.shape, keep.dtype, *RADII)
    radius = jnp.where(jax.random.bernoulli(certain_key, CERTAIN, keep.shape), RADII[1], radius)
    room = jnp.asarray(look_around(distance, points))
    ends = distance(jnp.stack([points[0], points[-2]]))
    courses = Courses(points, room, radius.astype(points.dtype), jnp.asarray(fleet.numbers).T)
    return Problems(courses, initial, jnp.all(ends > keep[None], axis=0))


def _along(places: Float[Array, "3 i k"], share: Float[Array, "p k"]) -> Float[Array, "p 3 k"]:
    """Between known places, at shares of the whole time."""
    at = share * (places.shape[1] - 1)
    low = jnp.clip(jnp.floor(at), 0, places.shape[1] - 2).astype(jnp.int32)
    weight = (at - low.astype(at.dtype))[None]
    before, after = (jnp.take_along_axis(places, index[None], axis=1) for index in (low, low + 1))
    return jnp.moveaxis(before + weight * (after - before), 0, 1)


def mean_of(part: Float[Array, "k"], good: Bool[AnyArray, "k"]) -> Float[Array, ""]:
    """The mean over those that count."""
    count = jnp.sum(good).astype(part.dtype)
    return safe_divide(jnp.sum(jnp.where(good, part, 0.0)), count)
